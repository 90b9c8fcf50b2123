"""Drive four servos through the contract of a servo bus: the front left tendon goes to 1 rad.

The servos are emulated. For real ones the bus is `brand.make_bus(brand.read_settings())`, and the
program waits for `PERIOD` where it advances the emulated servos.
"""

from slot_core.servos.registry import read_brand

PERIOD = 0.01  # s, between two bus cycles
REST = [0.2, 0.2, 0.2, 0.2]  # rad, tendon angles FL FR RL RR
GOAL = [1.0, 0.2, 0.2, 0.2]  # rad
LOAD = [0.3, 0.3, 0.3, 0.3]  # N m, of the tendons on their spools
VOLTAGE = 11.1  # V

brand, time = read_brand(), [0.0]
servos = brand.emulate(REST, VOLTAGE)
bus = servos.connect(lambda: time[0])

print(*bus.configure(), sep="\n")
bus.activate()  # torque on, without motion
for cycle in range(61):
    bus.command(GOAL)
    reading = bus.cycle().readings[0]
    # None: the servo has not answered
    if cycle % 10 == 0 and reading is not None:
        print(
            f"{time[0]:.1f} s: {reading.angle:.3f} rad, {reading.load:.0%} of the stall torque"
        )
    servos.advance(PERIOD, LOAD)
    time[0] += PERIOD
print("torque off" if bus.torque_off().complete else "torque NOT off")
bus.close()

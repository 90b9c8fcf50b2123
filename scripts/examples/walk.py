"""Walks the simulated robot with its whole controller, in one process and without ROS."""

import numpy as np

from slot_core.simulation.closed_loop import ClosedLoop

# forward and to the left m/s, yaw rate rad/s
VELOCITY = np.array([0.05, 0.0, 0.0])

loop = ClosedLoop("flat", "walk", VELOCITY, seed=1)
# what an estimator cannot know: its state, and the forces on it
robot = loop.plant.robot
for n, tick in enumerate(loop.run(ticks=300)):  # 30 a second
    if n in {150, 156}:  # a push of 3 N to the left for 0.2 s
        robot.push([0.0, 3.0 if n == 150 else -3.0, 0.0], [0.0, 0.0, 0.0])
    if n % 30 == 0:
        roll, pitch, yaw, x, y, z = tick.estimate.state[:6]
        angles = np.degrees(tick.command.angle).round(1)
        print(
            f"{n / 30:4.1f} s: x {x:5.3f} m, y {y:5.3f} m, yaw {yaw:5.2f} rad, tendons {angles} deg"
        )

print(
    f"true position {robot.position.round(3)} m, ground forces\n{robot.ground_force.round(2)} N"
)

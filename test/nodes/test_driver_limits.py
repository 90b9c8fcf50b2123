"""Time limits of driver and servos, as in config/."""

import numpy as np
import pytest
from rig import RAMP, servo_angle
from stub_supervisor import DRIVER

from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.messages import decode
from slot_core.safety.commands import Action
from slot_msgs.msg import RobotState

LATE = 0.02  # s, from a limit to the reaction: two bus cycles
FRAME = 0.033  # s, between two true states of the legs


@pytest.fixture
def rig(simulate):
    made = simulate(hardware="fake_bus", only=["sim_robot", DRIVER])
    yield made
    made.close()


def first(rig, action, since):
    """Wait for an action after a time and after the last PASS; returns the stamp of its report."""
    number = decode.ACTION_NUMBERS.index(action)

    def found():
        reports = rig.since("/servo_health", since)
        passes = [k for k, m in enumerate(reports) if m.action == RobotState.ACTION_PASS]
        return [m for m in reports[passes[-1] + 1 if passes else 0 :] if m.action == number]

    return decode.stamp(rig.wait_for(found, what=f"never {action}")[0])


@pytest.mark.parametrize("what", ["command", "message of the supervisor"])
def test_missing_messages_end_in_hold_after_100_ms_and_relax_after_500_ms(rig, stub, what):
    stub.move_to(1.0)
    silent = stub.stop_sending(what)
    relaxed = first(rig, Action.RELAX, silent)  # after it no PASS can follow
    held = first(rig, Action.HOLD, silent)
    off = rig.wait_for_torque_off(relaxed)
    times = [(time - silent) * 1e-9 for time in (held, relaxed, decode.stamp(off))]
    assert 0.1 <= times[0] <= 0.1 + LATE
    assert 0.5 <= times[1] <= 0.5 + LATE
    assert times[2] - times[1] <= RAMP + LATE
    assert off.reason.startswith(f"torque off, after: no {what} for 0.5")


def test_the_servos_stop_within_200_ms_of_the_drivers_kill(rig, stub):
    """The driver is killed while all tendons are on their way to 1.9 rad."""
    stub.move_to(0.3)
    begin = rig.now()
    stub.angle = 1.9
    rig.wait_for(lambda: max(rig.last("/joint_states").position) > 0.6)
    killed = rig.kill(DRIVER)
    end = killed + 1_000_000_000
    rig.wait_for(lambda: decode.stamp(rig.last("/ground_truth/legs")) > end)
    assert rig.registers("bus_watchdog") == [-1] * 4
    zero, pulled = servo_angle(0.0), servo_angle(1.9)
    goals = np.array(rig.registers("goal_position")) * RAD_PER_COUNT
    assert zero < goals.min() <= goals.max() < pulled - 0.2  # they have stopped on their way
    stopped = legs_stopped(rig.since("/ground_truth/legs", begin))
    assert (stopped - killed) * 1e-9 <= 0.2 + FRAME


def legs_stopped(truth):
    """Time (ns) from which no leg's chord changes by more than 1 mm a frame."""
    nodes = np.array([np.reshape(m.position, (4, -1, 3)) for m in truth])
    chord = np.linalg.norm(nodes[:, :, -1] - nodes[:, :, 0], axis=2)
    moving = np.abs(np.diff(chord, axis=0)).max(axis=1) > 1e-3
    return decode.stamp(truth[int(np.flatnonzero(moving)[-1]) + 1])

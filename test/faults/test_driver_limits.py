"""Time limits of driver and servos themselves, as in config/: only the bus is given more time."""

import signal

import numpy as np
import pytest
from boss import Boss
from rig import LATE, RAMP

from slot_core.bags import decode
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.safety.command_gate import Action
from slot_msgs.msg import RobotState

DRIVER = "dynamixel_driver"
BUS = {"  timeout: 0.008": "  timeout: 0.05"}
LONG_WATCHDOG = {"  watchdog: 0.1": "  watchdog: 1.0"}
FRAME = 0.033  # s, between two true states of the legs


@pytest.fixture
def rig(make_rig, request):
    made = make_rig(only=["sim_robot", DRIVER], config={"dynamixel.yaml": BUS | request.param})
    yield made
    made.close()


@pytest.fixture
def boss(rig):
    made = Boss(rig)
    yield made
    made.close()


def first(rig, action, since):
    """Stamp of the first report of an action after a time and after the last PASS; waits for it.

    A busy machine may have held for a moment before.
    """
    number = decode.ACTION_NUMBERS.index(action)

    def found():
        reports = rig.since("/servo_health", since)
        passed = [k for k, m in enumerate(reports) if m.action == RobotState.ACTION_PASS]
        return [m for m in reports[passed[-1] + 1 if passed else 0 :] if m.action == number]

    return decode.stamp(rig.wait_for(found, what=f"never {action}")[0])


@pytest.mark.parametrize("rig", [LONG_WATCHDOG], indirect=True, ids=["patient bus"])
@pytest.mark.parametrize("what", ["command", "message of the supervisor"])
def test_silence_is_hold_after_100_ms_and_relax_after_500_ms(rig, boss, what):
    boss.lead(1.0)
    silent = boss.fall_silent(what)
    relaxed = first(rig, Action.RELAX, silent)  # then the last PASS is known
    held = first(rig, Action.HOLD, silent)
    off = rig.slack(relaxed)
    times = [(time - silent) * 1e-9 for time in (held, relaxed, decode.stamp(off))]
    assert 0.1 <= times[0] <= 0.1 + LATE
    assert 0.5 <= times[1] <= 0.5 + LATE
    assert times[2] - times[1] <= RAMP + LATE
    assert off.reason.startswith(f"torque off, after: no {what} for 0.5")


@pytest.mark.parametrize("rig", [{}], indirect=True, ids=["0.1 s of watchdog"])
def test_a_killed_driver_leaves_servos_that_stop_within_200_ms(rig, boss):
    """Killed while all tendons are pulled by half a turn, of which they have done a part."""
    boss.lead(0.3)
    begin = rig.now()
    boss.angle = 1.9
    rig.wait_for(lambda: max(rig.last("/joint_states").position) > 0.6)
    killed = rig.send(DRIVER, signal.SIGKILL)
    end = killed + 1_000_000_000
    rig.wait_for(lambda: decode.stamp(rig.last("/ground_truth/legs")) > end)
    assert rig.registers("bus_watchdog") == [-1] * 4
    zero, pulled = (np.radians(130.0) + 1.03199 * angle for angle in (0.0, 1.9))
    goals = np.array(rig.registers("goal_position")) * RAD_PER_COUNT
    assert zero < goals.min() <= goals.max() < pulled - 0.2  # where it stopped, on its way
    stopped = legs_stopped(rig.since("/ground_truth/legs", begin))
    assert (stopped - killed) * 1e-9 <= 0.2 + FRAME


def legs_stopped(truth):
    """Time (ns) from which on no leg's chord changes faster than 1 mm in a frame."""
    nodes = np.array([np.reshape(m.position, (4, -1, 3)) for m in truth])
    chord = np.linalg.norm(nodes[:, :, -1] - nodes[:, :, 0], axis=2)
    moving = np.abs(np.diff(chord, axis=0)).max(axis=1) > 1e-3
    return decode.stamp(truth[int(np.flatnonzero(moving)[-1]) + 1])

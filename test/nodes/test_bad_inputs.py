"""Bad inputs of estimator, MPC and servos, while the robot walks.

The test changes the messages between the nodes. Times are those of the messages' stamps. What the
supervisor makes of each fault is shown without messages: test/safety, test/simulation.
"""

import math

import pytest
from rig import TICK
from sensor_msgs.msg import Imu

from slot_core.control.policy import Status
from slot_core.messages import decode
from slot_core.mpc.settings import read_mpc
from slot_core.safety.states import State
from slot_msgs.msg import ForceMapStatus, MpcState, TendonPlan
from slot_nodes import qos

STEP = 0.021  # s, between two steps of the supervisor, with the latency of a message
NAN = math.nan


@pytest.fixture(scope="module")
def rig(simulate):
    """A robot with simulated servos; its MPC has few iterations more than usual problems need."""
    made = simulate(parameters={"mpc_controller": {"solver.iterations": 20}})
    made.subscribe("/mpc_state", MpcState, qos.CONTROL)
    made.subscribe("/force_map/status", ForceMapStatus, qos.CONTROL)
    made.subscribe("/tendon_plan", TendonPlan, qos.CONTROL)
    made.subscribe("/imu", Imu, qos.SENSOR)
    return made


def time_to_hold(rig, begin):
    """Wait for HOLD; returns the seconds since `begin`."""
    return (rig.wait_for_state(State.HOLD, begin)[0] - begin) * 1e-9


def wait_for_warning(rig, begin, part):
    """Wait for a warning since `begin` that contains `part`."""

    first = max(len(rig.messages["/robot_state"]) - 100, 0)

    def found():
        states = [m for m in rig.messages["/robot_state"][first:] if decode.stamp(m) >= begin]
        return any(part in warning for state in states for warning in state.warnings)

    rig.wait_for(found, what=f"no warning {part!r}")


def wait_for_walking(rig):
    """Wait until the robot walks again, without a request."""
    rig.wait_for_state(State.WALKING, rig.now())


def test_an_mpc_without_solutions_ends_in_hold_after_its_fallback(walking):
    """Two causes in turn: problems without a solution, and inputs that are rejected."""

    def infeasible(message):
        message.posture = True
        angle = list(message.tendon_angle)
        message.tendon_angle = angle[:4] + [9.0] * (len(angle) - 4)  # rad, after the first stage

    def invalid(message):
        message.friction = [NAN] * len(message.friction)

    most = read_mpc().fallback.cycles
    for change, status in ((infeasible, Status.NOT_SOLVED), (invalid, Status.REJECTED)):
        before = len(walking.messages["/tendon_plan"])
        with walking.changed("gait_preview", change) as begin:
            wait_for_warning(walking, begin, f"MPC stopped, {most + 1} cycles without a solution")
            assert time_to_hold(walking, begin) < (most + 3) * TICK + STEP
        wait_for_walking(walking)
        failed = [m for m in walking.messages["/tendon_plan"][before:] if m.message]
        assert [m.status for m in failed[:most]] == [status] * most
        assert failed[most].status == Status.STOPPED
        assert not len(failed[most].angle)


def test_stand_is_refused_while_the_mpc_is_always_late(walking):
    walking.wait_for_state(State.FAULT, walking.kill("mpc_controller"))
    walking.start("mpc_controller", parameters={"acceptance.time_budget": 1e-6})
    wait_for_warning(walking, walking.now(), "MPC stopped, ")
    assert walking.request("reset") == ""
    assert walking.request("ready") == ""
    assert walking.request("stand").startswith("STAND refused in READY: MPC stopped, ")
    status = walking.last("/tendon_plan")
    assert status.status == Status.STOPPED
    assert "ms exceed 0.001 ms" in status.message
    walking.kill("mpc_controller")
    walking.start("mpc_controller")
    walking.walk()

"""Bad inputs of estimator, MPC, force map and servos, while the robot walks.

The test changes the messages between the nodes. Times are those of the messages' stamps.
"""

import copy
import itertools
import math

import numpy as np
import pytest
from rig import TICK
from sensor_msgs.msg import Imu

from slot_core.control.policy import Status
from slot_core.estimation.estimate import Validity
from slot_core.messages import decode
from slot_core.mpc.settings import read_mpc
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import ForceMapStatus, MpcState, TendonPlan
from slot_nodes import qos

COAST = read_supervisor().estimate.coast_cycles
APPROACH = read_supervisor().gate.approach_rate  # rad/s
STEP = 0.021  # s, between two steps of the supervisor, with the latency of a message
ANGLE_MAX = read_robot().tendon.angle_max  # 116.28 deg
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


@pytest.fixture
def walking(rig):
    rig.walk_steadily()
    return rig


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


def lose_position(message):
    message.pose.pose.position.x = NAN


def test_odometry_that_is_nan_is_bridged_for_three_cycles_then_ends_in_hold(walking):
    before = len(walking.messages["/mpc_state"])
    with walking.changed("odom", lose_position) as begin:
        wait_for_warning(walking, begin, "estimates in a row unusable, limit 3")
        assert time_to_hold(walking, begin) < 5 * TICK + STEP
    wait_for_walking(walking)
    after = walking.messages["/mpc_state"][before:]
    lost = [m for m in after if m.validity == Validity.ODOMETRY_REJECTED]
    assert len(lost) > COAST
    assert all(np.isfinite(decode.estimate(message).state).all() for message in lost)


def test_missing_odometry_ends_in_hold(walking):
    with walking.changed("odom", lambda _: False) as begin:
        assert time_to_hold(walking, begin) < walking.limit("command_hold") + TICK + STEP
    walking.walk()  # after a reset, if a busy machine has caused a RELAX


def test_a_jump_of_10_cm_is_rejected_and_accepted_once_it_lasts(walking):
    def jump(message):
        message.pose.pose.position.x += 0.1

    before = len(walking.messages["/mpc_state"])
    with walking.changed("odom", jump) as begin:
        wait_for_warning(walking, begin, "estimates in a row unusable, limit 3")
        assert time_to_hold(walking, begin) < 5 * TICK + STEP
        wait_for_walking(walking)
    after = walking.messages["/mpc_state"][before - 1 :]
    rejected = [m.position.x for m in after if m.validity == Validity.ODOMETRY_REJECTED][:4]
    # four ticks of walking at 60 mm/s, predicted from the IMU: much less than the jump
    assert max(rejected) - after[0].position.x < 0.05
    walking.walk()


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


@pytest.mark.parametrize("value", [NAN, math.inf, -0.1, ANGLE_MAX + 0.1])
def test_a_command_with_a_bad_angle_is_rejected_as_a_whole_and_ends_in_hold(walking, value):
    def damage(message):
        message.position = [0.0, 0.0, 0.0, value]

    with walking.changed("desired_joint_angles", damage) as begin:
        wait_for_warning(walking, begin, "command RR = ")
        assert time_to_hold(walking, begin) < 2 * TICK + STEP
        # the three good angles are not followed either
        assert min(angle_after(walking, begin)) > 0.1
    wait_for_walking(walking)


def angle_after(rig, begin, seconds=0.1):
    """Measured tendon angles (4,), rad, `seconds` after `begin`."""
    joints = rig.messages["/joint_states"]
    rig.wait_for(lambda: decode.stamp(joints[-1]) > begin + seconds * 1e9)
    return joints[-1].position


def test_a_step_larger_than_the_rate_limit_is_slewed_with_a_warning(walking):
    ends = itertools.cycle([0.0, ANGLE_MAX])

    def jump(message):
        message.position = [next(ends)] * 4

    def no_warnings():
        return not any(m.warnings for m in walking.messages["/robot_state"][-15:])  # 0.3 s

    walking.wait_for(no_warnings)  # the gait itself is within the limit
    with walking.changed("desired_joint_angles", jump) as begin:
        wait_for_warning(walking, begin, "command slewed")
    walking.walk()


def test_a_robot_that_stands_up_moves_at_most_at_the_approach_rate(walking):
    """The servos alone would turn at 6 rad/s."""
    assert walking.request("relax") == ""
    walking.wait_for(lambda: walking.state is State.IDLE)
    assert walking.request("ready") == ""
    walking.wait_for(lambda: walking.request("stand") == "")
    begin = walking.now()
    walking.wait_for(lambda: min(walking.last("/joint_states").position) > 0.9)
    taken = (decode.stamp(walking.last("/joint_states")) - begin) * 1e-9
    assert taken > (0.9 - 0.1) / APPROACH
    walking.walk()


def test_planned_angles_beyond_the_largest_are_clipped_and_reported(walking):
    def pull(message):
        message.angle = [3.0] * len(message.angle)

    with walking.changed("tendon_plan", pull) as begin:

        def saturated():
            return [m for m in walking.since("/force_map/status", begin) if any(m.saturated)]

        walking.wait_for(saturated)
    status = saturated()[0]
    commands = walking.wait_for(
        lambda: [
            m
            for m in walking.messages["/desired_joint_angles"]
            if m.header.stamp == status.header.stamp
        ]
    )
    command = commands[0]
    for angle, unclamped, clamped in zip(
        command.position, status.angle_unclamped, status.saturated
    ):
        assert angle == pytest.approx(ANGLE_MAX if clamped else unclamped, abs=1e-12)
        assert clamped == (unclamped > ANGLE_MAX)
    walking.walk()


@pytest.mark.parametrize(
    ("topic", "profile", "warning"),
    [
        ("odom", qos.SENSOR, "estimate stamped -"),
        ("imu", qos.SENSOR, ""),
        ("joint_states", qos.SENSOR, "joints stamped -"),
        ("desired_joint_angles", qos.CONTROL, "command stamped -"),
    ],
)
def test_messages_stamped_in_simulated_time_are_rejected(walking, topic, profile, warning):
    """The warning lasts until the next message of the present, a few ms later."""
    publisher = walking.publisher(None, topic, profile)
    begin = walking.now()
    for number in range(5):
        foreign = copy.deepcopy(walking.last(f"/{topic}"))
        foreign.header.stamp.sec = 10
        foreign.header.stamp.nanosec = 1_000_000 * number
        publisher.publish(foreign)
        walking.run(0.1)
    if warning:
        wait_for_warning(walking, begin, warning)
    walking.run(1.0)
    walking.walk()


def test_servos_reject_commands_stamped_by_another_clock(walking):
    """Commands do not pass through the supervisor: the servos check the stamps themselves."""

    def slacken(message):
        message.header.stamp.sec -= 10
        message.position = [0.0] * 4

    with walking.changed("desired_joint_angles", slacken) as begin:
        walking.wait_for_state(State.HOLD, begin)
        assert min(angle_after(walking, begin)) > 0.1
        line = "desired_joint_angles refused: stamped -1"
        walking.wait_for(lambda: line in walking.log("sim_robot"))
    walking.walk()


@pytest.mark.parametrize("shift", [10, -10])
def test_a_jump_of_the_sensors_clock_ends_in_hold_and_restarts_the_filter(walking, shift):
    def move(message):
        message.header.stamp.sec += shift

    with walking.changed("odom", move) as begin:
        wait_for_warning(walking, begin, f"estimate stamped {'+' if shift > 0 else '-'}")
        assert time_to_hold(walking, begin) < walking.limit("command_hold") + TICK + STEP
    before = len(walking.messages["/mpc_state"])
    walking.walk()
    assert Validity.INITIALISING in [m.validity for m in walking.messages["/mpc_state"][before:]]

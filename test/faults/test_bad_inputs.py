"""What estimator, MPC, force map and servos make of bad inputs, while the robot walks in real time.

The test relays what passes between the nodes. Times are those of the messages' stamps.
"""

import copy
import itertools
import math

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from relay import FOR_RELAYS, SOURCES, Relay, remaps
from sensor_msgs.msg import Imu, JointState

from slot_core.bags import decode
from slot_core.control.mpc.mpc import Status, read_mpc
from slot_core.control.state_estimator import Validity
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import ForceMapStatus, MpcState
from slot_nodes import qos

TICK = 0.033  # s, between two odometry readings
BUSY = 0.3  # s that a busy machine may add
COAST = read_supervisor().estimate.coast_cycles
APPROACH = 1.0  # rad/s, of FOR_RELAYS
ANGLE_MAX = read_robot().tendon.angle_max  # 116.28 deg
NAN = math.nan


@pytest.fixture(scope="module")
def rig(make_rig):
    """A robot on simulated servos; its MPC has the iterations for usual problems, and few more."""
    made = make_rig(
        hardware="sim",
        config=FOR_RELAYS,
        remaps=remaps(*SOURCES),
        parameters={"mpc_controller": {"solver.iterations": 20}},
    )
    made.relays = {topic: Relay(made, topic) for topic in SOURCES}
    for topic, kind in (("/mpc_state", MpcState), ("/force_map/status", ForceMapStatus)):
        made.listen(topic, kind, qos.CONTROL)
    made.listen("/ground_reaction_forces", SOURCES["ground_reaction_forces"][1], qos.CONTROL)
    return made


@pytest.fixture
def walking(rig):
    rig.walk_on()
    return rig


def held(rig, begin):
    """Seconds from `begin` to HOLD."""
    return (rig.reached(State.HOLD, begin)[0] - begin) * 1e-9


def warned(rig, begin, words):
    """Wait for a warning since `begin` that holds `words`."""

    first = max(len(rig.heard["/robot_state"]) - 100, 0)

    def found():
        states = [m for m in rig.heard["/robot_state"][first:] if decode.stamp(m) >= begin]
        return any(words in warning for state in states for warning in state.warnings)

    rig.wait_for(found, what=f"no warning {words!r}")


def walks_again(rig):
    """Without anybody asking for it."""
    rig.reached(State.WALKING, rig.now())


def lose_position(message):
    message.pose.pose.position.x = NAN


def test_odometry_that_is_no_number_is_coasted_over_for_three_cycles_then_held(walking):
    before = len(walking.heard["/mpc_state"])
    with walking.relays["odom"].changed(lose_position) as begin:
        warned(walking, begin, "estimates in a row unusable, limit 3")
        assert held(walking, begin) < 5 * TICK + BUSY
    walks_again(walking)
    after = walking.heard["/mpc_state"][before:]
    lost = [m for m in after if m.validity == Validity.ODOMETRY_REJECTED]
    assert len(lost) > COAST
    assert all(np.isfinite(decode.state(message)[1]).all() for message in lost)


def test_odometry_that_stays_away_is_held_for(walking):
    with walking.relays["odom"].changed(lambda _: False) as begin:
        assert held(walking, begin) < walking.limit("command_hold") + TICK + BUSY
    walking.walk()  # where a busy machine made it longer than command_lost, after a reset


def test_a_jump_of_10_cm_is_rejected_and_believed_once_it_stays(walking):
    def jump(message):
        message.pose.pose.position.x += 0.1

    before = len(walking.heard["/mpc_state"])
    with walking.relays["odom"].changed(jump) as begin:
        warned(walking, begin, "estimates in a row unusable, limit 3")
        assert held(walking, begin) < 5 * TICK + BUSY
        walks_again(walking)
    after = walking.heard["/mpc_state"][before - 1 :]
    rejected = [m.position.x for m in after if m.validity == Validity.ODOMETRY_REJECTED][:4]
    # four ticks of walking at 60 mm/s, and of coasting on the IMU: far from the jump
    assert max(rejected) - after[0].position.x < 0.05
    walking.walk()


def test_an_mpc_without_solutions_stops_the_gait_after_its_fallback(walking):
    """Both causes, one after the other: problems too hard for its iterations, inputs it refuses."""

    def too_hard(message):
        message.reference = [value + 9e3 for value in message.reference]

    def impossible(message):
        message.friction = [NAN] * len(message.friction)

    most = read_mpc().fallback.cycles
    for change, status in ((too_hard, Status.NOT_SOLVED), (impossible, Status.REJECTED)):
        before = len(walking.heard["/ground_reaction_forces"])
        with walking.relays["gait_preview"].changed(change) as begin:
            warned(walking, begin, f"limit {most}")
            assert held(walking, begin) < (most + 3) * TICK + BUSY
        walks_again(walking)
        failed = [m for m in walking.heard["/ground_reaction_forces"][before:] if m.message]
        assert [m.status for m in failed[:most]] == [status] * most
        assert failed[most].status == Status.STOPPED
        assert all(force == Vector3() for force in failed[most].force)


def test_an_mpc_that_is_always_late_lets_nobody_stand_up(walking):
    walking.reached(State.FAULT, walking.kill("mpc_controller"))
    walking.start("mpc_controller", parameters={"acceptance.time_budget": 1e-6})
    warned(walking, walking.now(), "no solution for")
    assert walking.ask("reset") == ""
    assert walking.ask("ready") == ""
    assert walking.ask("stand").startswith("STAND refused in READY: no solution for ")
    status = walking.last("/ground_reaction_forces")
    assert status.status == Status.STOPPED
    assert "ms exceed 0.001 ms" in status.message
    walking.kill("mpc_controller")
    walking.start("mpc_controller")
    walking.walk()


@pytest.mark.parametrize("value", [NAN, math.inf, -0.1, ANGLE_MAX + 0.1])
def test_a_command_with_one_bad_angle_is_refused_as_a_whole_and_held_for(walking, value):
    def spoil(message):
        message.position = [0.0, 0.0, 0.0, value]

    with walking.relays["desired_joint_angles"].changed(spoil) as begin:
        warned(walking, begin, "command RR = ")
        assert held(walking, begin) < 2 * TICK + BUSY
        assert min(angle_after(walking, begin)) > 0.1  # the good three are not obeyed either
    walks_again(walking)


def angle_after(rig, begin, seconds=0.1):
    """Measured tendon angles `seconds` after `begin`, rad."""
    joints = rig.heard["/joint_states"]
    rig.wait_for(lambda: decode.stamp(joints[-1]) > begin + seconds * 1e9)
    return joints[-1].position


def test_a_step_larger_than_the_rate_allows_is_slewed_and_flagged(walking):
    ends = itertools.cycle([0.0, ANGLE_MAX])

    def jump(message):
        message.position = [next(ends)] * 4

    def calm():
        return not any(m.warnings for m in walking.heard["/robot_state"][-15:])  # 0.3 s

    walking.wait_for(calm)  # the usual gait is not too fast
    with walking.relays["desired_joint_angles"].changed(jump) as begin:
        warned(walking, begin, "command slewed")
    walking.walk()


def test_a_standing_robot_follows_a_step_no_faster_than_it_approaches(walking):
    """The servos alone would turn at 6 rad/s."""
    assert walking.ask("stand") == ""
    stood = walking.now()
    start = angle_after(walking, stood, 2.0)

    def slacken(message):
        message.position = [0.0] * 4

    with walking.relays["desired_joint_angles"].changed(slacken) as begin:
        walking.wait_for(lambda: max(walking.last("/joint_states").position) < 0.1)
        taken = (decode.stamp(walking.last("/joint_states")) - begin) * 1e-9
    assert taken > (max(start) - 0.1) / APPROACH - BUSY
    walking.walk()


def test_forces_beyond_the_map_are_clamped_to_the_last_angle_and_flagged(walking):
    def pull(message):
        message.force = [Vector3(z=100.0)] * 4

    with walking.relays["ground_reaction_forces"].changed(pull) as begin:

        def saturated():
            return [m for m in walking.since("/force_map/status", begin) if any(m.saturated)]

        walking.wait_for(saturated)
    status = saturated()[0]
    commands = walking.wait_for(
        lambda: [
            m
            for m in walking.heard["/desired_joint_angles"]
            if m.header.stamp == status.header.stamp
        ]
    )
    command = commands[0]
    for angle, wanted, hit in zip(command.position, status.angle_unclamped, status.saturated):
        assert angle == pytest.approx(ANGLE_MAX if hit else wanted, abs=1e-12)
        assert hit == (wanted > ANGLE_MAX)
    walking.walk()


@pytest.mark.parametrize(
    ("topic", "kind", "profile", "words"),
    [
        ("odom", *SOURCES["odom"][1:], "estimate stamped -"),
        ("imu", Imu, qos.SENSOR, ""),
        ("joint_states", JointState, qos.SENSOR, "joints stamped -"),
        ("desired_joint_angles", *SOURCES["desired_joint_angles"][1:], "command stamped -"),
    ],
)
def test_messages_in_simulated_time_among_those_in_wall_time_are_refused(
    walking, topic, kind, profile, words
):
    heard = walking.heard[f"/{topic}"]
    if not heard:
        walking.listen(f"/{topic}", kind, profile)
    walking.wait_for(lambda: heard)
    publisher = walking.node.create_publisher(kind, topic, profile)
    foreign = copy.deepcopy(heard[-1])
    foreign.header.stamp.sec = 10
    begin = walking.now()
    for _ in range(5):
        foreign.header.stamp.nanosec += 1_000_000
        publisher.publish(foreign)
    if words:
        warned(walking, begin, words)
    walking.wait_for(lambda: walking.now() - begin > 1e9)
    walking.walk()
    walking.node.destroy_publisher(publisher)


def test_servos_refuse_commands_of_another_clock(walking):
    """The wire goes past the supervisor: they look themselves."""

    def slacken(message):
        message.header.stamp.sec -= 10
        message.position = [0.0] * 4

    with walking.relays["desired_joint_angles"].changed(slacken) as begin:
        walking.reached(State.HOLD, begin)
        assert min(angle_after(walking, begin)) > 0.1
        told = "desired_joint_angles refused: stamped -1"
        walking.wait_for(lambda: told in walking.log("sim_robot"))
    walking.walk()


@pytest.mark.parametrize("shift", [10, -10])
def test_a_jump_of_the_sensors_clock_is_held_for_and_the_filter_begins_anew(walking, shift):
    def move(message):
        message.header.stamp.sec += shift

    with walking.relays["odom"].changed(move) as begin:
        warned(walking, begin, f"estimate stamped {'+' if shift > 0 else '-'}")
        assert held(walking, begin) < walking.limit("command_hold") + TICK + BUSY
    before = len(walking.heard["/mpc_state"])
    walking.walk()
    assert Validity.INITIALISING in [m.validity for m in walking.heard["/mpc_state"][before:]]

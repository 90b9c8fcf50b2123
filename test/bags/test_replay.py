"""The cores reproduce the recorded bags; a change is reported by topic, stamp and field.

Bags with records of the stages replay in whatever order their readings came, also from a cut.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from real_graph import set_values
from std_msgs.msg import String

from slot_core import config
from slot_core.clock import to_seconds
from slot_core.control.force_map import read_springs
from slot_core.estimation.inertial_filter import NO_ODOMETRY
from slot_core.estimation.state_estimator import read_estimator
from slot_core.estimation.unaided_estimator import make_estimator
from slot_core.key_frame import capture
from slot_core.messages import decode
from slot_core.recording.bag_writer import BagWriter, message_types
from slot_core.recording.origin import FILES, Origin, origin_here
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_lab.bags import check_bag as replay
from slot_lab.bags import replay_command
from slot_lab.bags.bag import Bag
from slot_lab.bags.replayed_stages import READERS, RECORDS, TAKERS
from slot_lab.bags.topics import SENSORS
from slot_msgs.msg import StageRecord
from slot_nodes import messages

HERE, TYPES = Path(__file__).parent, message_types()
WALK = HERE / "walk"
SIZE_MAX = 700_000  # bytes of a bag in the repository
STATES = [*SENSORS, "/mpc_state", RECORDS]  # what the first stage needs
TOPICS = [
    "/mpc_state",
    "/gait_preview",
    "/tendon_plan",
    "/desired_joint_angles",
]


def first_differences(path=WALK):
    return {
        c.topic: c.first
        for c in replay.check_bag(Bag(path), replay_command.TOLERANCE)
    }


@pytest.mark.parametrize(
    "name", ["walk", "turn", "path", "fault", "lost_odometry"]
)
def test_a_recorded_bag_is_small_and_replays(name):
    assert (
        sum(file.stat().st_size for file in (HERE / name).iterdir()) < SIZE_MAX
    )
    comparisons = replay.check_bag(Bag(HERE / name), replay_command.TOLERANCE)
    assert [c.topic for c in comparisons] == TOPICS
    for comparison in comparisons:
        assert comparison.first is None, str(comparison.first)
        assert comparison.compared > 40


@pytest.mark.parametrize(
    ("file", "name", "value", "topic"),
    [
        ("estimator", "odometry.position_noise", 0.002, "/mpc_state"),
        ("gait", "acceleration", 0.11, "/gait_preview"),
        ("gait/walk", "forward.speed", 0.07, "/gait_preview"),
        ("rollout_mpc", "cost.height", 3e-3, "/tendon_plan"),
    ],
)
def test_a_change_shows_only_at_its_own_stage(
    own_config, file, name, value, topic
):
    set_values(own_config, {file: {name: value}})
    differences = first_differences()
    assert differences.pop(topic) is not None
    assert set(differences.values()) == {None}


@pytest.mark.parametrize(
    ("node", "changes"), [("mpc_controller", True), ("force_mapper", False)]
)
def test_the_parameter_file_of_a_run_is_that_of_its_replay(
    tmp_path, node, changes
):
    """A bag that says of a walk with the shipped settings that one was changed."""
    source = Bag(WALK).origin
    assert FILES["params_file"] not in source.files
    text = f"/**/{node}:\n  ros__parameters: {{cost.height: 0.003}}\n"
    origin = replace(
        source, files=source.files | {FILES["params_file"]: text.encode()}
    )
    found = first_differences(part(tmp_path / "bag", origin=origin))
    assert (found.pop("/tendon_plan") is not None) == changes
    assert set(found.values()) == {None}


def test_the_first_difference_is_reported(own_config, capsys):
    set_values(own_config, {"rollout_mpc": {"cost.height": 3e-3}})
    assert replay_command.main([str(WALK)]) == 1
    line = capsys.readouterr().out.strip().splitlines()[-1]
    assert line.startswith("first difference: /tendon_plan at 1.")
    assert " s: angle[" in line


def part(path, *topics, name="walk", share=0.0, origin=None):
    """Copy of topics of a bag; of one after a share of its states, without records of the stages.

    origin: default the bag's.
    """
    source = Bag(HERE / name)
    times = [time for time, _ in source.messages("/mpc_state")]
    begin = times[int(share * len(times))] if share else 0
    origin = origin or source.origin
    with BagWriter(path, read_record_settings(), origin) as bag:
        for topic, time, data in source.raw(*topics):
            if time >= begin and not (share and topic == RECORDS):
                bag.write(topic, source.topics[topic], time, data)
    return path


def test_stages_that_a_bag_does_not_hold_are_left_out_by_name(tmp_path, capsys):
    """And the gait of a path that it only names, as a bag of `ros2 bag record` does."""
    origin = Origin({"path": "way.csv"})
    path = part(tmp_path / "bag", *STATES, "/gait_preview", origin=origin)
    assert replay_command.main([str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()[-4:]
    assert lines[0].split()[2] == "compared,"
    missing = "way.csv", "/tendon_plan", "/desired_joint_angles, /tendon_plan"
    for line, name in zip(lines[1:], missing):
        assert line.endswith(f"left out: the bag holds no {name}")


def test_readings_that_the_node_refuses_are_left_out(tmp_path):
    """An IMU without a rate (REP 145), odometry of another frame, joints without names."""
    source, path = Bag(WALK), tmp_path / "bag"
    with BagWriter(path, read_record_settings()) as bag:
        for topic, time, data in source.raw(*STATES):
            kind = source.topics[topic]
            message = TYPES.deserialize_cdr(data, kind)
            if topic == "/imu":
                message.angular_velocity_covariance = np.full(9, -1.0)
            if topic == "/odom":
                message.child_frame_id = "camera_link"
            if topic == "/joint_states":
                message.name = []
            if topic in SENSORS:
                bag.write(topic, kind, time, TYPES.serialize_cdr(message, kind))
            bag.write(topic, kind, time, data)
    (states, *_) = replay.check_bag(Bag(path), replay_command.TOLERANCE)
    assert states.compared > 40
    assert states.first is None


@pytest.mark.parametrize("topic", SENSORS)
def test_the_estimator_is_left_out_if_the_bag_lacks_a_sensor_that_it_has_taken(
    tmp_path, topic
):
    held = [name for name in (*STATES, "/gait_preview") if name != topic]
    (states, *_) = replay.check_bag(Bag(part(tmp_path / "bag", *held)), 0.0)
    assert states.why == f"the bag holds no {topic}"


@pytest.mark.parametrize(
    ("name", "share"), [("walk", 0.2), ("walk", 0.5), ("turn", 0.5)]
)
def test_a_bag_that_begins_mid_run_says_so_and_compares_the_stage_without_memory(
    tmp_path, capsys, name, share
):
    """The first share begins among the states that are initialising, the others in the walk."""
    assert (
        replay_command.main(
            [str(part(tmp_path / "bag", name=name, share=share))]
        )
        == 0
    )
    *left_out, last = capsys.readouterr().out.splitlines()[-4:]
    assert [line.split()[0] for line in left_out] == TOPICS[:3]
    assert all("left out: the bag begins mid-run" in line for line in left_out)
    assert re.match(
        r"/desired_joint_angles +\d\d compared, largest difference 0.0e\+00",
        last,
    )


def test_a_bag_of_which_no_stage_can_be_compared_is_refused(tmp_path, refusal):
    line = refusal(
        replay_command.main, part(tmp_path / "bag", *STATES, share=0.5)
    )
    assert "the bag begins mid-run" in line
    assert line.endswith("; no stage can be compared")
    line = refusal(replay_command.main, part(tmp_path / "in", "/odom", "/imu"))
    assert "holds no stage together with its input" in line


def test_replay_says_what_made_the_bag_and_how_its_configuration_differs(
    own_config, tmp_path, capsys
):
    origin = origin_here({"scene": "flat", "seed": 1})
    path = part(tmp_path / "bag", *STATES, origin=origin)
    assert replay_command.main([str(path)]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert re.fullmatch(
        r"recorded by  revision \S.*, scene flat, seed 1", first
    )
    assert second.startswith("/mpc_state")
    set_values(own_config, {"rollout_mpc": {"cost.height": 3e-3}})
    assert replay_command.main([str(path)]) == 0
    shown = capsys.readouterr().out
    assert "its configuration differs in rollout_mpc.yaml\n" in shown


def test_the_policy_that_the_bag_names_is_replayed(tmp_path):
    """The recorded plans are of the default policy, which plans angles."""
    path = part(
        tmp_path / "bag", *TOPICS, origin=Origin({"policy": "paper_text"})
    )
    found = [first is None for first in first_differences(path).values()]
    assert found[1:] == [True, False, True]


LATENCY = 40_000_000  # ns, at most, of a reading
EVERY = 12  # records from a key frame to the next


class Recording:
    """A state estimator that takes readings in an order of its own, and what is recorded of it."""

    def __init__(self, seed, state=False, topics=SENSORS, source="topic"):
        """Take the walk's readings, each after a latency; state: whether there are key frames.

        source: of the odometry.
        """
        rng = np.random.default_rng(seed)
        settings = read_estimator()
        settings = config.replace(settings, {"odometry.source": source})
        estimator = make_estimator(settings, read_robot(), read_springs())
        self.origin = Origin({"odometry": source})
        self.entries, self.number, self.taken, self.stamp = [], 0, [], 0
        self._record(0, "")
        source = Bag(WALK)
        readings = list(source.merged(*topics))
        stamps = [decode.stamp(message) for *_, message in readings]
        late = stamps + rng.integers(0, LATENCY, len(stamps))
        for k in np.argsort(late):
            topic, _, message = readings[k]
            kind, now = source.topics[topic], int(late[k])
            self.entries.append(
                (stamps[k], topic, kind, TYPES.serialize_cdr(message, kind))
            )
            self.taken.append((SENSORS.index(topic), stamps[k]))
            getattr(estimator, TAKERS[topic])(*READERS[topic](message))
            while (estimate := estimator.poll()) is not None:
                self.stamp = estimate.stamp
                self.write(now, "/mpc_state", messages.state_to_msg(estimate))
                due = state and self.number % EVERY == 0
                self._record(now + 1, capture(estimator) if due else "")

    def _record(self, now, state):
        topics, stamps = zip(*self.taken) if self.taken else ((), ())
        record = StageRecord(
            header=messages.header(self.stamp),
            node="state_estimator",
            number=self.number,
            taken=topics,
            stamp=stamps,
            state=state,
        )
        self.number, self.taken = self.number + 1, []
        self.write(now, "/stage_record", record)

    def write(self, now, topic, message):
        kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
        self.entries.append((now, topic, kind, serialize_message(message)))

    def bag(self, path, keep=lambda k, entry: True):
        """The bag of the entries to keep, in the order of their times."""
        with BagWriter(path, read_record_settings(), self.origin) as bag:
            ordered = sorted(self.entries, key=lambda entry: entry[0])
            for k, (time, topic, kind, data) in enumerate(ordered):
                if keep(k, (time, topic)):
                    bag.write(topic, kind, time + 10**9, data)
        return path


def states(path):
    (found, *_) = replay.check_bag(Bag(path), 0.0)
    return found


@pytest.mark.parametrize("seed", range(4))
def test_the_order_in_which_the_estimator_took_its_readings_is_replayed(
    tmp_path, seed
):
    recording = Recording(seed)
    path = recording.bag(tmp_path / "bag")
    found = states(path)
    assert found.compared == Bag(path).counts["/mpc_state"] > 40
    assert found.largest == 0.0


def test_the_estimator_without_odometry_is_replayed_without_it(tmp_path):
    recording = Recording(0, topics=SENSORS[1:], source=NO_ODOMETRY)
    found = states(recording.bag(tmp_path / "bag"))
    assert found.compared > 40
    assert found.largest == 0.0


@pytest.mark.parametrize("share", [0.1, 0.4, 0.6])
def test_a_bag_begun_in_mid_run_is_compared_from_its_first_key_frame_on(
    tmp_path, share
):
    recording = Recording(1, state=True)
    times = [entry[0] for entry in recording.entries]
    begin = np.quantile([t for t in times if t], share)
    found = states(
        recording.bag(tmp_path / "bag", lambda _, entry: entry[0] >= begin)
    )
    assert found.compared > 4
    assert (found.largest, found.gaps) == (0.0, 0)
    assert f", from {to_seconds(found.begin):.3f} s on" in str(found)


@pytest.mark.parametrize("topic", [*SENSORS, "/stage_record"])
def test_after_a_lost_message_the_replay_goes_on_at_the_next_key_frame(
    tmp_path, topic
):
    recording = Recording(2, state=True)
    ordered = sorted(recording.entries, key=lambda entry: entry[0])
    places = [k for k, entry in enumerate(ordered) if entry[1] == topic]
    lost = places[len(places) // 3]
    path = recording.bag(tmp_path / "bag", lambda k, _: k != lost)
    found = states(path)
    assert found.largest == 0.0
    assert 0 < found.gaps <= 2 * EVERY
    assert found.compared + found.gaps == Bag(path).counts["/mpc_state"]
    if topic in SENSORS:
        assert re.search(
            rf"; \d+ are not: {topic} at \d+\.\d+ s is not in the bag",
            str(found),
        )


def test_the_output_of_a_node_of_a_users_own_is_left_out_and_its_node_named(
    tmp_path,
):
    recording = Recording(3)
    nodes = json.dumps({"/mpc_state": ["/fred/my_filter"]})
    recording.write(1, "/recorded_nodes", String(data=nodes))
    path = recording.bag(tmp_path / "bag")
    with pytest.raises(replay.BagError, match="no stage can be compared"):
        replay.check_bag(Bag(path), 0.0)
    (found, *_) = replay.check_bag(Bag(path), 0.0, only=["state_estimator"])
    assert found.compared > 40
    assert str(found).endswith("; published by /fred/my_filter")


@pytest.mark.parametrize("option", ["--skip", "--only"])
def test_stages_are_left_out_at_request_with_a_line_that_says_so(
    capsys, option
):
    assert replay_command.main([str(WALK), option, "mpc_controller"]) == 0
    lines = {
        line.split()[0]: line for line in capsys.readouterr().out.splitlines()
    }
    for topic in replay.STAGES:
        left_out = f"left out: {option} mpc_controller" in lines[topic]
        assert left_out == ((topic == "/tendon_plan") == (option == "--skip"))

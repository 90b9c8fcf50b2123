"""The cores reproduce the recorded bags; a change is reported by topic, stamp and field."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from real_graph import set_values
from record_bags import SIZE_MAX
from rosbags.rosbag2 import Reader
from synthetic_walk import TYPES

from slot_core.estimation.estimate import Validity
from slot_core.recording.bag_writer import BagWriter, MessageType
from slot_core.recording.origin import FILES, Origin, origin_here
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags import check_bag as replay
from slot_lab.bags import replay_command
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_stages import RECORDS

HERE = Path(__file__).parent
BAGS = ["walk", "turn", "path", "fault", "lost_odometry"]
WALK = HERE / "walk"
STATES = ["/odom", "/imu", "/mpc_state"]  # what the first stage needs
TOPICS = ["/mpc_state", "/gait_preview", "/tendon_plan", "/desired_joint_angles"]


def first_differences(path=WALK):
    return {
        c.topic: c.first for c in replay.check_bag(Bag(path), replay_command.TOLERANCE)
    }


@pytest.mark.parametrize("name", BAGS)
def test_a_recorded_bag_is_small_and_replays(name):
    assert sum(file.stat().st_size for file in (HERE / name).iterdir()) < SIZE_MAX
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
def test_a_change_shows_only_at_its_own_stage(own_config, file, name, value, topic):
    set_values(own_config, {file: {name: value}})
    differences = first_differences()
    assert differences.pop(topic) is not None
    assert set(differences.values()) == {None}


@pytest.mark.parametrize(
    ("node", "changes"), [("mpc_controller", True), ("force_mapper", False)]
)
def test_the_parameter_file_of_a_run_is_that_of_its_replay(tmp_path, node, changes):
    """A bag that says of a walk with the shipped settings that one was changed."""
    source = Bag(WALK).origin
    assert FILES["params_file"] not in source.files
    text = f"/**/{node}:\n  ros__parameters: {{cost.height: 0.003}}\n"
    origin = replace(source, files=source.files | {FILES["params_file"]: text.encode()})
    found = first_differences(partly(tmp_path / "bag", Bag(WALK).counts, origin=origin))
    assert (found.pop("/tendon_plan") is not None) == changes
    assert set(found.values()) == {None}


def test_the_first_difference_is_reported(own_config, capsys):
    set_values(own_config, {"rollout_mpc": {"cost.height": 3e-3}})
    assert replay_command.main([str(WALK)]) == 1
    line = capsys.readouterr().out.strip().splitlines()[-1]
    assert line.startswith("first difference: /tendon_plan at 1.0")
    assert " s: angle[" in line


def partly(path, topics, **changes):
    """Copy of some topics of the walk, with its definitions of their types.

    changes: `names` replaces theirs, `late` delays them (ns); `origin` of the copy.
    """
    source, names = Bag(WALK), changes.get("names", {})
    with (
        Reader(WALK) as reader,
        BagWriter(path, read_record_settings(), changes.get("origin")) as bag,
    ):
        for c in (c for c in reader.connections if c.topic in topics):
            kind = MessageType(c.msgtype, c.msgdef.data, digest=c.digest)
            bag.add_topic(names.get(c.topic, c.topic), kind)
        for topic, time, data in source.raw(*topics):
            name = names.get(topic, topic)
            late = changes.get("late", {}).get(topic, 0)
            bag.write(name, source.topics[topic], time + late, data)
    return path


def test_stages_that_a_bag_does_not_hold_are_left_out_by_name(tmp_path, capsys):
    path = partly(tmp_path / "bag", [*STATES, "/gait_preview"])
    assert replay_command.main([str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[2] for line in lines[:2]] == ["compared,"] * 2
    assert lines[2].endswith("left out: the bag holds no /tendon_plan")
    assert lines[3].endswith(
        "left out: the bag holds no /desired_joint_angles, /tendon_plan"
    )


def test_readings_that_the_node_refuses_are_left_out(tmp_path):
    """An IMU that says it has no rate (REP 145), odometry of another frame."""
    source, path = Bag(WALK), tmp_path / "bag"
    with BagWriter(path, read_record_settings()) as bag:
        for topic, time, data in source.raw("/odom", "/imu", "/mpc_state"):
            kind = source.topics[topic]
            bag.write(topic, kind, time, data)
            message = TYPES.deserialize_cdr(data, kind)
            if topic == "/imu":
                message.angular_velocity_covariance = np.full(9, -1.0)
            elif topic == "/odom":
                message.child_frame_id = "camera_link"
                message.pose.pose.position.x += 1.0
            else:
                continue
            bag.write(topic, kind, time, bytes(TYPES.serialize_cdr(message, kind)))
    (states, *_) = replay.check_bag(Bag(path), replay_command.TOLERANCE)
    assert states.compared > 40
    assert states.first is None


@pytest.mark.parametrize("delay", [-12_000_000, 12_000_000])
def test_the_order_in_which_odometry_and_imu_were_recorded_changes_nothing(
    tmp_path, delay
):
    """The recorder receives odometry 12 ms before or after the estimator did."""
    path = partly(tmp_path / "bag", STATES, late={"/odom": delay})
    (states, *_) = replay.check_bag(Bag(path), replay_command.TOLERANCE)
    assert states.compared == Bag(WALK).counts["/mpc_state"]
    assert states.first is None


def test_odometry_before_the_estimator_listened_changes_nothing(tmp_path):
    """The recorder was connected to the robot 0.5 s before the estimator was."""
    source, path, early = Bag(WALK), tmp_path / "bag", 500_000_000
    with BagWriter(path, read_record_settings()) as bag:
        for topic, time, message in source.merged("/odom", "/imu"):
            stamp = message.header.stamp
            at = stamp.sec * 10**9 + stamp.nanosec - early
            if at < 10**9:  # the walk's first stamp is 1 s
                stamp.sec, stamp.nanosec = divmod(at, 10**9)
                kind = source.topics[topic]
                bag.write(
                    topic, kind, time - early, bytes(TYPES.serialize_cdr(message, kind))
                )
        for topic, time, data in source.raw("/odom", "/imu", "/mpc_state"):
            bag.write(topic, source.topics[topic], time, data)
    (states, *_) = replay.check_bag(Bag(path), replay_command.TOLERANCE)
    assert states.compared == source.counts["/mpc_state"]
    assert states.first is None


def cut(path, share, name="walk", topics=()):
    """Copy of what a bag holds after a share of its states, without records of the stages."""
    source = Bag(HERE / name)
    times = [time for time, _ in source.messages("/mpc_state")]
    begin = times[int(share * len(times))]
    with BagWriter(path, read_record_settings(), source.origin) as bag:
        for topic, time, data in source.raw(*topics):
            if time >= begin and topic != RECORDS:
                bag.write(topic, source.topics[topic], time, data)
    return path


@pytest.mark.parametrize(
    ("name", "share"), [("walk", 0.2), ("walk", 0.5), ("turn", 0.5)]
)
def test_a_bag_that_begins_mid_run_says_so_and_compares_the_stage_without_memory(
    tmp_path, capsys, name, share
):
    """The first share begins among the states that are initialising, the others in the walk."""
    assert replay_command.main([str(cut(tmp_path / "bag", share, name))]) == 0
    *left_out, last = capsys.readouterr().out.splitlines()[-4:]
    assert [line.split()[0] for line in left_out] == TOPICS[:3]
    assert all("left out: the bag begins mid-run" in line for line in left_out)
    assert re.match(
        r"/desired_joint_angles +\d\d compared, largest difference 0.0e\+00", last
    )


def test_a_bag_that_begins_mid_run_without_the_force_map_is_refused(tmp_path, refusal):
    line = refusal(replay_command.main, cut(tmp_path / "bag", 0.5, topics=STATES))
    assert "the bag begins mid-run" in line
    assert line.endswith("; no stage can be compared")


def test_what_a_bag_says_of_itself_cannot_command_the_terminal(tmp_path, capsys):
    about, files = (
        {"revision": "\x1b]0;x\x07", "gait": "\x9b2J"},
        {"config.zip": b"no zip"},
    )
    path = partly(tmp_path / "bag", STATES, origin=Origin(about, files))
    assert replay_command.main([str(path)]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == r"recorded by  revision \x1b]0;x\x07, gait \x9b2J"
    assert (
        "its configuration cannot be read: config.zip: File is not a zip file" in second
    )


def test_a_bag_without_any_stage_is_refused(tmp_path, capsys):
    assert replay_command.main([str(partly(tmp_path / "bag", ["/odom", "/imu"]))]) == 2
    assert "holds no stage together with its input" in capsys.readouterr().err


def test_topics_of_other_names_are_replayed_by_their_new_ones(tmp_path, capsys):
    names = {"/odom": "/visual_slam/odometry", "/imu": "/camera/imu"}
    path = partly(tmp_path / "bag", STATES, names=names)
    remaps = [
        word for new, old in names.items() for word in ("--remap", f"{old}:={new}")
    ]
    assert replay_command.main([str(path), *remaps]) == 0
    assert re.match(r"/mpc_state +4\d compared", capsys.readouterr().out)


def test_replay_says_what_made_the_bag_and_how_its_configuration_differs(
    own_config, tmp_path, capsys
):
    origin = origin_here({"scene": "flat", "seed": 1})
    path = partly(tmp_path / "bag", STATES, origin=origin)
    assert replay_command.main([str(path)]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"recorded by  revision \S.*, scene flat, seed 1", first)
    assert second.startswith("/mpc_state")
    set_values(own_config, {"rollout_mpc": {"cost.height": 3e-3}})
    assert replay_command.main([str(path)]) == 0
    shown = capsys.readouterr().out
    assert "its configuration differs in rollout_mpc.yaml\n" in shown


def test_the_policy_that_the_bag_names_is_replayed(tmp_path):
    """The recorded plans are of the default policy, which plans angles."""
    path = partly(tmp_path / "bag", TOPICS, origin=Origin({"policy": "paper_text"}))
    first = first_differences(path)
    assert first["/gait_preview"] is None
    assert first["/tendon_plan"] is not None
    assert first["/desired_joint_angles"] is None


def test_a_path_that_the_bag_lacks_leaves_out_the_gait_by_name(tmp_path, capsys):
    """As in a bag of `ros2 bag record`, which has the path's name without its file."""
    path = partly(
        tmp_path / "bag", [*STATES, "/gait_preview"], origin=Origin({"path": "way.csv"})
    )
    assert replay_command.main([str(path)]) == 0
    assert "left out: the bag holds no way.csv" in capsys.readouterr().out


def test_what_is_left_of_a_cut_off_bag_is_replayed(tmp_path, capsys):
    whole = partly(tmp_path / "whole", STATES)
    data = (whole / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[:-20])
    assert replay_command.main([str(tmp_path / "cut.mcap")]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"unfinished   what is left of it: \d\.\d\d s", first)
    assert second.startswith("/mpc_state")


def test_the_bags_hold_what_they_are_named_after():
    """Else a bag recorded afresh could replay without the case that it is there for."""
    turn = Bag(HERE / "turn").series("/gait_preview", "velocity", "reference")
    assert turn["velocity"][-1, 2] == pytest.approx(0.11)
    assert turn["reference"][-1, 2] > 0.05  # rad, yaw of the reference at the end
    assert "path.csv" in Bag(HERE / "path").origin.files
    validity = Bag(HERE / "lost_odometry").series("/mpc_state", "validity")["validity"]
    assert (
        np.count_nonzero(validity == Validity.ODOMETRY_REJECTED) > 15
    )  # marked as lost
    torque = Bag(HERE / "fault").series("/joint_states", "effort")["effort"]
    assert not torque[-20:, 0].any()  # FL's tendon
    assert torque[-20:, 1:].all()
    *_, (_, last) = Bag(HERE / "fault").messages("/robot_state")
    assert "broken tendon FL" in last.reason

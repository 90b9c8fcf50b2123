"""Bags: an independent reader gets what was written; damage is reported in one line."""

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from synthetic_walk import (
    TOPICS,
    TYPES,
    WALL,
    Walk,
    encode,
    message,
    write_old,
    write_walk,
)

from slot_core.messages import decode
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.origin import Origin
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags.bag import Bag, BagError, NoFieldError
from slot_lab.bags.topics import LEG_STATES

SETTINGS = read_record_settings()


@pytest.fixture(scope="module")
def walk_bag(tmp_path_factory):
    """Half a second of a walk, with every recorded type of slot_msgs."""
    return write_walk(tmp_path_factory.mktemp("bags") / "walk", Walk(duration=0.5))


def write(path, *entries):
    with BagWriter(path, SETTINGS) as bag:
        for topic, time, data in entries:
            bag.write(topic, TOPICS[topic], time, data)
    return path


def independent_messages(path):
    with next(path.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (m.channel.topic, m.message.log_time, m.message.data, m.decoded_message)
            for m in reader.iter_decoded_messages()
        ]


def plain(value):
    """Nested lists and mappings of a message's values, for the message classes of any library."""
    if isinstance(value, bytes):  # a scalar to NumPy
        return list(value)
    if isinstance(value, (str, bool, int, float)) or np.isscalar(value):
        return value
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    names = getattr(value, "__slots__", None) or list(vars(value))
    fields = [
        n for n in names if not n.startswith("_") and not n.isupper()
    ]  # without constants
    return {n: plain(getattr(value, n)) for n in fields}


@pytest.mark.parametrize("effort", [[], [0.1]])
def test_messages_that_rclpy_has_serialized_are_read(tmp_path, effort):
    """As by a user's program with rosbag2_py; without velocities it adds eight bytes."""
    joints = JointState(name=["FL"], position=[0.5], effort=effort)
    data = serialize_message(joints)
    path = write(tmp_path / "bag", ("/joint_states", WALL, data))
    ((_, read),) = Bag(path).messages("/joint_states")
    assert (read.name, [*read.position], [*read.effort]) == (["FL"], [0.5], effort)
    for wrong in (data[:30], data + bytes(80)):
        path = write(tmp_path / str(len(wrong)), ("/joint_states", WALL, wrong))
        with pytest.raises(BagError, match="cannot be read"):
            list(Bag(path).messages("/joint_states"))


def test_every_field_reads_the_same_with_an_independent_library(walk_bag):
    ours = [
        (topic, time, plain(built)) for topic, time, built in Bag(walk_bag).merged()
    ]
    theirs = [
        (topic, time, plain(built))
        for topic, time, _, built in independent_messages(walk_bag)
    ]
    raw = [entry[:3] for entry in independent_messages(walk_bag)]
    assert sorted(Bag(walk_bag).raw()) == sorted(raw)
    assert {topic for topic, _, _ in ours} >= {
        t for t, name in TOPICS.items() if "slot_" in name
    }
    key = lambda entry: (entry[1], entry[0])  # noqa: E731
    assert sorted(ours, key=key) == sorted(theirs, key=key)


def test_type_hashes_are_those_of_the_ros_installation(walk_bag):
    prefixes = [
        Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    ]
    checked = set()
    for name in set(TOPICS.values()):
        package, _, stem = name.split("/")
        for path in (p / "share" / package / "msg" / f"{stem}.json" for p in prefixes):
            if path.is_file():
                listed = json.loads(path.read_text())["type_hashes"]
                hashes = {h["type_name"]: h["hash_string"] for h in listed}
                assert TYPES.hash_rihs01(name) == hashes[name], name
                checked.add(package)
                break
    assert {"slot_msgs", "nav_msgs"} <= checked


def test_bag_offers_the_recorded_quality_of_service(walk_bag):
    information = yaml.safe_load((walk_bag / "metadata.yaml").read_text())
    listed = information["rosbag2_bagfile_information"]["topics_with_message_count"]
    topics = [entry["topic_metadata"] for entry in listed]
    offered = {t["name"]: t["offered_qos_profiles"][0] for t in topics}
    assert offered["/mpc_state"]["durability"] == "transient_local"
    assert offered["/odom"]["durability"] == "volatile"
    for name, profile in offered.items():
        assert profile["reliability"] == SETTINGS.topics[name].reliability


def test_a_bag_is_readable_with_its_own_definitions_alone(walk_bag, monkeypatch):
    def nowhere(types):
        raise FileNotFoundError

    monkeypatch.setattr("slot_lab.bags.bag.add_installed", nowhere)
    (_, state), *_ = Bag(walk_bag).messages("/mpc_state")
    assert state.position.z == pytest.approx(0.06)


def test_series_are_arrays_in_the_order_of_the_fields(walk_bag):
    fields = ("force", "status", "slack_friction", "header.frame_id")
    series = Bag(walk_bag).series("/tendon_plan", *fields)
    n = len(series)
    assert n == 16  # 0.5 s at 30 Hz, both ends
    force = series["force"].reshape(n, 4, 3)
    assert np.array_equal(force[:, :, :2], np.zeros((n, 4, 2)))
    assert np.allclose(series["slack_friction"], 0.4 * force[..., 2] - 0.5)
    assert np.allclose(np.diff(series.stamp), 1e9 / 30, atol=1)  # stamps are whole ns
    assert np.array_equal(series.time - series.time[0], series.stamp - series.stamp[0])
    quaternion = Bag(walk_bag).series("/odom", "pose.pose.orientation")[
        "pose.pose.orientation"
    ]
    assert np.allclose(quaternion, [0, 0, 0, 1])  # x y z w


def test_writer_refuses_a_second_type_on_a_topic_and_an_unknown_type(tmp_path):
    with BagWriter(tmp_path / "bag", SETTINGS) as bag:
        bag.write(
            "/odom", TOPICS["/odom"], WALL, encode("/odom", message("/odom", 0.0))
        )
        with pytest.raises(
            BagError, match="/odom: is recorded as nav_msgs/msg/Odometry"
        ):
            bag.write("/odom", TOPICS["/imu"], WALL, b"")
        with pytest.raises(BagError, match="no definition of other_msgs/msg/Thing"):
            bag.write("/thing", "other_msgs/msg/Thing", WALL, b"")


def test_writer_does_not_overwrite_a_bag(walk_bag):
    before = next(walk_bag.glob("*.mcap")).read_bytes()
    with pytest.raises(BagError, match="exists already"):
        BagWriter(walk_bag, SETTINGS)
    assert next(walk_bag.glob("*.mcap")).read_bytes() == before


def listed(walk_bag):
    """Metadata of the bag, without its file."""
    return (walk_bag / "metadata.yaml").read_bytes()


def damaged(walk_bag):
    """The bag's file with a chunk of zeros."""
    data = bytearray((walk_bag / "walk.mcap").read_bytes())
    start = data.index(b"\x28\xb5\x2f\xfd")  # magic number of a zstd frame
    data[start : start + 200] = bytes(200)
    return data


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("", b"", "does not exist"),
        ("notes.txt", b"no bag", "cannot be read"),
        ("foreign.mcap", b"\x89PNG\r\n\x1a\n" + bytes(100), "magic is invalid"),
        ("empty.mcap", b"", "seems to be empty"),
        ("damaged.mcap", damaged, "cannot be read"),
        ("bag/notes.txt", b"", r"bag: holds no metadata\.yaml, \.mcap or \.db3 file"),
        ("bag/metadata.yaml", b"", "cannot be read"),
        ("bag/metadata.yaml", b"a: [", "cannot be read"),
        ("bag/metadata.yaml", b"a: 1", "read: 'rosbag2_bagfile_information'"),
        ("bag/metadata.yaml", listed, r"/walk\.mcap: does not exist"),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(
    walk_bag, tmp_path, file, content, reason
):
    path = tmp_path / (file or "nowhere")
    path.parent.mkdir(exist_ok=True)
    if file:
        path.write_bytes(content(walk_bag) if callable(content) else content)
    bag = path.parent if path.parent != tmp_path else path
    with pytest.raises(BagError, match=reason) as refused:
        list(Bag(bag).merged())
    assert str(bag) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_bag_split_by_size_reads_as_one(walk_bag, tmp_path):
    settings = dataclasses.replace(SETTINGS, split=0.003)
    entries = list(Bag(walk_bag).raw())
    with BagWriter(tmp_path / "walk", settings, Origin({"scene": "flat"})) as bag:
        for n, (topic, time, data) in enumerate(entries):
            bag.write(topic, TOPICS[topic], time, data)
            if n % 40 == 39:
                bag.flush()
    files = sorted(path.name for path in (tmp_path / "walk").glob("*.mcap"))
    assert files[:4] == ["walk.mcap", "walk_1.mcap", "walk_2.mcap", "walk_3.mcap"]
    split = Bag(tmp_path / "walk")
    assert list(split.raw()) == entries
    assert (split.counts, split.duration_ns) == (
        Bag(walk_bag).counts,
        Bag(walk_bag).duration_ns,
    )
    with Reader(tmp_path / "walk") as reader:  # as the library reads the directory
        assert reader.message_count == len(entries) == sum(1 for _ in reader.messages())
    for file in files:  # and each file by itself
        assert Bag(tmp_path / "walk" / file).origin.about == {"scene": "flat"}


def test_remapped_topics_are_read_by_their_new_names(walk_bag):
    bag = Bag(walk_bag, remap={"/ground_truth/odom": "odom"})
    assert "/ground_truth/odom" not in bag.topics
    assert bag.counts["/odom"] == Bag(walk_bag).counts["/ground_truth/odom"]
    times = [time for time, _ in bag.messages("/odom")]
    assert times == [time for time, _ in Bag(walk_bag).messages("/ground_truth/odom")]
    with pytest.raises(
        BagError, match=r"no topic /camera/odom \(topics: /desired_joint_angles"
    ):
        Bag(walk_bag, remap={"/camera/odom": "/odom"})


def test_error_names_the_missing_topic_or_field(walk_bag):
    bag = Bag(walk_bag)
    with pytest.raises(BagError, match="no topic /scan"):
        list(bag.messages("/scan"))
    with pytest.raises(NoFieldError, match=r"/odom has no field pose\.speed"):
        bag.series("/odom", "pose.speed")


def test_legs_recorded_before_they_had_directors_are_read_without_them(tmp_path):
    recorded = np.arange(24.0).reshape(4, 2, 3)
    legs = message(LEG_STATES, 1.0, nodes=2, position=recorded)
    bag = Bag(write_old(tmp_path / "bag", LEG_STATES, legs))
    ((_, received),) = bag.messages(LEG_STATES)
    assert not hasattr(received, "director")
    _, _, _, nodes, directors = decode.legs(received)
    assert np.array_equal(nodes, recorded)
    assert directors.shape == (4, 0, 3)

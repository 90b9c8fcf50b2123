"""Bags: an independent reader gets what was written; damage is reported in one line."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from bag_messages import TOPICS, WALL, message, write_messages
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState

from slot_core.messages import decode
from slot_core.recording.bag_writer import BagWriter, MessageType, message_types
from slot_core.recording.origin import Origin
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags.bag import Bag, BagError, NoFieldError
from slot_lab.bags.recorded_walk import read_motion, tendon_angles
from slot_lab.bags.topics import LEG_STATES

SETTINGS = read_record_settings()


@pytest.fixture(scope="module")
def walk_bag(tmp_path_factory):
    """A walk, with every recorded type of slot_msgs."""
    status = serialize_message(message("/force_map/status", 1.0))
    walk = Bag(Path(__file__).parent / "walk")
    return write(
        tmp_path_factory.mktemp("bags") / "walk",
        *walk.raw(*walk.topics.keys() & TOPICS.keys()),
        ("/force_map/status", walk.end_ns, status),
    )


def write(path, *entries):
    with BagWriter(path, SETTINGS) as bag:
        for topic, time, data in entries:
            bag.write(topic, TOPICS[topic], time, data)
    return path


def plain(value):
    """Nested lists and mappings of a message's values, for the message classes of any library."""
    if isinstance(value, (bytes, list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    names = getattr(
        value, "__dataclass_fields__", getattr(value, "__slots__", None)
    )
    if names is None:
        return "NaN" if str(value) == "nan" else value
    # without constants
    fields = [n for n in names if n[0] != "_" and not n.isupper()]
    return {n: plain(getattr(value, n)) for n in fields}


@pytest.mark.parametrize("effort", [[], [0.1]])
def test_messages_that_rclpy_has_serialized_are_read(tmp_path, effort):
    """As by a user's program with rosbag2_py; without velocities it adds eight bytes."""
    joints = JointState(name=["FL"], position=[0.5], effort=effort)
    data = serialize_message(joints)
    path = write(tmp_path / "bag", ("/joint_states", WALL, data))
    ((_, read),) = Bag(path).messages("/joint_states")
    assert (read.name, [*read.position], [*read.effort]) == (
        ["FL"],
        [0.5],
        effort,
    )
    for wrong in (data[:30], data + bytes(80)):
        path = write(tmp_path / str(len(wrong)), ("/joint_states", WALL, wrong))
        with pytest.raises(BagError, match="cannot be read"):
            list(Bag(path).messages("/joint_states"))


def test_every_field_reads_the_same_with_an_independent_library(walk_bag):
    ours = [
        (topic, time, plain(built))
        for topic, time, built in Bag(walk_bag).merged()
    ]
    with (walk_bag / "walk.mcap").open("rb") as file:
        read = make_reader(file, decoder_factories=[DecoderFactory()])
        theirs = [
            (m.channel.topic, m.message.log_time, plain(m.decoded_message))
            for m in read.iter_decoded_messages()
        ]
    assert {topic for topic, _, _ in ours} >= {
        t for t, name in TOPICS.items() if "slot_" in name
    }
    key = lambda entry: (entry[1], entry[0])  # noqa: E731
    assert sorted(ours, key=key) == sorted(theirs, key=key)


def test_type_hashes_are_those_of_the_ros_installation():
    types = message_types()
    for name in set(TOPICS.values()):
        package, kind, stem = name.split("/")
        share = Path(get_package_share_directory(package))
        listed = json.loads((share / kind / f"{stem}.json").read_text())[
            "type_hashes"
        ]
        hashes = {each["type_name"]: each["hash_string"] for each in listed}
        assert types.hash_rihs01(name) == hashes[name], name


def test_bag_offers_the_recorded_quality_of_service(walk_bag):
    (about,) = yaml.safe_load((walk_bag / "metadata.yaml").read_text()).values()
    topics = [
        entry["topic_metadata"] for entry in about["topics_with_message_count"]
    ]
    offered = {t["name"]: t["offered_qos_profiles"][0] for t in topics}
    assert offered["/mpc_state"]["durability"] == "transient_local"
    assert offered["/odom"]["durability"] == "volatile"
    for name, profile in offered.items():
        assert profile["reliability"] == SETTINGS.topics[name].reliability


def test_a_bag_is_readable_with_its_own_definitions_alone(
    walk_bag, monkeypatch
):
    monkeypatch.setattr("slot_lab.bags.bag.add_installed", None)
    (_, state), *_ = Bag(walk_bag).messages("/mpc_state")
    assert state.position.z == pytest.approx(0.04, abs=5e-3)


def test_writer_refuses_a_second_type_an_unknown_type_and_a_bag_that_exists(
    tmp_path,
):
    with BagWriter(tmp_path / "bag", SETTINGS) as bag:
        bag.write(
            "/odom",
            TOPICS["/odom"],
            WALL,
            serialize_message(message("/odom", 0.0)),
        )
        with pytest.raises(
            BagError, match="/odom: is recorded as nav_msgs/msg/Odometry"
        ):
            bag.write("/odom", TOPICS["/imu"], WALL, b"")
        with pytest.raises(
            BagError, match="no definition of other_msgs/msg/Thing"
        ):
            bag.write("/thing", "other_msgs/msg/Thing", WALL, b"")
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "bag", SETTINGS)
    assert Bag(tmp_path / "bag").counts == {"/odom": 1}


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("", b"", "does not exist"),
        ("notes.txt", b"no bag", "cannot be read"),
        ("foreign.mcap", b"\x89PNG\r\n\x1a\n" + bytes(100), "magic is invalid"),
        ("empty.mcap", b"", "seems to be empty"),
        ("walk.mcap", b"version https://git-lfs.x", "a pointer of Git LFS"),
        (
            "bag/notes.txt",
            b"",
            r"bag: holds no metadata\.yaml, \.mcap or \.db3 file",
        ),
        ("bag/metadata.yaml", b"", "cannot be read"),
        ("bag/metadata.yaml", b"a: [", "cannot be read"),
        ("bag/metadata.yaml", b"a: 1", "read: 'rosbag2_bagfile_information'"),
        (
            "bag/metadata.yaml",
            (Path(__file__).parent / "walk" / "metadata.yaml").read_bytes(),
            r"/walk\.mcap: does not exist",
        ),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(tmp_path, file, content, reason):
    path = tmp_path / (file or "nowhere")
    path.parent.mkdir(exist_ok=True)
    if file:
        path.write_bytes(content)
    bag = path.parent if path.parent != tmp_path else path
    with pytest.raises(BagError, match=reason) as refused:
        list(Bag(bag).merged())
    assert str(bag) in str(refused.value)
    assert "\n" not in str(refused.value)


class Binary(bytes):
    """A definition that is no text."""

    encode = bytes


FOREIGN = {
    "/gps": MessageType(
        "a.Fix", Binary(b"\n\xc5\x01\xff"), "protobuf", "", "protobuf"
    ),
    "/plan": MessageType("Plan", "{}", "jsonschema", "", "json"),
    "/scan": MessageType("a_msgs/Scan", "Header h", "ros1msg", "", "ros1"),
    "/text": MessageType("", "", "", "", "json"),
    "/service": MessageType("a_msgs/srv/Add_Event", "int8 a\n---\n"),
    "/lidar": MessageType("a_msgs/msg/Lidar", "", "unknown"),
}


@pytest.mark.parametrize("finished", [True, False])
def test_foreign_channels_are_skipped_and_named_where_they_are_needed(
    walk_bag, tmp_path, finished
):
    """As a service that is introspected, Foxglove or a driver adds them."""
    entries, file = list(Bag(walk_bag).raw()), tmp_path / "bag" / "bag.mcap"
    with BagWriter(file.parent, SETTINGS) as out:
        for topic, kind in FOREIGN.items():
            out.add_topic(topic, kind)
            out.write(topic, kind.name, WALL, b"{}")
        for topic, time, data in entries:
            out.write(topic, TOPICS[topic], time, data)
    if not finished:
        file.write_bytes(file.read_bytes()[:-9])
    bag = Bag(file, remap={"/plan": "/odom"})
    left = [topic for topic, _, _ in entries if topic != "/odom"]
    assert [topic for topic, _, _ in bag.merged()] == left
    asked = dict(FOREIGN) | {"/odom": FOREIGN["/plan"]}
    for topic in asked.keys() - {"/plan"}:
        held = asked[topic].serialization
        reason = f"in '{held}', expected cdr"
        reason = "no definition in ros2msg" if held == "cdr" else reason
        with pytest.raises(BagError, match=f"{topic} holds .*{reason}"):
            read_motion(bag, topic)
    bag.save(tmp_path / "copy")
    assert set(Bag(tmp_path / "copy").topics) == set(left)


def test_a_bag_split_by_size_reads_as_one(walk_bag, tmp_path):
    settings = dataclasses.replace(SETTINGS, split=0.003)
    entries = list(Bag(walk_bag).raw())
    with BagWriter(
        tmp_path / "walk", settings, Origin({"scene": "flat"})
    ) as bag:
        for n, (topic, time, data) in enumerate(entries):
            bag.write(topic, TOPICS[topic], time, data)
            if n % 40 == 39:
                bag.flush()
    files = sorted((tmp_path / "walk").glob("*.mcap"))
    assert len(files) > 3
    split, whole = Bag(tmp_path / "walk"), Bag(walk_bag)
    assert list(split.raw()) == entries
    assert (split.counts, split.duration_ns) == (
        whole.counts,
        whole.duration_ns,
    )
    with Reader(
        tmp_path / "walk"
    ) as reader:  # as the library reads the directory
        assert (
            reader.message_count
            == len(entries)
            == sum(1 for _ in reader.messages())
        )
    for file in files:  # and each file by itself
        assert Bag(file).origin.about == {"scene": "flat"}


def test_topics_are_read_by_their_new_names_and_a_missing_one_is_named(
    walk_bag,
):
    bag = Bag(walk_bag, remap={"/ground_truth/odom": "odom"})
    assert "/ground_truth/odom" not in bag.topics
    assert bag.counts["/odom"] == Bag(walk_bag).counts["/ground_truth/odom"]
    with pytest.raises(
        BagError,
        match=r"no topic /camera/odom \(topics: /clock, /desired_joint_angles",
    ):
        Bag(walk_bag, remap={"/camera/odom": "/odom"})
    with pytest.raises(NoFieldError, match=r"/odom has no field pose\.speed"):
        bag.series("/odom", "pose.speed")


def test_legs_recorded_before_they_had_directors_are_read_without_them():
    recorded = np.arange(24.0).reshape(4, 2, 3)
    legs = message(LEG_STATES, 1.0, nodes=2, position=recorded)
    del legs._director
    _, _, _, nodes, directors = decode.legs(legs)
    assert np.array_equal(nodes, recorded)
    assert directors.shape == (4, 0, 3)


def odometry(stamp, x=0.0, quaternion=(0.0, 0.0, 0.0, 1.0)):
    fields = {
        "pose__pose__position": (x, 0, 0),
        "pose__pose__orientation": quaternion,
    }
    return "/odom", message("/odom", stamp, **fields)


@pytest.fixture
def written(tmp_path):
    """Writes a bag of (topic, message) and opens it."""

    def write(*entries):
        stamped = [(n, *entry) for n, entry in enumerate(entries)]
        return Bag(write_messages(tmp_path / "bag", stamped))

    return write


def test_equal_messages_of_one_stamp_count_once_and_lost_ones_not(written):
    entries = (1.0,), (1.0,), (2.0, 0.0, (0.0,) * 4), (3.0, 0.5)
    moved = read_motion(
        written(*(odometry(*entry) for entry in entries)), "/odom"
    )
    assert moved.t.tolist() == [1.0, 3.0]
    assert moved.position[:, 0].tolist() == [0.0, 0.5]
    assert moved.left_out == 1


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (
            [(1.0, np.nan), (2.0, 0.0)],
            "message 0 holds a value that is not finite",
        ),
        (
            [(1.0, 0.0), (3.0, 0.1), (2.5, 0.2)],
            "time goes back by 0.5 s after message 1",
        ),
        (
            [(1.0, 0.0), (2000.0, 0.1)],
            "steps by 1999 s to 2000 s, limit 600 s: was the clock set",
        ),
        ([(1.0, 0.0), (1.0, 0.1)], "messages 0 and the next have one stamp"),
        ([(1.0, 0.0), (1.0, 0.0)], "1 samples, less than 2"),
        (
            [(1.0, 0.0), (2.0, 0.0, (0, 0, 0, 0.5))],
            "quaternion of sample 1 has the length 0.5",
        ),
        ([(1.0, 0.0), (2.0, 0.0, (0, 0, 0, 0))], "1 samples, less than 2"),
    ],
)
def test_an_odometry_that_is_not_sound_is_refused(written, entries, message):
    with pytest.raises(BagError, match=message) as refusal:
        read_motion(written(*(odometry(*entry) for entry in entries)), "/odom")
    assert "/odom: " in str(refusal.value)


def test_of_two_states_of_one_time_the_second_counts(written):
    states = [
        (
            "/mpc_state",
            message("/mpc_state", stamp, position__x=x, lead__nanosec=lead),
        )
        for stamp, lead, x in (
            (1.0, 30_000_000, 0.1),
            (1.01, 20_000_000, 0.2),
            (1.1, 0, 0.3),
        )
    ]
    moved = read_motion(written(*states), "/mpc_state")
    assert moved.t == pytest.approx([1.03, 1.1])
    assert moved.position[:, 0].tolist() == [0.2, 0.3]


def test_joints_of_another_robot_are_refused(written):
    """As many names as values, but twelve joints."""
    others = message("/joint_states", 1.0, position=[0.0] * 12)
    others.name = [f"joint_{n}" for n in range(12)]
    with pytest.raises(BagError, match="does not name each of FL_tendon"):
        tendon_angles(
            written(("/joint_states", others), ("/joint_states", others))
        )

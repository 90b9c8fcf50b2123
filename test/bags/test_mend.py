"""Recordings that did not end are read; storages and compressions of rosbag2."""

import os
import resource
import shutil
import sqlite3
from pathlib import Path

import pytest
from bag_messages import TOPICS, WALL, message
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    Reader,
    StoragePlugin,
    Writer,
)

from slot_core.recording.bag_writer import BagWriter, message_types
from slot_core.recording.origin import Origin
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags import replay_command
from slot_lab.bags.bag import Bag, BagError

SETTINGS = read_record_settings()
WALK = Path(__file__).parent / "walk"
ODOM = TOPICS["/odom"]
ORIGIN = Origin(
    {"revision": "1234567890", "scene": "slope5"},
    {"path.csv": b"x,y\n0,0\n1,0\n"},
)


def odometry(n):
    return serialize_message(message("/odom", 0.01 * n))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A walk in chunks of 0.1 s."""
    path, walk = tmp_path_factory.mktemp("bags") / "walk", Bag(WALK)
    with BagWriter(path, SETTINGS, ORIGIN) as bag:
        flushed = walk.start_ns
        for topic, time, data in walk.raw():
            if time - flushed > 100_000_000:
                bag.flush()
                flushed = time
            bag.write(topic, walk.topics[topic], time, data)
    return path


def test_a_killed_writer_loses_what_came_after_the_last_flush_and_no_more(
    tmp_path,
):
    bag, killed = (
        BagWriter(tmp_path / "bag", SETTINGS, ORIGIN),
        tmp_path / "killed",
    )
    # serialized once: the bytes between two fields are arbitrary
    entries = [("/odom", WALL + n, odometry(n)) for n in range(130)]
    for n, (topic, time, data) in enumerate(entries):
        if n == 100:
            bag.flush()
        bag.write(topic, ODOM, time, data)
    # the disk as SIGKILL would leave it now
    shutil.copytree(tmp_path / "bag", killed)
    bag.close()
    left = Bag(killed)
    assert not left.finished
    assert list(left.raw()) == entries[:100]
    assert left.origin == ORIGIN


def test_a_full_disk_is_an_error_of_one_line_and_what_was_flushed_is_left(
    tmp_path,
):
    """A limit on the size of files stands for the disk."""
    bag = BagWriter(tmp_path / "bag", SETTINGS)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, limits[1]))
    try:
        for n in range(10_000):
            bag.write("/odom", ODOM, WALL + n, os.urandom(len(odometry(0))))
            if n % 20 == 19:
                bag.flush()
    except BagError as error:
        refusal = str(error)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert refusal == f"{tmp_path / 'bag'}: cannot be written: File too large"
    # all chunks but the one that did not fit
    assert Bag(tmp_path / "bag").counts["/odom"] == n - 19 > 40


def cut(whole, path, share):
    """Copy of a bag as SIGKILL leaves it: a share of its file, without metadata.yaml."""
    path.mkdir()
    data = (whole / "walk.mcap").read_bytes()
    (path / "walk.mcap").write_bytes(data[: int(share * len(data))])
    return Bag(path)


@pytest.mark.parametrize("share", [0.4, 0.999, 1.0])
def test_a_bag_that_is_cut_off_is_read_up_to_its_last_whole_chunk(
    whole, tmp_path, share
):
    left = cut(whole, tmp_path / "walk", share)
    entries, all_entries = list(left.raw()), list(Bag(whole).raw())
    assert not left.finished
    assert entries == all_entries[: len(entries)]
    assert entries
    assert (entries == all_entries) == (share > 0.9)
    assert left.origin == ORIGIN
    assert left.remark.startswith("unfinished   what is left of it: ")


def test_a_mended_bag_is_whole_to_another_reader(whole, tmp_path):
    left, new = cut(whole, tmp_path / "walk", 0.7), tmp_path / "new"
    assert replay_command.main([str(left.path), "--mend", str(new)]) == 0
    with Reader(new) as reader:
        entries = [(c.topic, time, data) for c, time, data in reader.messages()]
    assert entries == list(left.raw())
    assert Bag(new).finished
    assert Bag(new).origin == ORIGIN
    # it exists
    assert replay_command.main([str(left.path), "--mend", str(new)]) == 2


def copied(whole, path, plugin, mode):
    """The same messages in a bag of the library's own writer."""
    types, source = message_types(), Bag(whole)
    writer = Writer(path, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=types)
            for topic, kind in source.topics.items()
        }
        for topic, time, data in source.raw():
            writer.write(connections[topic], time, data)
    return path


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.NONE),
    ],
)
def test_every_storage_and_compression_of_rosbag2_reads_the_same(
    whole, tmp_path, plugin, mode
):
    bag = Bag(copied(whole, tmp_path / "copy", plugin, mode))
    assert bag.finished
    assert list(bag.raw()) == list(Bag(whole).raw())
    (_, state), *_ = bag.messages("/mpc_state")
    assert state.position.z == pytest.approx(0.04, abs=5e-3)


def test_a_database_without_definitions_is_read_with_the_installed_ones(
    whole, tmp_path
):
    """As written by a ROS before Iron."""
    path = copied(
        whole, tmp_path / "copy", StoragePlugin.SQLITE3, CompressionMode.NONE
    )
    with sqlite3.connect(path / "copy.db3") as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")
    database.close()
    (_, state), *_ = Bag(path / "copy.db3").messages("/mpc_state")
    assert state.position.z == pytest.approx(0.04, abs=5e-3)


def test_messages_in_the_log_of_a_database_that_was_killed_are_read(
    whole, tmp_path
):
    path = copied(
        whole, tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE
    )
    killed = tmp_path / "killed"
    killed.mkdir()
    database = sqlite3.connect(path / "bag.db3")
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("UPDATE messages SET timestamp = 7 WHERE id = 1")
    database.commit()
    # as they are while the recorder runs
    for name in ("bag.db3", "bag.db3-wal"):
        shutil.copy(path / name, killed)
    database.close()
    bag = Bag(killed)
    assert not bag.finished
    assert bag.start_ns == 7

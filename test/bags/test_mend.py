"""Recordings that did not end are read; storages and compressions of rosbag2."""

import os
import resource
import shutil
import signal
import sqlite3

import pytest
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    Reader,
    StoragePlugin,
    Writer,
)
from synthetic_walk import TOPICS, TYPES, WALL, Walk, encode, message, write_walk

from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.message_types import message_types
from slot_core.recording.origin import Origin
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags import replay_command
from slot_lab.bags.bag import Bag, BagError

SETTINGS = read_record_settings()
ODOM = TOPICS["/odom"]
ORIGIN = Origin(
    {"revision": "1234567890", "scene": "slope5"}, {"path.csv": b"x,y\n0,0\n1,0\n"}
)


def odometry(n):
    return encode("/odom", message("/odom", 0.01 * n))


def in_child(action):
    """Run `action` in a forked process; return its pid."""
    if (pid := os.fork()) == 0:
        try:
            action()
        finally:
            os._exit(0)
    return pid


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Half a second of a walk in chunks of 0.1 s."""
    path = tmp_path_factory.mktemp("bags") / "walk"
    entries = list(Bag(write_walk(path.with_name("source"), Walk(duration=0.5))).raw())
    with BagWriter(path, SETTINGS, ORIGIN) as bag:
        flushed = WALL
        for topic, time, data in entries:
            if time - flushed > 100_000_000:
                bag.flush()
                flushed = time
            bag.write(topic, TOPICS[topic], time, data)
    return path


def cut(whole, path, size):
    """Copy of a bag as SIGKILL leaves it: cut off at `size` bytes and without metadata.yaml."""
    path.mkdir()
    (path / "walk.mcap").write_bytes((whole / "walk.mcap").read_bytes()[:size])
    return path


def test_a_killed_writer_loses_what_came_after_the_last_flush_and_no_more(tmp_path):
    ready, told = os.pipe()

    def write():
        bag = BagWriter(tmp_path / "bag", SETTINGS, ORIGIN)
        for n in range(130):
            if n == 100:
                bag.flush()
            bag.write("/odom", ODOM, WALL + n, odometry(n))
        os.write(told, b"x")
        signal.pause()

    child = in_child(write)
    os.read(ready, 1)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    bag = Bag(tmp_path / "bag")
    assert not bag.finished
    assert list(bag.raw()) == [("/odom", WALL + n, odometry(n)) for n in range(100)]
    assert bag.origin == ORIGIN


def test_a_full_disk_is_an_error_of_one_line_and_what_was_flushed_is_left(tmp_path):
    """A limit on the size of files stands for the disk."""
    limit, (ready, told) = 60_000, os.pipe()

    def write():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        bag = BagWriter(tmp_path / "bag", SETTINGS)
        n = 0
        try:
            while True:
                bag.write("/odom", ODOM, WALL + n, os.urandom(len(odometry(0))))
                n += 1
                if n % 20 == 0:
                    bag.flush()
        except BagError as error:
            os.write(told, f"{n} {error}".encode())

    os.waitpid(in_child(write), 0)
    count, _, error = os.read(ready, 1000).decode().partition(" ")
    assert error == f"{tmp_path / 'bag'}: cannot be written: File too large"
    left = Bag(tmp_path / "bag").counts["/odom"]
    assert left == int(count) - 20 > 40  # all chunks but the one that did not fit


@pytest.mark.parametrize("kept", [0.6, 0.999])
def test_a_bag_that_is_cut_off_is_read_up_to_its_last_whole_chunk(
    whole, tmp_path, kept
):
    size = int(kept * (whole / "walk.mcap").stat().st_size)
    left = Bag(cut(whole, tmp_path / "walk", size))
    entries, all_entries = list(left.merged()), list(Bag(whole).raw())
    assert not left.finished
    assert 0 < len(entries) <= len(all_entries)
    assert [e[:2] for e in entries] == [e[:2] for e in all_entries[: len(entries)]]
    assert left.topics.items() <= Bag(whole).topics.items()
    assert left.origin == ORIGIN
    assert left.remark.startswith("unfinished   what is left of it: 0.")


def test_a_file_of_nothing_but_its_head_holds_no_topics(whole, tmp_path):
    bag = Bag(cut(whole, tmp_path / "walk", 100))
    assert (bag.topics, bag.duration_ns, bag.finished) == ({}, 0, False)
    with pytest.raises(BagError, match=r"no topic /odom \(topics: none\)"):
        list(bag.messages("/odom"))


def test_a_whole_file_without_metadata_is_read_as_not_finished(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "walk")
    (tmp_path / "walk" / "metadata.yaml").unlink()
    bag = Bag(tmp_path / "walk")
    assert not bag.finished
    assert list(bag.raw()) == list(Bag(whole).raw())


def test_a_mended_bag_is_whole_to_another_reader(whole, tmp_path):
    size = (whole / "walk.mcap").stat().st_size * 7 // 10
    left = cut(whole, tmp_path / "walk", size)
    assert replay_command.main([str(left), "--mend", str(tmp_path / "new")]) == 0
    with Reader(tmp_path / "new") as reader:
        entries = [(c.topic, time, data) for c, time, data in reader.messages()]
        assert all(
            c.ext.offered_qos_profiles and c.msgdef.data for c in reader.connections
        )
    assert entries == list(Bag(left).raw())
    assert Bag(tmp_path / "new").finished
    assert Bag(tmp_path / "new").origin == ORIGIN
    assert (
        replay_command.main([str(left), "--mend", str(tmp_path / "new")]) == 2
    )  # it exists


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
    assert state.position.z == pytest.approx(0.06)


def test_a_database_without_definitions_is_read_with_the_installed_ones(
    whole, tmp_path
):
    """As written by a ROS before Iron."""
    path = copied(whole, tmp_path / "copy", StoragePlugin.SQLITE3, CompressionMode.NONE)
    with sqlite3.connect(path / "copy.db3") as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")
    database.close()
    (_, state), *_ = Bag(path / "copy.db3").messages("/mpc_state")
    assert state.position.z == pytest.approx(0.06)


def test_messages_in_the_log_of_a_database_that_was_killed_are_read(tmp_path):
    with Writer(tmp_path / "bag", version=8) as writer:
        connection = writer.add_connection("/odom", ODOM, typestore=TYPES)
        writer.write(connection, WALL, odometry(0))
    file, killed = tmp_path / "bag" / "bag.db3", tmp_path / "killed"
    killed.mkdir()
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode=WAL")
    insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)"
    database.execute(insert, (WALL + 1, odometry(1)))
    database.commit()
    for name in ("bag.db3", "bag.db3-wal"):  # as they are while the recorder runs
        shutil.copy(tmp_path / "bag" / name, killed)
    database.close()
    bag = Bag(killed)
    assert not bag.finished
    assert [time for _, time, _ in bag.raw()] == [WALL, WALL + 1]

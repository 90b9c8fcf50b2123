"""Bags: rosbag2 recordings in MCAP, written from raw CDR bytes and read as NumPy arrays.

A bag is a directory `NAME/` with `NAME.mcap` and `metadata.yaml`, as `ros2 bag record` makes it.
A bag contains its message definitions, so it stays readable when slot_msgs changes. The time of a
message is its publisher's wall clock at publication; its stamp is graph time.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    Reader,
    StoragePlugin,
    Writer,
    WriterError,
)

from slot_core import config
from slot_core.bags.message_types import Types, message_types, types_inside
from slot_core.config import choice, quantity, text

Stamps = NDArray[np.int64]

FOREVER = QosTime(9223372036, 854775807)  # how rosbag2 writes an infinite duration, 2^63 - 1 ns


class BagError(ValueError):
    """A bag that cannot be read or written; the message is one line with its path and the cause."""


class NoFieldError(BagError):
    """The messages of a topic have no field of that name."""


@dataclass(frozen=True)
class RecordedTopic:
    """One recorded topic: its type, and the quality of service requested and stored in the bag."""

    type: str = text("message type, package/msg/Name")
    reliability: str = choice("reliability", "reliable", "best_effort")
    durability: str = choice("durability", "volatile", "transient_local")


@dataclass(frozen=True)
class RecordSettings:
    """Recorded topics, and the warm-up that the metrics leave out (`config/record.yaml`)."""

    warm_up: float = quantity("time at the start left out by the metrics", "s", 0.0, 60.0)
    depth: int = quantity("queue of each subscription", "messages", 1, 100_000)
    topics: dict[str, RecordedTopic] = text("recorded topics by name")


def read_record_settings(namespace: str = "") -> RecordSettings:
    """The settings of `config/record.yaml`, topics in a namespace; raises ConfigError."""
    settings = config.read(RecordSettings, "record")
    topics = {f"{_root(namespace)}/{name}": topic for name, topic in settings.topics.items()}
    return dataclasses.replace(settings, topics=topics)


def _root(namespace: str) -> str:
    """What stands before a topic's name in a namespace: /fred for fred, nothing for none."""
    return f"/{namespace.strip('/')}".rstrip("/")


class BagWriter:
    """Writes a rosbag2 MCAP bag with zstd chunks; a context manager.

    Raises BagError if `path` exists or cannot be written. Until it is closed, a bag has no index
    and no metadata.yaml.
    """

    def __init__(self, path: Path | str, settings: RecordSettings) -> None:
        self._settings = settings
        self._types = message_types()
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(Path(path), version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (WriterError, OSError) as error:
            raise BagError(f"{path}: cannot be written: {_one_line(error)}") from None

    def write(self, topic: str, typename: str, time_ns: int, data: bytes | memoryview) -> None:
        """Append one message: CDR bytes `data` of `typename`, published at wall time `time_ns`.

        Raises BagError for an unknown type and for a topic that changes its type.
        """
        connection = self._connections.get(topic) or self._connect(topic, typename)
        if connection.msgtype != typename:
            raise BagError(f"{topic}: is recorded as {connection.msgtype}, not {typename}")
        self._writer.write(connection, time_ns, data)

    def close(self) -> None:
        """Write the index and metadata.yaml; a second call does nothing."""
        if self._writer.storage:
            self._writer.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _connect(self, topic: str, typename: str) -> Connection:
        if typename not in self._types.fielddefs:
            raise BagError(f"{topic}: no definition of {typename} found")
        self._connections[topic] = self._writer.add_connection(
            topic,
            typename,
            typestore=self._types,
            offered_qos_profiles=[self._qos(topic, typename)],
        )
        return self._connections[topic]

    def _qos(self, topic: str, typename: str) -> Qos:
        plain = RecordedTopic(typename, "reliable", "volatile")
        wanted = self._settings.topics.get(topic, plain)
        return Qos(
            QosHistory.KEEP_LAST,
            self._settings.depth,
            QosReliability[wanted.reliability.upper()],
            QosDurability[wanted.durability.upper()],
            FOREVER,
            FOREVER,
            QosLiveliness.AUTOMATIC,
            FOREVER,
            False,
        )


@dataclass(frozen=True)
class Series:
    """Fields of a topic as arrays over its n messages, in the order of the bag."""

    time: Stamps  # (n,) ns, publisher's wall clock
    stamp: Stamps  # (n,) ns, graph time
    values: dict[str, NDArray[Any]]  # by field: (n, ...)

    def __getitem__(self, field: str) -> NDArray[Any]:
        return self.values[field]

    def __len__(self) -> int:
        return len(self.stamp)


class Bag:
    """Reads a rosbag2 bag (a directory, or one .mcap file).

    With a `namespace` only its topics are read, named without it: /fred/odom of `fred` is /odom.
    Raises BagError, also while reading, if the bag is missing, unfinished, truncated or not a bag.
    """

    def __init__(self, path: Path | str, namespace: str = "") -> None:
        self.path = Path(path)
        self._root = _root(namespace)
        self._cache: dict[str, list[tuple[int, Any]]] = {}
        with self._open() as reader:
            self._definitions = {c.msgtype: c.msgdef.data for c in reader.connections}
            connections = self._connections(reader)
            self.counts = {t: reader.topics[c.topic].msgcount for t, c in connections}
            self.topics = {t: c.msgtype for t, c in connections}
            self._known = sorted(reader.topics)
            self.duration_ns = max(0, reader.end_time - 1 - reader.start_time)
            self.end_ns = reader.end_time - 1
            self._types: Types = types_inside(self._definitions.items())

    def raw(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time in ns, CDR bytes) of these topics (default: all), ordered by time."""
        self._require(*topics)
        with self._open() as reader:
            wanted = [c for t, c in self._connections(reader) if not topics or t in topics]
            for connection, time, data in reader.messages(wanted):
                yield connection.topic.removeprefix(self._root), time, bytes(data)

    def merged(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time in ns, message) of these topics (default: all), ordered by time."""
        for topic, time, data in self.raw(*topics):
            with self._readable():
                message = self._types.deserialize_cdr(data, self.topics[topic])
            yield topic, time, message

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (time in ns, message) of one topic, ordered by time."""
        return ((time, message) for _, time, message in self.merged(topic))

    def series(self, topic: str, *fields: str) -> Series:
        """Fields (dotted, as `pose.pose.position`) as arrays over the messages of a topic.

        A field that is a message becomes the vector of its own fields, so a Vector3[4] is (n, 4, 3)
        and a quaternion (n, 4) in the order x y z w. Raises NoFieldError if the type lacks a
        field, BagError if the field's shape changes.
        """
        if topic not in self._cache:
            self._cache[topic] = list(self.messages(topic))
        entries = self._cache[topic]
        return Series(
            np.array([time for time, _ in entries], np.int64),
            np.array([_stamp(message, time) for time, message in entries], np.int64),
            {field: self._column(topic, field) for field in fields},
        )

    def _column(self, topic: str, field: str) -> NDArray[Any]:
        getter = operator.attrgetter(field)
        try:
            return np.array([_plain(getter(message)) for _, message in self._cache[topic]])
        except AttributeError:
            raise NoFieldError(f"{self.path}: {topic} has no field {field}") from None
        except ValueError:
            raise BagError(f"{self.path}: {topic} {field} changes its shape") from None

    def _connections(self, reader: Reader) -> list[tuple[str, Connection]]:
        """Name within the namespace, and connection, of every topic in the namespace."""
        root = self._root
        return [
            (c.topic.removeprefix(root), c)
            for c in reader.connections
            if c.topic.startswith(f"{root}/")
        ]

    def _require(self, *topics: str) -> None:
        for topic in topics:
            if topic not in self.topics:
                known = ", ".join(self._known) or "none"
                raise BagError(f"{self.path}: no topic {self._root}{topic} (topics: {known})")

    @contextmanager
    def _open(self) -> Iterator[Reader]:
        with self._readable(), Reader(self.path) as reader:
            yield reader

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Turn every error of the reading library into a BagError."""
        try:
            yield
        except BagError:
            raise
        except FileNotFoundError:
            unfinished = "no metadata.yaml: not a bag, or its recording did not end"
            raise BagError(
                f"{self.path}: {unfinished if self.path.exists() else 'does not exist'}"
            ) from None
        except Exception as error:
            # On a damaged file the library also raises struct, zstd, assertion and type errors.
            raise BagError(f"{self.path}: cannot be read: {_one_line(error)}") from error


def _stamp(message: Any, time: int) -> int:
    """Graph time of a message in ns: its stamp, a clock's value, else its time in the bag."""
    stamp = message.header.stamp if hasattr(message, "header") else getattr(message, "clock", None)
    return time if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _plain(value: Any) -> Any:
    """Numbers, strings and arrays as they are; a message as the list of its fields."""
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        names = [f.name for f in dataclasses.fields(value) if f.name != "__msgtype__"]
        return [_plain(getattr(value, name)) for name in names]
    return value


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__

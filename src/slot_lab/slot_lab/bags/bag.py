"""Bags: rosbag2 recordings in MCAP or SQLite, read as NumPy arrays.

A bag contains its message definitions, so it stays readable when slot_msgs changes. The time of a
message is its publisher's wall clock at publication; its stamp is graph time. A recording that did
not end is mended: its intact part is copied, and gets an index.
"""

import dataclasses
import functools
import heapq
import operator
import shutil
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader, storage_mcap
from rosbags.serde import SerdeError

from slot_core import config
from slot_core.clock import to_seconds
from slot_core.recording.bag_writer import (
    CDR,
    BagWriter,
    MessageType,
    Types,
    add_installed,
    types_inside,
)
from slot_core.recording.origin import ORIGIN, Origin
from slot_core.recording.record_settings import (
    BagError,
    NoFieldError,
    RecordedTopic,
    read_record_settings,
    root_of,
)
from slot_core.refusal import one_line, quoted, read_text, require_regular

__all__ = ["Bag", "BagError", "NoFieldError", "Series", "Stamps"]

Stamps = NDArray[np.int64]
STORAGES = (".mcap", ".db3")
METADATA_MAX = 10_000_000  # bytes of metadata.yaml
LANGUAGES = ("ros2msg", "ros2idl", "omgidl", "")  # of definitions
_mcap: Any = storage_mcap
# At every opening of a file the library parses a text of YAML for every topic.
_mcap.parse_qos = functools.lru_cache(64)(_mcap.parse_qos)
# It refuses a file for a schema of Protobuf, which is no text, or in another language.
_mcap.read_string = lambda stream: _mcap.read_bytes(stream).decode(
    errors="replace"
)
_message_definition = _mcap.get_msgdef
_mcap.get_msgdef = lambda schema: _message_definition(
    schema if schema and schema.encoding in LANGUAGES else None
)
SPARE = 64  # bytes at the end of a message, beyond its own, at most
MAGIC = b"\x89MCAP0\r\n"  # at both ends of a whole file


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
    """Reads a rosbag2 bag: a directory, or one .mcap or .db3 file; also a truncated file.

    With a `namespace` only its topics are read, named without it: /fred/odom of `fred` is /odom.
    `remap` names topics of the bag (in full) otherwise; a topic that has the new name is left out.
    `foreign` are topics that cannot be decoded, by reason; they are skipped unless asked for.
    Raises BagError, also while reading, if the bag is missing, damaged or not a bag.
    """

    def __init__(
        self,
        path: Path | str,
        namespace: str = "",
        remap: Mapping[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        self._root = root_of(namespace)
        self._remap = {
            f"/{old.lstrip('/')}": f"/{new.lstrip('/')}"
            for old, new in (remap or {}).items()
        }
        self._cache: dict[str, list[tuple[int, Any]]] = {}
        self._scratch: TemporaryDirectory[str] | None = None  # of mended files
        with self._readable():
            self._files, custom = self._find_files()
            first = self._files[0]
            origin = read_origin(first) if first.suffix == ".mcap" else Origin()
            self.origin = (
                origin if origin.about else Origin(custom, origin.files)
            )
        with self._open() as readers:
            connections = [
                (r, *entry) for r in readers for entry in self._connections(r)
            ]
            connections.sort(key=lambda entry: _serialization(entry[2]) == CDR)
            self.topics = {topic: c.msgtype for _, topic, c in connections}
            self.counts = dict.fromkeys(self.topics, 0)
            for _, topic, connection in connections:
                self.counts[topic] += connection.msgcount
            self._known = sorted(
                {c.topic for r in readers for c in r.connections}
            )
            spans = [
                (r.start_time, r.end_time - 1)
                for r in readers
                if r.message_count
            ]
            self.start_ns = min((first for first, _ in spans), default=0)
            self.end_ns = max((last for _, last in spans), default=0)
            _require_time(self.end_ns)
            self._types = self._read_types(readers)
            # by topic, the last of whose connections is the best
            faults = {topic: self._fault(c) for _, topic, c in connections}
            self.foreign = {t: fault for t, fault in faults.items() if fault}
        for topic in self._remap:
            if topic not in self._known:
                raise self._unknown(topic)

    @property
    def finished(self) -> bool:
        """Whether the recording ended; else its intact part is read."""
        return self._scratch is None

    @property
    def remark(self) -> str:
        """A line on a recording that did not end, else empty."""
        left = f"unfinished   what is left of it: {to_seconds(self.duration_ns):.2f} s"
        return "" if self.finished else left

    def lines(self) -> list[str]:
        """Text on where the bag comes from, and whether its recording ended."""
        return [*self.origin.lines(), *filter(None, [self.remark])]

    def save(self, path: Path) -> None:
        """Write the readable part of the bag, without `foreign`, as a whole bag; raises BagError."""
        with BagWriter(path, read_record_settings(), self.origin) as copy:
            with self._open() as readers:
                kinds = {
                    t: c
                    for reader in readers
                    for t, c in self._connections(reader)
                }
            held = [topic for topic in kinds if topic not in self.foreign]
            for topic in held:
                c = kinds[topic]
                copy.add_topic(
                    topic,
                    MessageType(c.msgtype, c.msgdef.data, digest=c.digest),
                )
            for topic, time, data in self.raw(*held) if held else ():
                copy.write(topic, self.topics[topic], time, data)

    @property
    def duration_ns(self) -> int:
        """Time from the first to the last message, ns."""
        return self.end_ns - self.start_ns

    def raw(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time in ns, CDR bytes) of these topics (default: all), ordered by time."""
        for topic in topics:
            if topic not in self.topics:
                raise self._unknown(f"{self._root}{topic}")
        with self._open() as readers:
            streams = (self._messages(reader, topics) for reader in readers)
            yield from heapq.merge(*streams, key=operator.itemgetter(1))

    def _messages(
        self, reader: Reader, topics: tuple[str, ...]
    ) -> Iterator[tuple[str, int, bytes]]:
        names = {
            c.id: t
            for t, c in self._connections(reader)
            if (not topics or t in topics) and _serialization(c) == CDR
        }
        wanted = [c for c in reader.connections if c.id in names]
        if wanted:
            for connection, time, data in reader.messages(wanted):
                _require_time(time)
                yield names[connection.id], time, bytes(data)

    def merged(self, *topics: str) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time in ns, message) of these topics (default: all), ordered by time.

        By default topics of `foreign` are skipped; raises BagError for one that is asked for.
        """
        self.require_types(*topics)
        for topic, time, data in self.raw(*topics):
            if topic not in self.foreign:
                yield topic, time, self.decode(topic, data)

    @functools.cached_property
    def _known_topics(self) -> Mapping[str, RecordedTopic]:
        """The topics of the graph."""
        return read_record_settings().topics

    def require_types(self, *topics: str) -> None:
        """Raise BagError for a topic in `foreign`, and one of the graph that has another type."""
        for topic in topics:
            if topic in self.foreign:
                raise BagError(f"{self.path}: {topic} {self.foreign[topic]}")
            known, kind = self._known_topics.get(topic), self.topics.get(topic)
            if known is not None and kind not in (None, known.type):
                raise BagError(
                    f"{self.path}: {topic} holds {kind}, not {known.type}"
                )

    @contextmanager
    def using(self, topic: str) -> Iterator[None]:
        """Turn the errors of code that uses the messages of a topic into a BagError.

        The definitions in a bag may name or type a field otherwise than the graph does.
        """
        try:
            yield
        except BagError:
            raise
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            TypeError,
            ValueError,
        ) as error:
            raise BagError(
                f"{self.path}: {topic} cannot be used: {error}"
            ) from error

    def decode(self, topic: str, data: bytes) -> Any:
        """Message of CDR bytes on a topic of the bag.

        Some bytes at their end need not be part of it: rclpy's `serialize_message` adds four or
        more to a message with an empty sequence of doubles, such as joints without efforts.
        """
        with self._readable():
            kind = self.topics[topic]
            try:
                return self._types.deserialize_cdr(data, kind)
            except SerdeError:
                found = self._types.get_msgdef(kind)
                read = (
                    found.deserialize_cdr_le
                    if data[1]
                    else found.deserialize_cdr_be
                )
                message, end = read(data[4:], 0, found.cls, self._types)
                if len(data) - 4 - end > SPARE:
                    raise
                return message

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (time in ns, message) of one topic, ordered by time."""
        return ((time, message) for _, time, message in self.merged(topic))

    def series(self, topic: str, *fields: str) -> Series:
        """Fields (dotted, as `pose.pose.position`) as arrays over the messages of a topic.

        A field that is a message becomes the vector of its fields, so a Vector3[4] is (n, 4, 3)
        and a quaternion (n, 4) in the order x y z w. Raises NoFieldError if the type lacks a
        field, BagError if the field's shape changes.
        """
        if topic not in self._cache:
            self._cache[topic] = list(self.messages(topic))
        entries = self._cache[topic]
        with self.using(topic):
            return Series(
                np.array([time for time, _ in entries], np.int64),
                np.array(
                    [_stamp(message, time) for time, message in entries],
                    np.int64,
                ),
                {field: self._column(topic, field) for field in fields},
            )

    def _column(self, topic: str, field: str) -> NDArray[Any]:
        getter = operator.attrgetter(field)
        try:
            return np.array(
                [plain(getter(message)) for _, message in self._cache[topic]]
            )
        except AttributeError:
            raise NoFieldError(
                f"{self.path}: {topic} has no field {field}"
            ) from None
        except ValueError:
            raise BagError(
                f"{self.path}: {topic} {field} changes its shape"
            ) from None

    def _find_files(self) -> tuple[list[Path], Mapping[str, str]]:
        """Whole files of the bag, mended where needed, and the custom data of metadata.yaml."""
        if not self.path.is_dir():
            return [self._intact(self.path)], {}
        metadata = self.path / "metadata.yaml"
        if not metadata.exists():
            found = sorted(
                p for p in self.path.iterdir() if p.suffix in STORAGES
            )
            if not found:
                raise BagError(
                    f"{self.path}: holds no metadata.yaml, .mcap or .db3 file: not a bag"
                )
            # it did not end, even if whole
            self._scratch = TemporaryDirectory()
            return [self._intact(file) for file in found], {}
        content = config.parse(read_text(metadata, METADATA_MAX))
        information = content["rosbag2_bagfile_information"]
        custom = {
            str(k): str(v)
            for k, v in (information.get("custom_data") or {}).items()
        }
        listed = [
            self.path / PurePath(name).name
            for name in information["relative_file_paths"]
        ]
        if information.get("compression_mode", "").lower() not in ("", "none"):
            for file in listed:
                require_regular(file)
            return [self.path], custom  # the library unpacks it
        return [self._intact(file) for file in listed], custom

    def _intact(self, file: Path) -> Path:
        """The file, or a mended copy if its recording did not end; raises ValueError for a pipe."""
        require_regular(file)
        if is_complete(file):
            return file
        self._scratch = self._scratch or TemporaryDirectory()
        return repaired(file, Path(self._scratch.name, file.stem))

    def _read_types(self, readers: list[Reader]) -> Types:
        """Types by the definitions in the bag, else by those installed."""
        all_connections = [c for reader in readers for c in reader.connections]
        inside = {
            c.msgtype: c.msgdef.data
            for c in all_connections
            if c.msgdef.format == MessageDefinitionFormat.MSG
        }
        types = types_inside(tuple(inside.items()))
        if not {c.msgtype for c in all_connections} <= types.fielddefs.keys():
            add_installed(types)
        return types

    def _fault(self, connection: Connection) -> str:
        """Reason why messages of a connection cannot be decoded; else empty."""
        found, kind = _serialization(connection), connection.msgtype
        if found != CDR:
            return f"holds {kind} in {quoted(found)}, expected {CDR}, as ROS 2 records"
        if kind not in self._types.fielddefs:
            return (
                f"holds {kind}, of which the bag has no definition in ros2msg"
            )
        return ""

    def _connections(self, reader: Reader) -> list[tuple[str, Connection]]:
        """Name within the namespace, and connection, of every topic in the namespace."""
        named = [(c, self._remap.get(c.topic)) for c in reader.connections]
        root, replaced = f"{self._root}/", set(self._remap.values())
        inside = [
            (c.topic.removeprefix(self._root), c)
            for c, new in named
            if new is None and c.topic.startswith(root)
        ]
        kept = [(name, c) for name, c in inside if name not in replaced]
        return kept + [(new, c) for c, new in named if new is not None]

    def _unknown(self, topic: str) -> BagError:
        known = ", ".join(self._known) or "none"
        return BagError(f"{self.path}: no topic {topic} (topics: {known})")

    @contextmanager
    def _open(self) -> Iterator[list[Reader]]:
        with self._readable(), ExitStack() as stack:
            yield [stack.enter_context(Reader(file)) for file in self._files]

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Turn every error of the reading libraries into a BagError."""
        try:
            yield
        except BagError:
            raise
        except FileNotFoundError as error:
            missing = Path(error.filename or self.path)
            raise BagError(f"{missing}: does not exist") from None
        except Exception as error:
            # On a damaged file the libraries also raise struct, zstd, assertion and type errors.
            reason = one_line(error) or type(error).__name__
            raise BagError(f"{self.path}: cannot be read: {reason}") from error


def _serialization(connection: Connection) -> str:
    """How the messages of a connection are encoded."""
    ext: Any = connection.ext
    return str(ext.serialization_format)


def _require_time(time: int) -> None:
    """Raise ValueError for a time that no 64 bits hold."""
    if not 0 <= time < 2**63:
        raise ValueError(f"a message at {time} ns, beyond 2^63 - 1")


def _stamp(message: Any, time: int) -> int:
    """Graph time of a message in ns: its stamp, a clock's value, else its time in the bag."""
    stamp = (
        message.header.stamp
        if hasattr(message, "header")
        else getattr(message, "clock", None)
    )
    return (
        time
        if stamp is None
        else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    )


def plain(value: Any) -> Any:
    """Numbers, strings and arrays as they are; a message as the list of its fields."""
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        names = [
            f.name for f in dataclasses.fields(value) if f.name != "__msgtype__"
        ]
        return [plain(getattr(value, name)) for name in names]
    return value


def is_complete(file: Path) -> bool:
    """Whether a file of a bag was finished; true if it was never an MCAP or SQLite file."""
    if file.suffix == ".db3":
        return not _write_ahead_log(file).exists()
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            return True
        stream.seek(-len(MAGIC), 2)
        return stream.read() == MAGIC


def repaired(file: Path, directory: Path) -> Path:
    """Whole copy of an unfinished file, in a new directory; raises OSError."""
    if file.suffix == ".db3":
        return _mended_database(file, directory)
    with BagWriter(directory, read_record_settings(), read_origin(file)) as bag:
        topics: dict[int, tuple[str, str]] = {}
        schemas = {0: Schema(id=0, name="", encoding="", data=b"")}
        for record in _whole_records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in topics:
                schema = schemas[record.schema_id]
                kind = MessageType(
                    schema.name,
                    schema.data.decode(errors="replace"),
                    schema.encoding,
                    record.metadata.get("topic_type_hash", ""),
                    record.message_encoding,
                )
                topics[record.id] = record.topic, kind.name
                bag.add_topic(record.topic, kind)
            elif isinstance(record, Message):
                bag.write(
                    *topics[record.channel_id], record.log_time, record.data
                )
    return directory / f"{directory.name}.mcap"


def read_origin(file: Path) -> Origin:
    """Origin in an MCAP file, finished or not: the metadata before its first chunk."""
    about, files = {}, {}
    for record in _whole_records(file, emit_chunks=True):
        if isinstance(record, Metadata) and record.name == ORIGIN:
            about = record.metadata
        elif isinstance(record, Attachment):
            files[record.name] = record.data
        elif not isinstance(record, (Metadata, Header)):
            break
    return Origin(about, files)


def _whole_records(file: Path, emit_chunks: bool = False) -> Iterator[Any]:
    """Records up to the first truncated or damaged one."""
    with file.open("rb") as stream:
        records = StreamReader(
            stream, emit_chunks=emit_chunks, validate_crcs=True
        ).records
        while True:
            try:
                record = next(records)
            except Exception:  # of the library, struct, zstd and lz4: where the recording ended
                return
            yield record


def _mended_database(file: Path, directory: Path) -> Path:
    """Copy of a database with the messages that are still in its write-ahead log."""
    directory.mkdir()
    copy = Path(shutil.copy(file, directory))
    shutil.copy(_write_ahead_log(file), _write_ahead_log(copy))
    database = sqlite3.connect(copy)
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.close()
    return copy


def _write_ahead_log(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")

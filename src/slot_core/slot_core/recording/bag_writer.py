"""Writes bags: rosbag2 directories with MCAP files, from raw CDR bytes.

A bag is a directory `NAME/` with `NAME.mcap` and `metadata.yaml`, as `ros2 bag record` makes it. A
bag that is split by size goes on in `NAME_1.mcap`, `NAME_2.mcap`, ... Every file contains its
message definitions and the origin of the bag, and consists of compressed chunks that are complete
in themselves: what was flushed is readable without the rest.

Message definitions: the standard ones of Jazzy, and slot_msgs from its .msg files.
"""

from __future__ import annotations

import functools
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import yaml
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from slot_core.recording.origin import ORIGIN, Origin
from slot_core.recording.record_settings import (
    BagError,
    RecordedTopic,
    RecordSettings,
)

Types: TypeAlias = Typestore

PACKAGE = "slot_msgs"
CDR = "cdr"  # serialization of messages that are written and read


def message_types() -> Types:
    """The types of Jazzy and of slot_msgs; raises FileNotFoundError if slot_msgs is not found."""
    types = get_typestore(Stores.ROS2_JAZZY)
    add_installed(types)
    return types


def add_installed(types: Types) -> None:
    """Register those types of slot_msgs that are not yet; FileNotFoundError if none is found."""
    add_definitions(
        types,
        {
            f"{PACKAGE}/msg/{path.stem}": path.read_text()
            for path in sorted(_message_files())
        },
    )


@functools.lru_cache(maxsize=8)
def types_inside(definitions: tuple[tuple[str, str], ...]) -> Types:
    """The types of Jazzy and the (type name, definition) pairs of a bag that can be parsed.

    Kept, as the library compiles the decoder of every type anew for each store.
    """
    types = get_typestore(Stores.ROS2_JAZZY)
    try:
        add_definitions(types, dict(definitions))
    except Exception:  # for one that is no message's, as a service event's
        for pair in definitions:
            with suppress(Exception):
                add_definitions(types, dict([pair]))
    return types


def add_definitions(types: Types, definitions: dict[str, str]) -> None:
    """Register definitions in .msg syntax; types that are registered already stay as they are."""
    types.register(
        {
            name: definition
            for typename, text in definitions.items()
            if typename not in types.fielddefs
            for name, definition in _parsed(text, typename).items()
            if name not in types.fielddefs
        }
    )


@functools.cache
def _parsed(text: str, typename: str) -> dict[str, Any]:
    """Types in a definition; parsing takes longer than all the rest of opening a bag."""
    return dict(get_types_from_msg(text, typename))


def _message_files() -> list[Path]:
    """The .msg files from the first installation that has slot_msgs, else from the source tree."""
    places = [
        Path(prefix, "share", PACKAGE, "msg")
        for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        if prefix
    ]
    places.append(Path(__file__).resolve().parents[4] / PACKAGE / "msg")
    for place in places:
        if files := list(place.glob("*.msg")):
            return files
    raise FileNotFoundError(
        f"no .msg files of {PACKAGE}: build it, and source the workspace"
    )


VERSION = 9  # of metadata.yaml
# how rosbag2 writes an infinite time, 2^63 - 1 ns
FOREVER = {"sec": 9223372036, "nsec": 854775807}
MEGABYTE = 1_000_000


@dataclass(frozen=True)
class MessageType:
    """A message type as a bag stores it."""

    name: str
    definition: str
    encoding: str = "ros2msg"
    digest: str = ""  # RIHS01 hash
    serialization: str = CDR  # of its messages


class BagWriter:
    """Writes a rosbag2 MCAP bag with zstd chunks; a context manager.

    Raises BagError if `path` exists or cannot be written, also later. Until it is closed, a bag has
    no index and no metadata.yaml; `Bag` reads it all the same, up to the last `flush`.
    """

    def __init__(
        self,
        path: Path | str,
        settings: RecordSettings,
        origin: Origin | None = None,
    ) -> None:
        self._path = Path(path)
        self._settings = settings
        self._origin = origin or Origin()
        self._types = message_types()
        self._topics: dict[str, MessageType] = {}
        self._files: list[_File] = []
        try:
            self._path.mkdir(parents=True)
            self._file = self._next_file()
        except FileExistsError:
            raise BagError(f"{path}: exists already") from None
        except OSError as error:
            raise self._failure(error) from None

    def write(
        self, topic: str, typename: str, time_ns: int, data: bytes | memoryview
    ) -> None:
        """Append one message: CDR bytes `data` of `typename`, published at wall time `time_ns`.

        Raises BagError for an unknown type and for a topic that changes its type.
        """
        known = self._topics.get(topic) or self.add_topic(
            topic, self._type(topic, typename)
        )
        if known.name != typename:
            raise BagError(
                f"{topic}: is recorded as {known.name}, not {typename}"
            )
        try:
            self._file.add(topic, time_ns, bytes(data))
        except OSError as error:
            raise self._failure(error) from None

    def add_topic(self, topic: str, kind: MessageType) -> MessageType:
        """Declare a topic by a definition of its type from elsewhere, for example another bag."""
        self._topics[topic] = kind
        self._file.connect(topic, kind, self._qos(topic))
        return kind

    def flush(self) -> None:
        """Close the present chunk and hand it to the system; start a new file beyond `split`.

        Raises BagError if the disk is full.
        """
        try:
            self._file.flush()
            if 0.0 < self._settings.split * MEGABYTE <= self._file.size:
                self._finish(self._file)
                self._file = self._next_file()
        except OSError as error:
            raise self._failure(error) from None

    def close(self) -> None:
        """Write the index and metadata.yaml; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self._finish(self._file)
            information = self._information(self._files)
            (self._path / "metadata.yaml").write_text(
                yaml.safe_dump(
                    {"rosbag2_bagfile_information": information},
                    sort_keys=False,
                )
            )
        except OSError as error:
            raise self._failure(error) from None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _failure(self, error: OSError) -> BagError:
        return BagError(f"{self._path}: cannot be written: {error.strerror}")

    def _type(self, topic: str, typename: str) -> MessageType:
        if typename not in self._types.fielddefs:
            raise BagError(f"{topic}: no definition of {typename} found")
        definition, _ = self._types.generate_msgdef(typename, ros_version=2)
        return MessageType(
            typename, definition, digest=self._types.hash_rihs01(typename)
        )

    def _next_file(self) -> _File:
        number = f"_{len(self._files)}" if self._files else ""
        file = _File(
            self._path / f"{self._path.name}{number}.mcap", self._origin
        )
        self._files.append(file)
        for topic, kind in self._topics.items():
            file.connect(topic, kind, self._qos(topic))
        return file

    def _finish(self, file: _File) -> None:
        file.finish(yaml.safe_dump(self._information([file]), sort_keys=False))

    def _qos(self, topic: str) -> list[dict[str, Any]]:
        plain = RecordedTopic("", "reliable", "volatile")
        wanted = self._settings.topics.get(topic, plain)
        return [
            {
                "history": "keep_last",
                "depth": self._settings.depth,
                "reliability": wanted.reliability,
                "durability": wanted.durability,
                "deadline": dict(FOREVER),
                "lifespan": dict(FOREVER),
                "liveliness": "automatic",
                "liveliness_lease_duration": dict(FOREVER),
                "avoid_ros_namespace_conventions": False,
            }
        ]

    def _information(self, files: list[_File]) -> dict[str, Any]:
        """Content of metadata.yaml, and of the same record in a file."""
        entries = [file.information() for file in files]
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": kind.name,
                    "serialization_format": kind.serialization,
                    "offered_qos_profiles": self._qos(topic),
                    "type_description_hash": kind.digest,
                },
                "message_count": sum(
                    file.counts.get(topic, 0) for file in files
                ),
            }
            for topic, kind in self._topics.items()
        ]
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            "relative_file_paths": [entry["path"] for entry in entries],
            **_span(files),
            "message_count": sum(entry["message_count"] for entry in entries),
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": entries,
            "custom_data": dict(self._origin.about) or None,
            "ros_distro": "jazzy",
        }


class _File:
    """One MCAP file of a bag."""

    def __init__(self, path: Path, origin: Origin) -> None:
        self._path = path
        self._stream = path.open("xb")
        self._writer = Writer(self._stream)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.counts: dict[str, int] = {}
        self.first, self.last = 2**63 - 1, 0  # ns, times of the messages
        self._writer.start("ros2")
        self._writer.add_metadata(ORIGIN, dict(origin.about))
        for name, data in origin.files.items():
            kind = "application/zip" if name.endswith(".zip") else "text/plain"
            self._writer.add_attachment(0, 0, name, kind, data)
        self.flush()

    @property
    def closed(self) -> bool:
        """Whether the file was finished."""
        return self._stream.closed

    @property
    def size(self) -> int:
        """Bytes handed to the system."""
        return self._stream.tell()

    def connect(
        self, topic: str, kind: MessageType, qos: list[dict[str, Any]]
    ) -> None:
        if kind.name not in self._schemas:
            self._schemas[kind.name] = self._writer.register_schema(
                kind.name, kind.encoding, kind.definition.encode()
            )
        self._channels[topic] = self._writer.register_channel(
            topic,
            kind.serialization,
            self._schemas[kind.name],
            {
                "offered_qos_profiles": yaml.safe_dump(qos, sort_keys=False),
                "topic_type_hash": kind.digest,
            },
        )
        self.counts[topic] = 0

    def add(self, topic: str, time_ns: int, data: bytes) -> None:
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)
        self.counts[topic] += 1
        self.first, self.last = (
            min(self.first, time_ns),
            max(self.last, time_ns),
        )

    def flush(self) -> None:
        self._writer.flush()

    def finish(self, information: str) -> None:
        """Write the rest, the information that rosbag2 keeps in a file, and the index.

        The writer is dropped, as it holds the index: 2 kB of each chunk.
        """
        try:
            self._writer.flush()
            self._writer.add_metadata(
                "rosbag2", {"serialized_metadata": information}
            )
            self._writer.finish()
        finally:
            self._stream.close()
            del self._writer

    def information(self) -> dict[str, Any]:
        """Entry of metadata.yaml."""
        return {
            "path": self._path.name,
            **_span([self]),
            "message_count": sum(self.counts.values()),
        }


def _span(files: list[_File]) -> dict[str, Any]:
    """Time of the first message and duration, as metadata.yaml holds them."""
    first, last = (
        min(file.first for file in files),
        max(file.last for file in files),
    )
    return {
        "duration": {"nanoseconds": max(0, last - first)},
        "starting_time": {"nanoseconds_since_epoch": first},
    }

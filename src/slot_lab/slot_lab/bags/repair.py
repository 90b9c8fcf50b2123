"""Mends bags whose recording did not end: copies the intact part, and adds the index."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from slot_core.recording.bag_writer import BagWriter, MessageType
from slot_core.recording.origin import ORIGIN, Origin
from slot_core.recording.record_settings import read_record_settings

MAGIC = b"\x89MCAP0\r\n"  # at both ends of a whole file


def is_complete(file: Path) -> bool:
    """Whether a file of a bag was finished; true if it was never an MCAP or SQLite file."""
    if file.suffix == ".db3":
        return not _log(file).exists()
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
        schemas: dict[int, Schema] = {}
        for record in _whole_records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in topics:
                schema = schemas[record.schema_id]
                digest = record.metadata.get("topic_type_hash", "")
                kind = MessageType(
                    schema.name, schema.data.decode(), schema.encoding, digest
                )
                topics[record.id] = record.topic, kind.name
                bag.add_topic(record.topic, kind)
            elif isinstance(record, Message):
                bag.write(*topics[record.channel_id], record.log_time, record.data)
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
            except (
                Exception
            ):  # of the library, struct, zstd and lz4: where the recording ended
                return
            yield record


def _mended_database(file: Path, directory: Path) -> Path:
    """Copy of a database with the messages that are still in its write-ahead log."""
    directory.mkdir()
    copy = Path(shutil.copy(file, directory))
    shutil.copy(_log(file), _log(copy))
    database = sqlite3.connect(copy)
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.close()
    return copy


def _log(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")

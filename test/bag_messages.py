"""Messages of the recorded topics, and bags of them."""

import functools
from array import array
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message

from slot_core.recording.bag_writer import (
    BagWriter,
    MessageType,
    types_inside,
)
from slot_core.recording.record_settings import read_record_settings
from slot_nodes.messages import header, message_class

MESSAGES = Path(__file__).parents[1] / "slot_msgs" / "msg"
TOPICS = {
    name: topic.type for name, topic in read_record_settings().topics.items()
}
WALL = 1_700_000_000_000_000_000  # ns, wall clock of a bag


def message(topic, stamp, **fields):
    """A message of a topic at graph time `stamp` (s); `a__b=value` sets the field a.b."""
    built = message_class(TOPICS[topic])(header=header(round(stamp * 1e9), ""))
    for path, value in fields.items():
        *parents, last = path.split("__")
        owner = functools.reduce(getattr, parents, built)
        setattr(owner, last, _filled(getattr(owner, last), value))
    return built


def _filled(old, value):
    """`value` in the type of a field's old one; numbers fill a message's fields in order."""
    if hasattr(old, "get_fields_and_field_types"):
        names = old.get_fields_and_field_types()
        return type(old)(**dict(zip(names, map(float, value))))
    if isinstance(old, list) and hasattr(next(iter(old), 0), "SLOT_TYPES"):
        return [_filled(old[0], row) for row in value]
    if isinstance(old, (array, list, np.ndarray)):
        return np.ravel(value).tolist()
    return value


def write_messages(path, entries):
    """Write a bag of messages, each after its time (ns) and topic."""
    with BagWriter(path, read_record_settings()) as bag:
        for time, topic, built in entries:
            bag.write(topic, TOPICS[topic], time, serialize_message(built))
    return path


def write_old(path, topic, now):
    """Write a bag of one message, of a type that ends before its last field."""
    kind = TOPICS[topic]
    *known, last = now.get_fields_and_field_types()
    text = (MESSAGES / f"{Path(kind).name}.msg").read_text()
    definition = text[: text.rindex("\n", 0, text.index(f" {last} "))] + "\n"
    types = types_inside(((kind, definition),))
    values = (getattr(now, name) for name in known)
    old = types.types[kind](
        *(np.array(v) if isinstance(v, array) else v for v in values)
    )
    with BagWriter(path, read_record_settings()) as bag:
        bag.add_topic(topic, MessageType(kind, definition))
        bag.write(topic, kind, WALL, bytes(types.serialize_cdr(old, kind)))
    return path

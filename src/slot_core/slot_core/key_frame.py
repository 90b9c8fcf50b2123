"""Key frame: the complete state of an object as text, from which an equal object goes on.

A class names what its state consists of:

    STATE = StateParts("_stamp", "_filter", values=(Rate,))

Numbers, text, arrays, sequences and the named value classes (frozen dataclasses and NamedTuples)
are written as they are, to the last bit; an attribute whose class has a STATE of its own is written
by that, and restored in place. Nothing is executed: a key frame may come from a stranger.
"""

import base64
import dataclasses
import json
import math
from collections import deque
from typing import Any

import numpy as np

TYPES = ("<f8", "<f4", "<i8", "|b1", "|u1")  # of the elements of arrays
TEXT_MAX = 4_000_000  # characters of a key frame
ARRAY, MAP, PART = "array", "map", "part"  # keys of what JSON has not


class StateParts:
    """Names of the attributes that are the state, in the order in which they are restored."""

    def __init__(self, *names: str, values: tuple[type, ...] = ()) -> None:
        self.names = names
        self.values = {kind.__name__: kind for kind in values}


def capture(thing: Any) -> str:
    """The state as text; empty for an object whose class names none."""
    return json.dumps(_part(thing)) if has_state(thing) else ""


def restore(thing: Any, text: str) -> None:
    """Set the state of an object that was made with the same settings.

    Raises ValueError for a text that is not a state of such an object, which is then not to be
    used: a part of it may be set.
    """
    if len(text) > TEXT_MAX:
        raise ValueError(
            f"key frame of {len(text)} characters, limit {TEXT_MAX}"
        )
    try:
        _restore_part(thing, json.loads(text))
    except (
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
        RecursionError,
    ) as error:
        raise ValueError(
            f"no key frame of {type(thing).__name__}: {error}"
        ) from error


def has_state(thing: Any) -> bool:
    """Whether the class of an object, and the classes of its parts, declare their state."""
    state = getattr(type(thing), "STATE", None)
    if not isinstance(state, StateParts):
        return False
    return all(
        has_state(part)
        for part in [getattr(thing, name) for name in state.names]
        if hasattr(type(part), "STATE")
    )


def _part(thing: Any) -> dict[str, Any]:
    return {
        name: _plain(getattr(thing, name)) for name in type(thing).STATE.names
    }


def _plain(value: Any) -> Any:
    """The value in terms of JSON."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple, deque)) and not hasattr(
        value, "_asdict"
    ):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return {
            ARRAY: [
                value.dtype.str,
                value.shape,
                base64.b64encode(value.tobytes()).decode(),
            ]
        }
    if hasattr(type(value), "STATE"):
        return {PART: _part(value)}
    kind, items = (
        (MAP, value)
        if isinstance(value, dict)
        else (type(value).__name__, _fields(value))
    )
    return {kind: {name: _plain(item) for name, item in items.items()}}


def _fields(value: Any) -> dict[str, Any]:
    """Fields of a value class."""
    if hasattr(value, "_asdict"):
        return dict(value._asdict())
    if dataclasses.is_dataclass(value):
        return {
            f.name: getattr(value, f.name) for f in dataclasses.fields(value)
        }
    raise TypeError(f"{type(value).__name__} is no part of a key frame")


def _restore_part(thing: Any, plain: Any) -> None:
    state = type(thing).STATE
    if sorted(plain) != sorted(state.names):
        raise ValueError(f"{type(thing).__name__} of {', '.join(plain)}")
    for name in state.names:
        present = getattr(thing, name)
        if hasattr(type(present), "STATE"):
            _restore_part(present, plain[name][PART])
            continue
        value = _value(plain[name], state.values)
        if isinstance(present, deque):
            value = deque(value, present.maxlen)
        _require_like(name, value, present)
        setattr(thing, name, value)


def _value(plain: Any, values: dict[str, type]) -> Any:
    """Inverse of `_plain`; a sequence becomes a tuple."""
    if isinstance(plain, list):
        return tuple(_value(item, values) for item in plain)
    if not isinstance(plain, dict):
        return plain
    ((kind, content),) = plain.items()
    if kind == ARRAY:
        return _array(*content)
    named = {name: _value(item, values) for name, item in content.items()}
    return named if kind == MAP else values[kind](**named)


def _array(kind: str, shape: list[int], text: str) -> np.ndarray:
    if kind not in TYPES or any(n < 0 for n in shape):
        raise ValueError(f"array of {kind} {shape}")
    data = base64.b64decode(text, validate=True)
    if len(data) != math.prod(shape) * np.dtype(kind).itemsize:
        raise ValueError(f"array {shape} of {len(data)} bytes")
    return np.frombuffer(data, dtype=kind).reshape(shape).copy()


def _require_like(name: str, value: Any, present: Any) -> None:
    """Raise ValueError unless arrays have the shapes of those they replace: kernels trust them."""
    if isinstance(present, np.ndarray):
        if not isinstance(value, np.ndarray) or _form(value) != _form(present):
            raise ValueError(f"{name}: expected an array of {_form(present)}")
    elif hasattr(present, "_asdict"):
        if type(value) is not type(present):
            raise ValueError(f"{name}: expected a {type(present).__name__}")
        for part, new, old in zip(present._fields, value, present, strict=True):
            _require_like(f"{name}.{part}", new, old)


def _form(array: np.ndarray) -> tuple[str, tuple[int, ...]]:
    return array.dtype.str, array.shape

"""Key frames: the state of a stage as bytes, from which its replay can begin.

A stage names in `STATE` the attributes that hold what it remembers, and in `KINDS` the dataclasses
and named tuples among their values; a value that has `STATE` itself is a part with a state of its
own. The bytes are compressed JSON, since a bag may come from a stranger: nothing in it is executed.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

SIZE_MAX = 50_000_000  # bytes of a key frame's JSON
TYPES = ("<f8", "<i8", "|b1")  # of arrays
Kinds = Mapping[str, type]


def has_state(stage: Any) -> bool:
    """Whether a stage says what it remembers."""
    return getattr(stage, "STATE", None) is not None


def captured(stage: Any) -> dict[str, Any]:
    """A copy of the state, to be encoded later; raises AttributeError for a stage without one."""
    return {name: _captured(getattr(stage, name)) for name in stage.STATE}


def encoded(state: dict[str, Any]) -> bytes:
    """The bytes of what was captured."""
    return zlib.compress(json.dumps(state, default=_of_array).encode(), 1)


def restore(stage: Any, data: bytes) -> None:
    """Set the state of a stage; raises ValueError for bytes that are not its key frame."""
    try:
        text = zlib.decompressobj().decompress(data, SIZE_MAX)
        _restore(stage, json.loads(text), _kinds(stage))
    except (zlib.error, AttributeError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f"no key frame of {type(stage).__name__}: {error}") from None


def _captured(value: Any) -> Any:
    if has_state(value):
        found: Any = {"state": captured(value)}
    elif isinstance(value, np.ndarray):
        found = value.copy()
    elif isinstance(value, np.generic):
        found = value.item()
    elif dataclasses.is_dataclass(value) or hasattr(value, "_fields"):
        names = getattr(value, "_fields", None) or [f.name for f in dataclasses.fields(value)]
        values = [_captured(getattr(value, name)) for name in names]
        found = {"kind": type(value).__name__, "values": values}
    elif isinstance(value, dict):
        found = {"items": {key: _captured(part) for key, part in value.items()}}
    elif isinstance(value, (list, tuple, deque)):
        found = [_captured(part) for part in value]
    else:
        found = value
    return found


def _of_array(array: np.ndarray) -> dict[str, Any]:
    data = base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
    return {"array": array.dtype.str, "shape": array.shape, "data": data}


def _kinds(stage: Any) -> dict[str, type]:
    """Classes that the state of a stage and its parts may hold, by their names."""
    found = {kind.__name__: kind for kind in getattr(stage, "KINDS", ())}
    for name in stage.STATE:
        part = getattr(stage, name)
        if has_state(part):
            found |= _kinds(part)
    return found


def _restore(stage: Any, state: dict[str, Any], kinds: Kinds) -> None:
    for name in stage.STATE:
        before = getattr(stage, name)
        if has_state(before):
            _restore(before, state[name]["state"], kinds)
        else:
            setattr(stage, name, _value(state[name], before, kinds))


def _value(value: Any, before: Any, kinds: Kinds) -> Any:
    """A value of the JSON in the type that it had; a list becomes what `before` is."""
    if isinstance(value, list):
        parts = [_value(part, None, kinds) for part in value]
        if isinstance(before, deque):
            return deque(parts, before.maxlen)
        return tuple(parts) if isinstance(before, tuple) else parts
    if not isinstance(value, dict):
        return value
    if "items" in value:
        return {key: _value(part, None, kinds) for key, part in value["items"].items()}
    if "kind" in value:
        return kinds[value["kind"]](*(_value(part, None, kinds) for part in value["values"]))
    if value["array"] not in TYPES:
        raise TypeError(f"an array of {value['array']!r}")
    flat = np.frombuffer(base64.b64decode(value["data"]), value["array"])
    return flat.reshape(value["shape"]).copy()

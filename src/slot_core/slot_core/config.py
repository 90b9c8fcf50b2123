"""Configuration: YAML files read into typed, bounded, frozen dataclasses.

A settings class is a frozen dataclass whose fields are made by `quantity`, `choice`, `flag` or
`text`; each carries its description, unit and bounds. Values are set in `config/*.yaml` only: a
field has no default. A missing, unknown, mistyped or out-of-range value raises a ConfigError with
its name, its value and the violated limit.
"""

from __future__ import annotations

import dataclasses
import math
import os
import stat
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

T = TypeVar("T")
SIZE_MAX = 1_000_000  # bytes of a configuration file
DEPTH_MAX = 100  # nested collections of a YAML text


class ConfigError(ValueError):
    """An invalid configuration value; the message gives its name, its value and the limit."""


def config_dir() -> Path:
    """Directory of the YAML files: $SLOT_CONFIG if set, else the one shipped with the package."""
    return Path(os.environ.get("SLOT_CONFIG") or Path(__file__).parent / "defaults")


def quantity(doc: str, unit: str = "", low: float = -math.inf, high: float = math.inf) -> Any:
    """A number, or a tuple of numbers, every element within [low, high]."""
    return dataclasses.field(metadata={"doc": doc, "unit": unit, "low": low, "high": high})


def choice(doc: str, *options: str) -> Any:
    """A string, one of `options`."""
    return dataclasses.field(metadata={"doc": doc, "options": options})


def flag(doc: str) -> Any:
    """True or false."""
    return dataclasses.field(metadata={"doc": doc})


def text(doc: str) -> Any:
    """Any string, or a tuple of strings."""
    return dataclasses.field(metadata={"doc": doc})


def read(cls: type[T], name: str) -> T:
    """Read `<config_dir>/<name>.yaml` into the settings class `cls`.

    Raises ConfigError if the file is missing, is not YAML, or holds a value invalid for `cls`.
    """
    return build(cls, load(name), where=f"{name}.yaml")


def load(name: str) -> Any:
    """Content of `<config_dir>/<name>.yaml`, unchecked.

    Raises ConfigError if the file is missing (the message lists the known names), no regular file,
    larger than SIZE_MAX or not YAML, if it repeats a key, or nests deeper than DEPTH_MAX.
    """
    path = config_dir() / f"{name}.yaml"
    try:
        return parse(read_text(path))
    except FileNotFoundError:
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.yaml")))
        raise ConfigError(f"no configuration {name!r} (known: {known})") from None
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{name}.yaml: {' '.join(str(error).split())}") from None


def names(folder: str) -> list[str]:
    """Names of the files of `<config_dir>/<folder>`, sorted."""
    return sorted(path.stem for path in (config_dir() / folder).glob("*.yaml"))


def parse(text: str) -> Any:
    """Content of a YAML text.

    Raises yaml.YAMLError, also where a mapping repeats a key, and ValueError if it nests deeper
    than DEPTH_MAX; the loader in C would overflow its stack.
    """
    depth = 0
    for event in yaml.parse(text, yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEPTH_MAX:
            raise ValueError(f"nested deeper than {DEPTH_MAX} levels")
    return yaml.load(text, _UniqueKeyLoader)


def read_text(path: Path) -> str:
    """Text of a regular file of at most SIZE_MAX bytes; raises OSError, ValueError."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("not a regular file")
    if status.st_size > SIZE_MAX:
        raise ValueError(f"{status.st_size} bytes, limit {SIZE_MAX}")
    return path.read_text()


class _UniqueKeyLoader(yaml.CSafeLoader):
    """YAML's safe loader, which refuses a mapping that repeats a key."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """The mapping of a node; raises ConstructorError."""
        seen: list[Any] = []
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                where, problem = key_node.start_mark, f"the key {key!r} is repeated"
                raise yaml.constructor.ConstructorError(None, None, problem, where)
            seen.append(key)
        return super().construct_mapping(node, deep)


def build(cls: type[T], mapping: Any, where: str) -> T:
    """Build the settings class `cls` from nested mappings; raises ConfigError.

    where: name of the source in error messages.
    """
    if not isinstance(mapping, Mapping):
        raise ConfigError(f"{where}: expected a mapping of {cls.__name__}, got {mapping!r}")
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    if unknown := [str(key) for key in mapping if key not in fields]:
        raise ConfigError(
            f"{_inside(where, unknown[0])} is not a setting (known: {', '.join(fields)})"
        )
    if missing := [name for name in fields if name not in mapping]:
        raise ConfigError(f"{_inside(where, missing[0])} is missing")
    values = {
        name: _convert(mapping[name], hints[name], field.metadata, _inside(where, name))
        for name, field in fields.items()
    }
    try:
        return cls(**values)
    except ConfigError as error:  # raised by a class that checks values against each other
        raise ConfigError(_inside(where, str(error))) from None


def leaves(settings: Any, prefix: str = "") -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Yield (dotted name, value, metadata) of every value of a settings object, except mappings."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from leaves(value, f"{prefix}{field.name}.")
        elif not isinstance(value, dict):
            yield prefix + field.name, value, field.metadata


def replace(settings: T, changes: Mapping[str, Any], where: str = "override") -> T:
    """Return a copy with the values at dotted names changed, checked as in `build`.

    Raises ConfigError as `build` does, for an unknown name, and if `changes` is no mapping.
    """
    if not isinstance(changes, Mapping):
        raise ConfigError(f"{where}: expected a mapping of dotted names, got {changes!r}")
    mapping = _to_mapping(settings)
    for name, value in changes.items():
        *parents, last = str(name).split(".")
        node = mapping
        for parent in parents:
            node = node.get(parent, {})
        if last not in node:
            raise ConfigError(f"{where}: {name} is not a setting")
        node[last] = value
    return build(type(settings), mapping, where)


def _inside(where: str, name: str) -> str:
    """`file.yaml: name`, and `file.yaml: name.inner` below that."""
    return f"{where}.{name}" if ": " in where else f"{where}: {name}"


def _to_mapping(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {f.name: _to_mapping(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: _to_mapping(item) for key, item in value.items()}
    return value


def _convert(value: Any, kind: Any, meta: Mapping[str, Any], where: str) -> Any:
    if dataclasses.is_dataclass(kind):
        return build(typing.cast(type, kind), value, where)
    if typing.get_origin(kind) is dict:
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where} = {value!r}: expected a mapping")
        item = typing.get_args(kind)[1]
        return {str(k): _convert(v, item, meta, f"{where}.{k}") for k, v in value.items()}
    if typing.get_origin(kind) is tuple:
        return _convert_tuple(value, typing.get_args(kind), meta, where)
    return _convert_scalar(value, kind, meta, where)


def _convert_tuple(value: Any, kinds: tuple[Any, ...], meta: Mapping[str, Any], where: str) -> Any:
    if not isinstance(value, (list, tuple)):
        raise ConfigError(f"{where} = {value!r}: expected a list")
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if len(value) != len(kinds):
        raise ConfigError(f"{where} = {value!r}: expected {len(kinds)} values, got {len(value)}")
    return tuple(
        _convert(v, k, meta, f"{where}[{i}]") for i, (v, k) in enumerate(zip(value, kinds))
    )


def _convert_scalar(value: Any, kind: Any, meta: Mapping[str, Any], where: str) -> Any:
    if kind is float and not isinstance(value, bool):
        try:  # YAML 1.1 reads 1e-8 as a string
            value = float(value)
        except (TypeError, ValueError):
            raise ConfigError(f"{where} = {value!r}: expected a number") from None
        except OverflowError:
            raise ConfigError(f"{where}: {_short(value)}: too large for a number") from None
    if type(value) is not kind:
        raise ConfigError(f"{where} = {value!r}: expected {kind.__name__}")
    if "options" in meta and value not in meta["options"]:
        raise ConfigError(f"{where} = {value!r}: expected one of {', '.join(meta['options'])}")
    if "low" in meta and not meta["low"] <= value <= meta["high"]:
        unit = f" {meta['unit']}" if meta["unit"] else ""
        limits = f"[{meta['low']}, {meta['high']}]{unit}"
        raise ConfigError(f"{where} = {_short(value)}: outside {limits}")
    return value


def _short(value: Any) -> str:
    """A number as text, or how long it is: Python refuses to print very long integers."""
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {value.bit_length()} bits"
    return str(value)

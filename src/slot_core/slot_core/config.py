"""Configuration: YAML files read into typed, bounded, frozen dataclasses.

A settings class is a frozen dataclass whose fields are made by `quantity`, `choice`, `flag` or
`text`; each carries its description, unit and bounds. Values are set in `config/*.yaml` only: a
field has no default. A missing, unknown, mistyped or out-of-range value raises a ConfigError with
its name, its value and the violated limit.
"""

import dataclasses
import math
import os
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from slot_core.refusal import InputError, nearest, quoted, read_text

T = TypeVar("T")
SIZE_MAX = 1_000_000  # bytes of a configuration file
KIND_NAMES = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "text",
}


class ConfigError(InputError):
    """An invalid configuration value; the message gives its name, its value and the limit."""


def config_dir() -> Path:
    """Directory of the YAML files: $SLOT_CONFIG if set, else the one shipped with the package."""
    # in the repository that one is a link to `config/`, under which name messages show it
    return Path(
        os.environ.get("SLOT_CONFIG")
        or (Path(__file__).parent / "defaults").resolve()
    )


def quantity(
    doc: str, unit: str = "", low: float = -math.inf, high: float = math.inf
) -> Any:
    """A number, or a tuple of numbers, every element within [low, high]."""
    return dataclasses.field(
        metadata={"doc": doc, "unit": unit, "low": low, "high": high}
    )


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

    Raises ConfigError if the file is missing (the message lists known names), no regular file,
    larger than SIZE_MAX, or cannot be parsed.
    """
    path = config_dir() / f"{name}.yaml"
    try:
        return parse(read_text(path, SIZE_MAX))
    except FileNotFoundError:
        known = names(str(Path(name).parent))
        raise ConfigError(
            f"no configuration {quoted(name)}{nearest(path.stem, known)}"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{name}.yaml: {error}") from None


def names(folder: str) -> list[str]:
    """Names of the files of `<config_dir>/<folder>`, sorted."""
    return sorted(path.stem for path in (config_dir() / folder).glob("*.yaml"))


def parse(text: str) -> Any:
    """Content of a YAML text; raises ConfigError as `load_plain` does ValueError."""
    from slot_core.yaml_text import load_plain  # noqa: PLC0415 - a help needs no PyYAML

    try:
        return load_plain(text)
    except ValueError as error:
        raise ConfigError(error) from None


def build(cls: type[T], mapping: Any, where: str) -> T:
    """Build the settings class `cls` from nested mappings; raises ConfigError.

    where: name of the source in error messages.
    """
    if not isinstance(mapping, Mapping):
        raise ConfigError(
            f"{where}: expected a mapping of {cls.__name__}, got {quoted(mapping)}"
        )
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    if unknown := [_name(key) for key in mapping if key not in fields]:
        raise ConfigError(
            f"{_inside(where, unknown[0])} is not a setting"
            f"{nearest(unknown[0], fields)}"
        )
    if missing := [name for name in fields if name not in mapping]:
        raise ConfigError(f"{_inside(where, missing[0])} is missing")
    values = {
        name: _convert(
            mapping[name], hints[name], field.metadata, _inside(where, name)
        )
        for name, field in fields.items()
    }
    try:
        return cls(**values)
    except (
        ConfigError
    ) as error:  # raised by a class that checks values against each other
        raise ConfigError(_inside(where, str(error))) from None


def leaves(
    settings: Any, prefix: str = ""
) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Yield (dotted name, value, metadata) of every value of a settings object, except mappings."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from leaves(value, f"{prefix}{field.name}.")
        elif not isinstance(value, dict):
            yield prefix + field.name, value, field.metadata


def dotted(
    mapping: Mapping[Any, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, value) of nested mappings; an empty one is a value."""
    for key, value in mapping.items():
        if isinstance(value, Mapping) and value:
            yield from dotted(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def replace(
    settings: T, changes: Mapping[str, Any], where: str = "override"
) -> T:
    """Return a copy with the values at dotted names changed, checked as in `build`.

    Raises ConfigError as `build` does, for an unknown name, and if `changes` is no mapping.
    """
    if not isinstance(changes, Mapping):
        raise ConfigError(
            f"{where}: expected a mapping of dotted names, got {quoted(changes)}"
        )
    mapping = dataclasses.asdict(settings)  # type: ignore[call-overload]
    for name, value in changes.items():
        *parents, last = str(name).split(".")
        node = mapping
        for parent in parents:
            node = node.get(parent) if isinstance(node, dict) else None
        if not isinstance(node, dict) or last not in node:
            raise ConfigError(
                f"{where}: {name} is not a setting"
                f"{nearest(str(name), dict(dotted(mapping)))}"
            )
        node[last] = value
    return build(type(settings), mapping, where)


def _name(key: Any) -> str:
    """Name of a setting, whose key need not be a string in YAML."""
    return key if isinstance(key, str) else quoted(key)


def _inside(where: str, name: str) -> str:
    """`file.yaml: name`, and `file.yaml: name.inner` below that."""
    return f"{where}.{name}" if ": " in where else f"{where}: {name}"


def _convert(value: Any, kind: Any, meta: Mapping[str, Any], where: str) -> Any:
    if dataclasses.is_dataclass(kind):
        return build(typing.cast(type, kind), value, where)
    if typing.get_origin(kind) is dict:
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where} = {quoted(value)}: expected a mapping")
        item = typing.get_args(kind)[1]
        return {
            k: _convert(v, item, meta, f"{where}.{k}")
            for k, v in zip(map(_name, value), value.values())
        }
    if typing.get_origin(kind) is not tuple:
        return _convert_scalar(value, kind, meta, where)
    kinds = typing.get_args(kind)
    if not isinstance(value, (list, tuple)):
        raise ConfigError(f"{where} = {quoted(value)}: expected a list")
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(value)
    if len(value) != len(kinds):
        raise ConfigError(
            f"{where} = {quoted(value)}: expected {len(kinds)} values, got {len(value)}"
        )
    return tuple(
        _convert(v, k, meta, f"{where}[{i}]")
        for i, (v, k) in enumerate(zip(value, kinds))
    )


def _convert_scalar(
    value: Any, kind: Any, meta: Mapping[str, Any], where: str
) -> Any:
    if kind is float and not isinstance(value, bool):
        try:  # YAML 1.1 reads 1e-8 as a string
            value = float(value)
        except (TypeError, ValueError):
            raise ConfigError(
                f"{where} = {quoted(value)}: expected {KIND_NAMES[float]}"
            ) from None
        except OverflowError:
            raise ConfigError(
                f"{where}: {quoted(value)}: too large for a number"
            ) from None
    if type(value) is not kind:
        raise ConfigError(
            f"{where} = {quoted(value)}: expected {KIND_NAMES[kind]}"
        )
    if "options" in meta and value not in meta["options"]:
        raise ConfigError(
            f"{where} = {quoted(value)}: expected one of {', '.join(meta['options'])}"
        )
    if "low" in meta and not meta["low"] <= value <= meta["high"]:
        unit = f" {meta['unit']}" if meta["unit"] else ""
        raise ConfigError(
            f"{where} = {quoted(value)}: outside [{meta['low']}, {meta['high']}]{unit}"
        )
    return value

"""Differences between the origins of two bags: revision, policy, arguments, configuration."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from slot_core import config
from slot_core.config import ConfigError
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.recording.bag_error import BagError
from slot_core.recording.origin import CONFIGURATION, Origin
from slot_core.refusal import one_line, quoted
from slot_lab.bags.bag import Bag
from slot_lab.bags.topics import PLANS

WIDTH = 24  # of the names


def origin_lines(first: Bag, second: Bag) -> list[str]:
    """Lines on revision, policy and other differences of the origins."""
    a, b = _about(first), _about(second)
    names = dict.fromkeys(["revision", "policy", *a, *b])
    changed = [name for name in names if a.get(name) != b.get(name)]
    shown = dict.fromkeys(["revision", "policy", *changed])
    lines = [_line(name, a.get(name, "-"), b.get(name, "-")) for name in shown]
    same = one_line(
        ", ".join(f"{name} {a[name]}" for name in names if name not in shown)
    )
    return [
        *lines,
        *([f"{'the same':<{WIDTH}}{same}"] if same else []),
        *_tuning_lines(first, second),
        *_file_lines(first.origin, second.origin),
        *_configuration_lines(first, second),
    ]


def _about(bag: Bag) -> dict[str, str]:
    """Revision and arguments; the policy is the default one where none is named."""
    about = dict(bag.origin.about)
    return ({"policy": DEFAULT_POLICY} | about) if about else {}


def _line(name: str, then: str, now: str) -> str:
    return f"{one_line(name):<{WIDTH}}" + one_line(
        then if then == now else f"{then} -> {now}"
    )


def _tuning_lines(first: Bag, second: Bag) -> list[str]:
    """A line on settings of the policy that were changed while it ran, if they differ."""
    then, now = _tuned(first), _tuned(second)
    return (
        []
        if then == now
        else [_line("changed in the run", then or "nothing", now or "nothing")]
    )


def _tuned(bag: Bag) -> str:
    """Settings changed while the policy ran, in the order of time."""
    if not bag.counts.get(PLANS):
        return ""
    with bag.using(PLANS):
        found = dict.fromkeys(
            getattr(m, "settings", "") for _, m in bag.messages(PLANS)
        )
        sets = [json.loads(text) for text in found if text]
        return "; ".join(
            f"{name} {quoted(value)}" for s in sets for name, value in s.items()
        )


def _file_lines(first: Origin, second: Origin) -> list[str]:
    """A line on each file that only one bag has, or that differs; without the configuration."""
    names = sorted((first.files.keys() | second.files.keys()) - {CONFIGURATION})
    files = [(name, first.files.get(name), second.files.get(name)) for name in names]
    return [
        _line(name, *_states(then, now)) for name, then, now in files if then != now
    ]


def _states(then: bytes | None, now: bytes | None) -> tuple[str, str]:
    """Words for two files that are not equal."""
    if then is not None and now is not None:
        return "one file", "another one"
    return ("-", "a file") if then is None else ("a file", "-")


def _configuration_lines(first: Bag, second: Bag) -> list[str]:
    """Lines on the values of the configuration that differ; raises BagError."""
    held = [CONFIGURATION in bag.origin.files for bag in (first, second)]
    if not all(held):
        then, now = ("recorded" if has else "not recorded" for has in held)
        return [_line("configuration", then, now)]
    return list(_changed_values(_files(first), _files(second))) or [
        f"{'configuration':<{WIDTH}}the same"
    ]


def _files(bag: Bag) -> dict[str, bytes]:
    try:
        return bag.origin.configuration()
    except BagError as error:
        raise BagError(f"{bag.path}: {error}") from None


def _changed_values(
    then: Mapping[str, bytes], now: Mapping[str, bytes]
) -> Iterator[str]:
    for file in sorted(then.keys() | now.keys()):
        if then.get(file) == now.get(file):
            continue
        if file not in then or file not in now:
            yield _line(file, *_states(then.get(file), now.get(file)))
            continue
        try:
            before, after = (
                _values(content, file) for content in (then[file], now[file])
            )
        except (BagError, ConfigError, UnicodeDecodeError):
            yield _line(file, "one file", "another one")
            continue
        names = [
            n for n in dict.fromkeys([*before, *after]) if before.get(n) != after.get(n)
        ]
        for name in names:
            texts = (
                quoted(values[name]) if name in values else "-"
                for values in (before, after)
            )
            yield f"{file} {name}  {' -> '.join(texts)}"
        if not names:
            yield f"{file:<{WIDTH}}other comments"


def _values(content: bytes, file: str) -> dict[str, Any]:
    """Values of a YAML file by dotted name; raises ConfigError if it is no mapping."""
    found = config.parse(content.decode()) if file.endswith(".yaml") else None
    if not isinstance(found, Mapping):
        raise ConfigError(f"{file}: no mapping")
    return dict(config.dotted(found))

"""Message definitions: the standard ones of Jazzy, and slot_msgs from its .msg files."""

import functools
import os
from pathlib import Path
from typing import Any, TypeAlias

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Types: TypeAlias = Typestore

PACKAGE = "slot_msgs"


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
    """The types of Jazzy and the (type name, definition) pairs of a bag.

    Kept, as the library compiles the decoder of every type anew for each store.
    """
    types = get_typestore(Stores.ROS2_JAZZY)
    add_definitions(types, dict(definitions))
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

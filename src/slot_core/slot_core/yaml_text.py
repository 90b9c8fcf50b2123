"""YAML texts: plain values alone, without aliases, tags, repeated keys or deep nesting."""

from collections.abc import Hashable
from typing import Any

import yaml

from slot_core.refusal import quoted

DEPTH_MAX = 100  # nested collections of a YAML text


def load_plain(text: str) -> Any:
    """Content of a YAML text.

    Raises ValueError if it is not YAML, repeats a key, nests deeper than DEPTH_MAX, where the
    loader in C would overflow its stack, or has aliases, of which a few lines can make gigabytes,
    or tags.
    """
    try:
        _require_plain(text)
        return yaml.load(text, _UniqueKeyLoader)
    except (OverflowError, yaml.YAMLError) as error:
        raise ValueError(error) from None


def _require_plain(text: str) -> None:
    """Raise ValueError for aliases, tags and deep nesting; raises yaml.YAMLError."""
    if text.startswith("%YAML:") or "opencv-matrix" in text:
        raise ValueError("a file of OpenCV (cv::FileStorage), expected YAML")
    depth = 0
    for event in yaml.parse(text, yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEPTH_MAX:
            raise ValueError(f"nested deeper than {DEPTH_MAX} levels")
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None):
            kind = "alias" if isinstance(event, yaml.AliasEvent) else "tag"
            mark = event.start_mark
            where = f"line {mark.line + 1}: " if mark else ""
            raise ValueError(f"{where}no {kind} is allowed")


class _UniqueKeyLoader(yaml.CSafeLoader):
    """YAML's safe loader, which refuses a mapping that repeats a key."""

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict[Any, Any]:
        """The mapping of a node; raises ConstructorError."""
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                break  # which is refused below
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    f"the key {quoted(key)} is repeated",
                    key_node.start_mark,
                )
            seen.add(key)
        return super().construct_mapping(node, deep)

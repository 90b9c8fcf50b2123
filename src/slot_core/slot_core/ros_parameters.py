"""Parameter file of ROS: settings of nodes by the names of these, for `params_file`.

mpc_controller:              # or /fred/mpc_controller; * is any name, /** any names or none
  ros__parameters:
    cost: {height: 0.003}    # or cost.height: 0.003
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from slot_core import config
from slot_core.config import ConfigError
from slot_core.refusal import read_text

KEY = "ros__parameters"


class Parameters(NamedTuple):
    """Parameters of the nodes whose full names match a pattern."""

    pattern: str  # as in the file, with a leading slash
    values: dict[str, Any]  # by dotted name

    def match(self, node: str) -> bool:
        """Whether a node, by its full name, gets them."""
        escaped = re.escape(self.pattern)
        pattern = escaped.replace(r"/\*\*", r"(/\w+)*").replace(r"\*", r"\w+")
        return re.fullmatch(pattern, node) is not None


def read_parameters(file: Path) -> list[Parameters]:
    """Parameters of a file; raises ConfigError."""
    try:
        return parse_parameters(read_text(file, config.SIZE_MAX), file.name)
    except (OSError, ValueError) as error:
        raise ConfigError(f"params_file {file}: {error}") from None


def parse_parameters(text: str, where: str) -> list[Parameters]:
    """Parameters of a text in YAML; raises ValueError."""
    found = list(_found(config.parse(text), "", where))
    if not found:
        raise ValueError(f"{where}: no {KEY}")
    return found


def of_node(found: list[Parameters], node: str) -> dict[str, Any]:
    """Parameters of a node, by its full name; later ones replace earlier ones."""
    return {
        name: v
        for each in found
        if each.match(node)
        for name, v in each.values.items()
    }


def _found(content: Any, pattern: str, where: str) -> Iterator[Parameters]:
    if not isinstance(content, Mapping):
        raise ValueError(
            f"{where}: {pattern or 'file'}: expected a mapping of nodes"
        )
    for key, value in content.items():
        if key == KEY:
            if not isinstance(value, Mapping):
                raise ValueError(
                    f"{where}: {pattern}: expected a mapping of parameters"
                )
            yield Parameters(
                pattern,
                {
                    n: v
                    for n, v in config.dotted(value)
                    if not isinstance(v, Mapping)
                },
            )
        else:
            yield from _found(value, f"{pattern}/{str(key).strip('/')}", where)

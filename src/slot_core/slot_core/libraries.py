"""The libraries that scripts/setup installs below .slot, for programs under another Python."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

LIBRARIES = ("numba", "numpy", "rosbags", "scipy", "yaml")


def require_libraries() -> None:
    """End a program with one line if Python does not find a library that all programs import.

    `ros2 launch` runs under the system's Python. In a terminal in which scripts/env was sourced it
    finds here what its own packages lack.
    """
    if prints_help():
        return
    if _missing():
        venv = Path(os.environ.get("VIRTUAL_ENV", os.devnull))
        sys.path += [str(path) for path in venv.glob("lib/python3*/site-packages")]
    if missing := _missing():
        sys.exit(
            f"Python finds no {', '.join(missing)}: in a new terminal first source scripts/env of"
            " the SLOT repository, then install/setup.bash"
        )


def prints_help() -> bool:
    """Whether scripts/help runs the program, which needs no package and finds none."""
    return bool(sys.flags.isolated and sys.flags.no_site)


def _missing() -> list[str]:
    return [name for name in LIBRARIES if find_spec(name) is None]

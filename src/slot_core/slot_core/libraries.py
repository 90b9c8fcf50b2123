"""Check that Python finds the libraries that scripts/setup installs below .slot."""

import sys
from importlib.util import find_spec

LIBRARIES = ("numba", "numpy", "rosbags", "scipy", "yaml")


def require_libraries() -> None:
    """End a program with one line if Python does not find a library that all programs import.

    With an installation of ROS the programs run under the system's Python, which finds them only
    in a terminal in which scripts/env was sourced.
    """
    missing = [name for name in LIBRARIES if find_spec(name) is None]
    if missing:
        sys.exit(
            f"Python finds no {', '.join(missing)}: in a new terminal first source scripts/env of"
            " the SLOT repository, then install/setup.bash"
        )

"""Compiles the controller's kernels into the cache, so that no start has to wait."""

from slot_core.control.mpc import Mpc, read_mpc
from slot_core.robot import read_robot


def main() -> None:
    """Solve once, with the configured solver."""
    Mpc(read_robot(), read_mpc(), lambda: 0.0)


if __name__ == "__main__":
    main()

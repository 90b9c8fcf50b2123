"""Error of a simulation that has diverged, of a rod or of the robot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


class DivergenceError(ArithmeticError):
    """The motion has diverged; the message names the time and place where they are known.

    `state` holds the values of `SimulatedRobot.snapshot` by name; of a rod it is empty.
    """

    def __init__(self, message: str, state: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.state = dict(state or {})

    def save(self, path: Path, scene: str) -> None:
        """Write state, message and the scene's name for `numpy.load`; raises OSError."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, scene=scene, message=str(self), **self.state)

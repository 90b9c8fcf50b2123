"""IMU samples, whose stamps and values are arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array


@dataclass(frozen=True)
class ImuSamples:
    """IMU samples in the order of their stamps."""

    stamps: NDArray[np.int64]  # (n,) ns, rising
    values: Array  # (n, 6) angular velocity rad/s, specific force m/s^2

    def __post_init__(self) -> None:
        """Raise ValueError for stamps and values of other types or shapes."""
        stamps, values = self.stamps, self.values
        if (
            stamps.dtype != np.int64
            or values.dtype != np.float64
            or stamps.ndim != 1
            or values.shape != (len(stamps), 6)
        ):
            raise ValueError(
                f"IMU samples: stamps {stamps.dtype} {stamps.shape}, values {values.dtype}"
                f" {values.shape}: expected int64 (n,), float64 (n, 6)"
            )

    @classmethod
    def none(cls) -> ImuSamples:
        """No samples."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 6)))

    def followed(self, stamp: int, value: Array, most: int) -> ImuSamples:
        """The newest samples, at most `most`: these and another, `stamp` (ns) and value (6,)."""
        return ImuSamples(
            np.append(self.stamps, stamp)[-most:],
            np.vstack([self.values, value])[-most:],
        )

    def __getitem__(self, part: slice) -> ImuSamples:
        """A part of the samples."""
        return ImuSamples(self.stamps[part], self.values[part])

    def until(self, stamp: int) -> ImuSamples:
        """The samples up to `stamp`, ns."""
        return self[: int(np.searchsorted(self.stamps, stamp, side="right"))]

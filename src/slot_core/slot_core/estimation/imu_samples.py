"""Queue of IMU samples whose stamps and values are arrays without gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.key_frame import StateParts
from slot_core.robot import Array


@dataclass(frozen=True)
class ImuSamples:
    """IMU samples in the order of their stamps."""

    stamps: NDArray[np.int64]  # (n,) ns, rising
    values: Array  # (n, 6) angular velocity rad/s, specific force m/s^2

    def __post_init__(self) -> None:
        """Raise ValueError for values that are not those of the stamps."""
        stamps, values = self.stamps, self.values
        typed = stamps.dtype == np.int64 and values.dtype == np.float64
        if not typed or stamps.ndim != 1 or values.shape != (len(stamps), 6):
            raise ValueError(
                f"IMU samples: stamps {stamps.dtype} {stamps.shape}, values {values.dtype}"
                f" {values.shape}: expected int64 (n,), float64 (n, 6)"
            )

    def until(self, stamp: int) -> ImuSamples:
        """The samples up to `stamp`, ns."""
        count = int(np.searchsorted(self.stamps, stamp, side="right"))
        return ImuSamples(self.stamps[:count], self.values[:count])


class ImuQueue:
    """The newest `size` IMU samples; older ones are dropped."""

    STATE = StateParts("content", values=(ImuSamples,))

    def __init__(self, size: int) -> None:
        self._size, self._begin, self._end = size, 0, 0
        self._stamps = np.zeros(2 * size, dtype=np.int64)
        self._values = np.zeros((2 * size, 6))

    @property
    def samples(self) -> ImuSamples:
        """The samples in the queue; valid until the next `append`."""
        kept = slice(self._begin, self._end)
        return ImuSamples(self._stamps[kept], self._values[kept])

    @property
    def content(self) -> list[ImuSamples]:
        """The samples, for key frames."""
        return [self.samples]

    @content.setter
    def content(self, content: Sequence[ImuSamples]) -> None:
        (samples,) = content
        self._begin = self._end = 0
        for stamp, value in zip(
            samples.stamps[-self._size :], samples.values[-self._size :]
        ):
            self.append(int(stamp), value)

    def append(self, stamp: int, value: Array) -> None:
        """Append a sample: stamp (ns), newer than all others, and (6,)."""
        if self._end == len(self._stamps):
            kept, count = slice(self._begin, self._end), self._end - self._begin
            self._stamps[:count], self._values[:count] = (
                self._stamps[kept],
                self._values[kept],
            )
            self._begin, self._end = 0, count
        self._stamps[self._end], self._values[self._end] = stamp, value
        self._end += 1
        self._begin = max(self._begin, self._end - self._size)

    def drop(self, count: int) -> None:
        """Drop the oldest samples."""
        self._begin += count

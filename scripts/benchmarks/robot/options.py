"""Options of the benchmark."""

from benchmarks.against import options as options  # noqa: PLC0414 - all that it has

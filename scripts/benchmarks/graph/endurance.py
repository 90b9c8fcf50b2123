"""Growth of memory, threads, file descriptors and shared memory over a long walk in lockstep.

The graph runs with its recorder. A sample is taken of every node and of the machine's shared memory
each `SAMPLE_PERIOD`; the growth is from the first tenth after the warm-up to the last tenth.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.graph.usage import in_background
from benchmarks.harness import BenchmarkError, Check, Row, at_most
from slot_bringup.graph import Graph
from slot_bringup.monitor import RunError, watch
from slot_bringup.run import started

SAMPLE_PERIOD = 2.0  # s of wall time
WARM_UP = 0.2  # of the samples: kernels, buffers of the middleware and of Python fill
SHARED_MEMORY = Path("/dev/shm")
LARGEST_GROWTH = 1.0  # MB per node
NODE_FIGURES = ("memory_mb", "threads", "descriptors")


@dataclass
class Samples:
    """Samples of the nodes and of the machine's shared memory, one after the other."""

    figures: list[list[list[float]]] = field(
        default_factory=list
    )  # (n, nodes, NODE_FIGURES)
    shared: list[float] = field(default_factory=list)  # (n,) MB

    def growth(self) -> tuple[np.ndarray, float]:
        """Growth (nodes, NODE_FIGURES) of the nodes and, MB, of the shared memory.

        From the first tenth of the samples after the warm-up to the last one.
        """
        figures, shared = np.array(self.figures), np.array(self.shared)
        count = len(shared)
        begin, tenth = int(WARM_UP * count), max(1, int((1.0 - WARM_UP) * count / 10))
        first, last = slice(begin, begin + tenth), slice(count - tenth, count)
        nodes = np.median(figures[last], axis=0) - np.median(figures[first], axis=0)
        return nodes, float(np.median(shared[last]) - np.median(shared[first]))


def long_walk(graph: Graph, values: Mapping[str, Any], duration: float) -> list[Row]:
    """Walk in lockstep for `duration` (s of graph time) and return the growth of every node.

    Raises BenchmarkError if the graph fails. Its bag is deleted: 0.2 MB a second.
    """
    with tempfile.TemporaryDirectory() as scratch:
        values = {**values, "lockstep": True, "bag": str(Path(scratch, "bag"))}
        names = tuple(spec.name for spec in graph.nodes(values))
        samples = Samples()
        try:
            with started(graph, values, Path(scratch, "logs")) as processes:
                nodes = [psutil.Process(processes.pid(name)) for name in names]
                with in_background(lambda: add(samples, nodes), SAMPLE_PERIOD):
                    watch(processes, duration)
        except RunError as error:
            raise BenchmarkError(f"the graph failed: {error}") from error
    grown, shared = samples.growth()
    figures = [f"{figure}_grown" for figure in NODE_FIGURES]
    rows = [
        {"kind": "endurance", "duration_s": duration, "node": name}
        | dict(zip(figures, row))
        for name, row in zip(names, grown.tolist())
    ]
    return [
        *rows,
        {"kind": "shared memory", "duration_s": duration, "grown_mb": shared},
    ]


def add(samples: Samples, nodes: Sequence[psutil.Process]) -> None:
    """Take one sample; raises psutil.Error if a node has ended."""
    samples.figures.append(
        [[p.memory_full_info().uss / 1e6, p.num_threads(), p.num_fds()] for p in nodes]
    )
    samples.shared.append(sum(f.stat().st_size for f in SHARED_MEMORY.iterdir()) / 1e6)


def endurance_checks(rows: Sequence[Row]) -> list[Check]:
    """The growth of the worst node against its limits; none if there was no long walk."""
    nodes = [row for row in rows if row["kind"] == "endurance"]
    if not nodes:
        return []
    memory, threads, descriptors = (
        max(row[f"{figure}_grown"] for row in nodes) for figure in NODE_FIGURES
    )
    [shared] = (row["grown_mb"] for row in rows if row["kind"] == "shared memory")
    return [
        at_most(
            "growth of a node's memory in a long walk", memory, LARGEST_GROWTH, "MB"
        ),
        at_most("growth of a node's threads in a long walk", threads, 0.0),
        at_most("growth of a node's file descriptors in a long walk", descriptors, 0.0),
        at_most("growth of shared memory in a long walk", shared, 0.0, "MB"),
    ]

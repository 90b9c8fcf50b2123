"""CPU time and memory of the nodes' processes, sampled while the graph runs."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from slot_core.arrays import Array

SAMPLE_PERIOD = 0.25  # s; the kernel counts CPU time in steps of 10 ms


@dataclass
class Usage:
    """CPU time and memory of the nodes' processes, sampled at n times."""

    nodes: tuple[str, ...]
    time: list[float] = field(default_factory=list)  # (n,) s, wall clock
    cpu: list[list[float]] = field(
        default_factory=list
    )  # (n, nodes + 1) s; last: `time_waited`
    rss: list[float] = field(
        default_factory=list
    )  # (nodes,) bytes, resident set, at the end
    pss: list[float] = field(
        default_factory=list
    )  # (nodes,) bytes, proportional set, at the end

    def percent(self, begin: float, end: float) -> Array:
        """(nodes + 1,) % of one core, last: % of the time waited, between two wall times (s)."""
        begin, end = max(begin, self.time[0]), min(end, self.time[-1])
        cpu = np.array(self.cpu).T
        used = [
            np.diff(np.interp([begin, end], self.time, column))[0] for column in cpu
        ]
        return 100 * np.array(used) / (end - begin)


@contextmanager
def metered(pids: Mapping[str, int]) -> Iterator[Usage]:
    """Sample the processes (pid by node) in the background while the block runs.

    Their memory is read once, at its end: counting shared pages takes the kernel too long for every
    sample.
    """
    processes = [psutil.Process(pid) for pid in pids.values()]
    usage = Usage(tuple(pids))
    with in_background(lambda: add_sample(usage, processes), SAMPLE_PERIOD):
        yield usage
    for process in processes:
        memory = process.memory_full_info()
        usage.rss.append(float(memory.rss))
        usage.pss.append(float(memory.pss))


@contextmanager
def in_background(sample: Callable[[], None], period: float) -> Iterator[None]:
    """Call `sample` each `period` (s) on a thread while the block runs and all nodes live."""
    ended = threading.Event()

    def sample_until_ended() -> None:
        with suppress(psutil.Error):  # a node has ended: `watch` reports which
            sample()
            while not ended.wait(period):
                sample()

    thread = threading.Thread(target=sample_until_ended, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def add_sample(usage: Usage, processes: Sequence[psutil.Process]) -> None:
    """Take one sample of all processes and of the machine; raises psutil.Error if one has ended."""
    cpu = [sum(process.cpu_times()[:2]) for process in processes]
    usage.time.append(time.time())
    usage.cpu.append([*cpu, time_waited()])


def time_waited() -> float:
    """Time in which any program waited for a core, s; NaN if the kernel does not count it."""
    try:
        counted = Path("/proc/pressure/cpu").read_text()
    except OSError:
        return math.nan
    return int(counted.partition("total=")[2].split()[0]) / 1e6

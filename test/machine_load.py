"""Whether the machine kept up with real time while a test ran: late wake-ups, CPU that others took.

A test in real time that fails on a machine which did not keep up says nothing about the graph: it
is reported as skipped, with the figures. On a machine that kept up a failure stays a failure, and
so does an error of the code, which no load explains.
"""

import os
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

import numpy as np
import psutil

PERIOD = 0.05  # s, between two wake-ups
WINDOW = 20  # periods, over which the CPU is counted: the kernel does so in steps of 10 ms
LATE = 0.05  # s; the limits of the tests are ten times as long or more
LARGEST_LATE_SHARE = 0.02  # of the wake-ups
LARGEST_TAKEN = 0.25  # of the CPU, over the whole test
# of the CPU, over a second: a half of two cores, and a tenth
LARGEST_TAKEN_IN_WINDOW = 0.6
ERRORS_OF_CODE = (AttributeError, ImportError, NameError, TypeError)


@dataclass
class Load:
    """Samples of a test's time: lateness of each wake-up (s), and `read_cpu` every WINDOW of them."""

    late: list[float] = field(default_factory=list)
    cpu: list[np.ndarray] = field(default_factory=list)

    def taken(self) -> np.ndarray:
        """Share of the CPU that others took or the host stole, in each window (n,)."""
        passed, busy, own = np.diff(self.cpu, axis=0).T
        return np.clip((busy - own) / np.maximum(passed, 1e-9), 0.0, 1.0)

    def overload(self) -> str:
        """Why the machine did not keep up, with the figures; "" if it did."""
        reasons = []
        late_share = np.mean(np.array(self.late) > LATE) if self.late else 0.0
        if late_share > LARGEST_LATE_SHARE:
            reasons.append(
                f"{100 * late_share:.0f} % of the wake-ups more than {1e3 * LATE:.0f} ms late, "
                f"at most {1e3 * max(self.late):.0f} ms"
            )
        taken = self.taken() if len(self.cpu) > 1 else np.zeros(1)
        if (
            taken.mean() > LARGEST_TAKEN
            or taken.max() > LARGEST_TAKEN_IN_WINDOW
        ):
            reasons.append(
                f"other programs took {100 * taken.mean():.0f} % of the CPU, "
                f"at most {100 * taken.max():.0f} % in a second"
            )
        return "; ".join(reasons)


def read_cpu():
    """CPU times (3,) since the start, s, of this process's cores: passed, spent, by the test.

    Stolen time counts as spent.
    """
    cores = [*os.sched_getaffinity(0)]
    # user nice system idle iowait irq softirq steal, s
    times = np.array(psutil.cpu_times(percpu=True))[cores, :8].sum(axis=0)
    return np.array([times.sum(), times.sum() - times[3] - times[4], own_cpu()])


def own_cpu():
    """CPU time of this process, its descendants and those that have ended, s."""
    this, total = psutil.Process(), 0.0
    for process in (this, *this.children(recursive=True)):
        with suppress(psutil.Error):  # it has ended meanwhile
            # user, system, and both of ended children
            total += sum(process.cpu_times()[:4])
    return total


@contextmanager
def measured():
    """The load while the block runs; sampled on a thread."""
    load, ended = Load(cpu=[read_cpu()]), threading.Event()

    def sample():
        due = time.monotonic() + PERIOD
        while not ended.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            load.late.append(now - due)
            due = now + PERIOD
            if len(load.late) % WINDOW == 0:
                load.cpu.append(read_cpu())

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield load
    finally:
        ended.set()
        thread.join()


EXCUSED = []  # exceptions with their reasons


def judge(report, where, error, load):
    """Change the report of a failure with its exception if the machine did not keep up.

    A fixture of a module fails once, and every test that uses it gets the same exception later.
    """
    if not report.failed or isinstance(error, ERRORS_OF_CODE):
        return
    known = next((why for excused, why in EXCUSED if excused is error), "")
    if reason := known or load.overload():
        EXCUSED.append((error, reason))
        report.outcome = "skipped"
        report.longrepr = (*where, f"Skipped: machine too slow: {reason}")

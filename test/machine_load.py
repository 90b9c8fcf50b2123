"""Whether the machine kept up with real time while a test ran: late wake-ups, CPU that others took.

A test in real time that fails on a machine which did not keep up says nothing about the graph: it
is reported as skipped, with the figures. On a machine that kept up a failure stays a failure, and
so does an error of the code, which no load explains.
"""

import os
import threading
import time
from contextlib import suppress

import numpy as np
import psutil

PERIOD = 0.05  # s, between two wake-ups
LATE = 0.05  # s; the limits of the tests are ten times as long or more
LARGEST_LATE_SHARE = 0.02  # of the wake-ups
LARGEST_TAKEN = 0.25  # of the CPU: a half of two cores
ERRORS_OF_CODE = (AttributeError, ImportError, NameError, TypeError)


class Load:
    """The load of the machine since this was made, until `end`; wake-ups are those of a thread."""

    def __init__(self):
        self._own = {}  # s, CPU time by process; that of one that has ended stays
        self._late, self._begin = [False], self._cpu_times()
        self._ended = threading.Event()
        threading.Thread(target=self._sample, daemon=True).start()

    def _sample(self):
        due = time.monotonic() + PERIOD
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            self._late.append(now - due > LATE)
            due = now + PERIOD
            if len(self._late) % 10 == 0:  # not always: it takes some ms
                self._cpu_times()

    def end(self):
        self._ended.set()

    def excuse(self, error):
        """Why the machine did not keep up, with the figures; "" if it did, or for an error of code.

        A fixture of a module fails once, and every test that uses it gets the same exception later:
        its reason stays with it.
        """
        passed, busy, own = self._cpu_times() - self._begin
        late, taken = np.mean(self._late), (busy - own) / max(passed, 1e-2)
        if late > LARGEST_LATE_SHARE or taken > LARGEST_TAKEN:
            error.excuse = (
                f"{late:.0%} of the wake-ups more than {1e3 * LATE:.0f} ms "
                f"late, other programs took {taken:.0%} of the CPU"
            )
        is_of_code = isinstance(error, ERRORS_OF_CODE)
        return "" if is_of_code else getattr(error, "excuse", "")

    def _cpu_times(self):
        """CPU times (3,) since the start, s, of this process's cores: passed, spent, by the test.

        Stolen time counts as spent; the test's is that of its descendants, too, also of ended ones.
        """
        cores = [*os.sched_getaffinity(0)]
        # user nice system idle iowait irq softirq steal, s
        times = np.array(psutil.cpu_times(percpu=True))[cores, :8].sum(axis=0)
        this = psutil.Process()
        for process in (this, *this.children(recursive=True)):
            with suppress(psutil.Error):  # it has ended meanwhile
                # user, system
                self._own[process.pid] = sum(process.cpu_times()[:2])
        return np.array(
            [
                times.sum(),
                times.sum() - times[3] - times[4],
                sum(tuple(self._own.values())),
            ]
        )

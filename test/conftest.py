"""Signal handling of the test process; precondition of tests that need real time."""

import functools
import signal
import time
from operator import sub

import pytest

# ms of CPU that a tick of controller and robot takes in one process. Beyond this the processes of
# the graph do not keep up with real time: at 4.2 ms the state estimator fell seconds behind. At 2.7
# to 3.0 ms, with a busy loop on each core, all of these tests passed.
LARGEST_TICK = 3.5
BATCHES, TICKS = 5, 60  # the quickest batch counts: what else runs on the host comes and goes

# A process started in the background of a script ignores SIGINT, and so do its children; those that
# the tests interrupt must receive it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@functools.cache
def tick_time():
    """CPU time of a tick of controller and robot in one process, ms."""
    from slot_core.simulation.closed_loop import ClosedLoop  # noqa: PLC0415 - slow to import

    loop = ClosedLoop("flat", "walk", None, 0)
    times = [time.process_time() for _ in loop.run(BATCHES * TICKS + 1)][::TICKS]
    return min(map(sub, times[1:], times)) / TICKS * 1e3


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Skip a test that needs real time on a machine that cannot keep up with it."""
    if item.get_closest_marker("real_time") and tick_time() > LARGEST_TICK:
        pytest.skip(
            f"no real time here: {tick_time():.1f} ms of CPU a tick, limit {LARGEST_TICK:g} ms"
        )

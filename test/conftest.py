"""Signal handling of the test process; machines on which tests in real time say nothing."""

import functools
import signal
import time

import machine_load
import numpy as np
import pytest
from real_graph import changed_config, domain  # noqa: F401 - a fixture

# ms of CPU that a tick of controller and robot takes in one process. Beyond this the processes of
# the graph may not keep up with real time. At 5 to 6 ms all of these tests pass; the limit lets a
# machine through that takes 1.6 times as long.
LARGEST_TICK = 9.0
LOAD = pytest.StashKey[machine_load.Load]()

# A process started in the background of a script ignores SIGINT, and so do its children; those that
# the tests interrupt must receive it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def own_config(tmp_path, monkeypatch):
    """A copy of config/ that is in force, and that a test may change."""
    copy = changed_config(tmp_path / "own", {})
    monkeypatch.setenv("SLOT_CONFIG", str(copy))
    return copy


@pytest.fixture
def refusal(capsys):
    """A function that calls a program, which has to refuse with exit code 2; its last line."""

    def refused(program, *arguments):
        try:
            code = program(list(map(str, arguments)))
        except SystemExit as ended:
            code = ended.code
        assert code == 2
        lines = capsys.readouterr().err.splitlines()
        assert "Traceback" not in "".join(lines)
        return lines[-1]

    return refused


@functools.cache
def tick_time():
    """CPU time of a tick of controller and robot in one process, ms."""
    from slot_core.simulation.closed_loop import ClosedLoop  # noqa: PLC0415 - slow to import

    loop = ClosedLoop("flat", "walk", None, 0)
    times = [time.process_time() for _ in loop.run(300)]
    # what else runs on the host comes and goes
    return 1e3 * float(np.quantile(np.diff(times), 0.25))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Measure the load of the machine while a test in real time runs, its fixtures included."""
    if not item.get_closest_marker("real_time"):
        return (yield)
    tick_time()  # not part of any test
    item.stash[LOAD] = machine_load.Load()
    try:
        return (yield)
    finally:
        item.stash[LOAD].end()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Skip a test that needs real time on a machine that cannot keep up with it."""
    if LOAD in item.stash and tick_time() > LARGEST_TICK:
        pytest.skip(
            f"no real time here: {tick_time():.1f} ms of CPU a tick, limit {LARGEST_TICK:g} ms"
        )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Report a failure on a machine that did not keep up as skipped."""
    report = yield
    if LOAD in item.stash and call.excinfo is not None and report.failed:
        reason = item.stash[LOAD].excuse(call.excinfo.value)
        if reason:
            report.outcome = "skipped"
            hidden = (
                f"{call.excinfo.typename}: {call.excinfo.value}".splitlines()
            )
            text = f"Skipped: machine too slow: {reason}; {hidden[0]}"
            report.longrepr = (*item.location[:2], text)
    return report

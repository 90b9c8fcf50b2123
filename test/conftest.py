"""Signal handling of the test process, and the mark of tests that need real time."""

import signal
from pathlib import Path

import pytest

# Folders whose tests run the graph as processes in real time: two graphs at once would each have
# half of the machine, and their time limits are those of a robot. scripts/test runs them alone.
REAL_TIME = ("faults", "graph")

# A process started in the background of a script ignores SIGINT, and so do its children; those that
# the tests interrupt must receive it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Mark the tests of the folders REAL_TIME with `real_time`."""
    here = Path(__file__).parent
    for item in items:
        if item.path.relative_to(here).parts[0] in REAL_TIME:
            item.add_marker(pytest.mark.real_time)

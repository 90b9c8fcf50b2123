"""Runs of the graph with a bag, started by the tests' own process."""

import math
from contextlib import contextmanager
from pathlib import Path

import pytest

from slot_bringup import monitor, run
from slot_bringup.arguments import parse
from slot_bringup.graph import read_graph


@contextmanager
def patient():
    """No run in lockstep ends because the machine is slow; pytest's timeout ends one that hangs."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("START_TIMEOUT", "SILENCE_TIMEOUT"):
            patch.setattr(monitor, name, math.inf)
        yield


def record(bag: Path, *arguments: str) -> Path:
    """Run the graph with a bag and return the directory of the bag."""
    graph = read_graph()
    with patient():
        run.run(parse([*arguments, "--bag", str(bag)]), graph, bag, [])
    return bag

"""CPU time of policy and plant over that of another checkout, in turn within one run."""

import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import ROOT, Check, Row, at_most

PACKAGES = ("src/slot_core", "src/slot_lab")
LARGEST = 1.1  # CPU over that of the other checkout
REPEATS = 5
# Prints s of CPU: of the policy in 150 ticks of a walk, and of 2000 steps of the robot.
PROGRAM = """
import time
from slot_core.simulation.closed_loop import ClosedLoop
loop, spent = ClosedLoop("flat", "walk", None, 0), [0.0]
policy, now = loop.controller.policy, time.process_time
def clocked(call):
    def timed(*arguments):
        begin = now()
        result = call(*arguments)
        spent[0] += now() - begin
        return result
    return timed
policy.step, policy.prepare = clocked(policy.step), clocked(policy.prepare)
ticks = loop.run(200)
for _ in range(40):
    last = next(ticks)
spent[0] = 0.0
for _ in range(150):
    last = next(ticks)
robot, command = loop.plant.robot, last.command.angle
begin = now()
robot.advance(2000, command)
print(spent[0], now() - begin)
"""


def against_rows(other: Path) -> list[Row]:
    """Medians over repeats of the ratios of CPU time, and the times of each."""
    timings: dict[Path, list[list[float]]] = {ROOT: [], other.resolve(): []}
    for _ in range(REPEATS + 1):
        for checkout, found in timings.items():
            found.append(_times(checkout))
    pairs = list(zip(*timings.values()))[1:]  # the first may have compiled kernels
    return [
        {
            "kind": "against",
            "what": what,
            "other": other.name,
            "ratio": statistics.median(ours[k] / theirs[k] for ours, theirs in pairs),
            "cpu_ms": 1e3 / count * statistics.median(ours[k] for ours, _ in pairs),
        }
        for k, (what, count) in enumerate(
            (("policy, a tick", 150), ("robot, a step", 2000))
        )
    ]


def against_checks(rows: Sequence[Row]) -> list[Check]:
    """The ratios against their goal."""
    found: Sequence[Any] = [row for row in rows if row["kind"] == "against"]
    return [
        at_most(f"CPU of the {row['what']}, over {row['other']}", row["ratio"], LARGEST)
        for row in found
    ]


def _times(checkout: Path) -> list[float]:
    """CPU times, s, that the program prints with the packages of a checkout."""
    places = [
        *(str(checkout / package) for package in PACKAGES),
        os.environ["PYTHONPATH"],
    ]
    chosen = {
        "PYTHONPATH": os.pathsep.join(places),
        "SLOT_CONFIG": str(checkout / "config"),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM],
        env={**os.environ, **chosen},
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(word) for word in done.stdout.split()]

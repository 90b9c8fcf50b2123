"""Search of a stride's pattern by CMA-ES, resumable.

A candidate runs at amplitude one on every floor, and at half of it on the middle one. With its
speed v along the pattern's direction (m/s or rad/s) on each floor, w at half the amplitude, and the
scale s of that speed, its cost is

    mean over the floors of
        (stray speeds; tilt, dip and servo load beyond the goals; mean height missed, roll, pitch)
    - (mean v + least v) / s + 2 std(v) / s + |2 w - v| / s,

so that a pattern is preferred that is fast on every floor and whose speed goes with its amplitude.

Source of the algorithm: N. Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772, in the
library `cma`. The record holds the costs of every generation that is done; a search that is started
again draws the same candidates and takes their costs from there.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.gait.gait import Pattern, Stride
from slot_core.robot import read_robot
from slot_lab.tuning import identification
from slot_lab.tuning.identification import FREE_LEGS, NUMBERS, numbers
from slot_lab.tuning.stride_run import (
    HEIGHT,
    HELD,
    Job,
    Outcome,
    RunAll,
    TuningSettings,
)

FAILED = 1000.0  # cost of a candidate that diverges on a floor
ZERO = (0.0, 0.0, 0.0, 0.0, 0.0)
AXIS = {"forward": 0, "turn": 2}
# Costs: per mm of dip and of mean height missed, deg of RMS tilt, deg of largest tilt, deg of mean
# roll and pitch, mm of top, and per share of the stall torque.
PER_DIP, PER_TILT, PER_LARGEST_TILT, PER_MEAN_TILT, PER_TOP = (
    0.2,
    1.5,
    0.5,
    1.0,
    1.0,
)
PER_LOAD = 100.0


@dataclass(frozen=True)
class Goal:
    """Goal of a search: a pattern of a kind, with the torso below a height."""

    kind: str  # forward or turn
    top_max: float = np.inf  # m, of the torso's highest point


@dataclass(frozen=True)
class Found:
    """Best candidate so far."""

    x: Array
    cost: float
    speed: Array  # per floor, m/s or rad/s


def trial(stride: Stride, kind: str, x: Array) -> Stride:
    """The stride with the pattern of the numbers x, at a speed of one scale."""
    angle = (
        identification.forward(x)
        if kind == "forward"
        else identification.turn(x)
    )
    # without tables
    found = Pattern(
        getattr(stride, kind).speed,
        identification.rows(angle),
        (ZERO,) * 4,
        *(ZERO,) * 5,
    )
    changed: dict[str, Any] = {kind: found}
    return replace(stride, **changed)


def jobs(
    stride: Stride, goal: Goal, x: Array, settings: TuningSettings
) -> list[Job]:
    """Runs of a candidate: at amplitude one on every floor, then at half on the middle one."""
    speed = getattr(stride, goal.kind).speed * np.eye(3)[AXIS[goal.kind]]
    changed, floors = trial(stride, goal.kind, x), settings.friction
    runs = [(friction, speed) for friction in floors]
    runs.append((floors[len(floors) // 2], speed / 2))
    return [
        Job(changed, friction, tuple(v), hold_height=goal.kind in HELD)
        for friction, v in runs
    ]


def cost(
    outcomes: Sequence[Outcome],
    stride: Stride,
    goal: Goal,
    settings: TuningSettings,
) -> tuple[float, Array]:
    """Cost of a candidate from the outcomes of its `jobs`, and its speed on each floor."""
    axis, floors = AXIS[goal.kind], len(outcomes) - 1
    scale = np.array(settings.speed_scale)
    speed, penalty = [], []
    for motion in outcomes:
        if motion is None:
            return FAILED, np.full(floors, np.nan)
        stray = np.abs(motion.means[:3]) / scale
        tilt = np.degrees(motion.tilt)
        dip = stride.height - settings.dip - motion.track[:, HEIGHT].min()
        penalty.append(
            np.delete(stray, axis).sum()
            + PER_TILT * max(0.0, np.sqrt(np.mean(tilt**2)) - settings.tilt_deg)
            + PER_LARGEST_TILT * max(0.0, tilt.max() - 2 * settings.tilt_deg)
            + PER_MEAN_TILT * np.abs(np.degrees(motion.means[4:])).sum()
            + PER_DIP
            * (max(0.0, 1e3 * dip) + 1e3 * abs(motion.means[3] - stride.height))
            + PER_TOP * max(0.0, 1e3 * (motion.top - goal.top_max))
            + PER_LOAD * max(0.0, motion.load - settings.load)
        )
        speed.append(motion.means[axis])
    v, half = np.array(speed[:-1]), speed[-1]
    gain = v.mean() + v.min() - 2 * v.std() - abs(2 * half - v[floors // 2])
    return float(np.mean(penalty[:-1]) - gain / scale[axis]), v


def start_of(
    stride: Stride, kind: str, settings: TuningSettings, seed: int | None = None
) -> Array:
    """Numbers that a search starts from: the stride's own, or random ones if a seed is given.

    Raises ConfigError if a number of the stride is beyond the largest coefficient.
    """
    limit = settings.coefficient_max_deg
    if seed is not None:
        return np.clip(
            np.random.default_rng(seed).normal(
                scale=settings.scatter_deg, size=NUMBERS[kind]
            ),
            -limit,
            limit,
        )
    x = numbers(kind, np.array(getattr(stride, kind).angle_deg))
    n = int(np.abs(x).argmax())
    if abs(x[n]) > limit:
        leg, column = FREE_LEGS[kind][n // 5], n % 5
        raise ConfigError(
            f"{kind}.angle_deg[{leg}][{column}] = {x[n]:.4g}: outside [-{limit:g}, {limit:g}], "
            "coefficient_max_deg of config/tune.yaml; raise it or start from another gait"
        )
    return x


class PatternSearch:
    """Generations of CMA-ES, with a record of their costs."""

    def __init__(
        self,
        stride: Stride,
        goal: Goal,
        start: Array,
        settings: TuningSettings,
        seed: int,
    ) -> None:
        """Start from the numbers of `start_of`; seed: positive."""
        import cma  # noqa: PLC0415 - not installed with the robot

        self._stride, self._goal, self._settings = stride, goal, settings
        self._head = {
            "kind": goal.kind,
            "seed": seed,
            "start": start.tolist(),
            "cma": cma.__version__,
            "settings": repr((settings, goal, stride, read_robot())),
        }
        options: dict[str, Any] = {
            "seed": seed,
            "popsize": settings.population,
            "verbose": -9,
            "bounds": [
                -settings.coefficient_max_deg,
                settings.coefficient_max_deg,
            ],
        }
        self._strategy = cma.CMAEvolutionStrategy(
            start, settings.step_deg, options
        )
        self.best = Found(
            start, np.inf, np.full(len(settings.friction), np.nan)
        )
        self.done = 0  # candidates, without the start

    def run(
        self,
        run_all: RunAll,
        record: Path,
        progress: Callable[[str, float], None],
    ) -> Found:
        """Search to the end of the evaluations; the best candidate, the start included.

        Raises ConfigError if another search has written `record`.
        """
        recorded = self._open(record)
        self._generation([self._strategy.x0], recorded, run_all, record)
        while (
            self.done < self._settings.evaluations and not self._strategy.stop()
        ):
            candidates = self._strategy.ask()
            self._strategy.tell(
                candidates,
                self._generation(candidates, recorded, run_all, record),
            )
            self.done += len(candidates)
            # whole generations: the last may go beyond the evaluations
            most = max(self.done, self._settings.evaluations)
            speeds = " ".join(f"{v:.4f}" for v in self.best.speed)
            progress(
                f"{self._goal.kind}: {self.done} of {most}, "
                f"cost {self.best.cost:.3f}, speed {speeds}",
                self.done / most,
            )
        return self.best

    def _generation(
        self,
        candidates: Sequence[Array],
        recorded: list[Any],
        run_all: RunAll,
        record: Path,
    ) -> list[float]:
        """Costs of candidates, from the record or by simulation."""
        if recorded:
            rows = recorded.pop(0)
        else:
            rows = self._evaluate(candidates, run_all)
            with record.open("a") as out:
                out.write(json.dumps(rows) + "\n")
        for x, (value, speed) in zip(candidates, rows):
            if value < self.best.cost:
                self.best = Found(np.array(x), value, np.array(speed))
        return [value for value, _ in rows]

    def _evaluate(
        self, candidates: Sequence[Array], run_all: RunAll
    ) -> list[Any]:
        runs = len(self._settings.friction) + 1
        todo = [
            jobs(self._stride, self._goal, np.array(x), self._settings)
            for x in candidates
        ]
        outcomes = list(run_all([job for each in todo for job in each]))
        rows = []
        for n in range(0, len(outcomes), runs):
            value, speed = cost(
                outcomes[n : n + runs], self._stride, self._goal, self._settings
            )
            rows.append([value, speed.tolist()])
        return rows

    def _open(self, record: Path) -> list[Any]:
        """Generations of the record; a line cut off by an interrupt is dropped."""
        head = json.dumps(self._head)
        lines = (
            record.read_text().splitlines(keepends=True)
            if record.exists()
            else []
        )
        whole = [line for line in lines if line.endswith("\n")]
        if not whole:
            whole = [head + "\n"]
        elif whole[0].strip() != head:
            raise ConfigError(
                f"{record}: record of another search; remove it to start again"
            )
        record.parent.mkdir(parents=True, exist_ok=True)
        record.write_text("".join(whole))
        return [json.loads(line) for line in whole[1:]]

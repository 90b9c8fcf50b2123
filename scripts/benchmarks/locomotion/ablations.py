"""Parts of the rollout MPC, each taken away: what it is worth in the rows that it is for."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.harness import Check, at_least
from benchmarks.locomotion.cases import DEFAULT, Changes, Job, WalkMotion
from benchmarks.locomotion.rows import LocomotionRow, ratio

SEEDS = (1, 2, 3)
WORTH = 1.2  # least mean error without a part over that with it, in the row where it is worth most
CORNER, CIRCLE = "corner by path, RMS", "circle of 1 m radius, RMS"
SPLIT = "lateral error, split friction"
TURNED = "heading, split friction"
STEP = "velocity .02 to .06: to a tenth"
PUSHED = "push of .83 N s aside: recovery"
PAYLOAD = "payload .3 kg off centre, at once: place lost"
FLOORS = "friction .5 left, .3 right, at once: place lost"
UPHILL, SLOPE = (
    "slope 5 deg, v_x of 0.04",
    "slope of 4 deg, up, at once: place lost",
)
STANDING = "standing, roll and pitch of 5 deg: angles"
LOADED = "standing, payload .5 kg: height"
HEIGHTS = "standing, heights .030 to .060: height"
GRIPS, TILT = "friction 1: speed missed", "tilt of the walk, RMS"
ABLATIONS: Mapping[str, tuple[Changes, Sequence[str]]] = {
    "damping of the step": ((("policy.cost.change", 100.0),), (CORNER, TILT)),
    "drift": ((("policy.observer.drift_gain", 0.0),), (TURNED, UPHILL)),
    "bound of the drift": (
        (("policy.observer.drift_taken", (0.05, 0.05, 0.1)),),
        (STEP, PUSHED),
    ),
    "wrench": ((("policy.observer.wrench_gain", 0.0),), (PAYLOAD, LOADED)),
    "cost of the swing": ((("policy.cost.swing", 0.5),), (UPHILL, TILT)),
    "two thirds of the horizon": (
        (("policy.stages", 7), ("policy.knots", (0, 2, 4, 6))),
        (CORNER, FLOORS),
    ),
    "half of the steps": ((("policy.nominal.steps", 1),), (CORNER, UPHILL)),
    "yield of the feet": (
        (("policy.nominal.springs", (1e3, 1e3, 1.6)),),
        (CIRCLE, SPLIT, SLOPE),
    ),
    "turn of the feet": (
        (("policy.nominal.springs", (1.0, 1.0, 1e3)),),
        (CIRCLE, SPLIT, FLOORS),
    ),
    "width of the feet": (
        (("policy.nominal.width", 0.01),),
        (UPHILL, CIRCLE, SPLIT, FLOORS),
    ),
    "gravity of the floor": (
        (("policy.nominal.slope", False),),
        (UPHILL, SLOPE),
    ),
    "friction that grips": (
        (("policy.observer.friction_after", 100.0),),
        (GRIPS,),
    ),
    "friction of a posture": (
        (("policy.nominal.posture_friction", 0.4),),
        (HEIGHTS,),
    ),
    "feedback of a posture": (
        (("policy.posture.stiffness", (0.0, 0.0, 0.0)),),
        (STANDING, LOADED),
    ),
    "robot that is simulated": (
        (("policy.limits.deviation", 0.0),),
        (CORNER, PAYLOAD, STANDING),
    ),
}
"""Changes of the policy without a part, and the rows that the part is for, by its name."""


def job(row: LocomotionRow, changes: Changes, seed: int) -> Job:
    """The first case of a row with changes of the policy."""
    case = row.cases[0]
    case = dataclasses.replace(case, changes=(*case.changes, *changes))
    return case, DEFAULT, seed


def pairs(
    rows: Sequence[LocomotionRow],
) -> Iterator[tuple[str, Changes, LocomotionRow]]:
    """Every part, the changes without it, and each row that it is for, with its first case."""
    found = {row.name: row for row in rows}
    for part, (changes, names) in ABLATIONS.items():
        for name in names:
            row = found[name]
            yield part, changes, dataclasses.replace(row, cases=row.cases[:1])


def jobs(rows: Sequence[LocomotionRow]) -> list[Job]:
    """Every part's rows without it and with all."""
    return [
        job(row, changes, seed)
        for _, without, row in pairs(rows)
        for changes in ((), without)
        for seed in SEEDS
    ]


def measured(
    rows: Sequence[LocomotionRow], motions: Mapping[Job, WalkMotion]
) -> list[dict[str, Any]]:
    """A row for every part and row: means over the seeds of its value with the part and without."""
    found = []
    for part, without, row in pairs(rows):
        means = {
            kind: sum(
                row.value([motions[job(row, changes, seed)]]) for seed in SEEDS
            )
            / len(SEEDS)
            for kind, changes in (("with", ()), ("without", without))
        }
        found.append(
            {
                "kind": "ablation",
                "part": part,
                "row": row.name,
                "unit": row.unit,
                **means,
            }
        )
    return found


def checks(found: Sequence[Mapping[str, Any]]) -> list[Check]:
    """Every part is worth its lines in one of its rows."""
    checks = []
    for part in dict.fromkeys(row["part"] for row in found):
        worth = max(
            ratio(row["without"], row["with"])
            for row in found
            if row["part"] == part
        )
        name = f"ablation, {part}: error without over that with it"
        checks.append(at_least(name, worth, WORTH))
    return checks

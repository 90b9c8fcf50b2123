"""Parts of the rollout MPC, each taken away: what it is worth in a few cases."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.harness import Check, at_least
from benchmarks.locomotion.cases import DEFAULT, Changes, Job, WalkMotion
from benchmarks.locomotion.rows import LocomotionRow, ratio

SEEDS = (1, 2, 3)
WORTH = 1.2  # least mean error without a part over that with it, in the case where it is worth most
ABLATIONS: Mapping[str, Changes] = {
    "all": (),
    "no damping of the step": (("policy.cost.change", 100.0),),
    "no drift": (("policy.observer.drift_gain", 0.0),),
    "no wrench": (("policy.observer.wrench_gain", 0.0),),
    "no cost of the swing": (("policy.cost.swing", 0.5),),
    "a third of the horizon": (
        ("policy.stages", 7),
        ("policy.knots", (0, 2, 4, 6)),
    ),
    "steps of 11 ms": (("policy.nominal.steps", 1),),
    "no robot simulated": (("policy.limits.deviation", 0.0),),
}
MEASURED = (
    "corner by path, RMS",
    "payload .3 kg off centre, at once: place lost",
    "friction .5 left, .3 right, at once: place lost",
    "slope 5 deg, v_x of 0.04",
    "standing, roll and pitch of 5 deg: angles",
    "standing, payload .5 kg: height",
    "tilt of the walk, RMS",
)


def chosen(rows: Sequence[LocomotionRow]) -> list[LocomotionRow]:
    """The rows of MEASURED, each with its first case."""
    found = {row.name: row for row in rows}
    return [
        dataclasses.replace(found[name], cases=found[name].cases[:1])
        for name in MEASURED
    ]


def job(row: LocomotionRow, changes: Changes, seed: int) -> Job:
    """The case of a chosen row with changes of the policy."""
    [case] = row.cases
    return (
        dataclasses.replace(case, changes=(*case.changes, *changes)),
        DEFAULT,
        seed,
    )


def jobs(rows: Sequence[LocomotionRow]) -> list[Job]:
    """Every case of the chosen rows without every part."""
    return [
        job(row, changes, seed)
        for row, changes, seed in itertools.product(
            chosen(rows), ABLATIONS.values(), SEEDS
        )
    ]


def measured(
    rows: Sequence[LocomotionRow], motions: Mapping[Job, WalkMotion]
) -> list[dict[str, Any]]:
    """A row for every part: the mean over the seeds of every value without it."""
    found = []
    for name, changes in ABLATIONS.items():
        result: dict[str, Any] = {"kind": "ablation", "without": name}
        for row in chosen(rows):
            values = [
                row.value([motions[job(row, changes, seed)]]) for seed in SEEDS
            ]
            result[row.name] = sum(values) / len(values)
        found.append(result)
    return found


def checks(found: Sequence[Mapping[str, Any]]) -> list[Check]:
    """Every part is worth its lines in one of the cases."""
    checks = []
    for part in found[1:]:
        worth = max(ratio(part[name], found[0][name]) for name in MEASURED)
        name = f"ablation, {part['without']}: largest error over that with all"
        checks.append(at_least(name, worth, WORTH))
    return checks

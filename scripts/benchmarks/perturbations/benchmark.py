"""Stability of the MPC: the paper's seven perturbations beside its table, and random samples.

Three studies: (a) the published problem on its own linear model, (b) the policy `forces` on a
rigid torso with lag, (c) the default policy on the Cosserat robot. With --samples also a Monte
Carlo study over mass, friction, lag, pushes and noise. Details are in published.py, rigid_torso.py,
simulated.py and samples.py.
"""

import hashlib
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    COURSES,
    ROOT,
    BenchmarkError,
    Check,
    Progress,
    Row,
    at_most,
    revision,
)
from benchmarks.perturbations.cases import (
    CASES,
    DURATION,
    NOISE,
    TABLE,
    PerturbedRun,
    courses_of,
    metrics,
)
from benchmarks.perturbations.plots import draw_failures, draw_responses, table_lines
from benchmarks.perturbations.samples import RandomSample, SampleRecord, draw, summary
from slot_core.mpc.settings import read_mpc, read_paper_mpc
from slot_core.robot import read_robot
from slot_lab.workers import workers

REQUIRES = ("clarabel", "distributed")
QUICK_DURATION = 6.0  # s, of (b) and (c)
NOISE_SEED = 1
PAPER = ("max_cost", "mean_cost", "final_cost", "settling_s")  # figures of the table
REPRODUCED = ("Baseline", "Roll", "Height", "Velocity", "Combined")
MOST_DEVIATION = 0.5  # % of the paper's maximum cost
LATEST = 2.0  # s, settling time
NOTES = (
    "Noise: neither seed nor clipping are published; here seed 1, clipped at 1 (SI)",
    "Pitch: ill-posed; R leaves the normal forces nearly free, the raised steps make a cost of it",
    "(a): problem and model of the policy paper_code",
    "mean cost and settling time: their intervals are not published in the paper",
    "(a) starts with every state zero but the perturbation; at the reference the cost would be 0",
    "(b), (c): other weights: settling and feasibility compare with the paper, the cost does not",
    "(c) stands still: the sway of a walk is larger than the perturbations",
    "(c) Height: the torso's underside reaches the floor at 17 mm, so 10 mm is not possible",
)
Runs = dict[str, PerturbedRun]  # by case


def run(
    quick: bool, out: Path, progress: Progress, *, samples: int, scheduler: str, **like: Any
) -> tuple[list[Row], list[Check]]:
    """Run the studies; `perturbations.png` shows them, `failures.png` the failed samples."""
    if like["observer"] is None:
        like["observer"] = read_mpc("forces").disturbance.time
    runs, rows = cases(QUICK_DURATION if quick else DURATION, progress)
    rows += [{"kind": "note", "note": note} for note in NOTES]
    np.savez_compressed(out / COURSES, **courses_of(runs))
    draw_responses(runs, out / "perturbations.png")
    for line in table_lines(rows):
        progress(line)
    if samples:
        rows += sample_rows(samples, draw(**like, index=0), scheduler, out, progress)
    return rows, checks(rows)


def cases(duration: float, progress: Progress) -> tuple[dict[str, Runs], list[dict[str, Any]]]:
    """Run every case of every study; (a) always lasts as long as in the paper."""
    # Imported after REQUIRES is checked.
    from benchmarks.perturbations.published import run_published  # noqa: PLC0415
    from benchmarks.perturbations.rigid_torso import run_torso  # noqa: PLC0415
    from benchmarks.perturbations.simulated import run_robot  # noqa: PLC0415

    robot, published, forces = read_robot(), read_paper_mpc("paper_code"), read_mpc("forces")
    runs: dict[str, Runs] = {"published": {}, "torso": {}, "robot": {}}
    rows = []
    for name, change in CASES.items():
        progress(f"case {name}")
        noisy = name == "Noise"
        noise = [np.random.default_rng(NOISE_SEED) if noisy else None for _ in range(2)]
        runs["published"][name] = run_published(robot, published, change, DURATION, noise[0])
        runs["torso"][name] = run_torso(robot, forces, change, duration, noise[1])
        runs["robot"][name], reached = run_robot(change, duration, NOISE if noisy else 0.0)
        for study, by_case in runs.items():
            row = {"kind": "case", "study": study, "case": name} | metrics(by_case[name])
            row |= {f"paper_{key}": value for key, value in zip(PAPER, TABLE[name])}
            rows.append(row | (reached if study == "robot" else {}))
    return runs, rows


def sample_rows(
    count: int, like: RandomSample, scheduler: str, out: Path, progress: Progress
) -> list[Row]:
    """Run the samples that `out/samples.csv` lacks; raises BenchmarkError for a negative count."""
    from benchmarks.perturbations.farm import run_samples  # noqa: PLC0415

    if count < 0:
        raise BenchmarkError(f"--samples {count}: a number of samples, 0 or more")
    record = SampleRecord(out / "samples.csv", state_of_code(), like)
    with workers(scheduler) as client:
        results = run_samples(client, record, like, count, progress)
    found = summary(results)
    draw_failures(results, title(found[0], like), out / "failures.png")
    for row in found:
        progress(", ".join(f"{key} {value}" for key, value in row.items() if key != "kind"))
    return list(found)


def title(total: Row, like: RandomSample) -> str:
    """Title of the samples' plot."""
    observer = f"observer {like.observer:g} s" if like.observer else "no observer"
    return (
        f"{total['failed']} of {total['samples']} samples exceed a limit: {total['rate']:.1%} "
        f"({total['rate_low']:.1%} to {total['rate_high']:.1%}); plant {like.plant}, {observer}"
    )


def state_of_code() -> str:
    """Commit, and a digest of uncommitted changes: only samples of equal code are put together."""
    commit = revision(ROOT)["commit"] or "unknown"
    diff = subprocess.run(["git", "-C", ROOT, "diff", "HEAD"], capture_output=True, check=False)
    change = hashlib.sha256(diff.stdout).hexdigest()[:12] if diff.stdout else ""
    return "-".join(filter(None, [commit, change]))


def checks(rows: Iterable[Row]) -> list[Check]:
    """(a) against the paper; (b) and (c) feasible and settled."""
    out = []
    for row in rows:
        if row["kind"] != "case":
            continue
        name = f"{row['study']}, {row['case']}"
        if row["study"] == "published":
            if row["case"] in REPRODUCED:
                off = 100 * abs(row["max_cost"] / row["paper_max_cost"] - 1)
                out.append(at_most(f"{name}: maximum cost", off, MOST_DEVIATION, "% off the paper"))
        else:
            out.append(at_most(f"{name}: infeasible steps", row["infeasible"], 0))
            out.append(at_most(f"{name}: settled", row["settling_s"], LATEST, "s"))
    return out

"""The paper's figures, each with its place, and where ours are found among the results.

Places are sections, tables and figures of S. Karan et al., *Dynamic Modeling and MPC for Locomotion
of Tendon-Driven Soft Quadruped*. The paper's validation (VI-B to VI-D) is of a real robot; ours are
of simulated ones throughout.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.perturbations.cases import TABLE
from benchmarks.report.results import Run, number

REPRODUCED = 5e-3  # largest deviation of a figure that counts as reproduced

EXAMPLE = "slot_bringup/example"
WALKED = {
    "walk.png": "path, height, velocities, tilt, tendon angles, forces and latencies of the run",
    "robot.png": "the same run in stills",
    "constraint_map.png": "constraint map: slack of every constraint over time; red is violated",
}
MAP = "scripts/view --map {} --out {}/constraint_map.png"
RUNS = (
    Run("walk", "Walk", ("scripts/run --lockstep --bag {}", MAP), WALKED),
    Run(
        "crawl", "Crawl", ("scripts/run --lockstep --gait crawl --bag {}", MAP), WALKED
    ),
    Run(
        "diagonal",
        "Walk at 60 degrees",
        ("scripts/run --lockstep --vx 0.025 --vy 0.043 --bag {}", MAP),
        WALKED,
    ),
    Run(
        "single_leg",
        "Single leg, compared with the synthetic example",
        (
            f"scripts/validate {EXAMPLE}/single_leg_run.csv {EXAMPLE}/single_leg_markers.csv"
            " --out {}",
        ),
        {
            "leg.png": "height of four points of a leg: simulated, and a synthetic measurement"
        },
    ),
    Run(
        "walk_validated",
        "Walk, compared with the synthetic example",
        (
            f"scripts/twin {EXAMPLE}/walk --out {{}}",
            f"scripts/validate {{}}/predicted.csv {EXAMPLE}/walk_markers.csv --frame-time 1.5"
            " --out {}",
        ),
        {"torso.png": "the torso: predicted by the model, and a synthetic measurement"},
    ),
)


@dataclass(frozen=True)
class Ours:
    """A number of ours: `name` of the first row that matches in a benchmark's or a run's rows."""

    result: str
    name: str
    match: Mapping[str, Any]
    factor: float = 1.0


@dataclass(frozen=True)
class TableColumn:
    """A figure of a table: its unit, and what makes ours good beside the paper's.

    judged: `equal` (within REPRODUCED), `smaller`, `larger`, or "" where they do not compare.
    """

    name: str
    unit: str = ""
    judged: str = ""


@dataclass(frozen=True)
class Line:
    """A row of a table: the paper's figures (text where it gives no number), and ours.

    judged: as of a column, which it takes precedence over unless it is None.
    """

    name: str
    paper: Sequence[float | str]
    ours: Sequence[Ours | None]
    place: str = ""
    judged: str | None = None


@dataclass(frozen=True)
class PaperComparison:
    """A table of the paper beside ours; `about` says what differs between the two."""

    title: str
    place: str
    about: str
    columns: Sequence[TableColumn]  # of the paper
    lines: Sequence[Line]
    results: Sequence[str]  # whose figures and images show the same
    others: Sequence[
        TableColumn
    ] = ()  # ours, if not those of the paper; then nothing is judged

    @property
    def ours(self) -> Sequence[TableColumn]:
        """Columns of our figures."""
        return self.others or self.columns


def comparisons() -> list[PaperComparison]:
    """All comparisons, in the order of the paper."""
    return [
        _timing(),
        _single_leg(),
        _whole_body(),
        _tracking(),
        _diagonal(),
        _stability(),
        _settling(),
        _feasibility(),
    ]


def _timing() -> PaperComparison:
    rod = Ours("robot", "us_per_step", {"kind": "cost", "nodes": 31}, 1e-3)
    solver = {"kind": "solver", "solver": "clarabel", "tolerance": 1e-10}
    published = {"kind": "cvxpy", "solver": "CVXPY, as published, SCS"}

    def stage(name: str) -> Ours:
        match = {
            "kind": "latency",
            "nodes": "separate",
            "stage": name,
            "repeat": "median",
        }
        return Ours("graph", "p50_ms", match)

    lines = [
        Line(
            "four legs of 31 nodes and torso, a step (four times 0.35, and 0.18)",
            (4 * 0.35 + 0.18,),
            (rod,),
            judged="smaller",
        ),
        Line(
            "MPC on forces, horizon 15, by Clarabel",
            (6.2,),
            (Ours("mpc", "median_ms", solver),),
            judged="smaller",
        ),
        Line(
            "the same rebuilt in every cycle, through CVXPY and SCS as in the paper",
            (6.2,),
            (Ours("mpc", "median_ms", published),),
            judged="smaller",
        ),
        Line(
            "gait scheduling; with force map and PID in the paper",
            (0.5,),
            (stage("gait_scheduler"),),
        ),
        Line(
            "force map; with gait scheduling and PID in the paper",
            (0.5,),
            (stage("force_mapper"),),
        ),
    ]
    return PaperComparison(
        "Time of each component",
        "Section V",
        "The paper's times are of an NVIDIA Jetson Xavier, ours of the machine named at each "
        "benchmark. Ours of the gait scheduler and the force map are medians from message to "
        "message, between processes; the paper's is an upper bound of both and the PID together.",
        (TableColumn("time", "ms"),),
        lines,
        ("robot", "mpc", "graph"),
    )


def _single_leg() -> PaperComparison:
    points = {"fixed base": "base", "1/3": "third", "2/3": "two_thirds", "tip": "tip"}
    metrics = {
        "RMSE, mm": ("rmse", 1e3, (5.20, 5.72, 4.00, 0.89)),
        "MAE, mm": ("mae", 1e3, (3.85, 3.90, 2.60, 0.71)),
        "NRMSE, %": ("nrmse", 1e2, (5.87, 6.94, 7.88, 19.22)),
        "average error, mm": ("mean_error", 1e3, (2.23, 2.87, 2.32, 0.15)),
        "error, %": ("error", 1e2, (2.51, 3.47, 4.56, 3.21)),
        "accuracy, %": ("accuracy", 1e2, (97.49, 96.53, 95.44, 96.79)),
    }
    lines = [
        Line(
            title,
            paper,
            [
                Ours("single_leg", name, {"point": point, "axis": "z"}, factor)
                for point in points.values()
            ],
        )
        for title, (name, factor, paper) in metrics.items()
    ]
    return PaperComparison(
        "Single leg: height of four points",
        "Table II, Fig. 5",
        "Not reproduced: no robot was measured. Ours are the same metrics between the simulated "
        "leg and a synthetic measurement of another simulated robot.",
        [TableColumn(name) for name in points],
        lines,
        ("single_leg",),
    )


def _whole_body() -> PaperComparison:
    def torso(axis: str) -> Ours:
        return Ours("walk_validated", "rmse", {"point": "torso", "axis": axis}, 1e3)

    lines = [
        Line("forward walk", (4.0, 4.8), (torso("x"), torso("z"))),
        Line("crawl", (5.1, 4.6), (None, None)),
    ]
    return PaperComparison(
        "Walk and crawl: place of the torso",
        "Table III, Fig. 6 to 8",
        "Not reproduced: no robot was measured. Ours is the walk that the model predicts from the "
        "tendon angles of a bag against a synthetic measurement of another simulated robot, whose "
        "parameters the model does not know.",
        (TableColumn("RMSE in x", "mm"), TableColumn("RMSE in z", "mm")),
        lines,
        ("walk_validated", "walk", "crawl"),
    )


def _default(row: str) -> Ours:
    """Our default controller's figure in a row of the locomotion benchmark."""
    return Ours("locomotion", "default", {"row": row})


def _tracking() -> PaperComparison:
    heights, angles = (
        "standing, heights .030 to .060: ",
        "standing, roll and pitch of 5 deg: ",
    )
    lines = [
        Line(
            "height held, standing and not walking: largest error, mm",
            ("reaches 0.04 m",),
            (_default(f"{heights}height"),),
            "VI-E, Fig. 9a",
        ),
        Line(
            "forward velocity held, friction 0.4, not at 0.04 m, m/s",
            (0.08,),
            (_default("fastest held, mu 0.4"),),
            "VI-E, Fig. 9b",
            "larger",
        ),
        Line(
            "lateral deviation over 0.8 m, largest, mm",
            (32.0,),
            (_default("lateral error over .8 m"),),
            "VI-E",
        ),
        Line(
            "lateral RMSE over 0.8 m, mm",
            (14.0,),
            (_default("lateral RMSE over .8 m"),),
            "VI-E",
        ),
        Line(
            "roll and pitch held, standing: largest error, deg",
            ("not given",),
            (_default(f"{angles}angles"),),
        ),
    ]
    return PaperComparison(
        "Height, velocity and angles under the MPC",
        "Section VI-E, Fig. 9 and 10",
        "The paper has its velocity and its height at once; ours are held one at a time: 0.079 m/s "
        "at a mean height of 65 mm, 0.025 m/s at 44 mm. "
        "The paper's lateral deviation is of its robot on a floor, ours of the simulated robot on "
        "even friction; ours are the worst cases of the rows below Locomotion.",
        (TableColumn("value"),),
        lines,
        ("locomotion", "walk"),
    )


def _diagonal() -> PaperComparison:
    lines = [
        Line(
            "RMSE of the path, mm",
            (35.0,),
            (_default("60 deg path, cross-track RMSE"),),
            judged="smaller",
        ),
        Line("velocity ahead and sideways, m/s", ("0.052, 0.09",), (None,)),
        Line(
            "change of heading, deg",
            ("not given",),
            (_default("60 deg path, heading"),),
        ),
    ]
    return PaperComparison(
        "Omnidirectional walk at 60 degrees",
        "Section VI-E, Fig. 11",
        "Both are simulated. The paper's velocity is not reproduced: our robot walks the path "
        "at the lower velocity of its benchmark.",
        (TableColumn("value"),),
        lines,
        ("locomotion", "diagonal"),
    )


def _stability() -> PaperComparison:
    names = ("max_cost", "mean_cost", "final_cost", "settling_cost_s")
    lines = [
        Line(
            case,
            [*(_settled(v) for v in paper), 0.0],
            [
                Ours(
                    "perturbations",
                    name,
                    {"kind": "case", "study": "published", "case": case},
                )
                for name in (*names, "infeasible")
            ],
            judged="" if case == "Noise" else None,
        )
        for case, paper in TABLE.items()
    ]
    columns = (
        TableColumn("max cost", "", "equal"),
        TableColumn("mean cost"),
        TableColumn("final cost"),
        TableColumn("settled", "s"),
        TableColumn("infeasible steps"),
    )
    return PaperComparison(
        "Perturbations: the published problem on its own model",
        "Table IV, Fig. 12",
        "Only the maximum cost is judged: the interval of mean cost and settling is not published, "
        "nor are the seed of the noise and its clipping.",
        columns,
        lines,
        ("perturbations",),
    )


def _settling() -> PaperComparison:
    lines = []
    for case, paper in TABLE.items():
        row = {"kind": "case", "study": "robot", "case": case}
        lines.append(
            Line(case, [_settled(paper[3])], [Ours("perturbations", "settling_s", row)])
        )
    return PaperComparison(
        "Perturbations: settling of the Cosserat robot",
        "Table IV",
        "The paper's settling is of its cost below 0.01; ours of height within 2 mm and tilt "
        "within 10 mrad, of the robot that stands under the default policy.",
        (TableColumn("settled", "s"),),
        lines,
        ("perturbations",),
    )


def _settled(value: float) -> float | str:
    return "never" if math.isnan(value) else value


def _feasibility() -> PaperComparison:
    fallback = Ours(
        "graph",
        "fallback_cycles",
        {"kind": "walk", "nodes": "separate", "repeat": "median"},
    )
    lines = [
        Line("walk: infeasible cycles", (0.0,), (fallback,), "Fig. 13a"),
        Line(
            "60 degrees: infeasible", ("at 22.374 and 61.875 s",), (None,), "Fig. 13b"
        ),
    ]
    return PaperComparison(
        "Constraint map",
        "Section VI-E, Fig. 13",
        "Every constraint of the MPC over time, of the walk and at 60 degrees: the maps are below "
        "Runs. In a stride our default solves no problem, so its cycles are not judged.",
        (TableColumn("cycles"),),
        lines,
        ("graph", "walk", "diagonal"),
    )


def find(ours: Ours, rows: Sequence[Mapping[str, Any]]) -> float | None:
    """Our number in `rows`, in the unit of its table; None if no row has it as a number."""
    row = next((row for row in rows if ours.match.items() <= row.items()), {})
    value = number(row.get(ours.name))
    return None if value is None else ours.factor * value


def judge(judged: str, paper: float | str, ours: float | None) -> str:
    """How ours stands beside the paper's: a word, or "" where they do not compare."""
    if not judged or ours is None or isinstance(paper, str):
        return ""
    is_equal = abs(ours - paper) <= REPRODUCED * abs(paper)
    if judged == "equal":
        return "reproduced" if is_equal else "not reproduced"
    if is_equal:
        return "equal"
    ahead = ours < paper if judged == "smaller" else ours > paper
    return "better" if ahead else "worse"

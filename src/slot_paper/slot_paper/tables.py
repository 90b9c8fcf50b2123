"""The figures of the paper's tables and text, each with its place, and where ours are found.

Ours are rows of the results of `scripts/bench` and `scripts/validate`; `scripts/report` shows them
beside the paper's. The paper's validation (VI-B to VI-D) is of a real robot; ours are of simulated
ones throughout.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slot_paper.perturbations import FIGURES, TABLE

REPRODUCED = 5e-3  # largest deviation of a figure that counts as reproduced


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
class PaperTable:
    """A table of the paper beside ours; `about` says what differs between the two."""

    title: str
    place: str
    about: str
    columns: Sequence[TableColumn]
    lines: Sequence[Line]
    results: Sequence[str]  # that hold our figures


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


def _mpc(name: str, **match: Any) -> tuple[Ours]:
    """A figure of the benchmark of the MPC's solvers."""
    return (Ours("mpc", name, match),)


def _graph(name: str, **match: Any) -> tuple[Ours]:
    """A figure of the benchmark of the graph, one process a node."""
    return (
        Ours("graph", name, {"nodes": "separate", "repeat": "median", **match}),
    )


def _leg(name: str, factor: float) -> list[Ours]:
    """An error of the height of four points of a leg."""
    points = ("base", "third", "two_thirds", "tip")
    return [
        Ours("single_leg", name, {"point": point, "axis": "z"}, factor)
        for point in points
    ]


def _torso(axis: str) -> Ours:
    """The error of the torso's place along an axis."""
    return Ours("walk_validated", "rmse", {"point": "torso", "axis": axis}, 1e3)


def _default(row: str) -> tuple[Ours]:
    """The default controller's figure in a row of the locomotion benchmark."""
    return (Ours("locomotion", "default", {"row": row}),)


def _case(study: str, case: str, *names: str) -> list[Ours]:
    """Figures of a perturbation in a study of the benchmark."""
    row = {"kind": "case", "study": study, "case": case}
    return [Ours("perturbations", name, row) for name in names]


def _settled(value: float) -> float | str:
    return "never" if math.isnan(value) else value


TABLES = (
    PaperTable(
        "Time of each component",
        "Section V",
        "The paper's times are of an NVIDIA Jetson Xavier, ours of the machine named at each "
        "benchmark. Ours of the gait scheduler and the force map are medians from message to "
        "message, between processes; the paper's is an upper bound of both and the PID together.",
        [TableColumn("time", "ms")],
        [
            Line(
                "four legs of 31 nodes and torso, a step (four times 0.35, and 0.18)",
                [4 * 0.35 + 0.18],
                [
                    Ours(
                        "robot",
                        "us_per_step",
                        {"kind": "cost", "nodes": 31},
                        1e-3,
                    )
                ],
                judged="smaller",
            ),
            Line(
                "MPC on forces, horizon 15, by Clarabel",
                [6.2],
                _mpc(
                    "median_ms",
                    kind="solver",
                    solver="clarabel",
                    tolerance=1e-10,
                ),
                judged="smaller",
            ),
            Line(
                "the same rebuilt in every cycle, through CVXPY and SCS as in the paper",
                [6.2],
                _mpc(
                    "median_ms", kind="cvxpy", solver="CVXPY, as published, SCS"
                ),
                judged="smaller",
            ),
            Line(
                "gait scheduling; with force map and PID in the paper",
                [0.5],
                _graph("p50_ms", kind="latency", stage="gait_scheduler"),
            ),
            Line(
                "force map; with gait scheduling and PID in the paper",
                [0.5],
                _graph("p50_ms", kind="latency", stage="force_mapper"),
            ),
        ],
        ["robot", "mpc", "graph"],
    ),
    PaperTable(
        "Single leg: height of four points",
        "Table II, Fig. 5",
        "Not reproduced: no robot was measured. Ours are the same metrics between the simulated "
        "leg and a synthetic measurement of another simulated robot.",
        [TableColumn(name) for name in ("fixed base", "1/3", "2/3", "tip")],
        [
            Line("RMSE, mm", (5.20, 5.72, 4.00, 0.89), _leg("rmse", 1e3)),
            Line("MAE, mm", (3.85, 3.90, 2.60, 0.71), _leg("mae", 1e3)),
            Line("NRMSE, %", (5.87, 6.94, 7.88, 19.22), _leg("nrmse", 1e2)),
            Line(
                "average error, mm",
                (2.23, 2.87, 2.32, 0.15),
                _leg("mean_error", 1e3),
            ),
            Line("error, %", (2.51, 3.47, 4.56, 3.21), _leg("error", 1e2)),
            Line(
                "accuracy, %",
                (97.49, 96.53, 95.44, 96.79),
                _leg("accuracy", 1e2),
            ),
        ],
        ["single_leg"],
    ),
    PaperTable(
        "Walk and crawl: place of the torso",
        "Table III, Fig. 6 to 8",
        "Not reproduced: no robot was measured. Ours is the walk that the model predicts from the "
        "tendon angles of a bag against a synthetic measurement of another simulated robot, whose "
        "parameters the model does not know.",
        [TableColumn("RMSE in x", "mm"), TableColumn("RMSE in z", "mm")],
        [
            Line("forward walk", (4.0, 4.8), (_torso("x"), _torso("z"))),
            Line("crawl", (5.1, 4.6), (None, None)),
        ],
        ["walk_validated"],
    ),
    PaperTable(
        "Height, velocity and angles under the MPC",
        "Section VI-E, Fig. 9 and 10",
        "The paper has its velocity and its height at once; ours are held one at a time: 0.079 m/s "
        "at a mean height of 65 mm, 0.025 m/s at 44 mm. "
        "The paper's lateral deviation is of its robot on a floor, ours of the simulated robot on "
        "even friction; ours are the worst cases of the rows below Locomotion.",
        [TableColumn("value")],
        [
            Line(
                "height held, standing and not walking: largest error, mm",
                ["reaches 0.04 m"],
                _default("standing, heights .030 to .060: height"),
                "VI-E, Fig. 9a",
            ),
            Line(
                "forward velocity held, friction 0.4, not at 0.04 m, m/s",
                [0.08],
                _default("fastest held, mu 0.4"),
                "VI-E, Fig. 9b",
                "larger",
            ),
            Line(
                "lateral deviation over 0.8 m, largest, mm",
                [32.0],
                _default("lateral error over .8 m"),
                "VI-E",
            ),
            Line(
                "lateral RMSE over 0.8 m, mm",
                [14.0],
                _default("lateral RMSE over .8 m"),
                "VI-E",
            ),
            Line(
                "roll and pitch held, standing: largest error, deg",
                ["not given"],
                _default("standing, roll and pitch of 5 deg: angles"),
            ),
        ],
        ["locomotion"],
    ),
    PaperTable(
        "Omnidirectional walk at 60 degrees",
        "Section VI-E, Fig. 11",
        "Both are simulated. The paper's velocity is not reproduced: our robot walks the path "
        "at the lower velocity of its benchmark.",
        [TableColumn("value")],
        [
            Line(
                "RMSE of the path, mm",
                [35.0],
                _default("60 deg path, cross-track RMSE"),
                judged="smaller",
            ),
            Line("velocity ahead and sideways, m/s", ["0.052, 0.09"], [None]),
            Line(
                "change of heading, deg",
                ["not given"],
                _default("60 deg path, heading"),
            ),
        ],
        ["locomotion"],
    ),
    PaperTable(
        "Perturbations: the published problem on its own model",
        "Table IV, Fig. 12",
        "Only the maximum cost is judged: the interval of mean cost and settling is not published, "
        "nor are the seed of the noise and its clipping.",
        [
            TableColumn("max cost", "", "equal"),
            TableColumn("mean cost"),
            TableColumn("final cost"),
            TableColumn("settled", "s"),
            TableColumn("infeasible steps"),
        ],
        [
            Line(
                case,
                [*map(_settled, paper), 0.0],
                _case("published", case, *FIGURES, "infeasible"),
                judged="" if case == "Noise" else None,
            )
            for case, paper in TABLE.items()
        ],
        ["perturbations"],
    ),
    PaperTable(
        "Perturbations: settling of the Cosserat robot",
        "Table IV",
        "The paper's settling is of its cost below 0.01; ours of height within 2 mm and tilt "
        "within 10 mrad, of the robot that stands under the default policy.",
        [TableColumn("settled", "s")],
        [
            Line(case, [_settled(paper[3])], _case("robot", case, "settling_s"))
            for case, paper in TABLE.items()
        ],
        ["perturbations"],
    ),
    PaperTable(
        "Constraint map",
        "Section VI-E, Fig. 13",
        "Every constraint of the MPC over time, of the walk and at 60 degrees: the maps are below "
        "Runs. In a stride our default solves no problem, so its cycles are not judged.",
        [TableColumn("cycles")],
        [
            Line(
                "walk: infeasible cycles",
                [0.0],
                _graph("fallback_cycles", kind="walk"),
                "Fig. 13a",
            ),
            Line(
                "60 degrees: infeasible",
                ["at 22.374 and 61.875 s"],
                [None],
                "Fig. 13b",
            ),
        ],
        ["graph"],
    ),
)
"""All tables, in the order of the paper."""

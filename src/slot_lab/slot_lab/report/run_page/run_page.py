"""Page of a run, or of two: sampled at frames, encoded, in one HTML file that loads nothing.

A frame is a recorded state of the simulated legs; without them, an estimated state. Columns of
numbers are rounded to multiples of a step. The page stores the differences of these integers along
each leg, then between frames, modulo 2^32 with the sign in the lowest bit, the lowest bytes of all
first; compressed (zlib) and in base64. A value that is not finite, or too large, is NO_VALUE.
"""

import base64
import html
import json
import math
import operator
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.command_line import Tell, untold
from slot_core.drawing import palette
from slot_core.drawing.drawing import FORCE_SCALE, LEAST_FORCE
from slot_core.messages import decode
from slot_core.refusal import InputError, one_line
from slot_core.robot import LEGS, RobotParameters, read_robot
from slot_lab.bags.bag import Bag, BagError, Stamps
from slot_lab.bags.recorded_walk import read_motion, seconds
from slot_lab.bags.topics import LEG_STATES
from slot_lab.report import traces
from slot_lab.report.robot_drawing import Snapshot, read_poses

Integers: TypeAlias = NDArray[np.int64]
Messages: TypeAlias = list[tuple[int, Any]]
"""Messages after their stamps, ns, in the order of these."""
States: TypeAlias = dict[str, list[tuple[float, str]]]
"""States by title: s since the first frame, name."""
# 100 s at 30 Hz; of a longer run every second, third, ... is left
MOST_FRAMES = 3000
NO_VALUE = -(2**31)
STEPS = {
    "t": 1e-4,
    "position": 5e-5,
    "quaternion": 1e-4,
    "nodes": 5e-5,
    "across": 2.5e-3,
    "force": 0.01,
}
"""Steps of the columns of the robot, SI; a curve has four digits of its largest value."""
ALONG = ("nodes", "across")  # columns (4, m, 3)
HERE = Path(__file__).resolve().parent
SCRIPTS = ("frames.js", "scene.js", "plots.js", "page.js")  # in this order
SUFFIX = ".html"


@dataclass(frozen=True)
class RunFrames:
    """A run at n frames, with legs of m nodes."""

    name: str
    # (n, k) by name: of STEPS, and curves as `plot/curve`
    columns: dict[str, Array]
    thickness: Array  # (4, m) m, of the legs at their nodes
    states: States  # where they change
    known: bool  # whether the shapes of the legs are recorded
    every: int  # of how many recorded frames one is shown
    left_out: Sequence[str]  # why the curves of a topic are not shown

    @property
    def count(self) -> int:
        """Number of frames n."""
        return len(self.columns["t"])

    def coded(self) -> dict[str, Any]:
        """The run as the page reads it."""
        columns, integers = [], []
        for name, values in self.columns.items():
            step = STEPS.get(name) or _step(values)
            rounded = _integers(values, step)
            columns.append([name, values.shape[1], step])
            integers.append(_along(rounded) if name in ALONG else rounded)
        return {
            "name": self.name,
            "frames": self.count,
            "columns": columns,
            "data": _packed(np.concatenate(integers, axis=1)),
            "thickness": np.round(self.thickness, 6).tolist(),
            "states": self.states,
            "known": self.known,
        }


def read_frames(
    bag: Bag, robot: RobotParameters, tell: Tell = untold
) -> RunFrames:
    """The frames of a bag; raises BagError if it holds no motion of the torso."""
    tell(0.0)
    known = bool(bag.counts.get(LEG_STATES))
    source = LEG_STATES if known else read_motion(bag).source
    stamps = np.unique(bag.series(source).stamp)
    every = math.ceil(len(stamps) / MOST_FRAMES)
    stamps = stamps[::every]
    with bag.using(source):
        poses = read_poses(bag, seconds(stamps), robot)
        columns = _columns(stamps, poses)
        thickness = np.asarray(robot.leg.thickness(poses[0].legs.fraction))
        if not np.isfinite(thickness).all():
            raise ValueError("the first shape of the legs is not finite")
    curves, states, left_out = _read_traces(bag, stamps, tell)
    return RunFrames(
        name=one_line(bag.path.absolute().name),
        columns={
            n: v.reshape(len(stamps), -1) for n, v in (columns | curves).items()
        },
        thickness=thickness,
        states=states,
        known=known,
        every=every,
        left_out=left_out,
    )


def _columns(stamps: Stamps, poses: list[Snapshot]) -> dict[str, Array]:
    """Columns of the robot; raises ValueError for legs whose number of nodes changes."""
    position = np.array([pose.position for pose in poses])
    return {
        "t": seconds(stamps - stamps[0]),
        "position": position,
        "quaternion": _continuous(
            np.array([pose.quaternion for pose in poses])
        ),
        "nodes": np.array([pose.legs.nodes for pose in poses])
        - position[:, None, None],
        "across": np.array([pose.legs.axes[0] for pose in poses]),
        "force": np.array([pose.force for pose in poses]),
    }


def _continuous(quaternion: Array) -> Array:
    """Quaternions (n, 4) of the same rotations, each on the side of the one before it."""
    turn = np.einsum("ij,ij->i", quaternion[1:], quaternion[:-1]) < 0
    sign = np.cumprod(np.where(turn, -1.0, 1.0))
    return quaternion * np.concatenate([[1.0], sign])[:, None]


def _read_traces(
    bag: Bag, stamps: Stamps, tell: Tell
) -> tuple[dict[str, Array], States, list[str]]:
    """Curves (n, k) by name at the stamps (n,), changes of states, why a topic is left out."""
    curves: dict[str, Array] = {}
    states: States = {}
    left_out = []
    topics = [*filter(bag.counts.get, traces.TOPICS)]
    for k, topic in enumerate(topics):
        # the robot's motion was the first part
        tell((k + 1) / (len(topics) + 1))
        try:
            with bag.using(topic):
                found = sorted(
                    ((decode.stamp(m), m) for _, m in bag.messages(topic)),
                    key=operator.itemgetter(0),
                )
                curves |= _curves(topic, found, stamps)
                states |= _states(topic, found, stamps)
        except BagError as error:
            left_out.append(str(error))
    return curves, states, left_out


def _states(topic: str, found: Messages, stamps: Stamps) -> States:
    """Changes of the states that a topic names."""
    states: States = {}
    for stamp, message in found:
        since = float(seconds(stamp - stamps[0]))
        for key, state in traces.states(topic, message).items():
            changes = states.setdefault(traces.STATES[key], [])
            if not changes or changes[-1][1] != state:
                changes.append((since, state))
    return states


def _curves(topic: str, found: Messages, stamps: Stamps) -> dict[str, Array]:
    """Values of the last message at or before each stamp; NaN before the first."""
    last = (
        np.searchsorted([stamp for stamp, _ in found], stamps, side="right") - 1
    )
    rows = [traces.values(topic, message) for _, message in found]
    columns = {
        name: np.array([row[name] for row in rows], dtype=float)
        for name in rows[0]
    }
    return {
        n: np.where(last[:, None] < 0, np.nan, v[last])
        for n, v in columns.items()
    }


def _step(values: Array) -> float:
    """Step of a curve: four digits of its largest value."""
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    return (
        10.0 ** (math.floor(math.log10(largest)) - 3) if largest > 0.0 else 1.0
    )


def _integers(values: Array, step: float) -> Integers:
    """(n, k) multiples of the step, rounded; NO_VALUE for those that do not fit."""
    with np.errstate(over="ignore"):
        scaled = values / step
    fits = np.isfinite(scaled) & (np.abs(scaled) < -NO_VALUE - 1)
    return np.where(
        fits, np.rint(np.where(fits, scaled, 0.0)), NO_VALUE
    ).astype(np.int64)


def _along(integers: Integers) -> Integers:
    """(n, k) differences between the nodes of each leg; the first node stays as it is."""
    nodes = integers.reshape(len(integers), len(LEGS), -1, 3)
    return np.diff(nodes, axis=2, prepend=0).reshape(integers.shape)


def _packed(table: Integers) -> str:
    """Text of integers (n, c)."""
    change = np.diff(table, axis=0, prepend=0).astype(np.int32)  # modulo 2^32
    signed = (change << 1) ^ (change >> 31)  # 0, -1, 1, -2 become 0, 1, 2, 3
    return _deflated(
        np.ascontiguousarray(signed.T)
        .astype("<i4")
        .view(np.uint8)
        .reshape(-1, 4)
        .T.tobytes()
    )


class PageError(InputError):
    """A page cannot be made; the message is one line."""


def write_page(
    bags: Sequence[Bag],
    path: Path,
    progress: Callable[[str, float], object] = untold,
) -> list[str]:
    """Write the page of one or two bags; returns lines on it.

    Raises PageError for another suffix, BagError if a bag holds no motion of the torso, OSError.
    """
    if path.suffix.lower() != SUFFIX:
        raise PageError(f"{path}: expected a name that ends in {SUFFIX}")
    robot = read_robot()
    runs = [
        read_frames(bag, robot, partial(progress, f"reading {bag.path}"))
        for bag in bags
    ]
    progress("writing", 0.0)
    text = page(content(runs, robot))
    path.write_text(text, encoding="utf-8")
    counts = ", ".join(
        f"{run.name} {run.count} frames"
        + (f" (one of {run.every})" if run.every > 1 else "")
        for run in runs
    )
    return [
        f"{path}: {counts}, {len(text) / 1e3:.0f} kB",
        *(f"left out: {reason}" for run in runs for reason in run.left_out),
    ]


def content(
    runs: Sequence[RunFrames], robot: RobotParameters
) -> dict[str, Any]:
    """Data of a page: robot, plots and runs."""
    held = {name for run in runs for name in run.columns}
    plots = [
        {
            "title": plot.title,
            "curves": [
                {
                    "column": f"{name}/{key}",
                    "names": curve.names,
                    "colours": curve.colours,
                }
                for key, curve in plot.curves.items()
                if f"{name}/{key}" in held
            ],
        }
        for name, plot in traces.PLOTS.items()
    ]
    return {
        "runs": [run.coded() for run in runs],
        "plots": [plot for plot in plots if plot["curves"]],
        "torso": robot.torso.size,
        "width": robot.leg.width,
        "force_scale": FORCE_SCALE,
        "least_force": LEAST_FORCE,
        "colours": {
            "legs": list(palette.LEG_COLOURS.values()),
            "unknown": palette.PALE,
            "torso": palette.TORSO,
            "runs": [palette.TRUE, palette.SECONDARY],
            "ink": palette.INK,
        },
    }


def page(shown: dict[str, Any]) -> str:
    """The page of a content; nothing in it can end the element that holds it."""
    names = " and ".join(run["name"] for run in shown["runs"])
    parts = {
        "title": html.escape(f"SLOT: {names}"),
        "style": _read("page.css"),
        "licence": _read("three/LICENSE").replace("--", "- -"),
        "core": _deflated((HERE / "three/three.core.min.js").read_bytes()),
        "module": _deflated((HERE / "three/three.module.min.js").read_bytes()),
        "content": json.dumps(shown, separators=(",", ":")).replace(
            "<", "\\u003c"
        ),
        "script": "\n".join(map(_read, SCRIPTS)),
    }
    before, *rest = _read("page.html").split("{{")
    pieces = (piece.split("}}", 1) for piece in rest)
    return before + "".join(parts[name] + after for name, after in pieces)


def _read(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


def _deflated(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode()

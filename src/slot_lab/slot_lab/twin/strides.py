"""Comparison of predicted and measured motion stride by stride.

Place x, y and heading of a walk accumulate all earlier errors; height, roll and pitch do not:
the legs' springs bring them back. So a prediction is compared over windows of a few strides,
each predicted from the measured place and heading: within a window both motions are aligned
in the plane, by the turn and the shift that make their means equal.

A stride's displacement leads from the mean place over a stride to the mean over the next, in
the frame of the mean heading: in the mean of 21 readings at 30 Hz their noise is a fifth.

Recorded walk of a robot: tendon angles and motion of the torso, from a bag or a CSV file.

The CSV file (`csv_table.py`) has the columns

    time,FL,FR,RL,RR,x,y,z,roll,pitch,yaw

in s of one clock, rad and m: tendon angles, and the pose of base_link in odom, z up, with
R = Rz(yaw) Ry(pitch) Rx(roll). A row holds the angles, the pose or both; the other cells are empty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.signal import correlate, find_peaks
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError, quantity
from slot_core.geometry import rotate
from slot_core.robot import LEGS
from slot_lab.bags.bag import STORAGES, Bag
from slot_lab.bags.recorded_walk import (
    TendonAngles,
    TorsoTrack,
    read_motion,
    stride_period,
    tendon_angles,
)
from slot_lab.bags.topics import COMMANDED, MOTION_TOPICS
from slot_lab.csv_table import Table, TableError, increasing_numbers, read_table

POSE = ("x", "y", "z", "roll", "pitch", "yaw")
COLUMNS = ("time", *LEGS, *POSE)


@dataclass(frozen=True)
class TwinSettings:
    """How the motion of a bag is predicted by the simulated robot and compared with it."""

    hold: float = quantity(
        "time between two tendon angles given to the robot", "s", 2e-3, 0.05
    )
    command_delay: float = quantity(
        "from a command's stamp to its effect", "s", 0.0, 0.5
    )
    run_in: int = quantity(
        "strides after the first motion that are not compared", "", 0, 1000
    )
    least_motion_deg: float = quantity(
        "range of a tendon angle in a stride; below it the robot stands",
        "deg",
        0.0,
        90.0,
    )
    window: int = quantity(
        "strides predicted from one measured place and heading", "", 1, 1000
    )
    held_out: float = quantity(
        "share of the strides, the last, that a fit does not see", "", 0, 0.9
    )
    position_sigma: float = quantity(
        "standard uncertainty of a position", "m", 1e-6, 1.0
    )
    angle_sigma: float = quantity(
        "standard uncertainty of roll, pitch, yaw", "rad", 1e-6, 1.0
    )


def read_twin() -> TwinSettings:
    """Read `config/twin.yaml`; raises ConfigError."""
    return config.read(TwinSettings, "twin")


@dataclass(frozen=True)
class BagRecording:
    """A walk in a recording: tendon angles and motion."""

    name: str
    angles: TendonAngles
    motion: TorsoTrack
    period: float | None  # s, of the gait; None: not recorded

    @property
    def span(self) -> tuple[float, float]:
        """Begin and end of the time that both cover, s of graph time."""
        t, moved = self.angles.t, self.motion.t
        return max(float(t[0]), float(moved[0])), min(
            float(t[-1]), float(moved[-1])
        )


def read_recorded(
    path: Path,
    namespace: str = "",
    angles: str = "",
    motion: str = "",
    remap: Mapping[str, str] | None = None,
) -> BagRecording:
    """Angles and motion of a bag, from the topics named or the first that are recorded, or of CSV.

    The angles of a CSV file are measured ones, unless `angles` names the topic of commands. remap:
    new names of a bag's topics. Raises BagError or TableError if they are not there or not sound,
    ConfigError if they do not overlap or if a CSV file is given with an option of bags.
    """
    if path.is_dir() or path.suffix in STORAGES:
        bag = Bag(path, namespace, remap)
        found = BagRecording(
            path.name,
            tendon_angles(bag, *filter(None, [angles])),
            read_motion(bag, *([motion] if motion else MOTION_TOPICS)),
            stride_period(bag),
        )
    elif namespace or motion or remap:
        raise ConfigError(
            f"{path}: --namespace, --motion and --remap are of bags"
        )
    else:
        found = _from_table(path, measured=angles != COMMANDED)
    begin, end = found.span
    if end <= begin:
        raise ConfigError(
            f"{path}: {found.angles.source} and {found.motion.source} do not overlap"
        )
    return found


def _from_table(path: Path, measured: bool) -> BagRecording:
    table = read_table(path)
    if table.columns != COLUMNS:
        raise TableError(
            f"{table.head}: columns {','.join(table.columns)[:80]}: expected"
            f" {','.join(COLUMNS)}"
        )
    t, angle = _columns(path, table, LEGS)
    at, pose = _columns(path, table, POSE)
    motion = TorsoTrack(
        "x .. yaw",
        at,
        position=pose[:, :3],
        quaternion=Rotation.from_euler("xyz", pose[:, 3:]).as_quat(),
        velocity=np.gradient(pose[:, :3], at, axis=0),
    )
    return BagRecording(
        path.name,
        TendonAngles("FL, FR, RL, RR", t, angle, measured=measured),
        motion,
        period=None,
    )


def _columns(
    path: Path, table: Table, names: Sequence[str]
) -> tuple[Array, Array]:
    """Times (n,) and values (n, m) of the rows in which the columns are not all empty."""
    rows = [row for row in table.rows if any(row.cells[name] for name in names)]
    values = increasing_numbers(rows, ["time", *names])
    if len(rows) < 2:
        raise TableError(
            f"{path}: {len(rows)} rows with {', '.join(names)}, less than 2"
        )
    return values[:, 0], values[:, 1:]


GRID = 0.01  # s, of the angles in the search of a period
PERIODS = (0.2, 10.0)  # s, sought
LEAST_CORRELATION = 0.5  # of angles with themselves a period later
HORIZON = 4  # strides
LEAST_STRIDES = HORIZON + 1
PER_STRIDE = 40  # points of a mean over a stride
X, Y, Z, ROLL, PITCH, YAW = range(6)


@dataclass(frozen=True)
class Strides:
    """Times that delimit the strides that are compared."""

    period: float  # s
    edges: Array  # (k + 1,) s, graph time

    @property
    def count(self) -> int:
        """Number of strides."""
        return len(self.edges) - 1

    def part(self, first: int, last: int) -> Strides:
        """Strides first .. last - 1."""
        return Strides(self.period, self.edges[first : last + 1])

    def split(self, held_out: float) -> tuple[Strides, Strides]:
        """Strides for a fit, and the last ones that it does not see; raises ConfigError."""
        seen = self.count - round(held_out * self.count)
        if seen < LEAST_STRIDES or self.count - seen < LEAST_STRIDES:
            raise ConfigError(
                f"{self.count} strides: a fit and its test need {LEAST_STRIDES} each; record longer"
            )
        return self.part(0, seen), self.part(seen, self.count)


@dataclass(frozen=True)
class StrideErrors:
    """Predicted minus measured motion of each stride."""

    predicted: Array  # (k - 1, 3) displacement m, m, and turn, rad, per stride
    measured: Array  # (k - 1, 3)
    far: Array  # (k - HORIZON, 2) error of the place after HORIZON strides, m
    level: Array  # (k, 3) error of mean height, m, roll and pitch, rad

    def summary(self) -> dict[str, float]:
        """RMS errors by name, SI units."""
        off = self.predicted - self.measured
        return {
            "displacement": _rms(np.hypot(off[:, 0], off[:, 1])),
            "turn": _rms(off[:, 2]),
            "place": _rms(np.hypot(*self.far.T)),
            "height": _rms(self.level[:, 0]),
            "tilt": _rms(np.hypot(self.level[:, 1], self.level[:, 2])),
        }


def find_strides(
    recorded: BagRecording, settings: TwinSettings, period: float | None = None
) -> Strides:
    """The longest row of strides in which the tendons move, without the run-in.

    period: of a stride, s; by default the recorded gait's, else the tendon angles'.
    Raises ConfigError for fewer than LEAST_STRIDES.
    """
    begin, end = recorded.span
    length = period or recorded.period or angle_period(recorded)
    t, angle = recorded.angles.t, recorded.angles.angle
    least = np.radians(settings.least_motion_deg)
    moved = t[np.abs(angle - angle[0]).max(axis=1) > least / 2]
    edges = np.arange(
        max(begin, float(moved[0]) if len(moved) else begin), end, length
    )
    row = _longest_row(
        [_range(t, angle, *pair) >= least for pair in pairwise(edges)]
    )
    count = len(row) - settings.run_in
    if count < LEAST_STRIDES:
        raise ConfigError(
            f"{recorded.name}: {max(count, 0)} strides of {length:.3g} s after a run-in of"
            f" {settings.run_in}, less than {LEAST_STRIDES}"
        )
    return Strides(length, edges[row.start + settings.run_in : row.stop + 1])


def _range(t: Array, angle: Array, begin: float, end: float) -> float:
    """Largest range of a column of angle (n, 4) from begin to end; zero without samples."""
    part = angle[(t >= begin) & (t < end)]
    return float(np.ptp(part, axis=0).max()) if len(part) else 0.0


def _longest_row(moves: Sequence[bool]) -> range:
    """Indices of the longest row of true values, the first of equal ones; empty without one."""
    longest, start = range(0), 0
    for end, true in enumerate([*moves, False]):
        if not true:
            longest = max(longest, range(start, end), key=len)
            start = end + 1
    return longest


def angle_period(recorded: BagRecording) -> float:
    """Period of the tendon angles, s: the first peak of their autocorrelation.

    Raises ConfigError if they are not periodic.
    """
    angles = recorded.angles
    t = np.arange(angles.t[0], angles.t[-1], GRID)
    columns = np.column_stack(
        [np.interp(t, angles.t, column) for column in angles.angle.T]
    )
    columns -= columns.mean(axis=0)
    total = sum(correlate(c, c, method="fft")[len(t) - 1 :] for c in columns.T)
    assert isinstance(total, np.ndarray)
    overlap = np.arange(len(t), 0, -1) / len(t)
    likeness = total / max(float(total[0]), 1e-12) / overlap
    low, high = (round(p / GRID) for p in PERIODS)
    part = likeness[low : min(high, len(t) // 2)]
    peaks, _ = find_peaks(part, height=LEAST_CORRELATION)
    if not len(peaks):
        raise ConfigError(
            f"{recorded.name}: the tendon angles are not periodic; name a length with --period"
        )
    best = peaks[part[peaks] > 0.9 * part[peaks].max()][0]
    return float((low + best) * GRID)


def stride_errors(
    predicted: TorsoTrack, measured: TorsoTrack, strides: Strides
) -> StrideErrors:
    """Errors of each stride."""
    moved = [_means(track, strides) for track in (predicted, measured)]
    first, second = (_displacements(means, 1) for means in moved)
    far = _displacements(moved[0], HORIZON) - _displacements(moved[1], HORIZON)
    return StrideErrors(
        first, second, far[:, :2], (moved[0] - moved[1])[:, [Z, ROLL, PITCH]]
    )


def error_growth(
    predicted: TorsoTrack, measured: TorsoTrack, strides: Strides
) -> Array:
    """(k - 1, 3) RMS over all starts of the error after 1 .. k - 1 strides: m, and rad of heading.

    Columns: strides, error of the place, error of the heading.
    """
    moved = [_means(track, strides) for track in (predicted, measured)]
    rows = []
    for ahead in range(1, strides.count):
        off = _displacements(moved[0], ahead) - _displacements(moved[1], ahead)
        rows.append(
            (ahead, _rms(np.hypot(off[:, 0], off[:, 1])), _rms(off[:, 2]))
        )
    return np.array(rows)


def residuals(
    predicted: TorsoTrack,
    measured: TorsoTrack,
    strides: Strides,
    settings: TwinSettings,
) -> list[Array]:
    """Residuals of each window, (n, 6) over their standard uncertainty.

    x and y are in the frame of the mean heading. Windows without samples are left out.
    """
    scale = np.repeat([settings.position_sigma, settings.angle_sigma], 3)
    out = []
    for first in range(0, strides.count, settings.window):
        last = min(first + settings.window, strides.count)
        begin, end = strides.edges[[first, last]]
        inside = (measured.t >= begin) & (measured.t < end)
        if inside.sum() >= 3:
            out.append(
                _aligned(
                    predicted.pose_at(measured.t[inside]), measured.pose[inside]
                )
                / scale
            )
    return out


def _aligned(predicted: Array, measured: Array) -> Array:
    """Predicted minus measured poses (n, 6), aligned in the plane."""
    off = predicted - measured
    off[:, :2] = _in_plane(predicted) - _in_plane(measured)
    off[:, YAW] -= off[:, YAW].mean()
    return off


def _in_plane(track: Array) -> Array:
    """(n, 2) places of a track (n, 6) from their mean, in the frame of the mean heading."""
    local = rotate(track[:, :2], -track[:, YAW].mean())
    return np.asarray(local - local.mean(axis=0))


def _means(track: TorsoTrack, strides: Strides) -> Array:
    """(k, 6) means over the strides."""
    share = (np.arange(PER_STRIDE) + 0.5) / PER_STRIDE
    t = strides.edges[:-1, None] + share * strides.period
    moved = track.pose_at(t.ravel()).reshape(strides.count, PER_STRIDE, 6)
    return np.asarray(moved.mean(axis=1))


def _displacements(means: Array, ahead: int) -> Array:
    """(k - ahead, 3) of means (k, 6): displacement in the frame of the heading, and turn."""
    off = means[ahead:] - means[:-ahead]
    return np.column_stack(
        [rotate(off[:, :2], -means[:-ahead, YAW]), off[:, YAW]]
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def placed(
    predicted: TorsoTrack, measured: TorsoTrack, strides: Strides
) -> tuple[Array, Array]:
    """The prediction over the strides: times (n,), s, and poses (n, 6).

    It is aligned with the measured place and heading of the first stride.
    """
    first = strides.part(0, 1)
    mine, given = (_means(track, first)[0] for track in (predicted, measured))
    inside = predicted.between(strides.edges[0], strides.edges[-1])
    pose, turned = inside.pose.copy(), given[YAW] - mine[YAW]
    pose[:, :2] = given[:2] + rotate(pose[:, :2] - mine[:2], turned)
    pose[:, YAW] += turned
    return inside.t, pose

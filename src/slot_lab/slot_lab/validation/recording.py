"""Recordings: tracks of points of the robot over time, from a bag, a CSV file or a video.

A bag gives `torso` and, if the shapes of the legs are recorded, `base`, `third`, `two_thirds` and
`tip` of each leg, as `FL_tip`. A CSV file (`csv_table.py`) has SI units and one of two
headers:

    time,point,x,y,z               one point a row, as above; of a single leg without `FL_`
    time,x,y,z[,roll,pitch,yaw]    the torso

The markers of a video are tracked as by scripts/validate --track, with its defaults; it also takes
folders of plots, bags with plots, and depth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slot_core.arrays import Array
from slot_core.progress import Tell, untold
from slot_core.refusal import InputError, quoted
from slot_core.robot import (
    BODY_POINTS,
    LEAST_NODES,
    LEG_POINTS,
    LEGS,
    ODOM_FRAME,
    POINT_COLUMNS,
    POINT_FRAME,
    TORSO,
    at_shares,
)
from slot_lab.bags.bag import STORAGES, Bag
from slot_lab.bags.measured import measured_motion, sound
from slot_lab.bags.recorded_walk import seconds
from slot_lab.bags.topics import LEG_STATES
from slot_lab.csv_table import CsvRow, TableError, read_table

POINTS = (*BODY_POINTS, *LEG_POINTS)
WIDE = ("time", "x", "y", "z")
ATTITUDE = ("roll", "pitch", "yaw")
VIDEOS = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg"}
LEAST_SAMPLES = 8
DIGITS = 5  # decimals of written values: 10 us, 10 um


class RecordingError(InputError):
    """A recording that cannot be used; the message is one line with file, place and cause."""


@dataclass(frozen=True)
class PointTrack:
    """A point over n times."""

    t: Array  # (n,) s, since the first sample of the recording
    position: Array  # (n, 3) m
    rpy: Array | None = None  # (n, 3) rad, of the torso if known; yaw unwrapped


@dataclass(frozen=True)
class PointRecording:
    """Tracks by name of the point."""

    name: str
    points: Mapping[str, PointTrack]
    notes: tuple[str, ...] = ()  # what limits its use, one line each
    tilted: bool = False  # whether it is in the axes of a camera, not in odom


def read_recording(
    path: Path,
    namespace: str = "",
    camera: Path | None = None,
    motion: str = "",
    tell: Tell = untold,
) -> PointRecording:
    """A recording from a bag, a CSV file, or a video and its camera's file.

    motion: topic of a bag, by default the first of MOTION_TOPICS that is recorded. Raises
    TableError for a CSV file, BagError for a bag, RecordingError for a video, and ConfigError for
    the settings of the tracker.
    """
    if path.suffix.lower() in VIDEOS:
        return _from_video(path, camera, tell)
    if path.is_dir() or path.suffix in STORAGES:
        return _from_bag(Bag(path, namespace), motion)
    return _from_csv(path)


def write_points(
    path: Path, points: Mapping[str, Array], comments: Sequence[str]
) -> None:
    """Write rows (n, 4) time, x, y, z of each point as CSV, ordered by time; raises OSError."""
    rows = [(row[0], name, row[1:]) for name, part in points.items() for row in part]
    lines = [f"# {comment}" for comment in comments] + [",".join(POINT_COLUMNS)]
    for time, name, place in sorted(rows, key=lambda row: row[0]):
        lines.append(
            f"{time:.{DIGITS}f},{name}," + ",".join(f"{v:.{DIGITS}f}" for v in place)
        )
    path.write_text("\n".join(lines) + "\n")


def _from_bag(bag: Bag, topic: str) -> PointRecording:
    motion = measured_motion(bag, topic)
    tracks, notes = {TORSO: (motion.t, motion.position, motion.rpy)}, []
    if motion.left_out:
        notes.append(
            f"{motion.source}: {motion.left_out} readings that were lost are left out"
        )
    if bag.counts.get(LEG_STATES, 0) > 1:
        series = bag.series(LEG_STATES, "position")
        flat = series["position"].astype(float)
        keep = sound(f"{bag.path}: {LEG_STATES}", series.stamp, flat)
        t, nodes = (
            seconds(series.stamp[keep]),
            flat[keep].reshape(len(keep), len(LEGS), -1, 3),
        )
        shaped = nodes.shape[2] >= LEAST_NODES
        if not shaped:
            notes.append(f"legs of {nodes.shape[2]} nodes: no points along them")
        for k, leg in enumerate(LEGS if shaped else ()):
            places = np.array([at_shares(shape[k]) for shape in nodes])
            for n, name in enumerate(LEG_POINTS):
                tracks[f"{leg}_{name}"] = (t, places[:, n], None)  # type: ignore[assignment]
    found = _since_first(bag.path.name, {k: PointTrack(*v) for k, v in tracks.items()})
    return dataclasses.replace(found, notes=tuple(notes))


def _from_video(path: Path, camera: Path | None, tell: Tell) -> PointRecording:
    # OpenCV takes a second to load, which other recordings do without.
    from slot_core.vision.camera import CameraError, nominal, read_camera  # noqa: PLC0415
    from slot_core.vision.settings import read_vision  # noqa: PLC0415
    from slot_lab.film.images import FilmError  # noqa: PLC0415
    from slot_lab.film.track import track_film  # noqa: PLC0415

    settings = read_vision()
    try:
        lens = read_camera(camera) if camera else nominal(settings.camera)
        found = track_film(path, lens, settings, tell=tell)
    except (FilmError, CameraError) as error:
        raise RecordingError(str(error)) from None
    rows: dict[str, list[tuple[float, ...]]] = {}
    for sample in found.samples:
        rows.setdefault(sample.point, []).append((sample.time, *sample.position))
    long = {
        name: np.array(part)
        for name, part in rows.items()
        if len(part) >= LEAST_SAMPLES
    }
    if not long:
        raise RecordingError(
            f"{path}: no marker in {LEAST_SAMPLES} plots; see scripts/validate --track"
        )
    tracks = {name: PointTrack(part[:, 0], part[:, 1:]) for name, part in long.items()}
    notes = (
        [] if camera else ["without --camera: the nominal camera of config/vision.yaml"]
    )
    return dataclasses.replace(
        _since_first(path.name, tracks),
        notes=(*notes, *found.warnings),
        tilted=found.frame != ODOM_FRAME,
    )


def _from_csv(path: Path) -> PointRecording:
    table = read_table(path)
    columns = table.columns
    if columns not in (POINT_COLUMNS, WIDE, WIDE + ATTITUDE):
        raise TableError(
            f"{table.head}: columns {','.join(columns)[:80]}: expected {','.join(POINT_COLUMNS)}"
            f" or {','.join(WIDE)}[,{','.join(ATTITUDE)}]"
        )
    parts: dict[str, list[tuple[int, list[float]]]] = {}
    numbers = [name for name in columns if name != "point"]
    for row in table.rows:
        name = _point(row)
        values = [
            row.number(n, "; leave out rows without a measurement") for n in numbers
        ]
        parts.setdefault(name, []).append((row.line, values))
    if not parts:
        raise TableError(f"{path}: no samples")
    tracks = {name: _track(path, name, part) for name, part in parts.items()}
    frames = [
        c.removeprefix(POINT_FRAME) for c in table.comments if c.startswith(POINT_FRAME)
    ]
    tilted = bool(frames) and frames[0] != ODOM_FRAME
    return dataclasses.replace(_since_first(path.name, tracks), tilted=tilted)


def _point(row: CsvRow) -> str:
    """Name of the point of a row."""
    point = row.cells.get("point", TORSO)
    if point not in POINTS:
        known = f"{TORSO}, {', '.join(LEG_POINTS)}, FL_tip ..."
        raise TableError(
            f"{row.where}, point: {quoted(point)} is unknown (known: {known})"
        )
    return point


def _track(
    path: Path, name: str, rows: Sequence[tuple[int, list[float]]]
) -> PointTrack:
    values = np.array([row for _, row in rows])
    step = np.diff(values[:, 0])
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        what = "repeats the time of" if step[k] == 0 else "is earlier than"
        raise TableError(
            f"{path}, line {rows[k + 1][0]}: {name} {what} line {rows[k][0]}"
        )
    if len(values) < LEAST_SAMPLES:
        raise TableError(
            f"{path}: {name} has {len(values)} samples, less than {LEAST_SAMPLES}"
        )
    rpy = values[:, 4:] if values.shape[1] > 4 else None
    return PointTrack(
        values[:, 0], values[:, 1:4], None if rpy is None else np.unwrap(rpy, axis=0)
    )


def _since_first(name: str, tracks: Mapping[str, PointTrack]) -> PointRecording:
    first = min(float(track.t[0]) for track in tracks.values())
    moved = {k: PointTrack(v.t - first, v.position, v.rpy) for k, v in tracks.items()}
    return PointRecording(name, moved)

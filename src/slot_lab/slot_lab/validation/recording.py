"""Recordings: tracks of points of the robot over time, from a bag, a CSV file or a video.

A bag gives `torso` and, if the shapes of the legs are recorded, `base`, `third`, `two_thirds` and
`tip` of each leg, as `FL_tip`. A CSV file (`csv_table.py`) has SI units and one of two
headers:

    time,point,x,y,z               one point a row, as above; of a single leg without `FL_`
    time,x,y,z[,roll,pitch,yaw]    the torso

and a trajectory of TUM, time x y z qx qy qz qw without a header, is the torso's.

The markers of a video are tracked as by scripts/validate --track, with its defaults; it also takes
folders of images and bags with images.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.command_line import Tell, untold
from slot_core.geometry import matrix_of_quaternion, rpy_of
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
from slot_lab.bags.recorded_walk import LENGTH_ERROR, read_legs, read_motion
from slot_lab.bags.topics import LEG_STATES, MOTION_TOPICS
from slot_lab.csv_table import (
    TUM,
    CsvRow,
    TableError,
    increasing_numbers,
    read_table,
)

POINTS = (*BODY_POINTS, *LEG_POINTS)
WIDE = ("time", "x", "y", "z")
ATTITUDE = ("roll", "pitch", "yaw")
VIDEOS = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg"}
LEAST_SAMPLES = 8
MISSING = "; leave out rows without a measurement"


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
    notes: Sequence[str] = ()  # what limits its use, one line each
    tilted: bool = False  # whether it is in the axes of a camera, not in odom


def read_recording(
    path: Path,
    camera: Path | None = None,
    motion: str = "",
    tell: Tell = untold,
    **names: Any,
) -> PointRecording:
    """A recording from a bag, a CSV file, or a video and its camera's file.

    motion: topic of a bag, by default the first of MOTION_TOPICS that is recorded. names:
    `namespace` and `remap` of a bag. Raises
    TableError for a CSV file, BagError for a bag, RecordingError for a video, and ConfigError for
    the settings of the tracker.
    """
    if path.suffix.lower() in VIDEOS:
        return _from_video(path, camera, tell)
    if path.is_dir() or path.suffix in STORAGES:
        return _from_bag(
            Bag(path, **names), [motion] if motion else MOTION_TOPICS
        )
    return _from_csv(path)


def _from_bag(bag: Bag, topics: Sequence[str]) -> PointRecording:
    motion = read_motion(bag, *topics)
    tracks = {TORSO: PointTrack(motion.t, motion.position, motion.rpy)}
    notes = []
    if motion.left_out:
        notes.append(
            f"{motion.source}: {motion.left_out} readings that were lost are left out"
        )
    if bag.counts.get(LEG_STATES, 0) > 1:
        t, shapes = read_legs(bag)
        if (count := shapes.shape[2]) < LEAST_NODES:
            notes.append(f"legs of {count} nodes: no points along them")
        else:
            for k, leg in enumerate(LEGS):
                places = np.array([at_shares(nodes) for nodes in shapes[:, k]])
                for n, name in enumerate(LEG_POINTS):
                    tracks[f"{leg}_{name}"] = PointTrack(t, places[:, n])
    return _since_first(bag.path.name, tracks, notes)


def _from_video(path: Path, camera: Path | None, tell: Tell) -> PointRecording:
    # OpenCV takes a second to load, which other recordings do without.
    from slot_core.vision.camera import CameraError, nominal, read_camera  # noqa: PLC0415
    from slot_core.vision.settings import read_vision  # noqa: PLC0415
    from slot_lab.film.images import FilmError  # noqa: PLC0415
    from slot_lab.film.tracker import track_film  # noqa: PLC0415

    settings = read_vision()
    try:
        found = track_film(
            path,
            read_camera(camera) if camera else nominal(settings.camera),
            settings,
            tell=tell,
        )
    except (FilmError, CameraError) as error:
        raise RecordingError(str(error)) from None
    rows: dict[str, list[tuple[float, ...]]] = {}
    for sample in found.samples:
        rows.setdefault(sample.point, []).append(
            (sample.time, *sample.position)
        )
    tracks = {
        name: PointTrack(np.array(part)[:, 0], np.array(part)[:, 1:])
        for name, part in rows.items()
        if len(part) >= LEAST_SAMPLES
    }
    if not tracks:
        raise RecordingError(
            f"{path}: no marker in {LEAST_SAMPLES} images; see scripts/validate --track"
        )
    unknown = "without --camera: the nominal camera of config/vision.yaml"
    notes = [*([] if camera else [unknown]), *found.warnings]
    return _since_first(
        path.name, tracks, notes, tilted=found.frame != ODOM_FRAME
    )


def _from_csv(path: Path) -> PointRecording:
    table = read_table(path)
    columns = table.columns
    if columns not in (POINT_COLUMNS, WIDE, WIDE + ATTITUDE, TUM):
        raise TableError(
            f"{table.head}: columns {','.join(columns)[:80]}: expected {','.join(POINT_COLUMNS)}"
            f" or {','.join(WIDE)}[,{','.join(ATTITUDE)}], or a trajectory of TUM"
        )
    parts: dict[str, list[CsvRow]] = {}
    for row in table.rows:
        name = row.cells.get("point", TORSO)
        if name not in POINTS:
            raise TableError(
                f"{row.where}, point: {quoted(name)} is unknown"
                f" (known: {TORSO}, {', '.join(LEG_POINTS)}, FL_tip ...)"
            )
        parts.setdefault(name, []).append(row)
    if not parts:
        raise TableError(f"{path}: no samples")
    numbers = [name for name in columns if name != "point"]
    tracks = {}
    for name, rows in parts.items():
        values = increasing_numbers(rows, numbers, MISSING)
        if len(values) < LEAST_SAMPLES:
            raise TableError(
                f"{path}: {name} has {len(values)} samples, less than {LEAST_SAMPLES}"
            )
        t, position, rpy = np.split(values, [1, 4], axis=1)
        if columns == TUM:
            rpy = _rpy(path, rpy)
        attitude = np.unwrap(rpy, axis=0) if rpy.size else None
        tracks[name] = PointTrack(t[:, 0], position, attitude)
    frames = [c for c in table.comments if c.startswith(POINT_FRAME)]
    tilted = frames[:1] not in ([], [f"{POINT_FRAME}{ODOM_FRAME}"])
    return _since_first(path.name, tracks, tilted=tilted)


def _rpy(path: Path, quaternion: Array) -> Array:
    """Roll, pitch, yaw (n, 3) of x y z w (n, 4); raises TableError unless their length is 1."""
    length = np.linalg.norm(quaternion, axis=1)
    if (off := np.abs(length - 1.0)).max() > LENGTH_ERROR:
        k = int(np.argmax(off))
        raise TableError(
            f"{path}: qx qy qz qw of sample {k} have the length {length[k]:.4g}, expected 1"
        )
    return rpy_of(matrix_of_quaternion(quaternion))


def _since_first(
    name: str,
    tracks: Mapping[str, PointTrack],
    notes: Sequence[str] = (),
    *,
    tilted: bool = False,
) -> PointRecording:
    """The recording with times since its first sample."""
    first = min(float(track.t[0]) for track in tracks.values())
    return PointRecording(
        name,
        {
            k: PointTrack(v.t - first, v.position, v.rpy)
            for k, v in tracks.items()
        },
        notes,
        tilted,
    )

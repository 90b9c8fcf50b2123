"""Recorded walk of a robot: tendon angles and motion of the torso, from a bag or a CSV file.

The CSV file (`csv_table.py`) has the columns

    time,FL,FR,RL,RR,x,y,z,roll,pitch,yaw

in s of one clock, rad and m: tendon angles, and the pose of base_link in odom, z up, with
R = Rz(yaw) Ry(pitch) Rx(roll). A row holds the angles, the pose or both; the other cells are empty.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.config import ConfigError
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
    path: Path, namespace: str = "", angles: str = "", motion: str = ""
) -> BagRecording:
    """Angles and motion of a bag, from the topics named or the first that are recorded, or of CSV.

    The angles of a CSV file are measured ones, unless `angles` names the topic of commands. Raises
    BagError or TableError if they are not there or not sound, ConfigError if they do not overlap or
    if a CSV file is given with a namespace or a topic of the motion.
    """
    if path.is_dir() or path.suffix in STORAGES:
        bag = Bag(path, namespace)
        found = BagRecording(
            path.name,
            tendon_angles(bag, *filter(None, [angles])),
            read_motion(bag, *([motion] if motion else MOTION_TOPICS)),
            stride_period(bag),
        )
    elif namespace or motion:
        raise ConfigError(f"{path}: --namespace and --motion are of bags")
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

"""Tabulated statics of a leg, `config/leg_map.csv`: reader and bilinear interpolation.

`scripts/tune leg` writes the file; `slot_lab.leg_tests.leg_map` defines its columns. A first line
`MADE_FOR` names the leg (`fingerprint.py`): the table of another leg is refused.

Legs as springs: normal force of a leg at rest over tendon angle and clamp height.

From the table `config/leg_map.csv` (`slot_lab.leg_tests.leg_map`), by bilinear interpolation.

Tendon angle and height set the shape of a leg, whatever its modulus E, so legs of another print
carry E / E_0 times the table's force F. With the weight m g, table's m_0 g, a robot at rest has

    sum_i F(theta_i, h_i) = m_0 g / kappa,      kappa = (E / E_0) / (m / m_0).

The tension of the tendons tells E / E_0 alone. Friction of the feet, between 0.1 and 0.8, alters
kappa by 4 % after standing up and by 17 % after the torso was lowered.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from slot_core import config
from slot_core.arrays import Array, checked
from slot_core.compiled import helper, kernel
from slot_core.elementary import cos, sin
from slot_core.legs.fingerprint import misfit
from slot_core.matrices import interpolated, invert
from slot_core.refusal import read_text
from slot_core.robot import RobotParameters, read_robot

FILE = "leg_map.csv"
MADE_FOR = "# made_for: "  # begins the line of a table that names its leg
SIZE_MAX = 10_000_000  # bytes of the file


@dataclass(frozen=True)
class LegTable:
    """Columns of the leg map on its grid of tendon angle and clamp height.

    Raises ValueError unless angles and heights are two or more, and rise, and the table is finite.
    """

    angle: Array  # (m,) rad, rising
    height: Array  # (n,) m, rising
    table: Array  # (m, n, requested columns)

    def __post_init__(self) -> None:
        grid = [
            checked("grid", values, (-1,))
            for values in (self.angle, self.height)
        ]
        checked("table", self.table, (*map(len, grid), -1))
        for values in grid:
            if len(values) < 2 or not (np.diff(values) > 0.0).all():
                raise ValueError(
                    "grid: expected two or more angles and heights that rise"
                )

    def at(self, angle: Array, height: Array) -> Array:
        """Columns (k, c) at angles (k,) rad and heights (k,) m, bilinear; outside: at the edge.

        NaN gives NaN. Raises ValueError for other shapes.
        """
        a = checked("angles", angle, (-1,), finite=False)
        h = checked("heights", height, a.shape, finite=False)
        columns = np.zeros((len(a), self.table.shape[2]))
        interpolate(self.angle, self.height, self.table, a, h, columns)
        return columns


def read_leg_table(columns: Sequence[str]) -> LegTable:
    """Columns of `config/leg_map.csv`.

    Raises ConfigError if it is missing, not a grid, or was made for another leg.
    """
    names = ("theta_deg", "height_m", *columns)
    try:
        lines = _lines()
        rows = [
            [float(row[name]) for name in names]
            for row in csv.DictReader(x for x in lines if x[:1] != "#")
        ]
        theta_deg, height, *values = np.array(sorted(rows)).T
        angles, heights = np.unique(theta_deg), np.unique(height)
        table = np.array(values).T.reshape(
            len(angles), len(heights), len(columns)
        )
        found = LegTable(
            np.radians(angles), heights, np.ascontiguousarray(table)
        )
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise config.ConfigError(
            f"{FILE}: no table of {names}: {error}"
        ) from None
    _require_own(_made_for(lines), read_robot())
    return found


def require_own_leg_map(robot: RobotParameters) -> str:
    """Remark on a `config/leg_map.csv` that does not name its leg, or "".

    Raises ConfigError for a table of another leg than the robot's.
    """
    return _require_own(leg_map_made_for(), robot)


def _require_own(made_for: Any, robot: RobotParameters) -> str:
    line = misfit(made_for, robot, FILE)
    if line and made_for is not None:
        raise config.ConfigError(line)
    return line


def leg_map_made_for() -> Any:
    """Fingerprint in `config/leg_map.csv`; None without one or without a file."""
    try:
        lines = _lines()
    except (OSError, ValueError):
        return None  # who reads the table says so
    return _made_for(lines)


def _made_for(lines: list[str]) -> Any:
    marked = [line for line in lines if line.startswith(MADE_FOR)]
    return config.parse(marked[0].removeprefix(MADE_FOR)) if marked else None


def _lines() -> list[str]:
    return read_text(config.config_dir() / FILE, SIZE_MAX).splitlines()


@kernel
def interpolate(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    angles, heights, table, angle, height, out
):
    """Rows (k, c) of a table (m, n, c) at k points, bilinear; outside: at the edge.

    angles (m,), heights (n,): the grid, rising; angle, height (k,): the points; out (k, c).
    """
    for k in range(len(angle)):
        i, p = _place(angles, angle[k])
        j, q = _place(heights, height[k])
        for c in range(out.shape[1]):
            low = (1 - q) * table[i, j, c] + q * table[i, j + 1, c]
            high = (1 - q) * table[i + 1, j, c] + q * table[i + 1, j + 1, c]
            out[k, c] = (1 - p) * low + p * high


@helper
def _place(grid, value):  # type: ignore[no-untyped-def]
    """Index of the cell of a rising grid that holds a value, and the share of its upper end.

    Below the grid the share is 0, above it 1.
    """
    inside = min(max(value, grid[0]), grid[-1])
    index = min(
        max(np.searchsorted(grid, inside, side="right") - 1, 0), len(grid) - 2
    )
    return index, (inside - grid[index]) / (grid[index + 1] - grid[index])


NO_LEAN = np.zeros(2)
STEPS = 60  # of Newton's method to the pose at rest, each at most STEP_MAX
STEP_MAX = 5e-3  # m
ROUNDING = 1e-9  # m, rad: it has converged
STIFFNESS_MIN = 30.0  # N/m of a leg, so that a leg that hangs cannot stop it
COLUMNS = ("force_N", "slope_N_per_rad", "stiffness_N_per_m", "contact_x_m")


class Springs(NamedTuple):
    """Statics of legs; every array has the shape of the angles they were evaluated at."""

    force: Array  # F, N
    slope: Array  # F_theta, N/rad
    stiffness: Array  # F_h, N/m, negative where the leg is stable
    contact: Array  # m, contact from the clamp, along the leg's azimuth


class LegSprings:
    """Table of F, F_theta, F_h and the place of contact; outside of it the values at its edge."""

    def __init__(self, table: LegTable, slope_min: float):
        """Take a table with `COLUMNS`; slope_min (N/rad): lower bound of F_theta, for the fold.

        Raises ValueError for a table with other columns.
        """
        checked("table", table.table, (-1, -1, len(COLUMNS)))
        self._table, self._slope_min = table, slope_min
        self.grid = table.angle, table.height, table.table
        self.at(np.zeros(1), np.zeros(1))  # compiles the kernel

    def at(self, angle: Array, height: Array, ratio: float = 1.0) -> Springs:
        """Statics at tendon angles (rad) and clamp heights (m) of one shape; raises ValueError.

        ratio: kappa, so that forces are those over m / m_0.
        """
        if np.shape(angle) != np.shape(height):
            raise ValueError(
                f"angles {np.shape(angle)}, heights {np.shape(height)}: not equal"
            )
        flat = self._table.at(np.ravel(angle), np.ravel(height))
        flat[:, :3] *= ratio
        flat[:, 1] = np.maximum(flat[:, 1], self._slope_min)
        flat[:, 2] = np.minimum(flat[:, 2], 0.0)
        return Springs(
            *(column.reshape(np.shape(angle)) for column in flat.T.copy())
        )

    def angle(self, force: Array, height: Array, ratio: float = 1.0) -> Array:
        """Tendon angles (n,) rad at which legs at heights (n,) m carry the forces (n,) N.

        The least such angle; beyond the table's largest force, its largest angle. Raises ValueError
        for other shapes.
        """
        angles, force = self._table.angle, checked("forces", force, (-1,))
        height = checked("heights", height, force.shape)
        turned, high = np.broadcast_arrays(angles, height[:, None])
        rising = np.maximum.accumulate(
            self.at(turned, high, ratio).force, axis=1
        )
        return np.array(
            [interpolated(f, row, angles) for f, row in zip(force, rising)]
        )

    def height(self, force: float, angle: float, ratio: float = 1.0) -> float:
        """Clamp height (m) at which a leg with a tendon angle (rad) carries a force (N)."""
        heights = self._table.height
        falling = np.minimum.accumulate(
            self.at(np.full(len(heights), angle), heights, ratio).force
        )
        return float(interpolated(-force, -falling, heights))


def drops(
    robot: RobotParameters, springs: LegSprings, angle: Array, pose: Array
) -> Array:
    """Feet below clamps (4,) m along the torso's z axis; arguments as of `stiffness_ratio`.

    A foot at x outward is lower by x times the leg's slope than its clamp.
    """
    place = robot.clamps, robot.outward, np.asarray(angle, dtype=float)
    drop, columns = np.empty(4), np.empty((4, len(COLUMNS)))
    _set_drops(*springs.grid, *place, np.array(pose, float), drop, columns)
    return drop


@kernel
def _set_drops(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    grid, heights, table, clamps, outward, angle, pose, drop, columns
):
    """Write `drops` to drop (4,), and the columns of the table there."""
    level = cos(pose[2])
    up_x, up_y, up_z = -sin(pose[2]), level * sin(pose[1]), level * cos(pose[1])
    for i in range(drop.size):
        clamp = pose[0] + up_x * clamps[i, 0] + up_y * clamps[i, 1]
        clamp += up_z * clamps[i, 2]
        slope = outward[i, 0] * up_x + outward[i, 1] * up_y
        drop[i] = clamp / up_z
        at, down, row = angle[i : i + 1], drop[i : i + 1], columns[i : i + 1]
        for _ in range(3):  # within 1 um
            interpolate(grid, heights, table, at, down, row)
            drop[i] = (clamp + columns[i, 3] * slope) / up_z
        interpolate(grid, heights, table, at, down, row)


def stiffness_ratio(
    robot: RobotParameters, springs: LegSprings, angle: Array, pose: Array
) -> float:
    """Ratio kappa at tendon angles (4,) rad and a pose (3,) height m, roll, pitch rad, at rest.

    Where the torso lies on the floor it is a lower bound; infinite if the legs carry nothing.
    """
    force = springs.at(angle, drops(robot, springs, angle, pose)).force.sum()
    return float(robot.weight / force) if force > 0.0 else np.inf


def rest_pose(
    robot: RobotParameters,
    springs: LegSprings,
    angle: Array,
    ratio: float = 1.0,
    lean: Array = NO_LEAN,
) -> Array:
    """Pose (3,) height m, roll, pitch rad above the floor at tendon angles (4,) rad, at rest.

    Forces and moments about the torso's centre are in balance: with W = m_0 g / kappa, its height h,
    the places p of the feet, and friction that carries it on a slope,

        sum F_i = W,    sum F_i p_y,i = -W h lean_y,    sum F_i p_x,i = -W h lean_x

    The torso is at least half its own height above the floor; there it lies flat.

    lean: (2,) x and y of the upward vertical in the floor's frame, at the torso's heading.
    """
    pose, lowest = np.array([0.06, 0.0, 0.0]), robot.torso.size[2] / 2
    place = robot.clamps, robot.outward, np.asarray(angle, dtype=float)
    shapes = (4,), (4, len(COLUMNS)), (3, 4), (3,), (3, 3), (3, 3)
    work = (np.empty(shape) for shape in shapes)
    _settle(*springs.grid, *place, robot.weight / ratio, lean, pose, *work)
    return pose if pose[0] > lowest else np.array([lowest, 0.0, 0.0])


@kernel
def _settle(  # type: ignore[no-untyped-def]  # noqa: PLR0917
    grid,
    heights,
    table,
    clamps,
    outward,
    angle,
    weight,
    lean,
    pose,
    drop,
    columns,
    lever,
    missing,
    matrix,
    inverse,
):
    """Move a pose (3,) to that of `rest_pose` by Newton's method; weight: m_0 g / kappa, N.

    Written too: drops (4,), columns (4, c), levers (3, 4), missing (3,), matrix and inverse (3, 3).
    """
    for _ in range(STEPS):
        _set_drops(
            grid, heights, table, clamps, outward, angle, pose, drop, columns
        )
        missing[:] = 0.0
        matrix[:] = 0.0
        for i in range(drop.size):
            lever[0, i] = 1.0  # force, M_x, M_y
            lever[1, i] = clamps[i, 1] + columns[i, 3] * outward[i, 1]
            lever[2, i] = -(clamps[i, 0] + columns[i, 3] * outward[i, 0])
            stiffness = max(-columns[i, 2], STIFFNESS_MIN)
            for row in range(3):
                missing[row] += lever[row, i] * columns[i, 0]
                for column in range(3):
                    part = lever[row, i] * stiffness * lever[column, i]
                    matrix[row, column] += part
        missing[0] -= weight
        missing[1] += weight * pose[0] * lean[1]
        missing[2] -= weight * pose[0] * lean[0]
        invert(matrix, inverse)
        size = 0.0
        for row in range(3):
            step = 0.0
            for column in range(3):
                step += inverse[row, column] * missing[column]
            lever[row, 0] = step
            size = max(size, abs(step))
        for row in range(3):
            pose[row] += lever[row, 0] / max(1.0, size / STEP_MAX)
        if size < ROUNDING:
            break


def legs_message(ratio: float, stiffness: float, mass: float) -> str:
    """One line on legs whose ratio kappa is not 1, or "".

    stiffness: E / E_0 by the servos' torque, NaN if they report none: then modulus and load cannot
    be distinguished. mass: m_0, kg.
    """
    if ratio == 1.0:
        return ""
    known = not np.isnan(stiffness)
    modulus = (stiffness if known else ratio) - 1.0
    load = mass * ((stiffness if known else 1.0) / ratio - 1.0)
    return (
        f"legs {abs(modulus):.0%} {'softer' if modulus < 0 else 'stiffer'} than the table,"
        f" {'' if known else 'or '}{abs(load):.1f} kg {'more' if load > 0 else 'less'} load"
    )


def read_leg_springs(slope_min: float) -> LegSprings:
    """The table of `config/leg_map.csv`; raises ConfigError if it is missing or not a grid."""
    return LegSprings(read_leg_table(COLUMNS), slope_min)

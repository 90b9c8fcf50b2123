"""Detection of slack and broken tendons, from servo torque and tendon angle.

The tabulated leg (`config/leg_map.csv`) says which torque tau_0(theta, h) holds a leg at tendon
angle theta with its clamp at height h. A tendon longer by s behaves like a spool turned back by
s / r, so to first order the mean over a stride of

    tau_0 - tau = (s / r) d tau_0 / d theta

gives s. The mean over a whole stride cancels what the statics leave out: inertia, damping and the
change of direction of the friction. A damaged tendon changes the load on its neighbours, so the leg
with the largest slack is named, and another leg only if its slack is a large share of that.

Legs of another print are softer or stiffer, all four alike: the table counts e = E / E_0 times, the
median of the legs' tau / tau_0 within `shared`. Legs softer than that, or three torn tendons, are
not explained by a print.

A payload, or a slope, shifts weight between the front and the rear legs, which the statics do not
hold: on the simulated walk with 1 kg the tendons seem 1.3 mm shorter in front and longer behind.
So what the front has in common against the rear, up to `slack_max`, counts for no leg. In a posture
the friction of the guides does not change its direction: where the legs of one diagonal were pulled
last and those of the other released, a friction of 0.3 makes 2.3 mm. So diagonals are taken alike.

The tables hold for a gait that is walked in time. Commands that come late hold legs back in a
stride: on a simulated walk with up to 0.2 s of delay the inferred slack of sound tendons reached
2.0 mm, against 0.5 mm. So the mean restarts when what the legs follow, or what they are compared
with, is older than `age_max`; until a whole stride was in time the slack is unknown.

While the robot slides, at twice the speed of its walk, dragged legs are loaded otherwise: the supervisor
gives no heights then.

Not detected: a tendon at an angle that needs hardly any tension (below some 20 deg), and a leg
lifted by hand while the torso stays at its standing height.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.legs.leg_table import LegTable, read_leg_table
from slot_core.matrices import product
from slot_core.robot import LEGS, RobotParameters
from slot_core.safety.motion_watch import MovingWindow
from slot_core.safety.settings import TendonLimits

TORQUE_MIN = 0.1  # N m, to divide by
# front against rear, and one diagonal against the other, in the order of LEGS
SHIFTS = np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
STILL = 0.3  # N m, extent of the expected torques: in a posture to 0.13, in a walk above 1


class TendonLoad:
    """Static torque of a leg and its slope, bilinear in tendon angle and clamp height."""

    def __init__(self, statics: LegTable, spool_radius: float):
        """`statics` with the one column of tension (N)."""
        torque = statics.table[..., 0] * spool_radius
        slope = np.gradient(torque, statics.angle, axis=0)
        self._table = replace(statics, table=np.stack([torque, slope], axis=-1))
        self(np.zeros(1), np.zeros(1))  # compiles the kernel

    def __call__(self, angle: Array, height: Array) -> tuple[Array, Array]:
        """N m and N m/rad at angles (n,), rad, and heights (n,), m; clipped to the table."""
        columns = self._table.at(angle, height)
        return columns[:, 0], columns[:, 1]


@dataclass(frozen=True)
class TendonReport:
    """Result of the last stride; legs in the order of LEGS."""

    slack: Array  # (4,) m, NaN before the first stride
    damaged: NDArray[np.bool_]  # (4,) since the last reset
    message: str  # one line that names the damaged legs, or ""
    stiffness: float  # e of all four legs, NaN before the first stride


class TendonWatch:
    """Means over a stride of measured and tabulated torques, and the alarms from them."""

    def __init__(
        self, load: TendonLoad, spool_radius: float, limits: TendonLimits
    ):
        self._load, self._radius, self._limits = load, spool_radius, limits
        # of both torques and the slope
        self._window = MovingWindow(3, len(LEGS))
        self.reset()

    def reset(self) -> None:
        """Discard all readings and alarms."""
        self._damaged = np.zeros(len(LEGS), dtype=bool)
        self._named: dict[str, float] = {}  # m, slack of a leg at its alarm
        self.pause()

    def pause(self) -> None:
        """Discard the readings, but not the alarms."""
        self._window.clear()
        self._slack = np.full(len(LEGS), np.nan)
        self._stiffness = np.nan
        # m s, sum of the slack beyond its limit
        self._excess = np.zeros(len(LEGS))

    def observe(
        self,
        stamp: int,
        angle: Array,
        torque: Array,
        height: Array,
        stride: float,
        *,
        age: float = 0.0,
    ) -> TendonReport:
        """Take a reading of the servos at `stamp` (ns): (4,) rad, (4,) N m, clamps at (4,) m.

        `stride` (s) is the period of the gait, `age` (s) the age of the oldest of reading, estimate
        and command. Readings that are not finite or not newer than the last are ignored.
        """
        if age > self._limits.age_max:
            self.pause()
            return self.state
        values, newest = (
            np.array([angle, torque, height], dtype=np.float64),
            self._window.newest,
        )
        if not np.isfinite(values).all() or (
            newest is not None and stamp <= newest
        ):
            return self.state
        elapsed = 0.0 if newest is None else to_seconds(stamp - newest)
        if elapsed > self._limits.sample_gap:
            self.pause()
        expected, slope = self._load(values[0], values[2])
        if self._window.add(
            stamp,
            np.array([expected, values[1], slope]),
            max(stride, self._limits.window_min),
        ):
            self._evaluate(elapsed)
        return self.state

    @property
    def state(self) -> TendonReport:
        """Slack and alarms at present."""
        return TendonReport(
            self._slack.copy(),
            self._damaged.copy(),
            self._message(),
            self._stiffness,
        )

    def _evaluate(self, elapsed: float) -> None:
        """Compute the slack from the means; sum its excess over `elapsed` (s), set the alarms."""
        rows, limits = self._window.rows(), self._limits
        expected, torque, slope = rows.sum(axis=0) / len(rows)
        shares = torque / np.maximum(expected, TORQUE_MIN)
        _, low, high, _ = sorted(shares.tolist())
        self._stiffness = sorted((*limits.shared, (low + high) / 2))[1]
        slope = np.maximum(self._stiffness * slope, limits.stiffness_min)
        self._slack = (
            self._radius * (self._stiffness * expected - torque) / slope
        )
        load, limit = rows[:, 0], limits.slack_max
        extent = (load.max(axis=0) - load.min(axis=0)).max()
        shifts = SHIFTS[: 1 + bool(extent < STILL)]
        shift = np.minimum(
            np.maximum(product(shifts, self._slack) / len(LEGS), -limit), limit
        )
        beyond = self._slack - product(shift, shifts)
        self._excess = np.maximum(
            self._excess + elapsed * (beyond - limit), 0.0
        )
        over = self._excess >= limits.excess_max
        if not over.any():
            return
        damaged = over & (self._slack >= limits.share * self._slack.max())
        damaged &= np.logical_not(limits.broken)
        for leg in np.flatnonzero(damaged & ~self._damaged):
            self._named[LEGS[leg]] = float(beyond[leg])
        self._damaged = self._damaged | damaged

    def _message(self) -> str:
        """One line with legs, values and limit, or ""."""
        if not self._named:
            return ""
        legs = ", ".join(
            f"{leg} ({1e3 * slack:.1f} mm)"
            for leg, slack in self._named.items()
        )
        return (
            f"slack or broken tendon {legs}, limit"
            f" {1e3 * self._limits.slack_max:.1f} mm"
        )


def read_tendon_watch(
    robot: RobotParameters, limits: TendonLimits
) -> TendonWatch:
    """The watch of the robot's tendons; raises ConfigError without `config/leg_map.csv`."""
    radius = robot.tendon.spool_radius
    return TendonWatch(
        TendonLoad(read_leg_table(("tension_N",)), radius), radius, limits
    )

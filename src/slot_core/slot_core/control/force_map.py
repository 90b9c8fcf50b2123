"""Force map: the tendon angles of a plan, from its forces where it has no angles.

    theta = theta_gait + (f_z - f_gait) / F_theta

theta_gait and f_gait are the gait's nominal angle and normal force, F_theta the slope of a leg at
rest at that angle and its present height (`legs/leg_table.py`); that the leg is a spring is
neglected. Until the next command the angle goes on at the rate of theta_gait. A planned angle is
passed on.

An angle is that of its tick. The IMU sample that leads to the tick comes up to a period of the IMU
later, now more, now less; so the angle is moved on at its rate by that time. Without it .3 kg that
are put on off the centre cost the walk 7.7 mm of its place instead of 4.4. All angles are clipped to
[0, angle_max].
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core import config
from slot_core.arrays import Array, checked
from slot_core.clock import to_seconds
from slot_core.config import quantity
from slot_core.control.policy import Status, TendonPlan
from slot_core.gait.gait import GaitPreview
from slot_core.key_frame import StateParts
from slot_core.legs.leg_table import LegSprings, read_leg_springs
from slot_core.refusal import quoted
from slot_core.robot import LEGS, RobotParameters

INCREMENTAL = "incremental"
PLANNED, HELD = "planned", "hold"  # names where no map is applied


@dataclass(frozen=True)
class ForceMapSettings:
    """Settings of `config/force_map.yaml`."""

    slope_min: float = quantity(
        "least slope of a leg's force over its angle", "N/rad", 0.1, 100
    )
    correction_max_deg: float = quantity(
        "largest correction of the gait's angle", "deg", 0, 120
    )


@dataclass(frozen=True)
class TendonCommand:
    """Tendon angles of the four legs, with the forces and slopes behind them."""

    map: str  # of the plan, or PLANNED, HELD
    angle: Array  # (4,) rad, within [0, angle_max]
    force: Array  # (4,) N, f_z of the plan
    slope: Array  # (4,) N/rad, zero without a map
    angle_unclamped: Array  # (4,) rad, before the limits
    saturated: NDArray[np.bool_]  # (4,) whether the limits changed the angle
    rate: Array  # (4,) rad/s, at which the driver extrapolates the angle


class ForceMap:
    """Computes tendon angles from the plans of a policy and the gait's nominal angles."""

    STATE = StateParts("_last")

    def __init__(
        self,
        robot: RobotParameters,
        settings: ForceMapSettings,
        springs: LegSprings,
        delay: float = 0.0,
    ):
        """`delay`: s, by which states are predicted beyond the newest IMU sample."""
        self._robot, self._settings, self._springs = robot, settings, springs
        self._delay = delay
        self._last: Array | None = None

    def step(
        self,
        plan: TendonPlan,
        preview: GaitPreview,
        state: Array,
        lead: int = 0,
    ) -> TendonCommand:
        """Command of a plan for the preview and state (12,) of its stamp.

        lead: ns, from the stamp to the time of the state.

        On STOPPED the last angles are held. Raises ValueError for an unknown map, and for forces,
        angles or a state of another shape.
        """
        if plan.status == Status.STOPPED:
            return self._hold(preview)
        count = len(LEGS)
        if not len(checked("force", plan.force, (-1, count, 3), finite=False)):
            raise ValueError("force: no stages")
        checked("angle", plan.angle, (-1, count), finite=False)
        checked("rate", plan.rate, (count,), finite=False)
        checked("state", state, (12,), finite=False)
        normal = plan.force[0, :, 2]
        if len(plan.angle):
            angle, slope, rate = plan.angle[0], np.zeros(count), plan.rate
        elif plan.map == INCREMENTAL:
            angle, slope = self._incremental(normal, preview, state)
            rate = preview.rate
        else:
            raise ValueError(f"map {quoted(plan.map)}: expected {INCREMENTAL}")
        late = min(max(to_seconds(lead) - self._delay, 0.0), preview.dt)
        angle = angle + late * rate
        self._last = clipped = self._clip(angle)
        return TendonCommand(
            map=plan.map or PLANNED,
            angle=clipped,
            force=normal,
            slope=slope,
            angle_unclamped=angle,
            saturated=clipped != angle,
            rate=rate,
        )

    def _incremental(
        self, normal: Array, preview: GaitPreview, state: Array
    ) -> tuple[Array, Array]:
        """Angle and slope for normal forces (4,) N."""
        nominal = preview.tendon_angle[0]
        height = self._robot.clamp_heights(state[5], *state[:2])
        slope = self._springs.at(nominal, height, preview.leg_stiffness).slope
        limit = np.radians(self._settings.correction_max_deg)
        correction = np.clip(
            (normal - preview.normal_force[0]) / slope, -limit, limit
        )
        return nominal + correction, slope

    def _hold(self, preview: GaitPreview) -> TendonCommand:
        """The last angles; before the first of them, the nominal angles of the preview."""
        nominal, zeros = preview.tendon_angle[0], np.zeros(len(LEGS))
        angle = self._clip(nominal) if self._last is None else self._last
        return TendonCommand(
            HELD, angle, zeros, zeros, angle, zeros.astype(bool), zeros
        )

    def _clip(self, angle: Array) -> Array:
        return np.clip(angle, 0.0, self._robot.tendon.angle_max)


def read_force_map() -> ForceMapSettings:
    """The settings of `config/force_map.yaml`; raises ConfigError."""
    return config.read(ForceMapSettings, "force_map")


def read_springs() -> LegSprings:
    """Legs as springs with the map's `slope_min`, for MPC and gait alike; raises ConfigError."""
    return read_leg_springs(read_force_map().slope_min)


def make_force_map(
    robot: RobotParameters, settings: ForceMapSettings, delay: float
) -> ForceMap:
    """The map with the table of `config/leg_map.csv`; raises ConfigError.

    delay: `command_delay` of the state estimator, s.
    """
    return ForceMap(
        robot, settings, read_leg_springs(settings.slope_min), delay
    )

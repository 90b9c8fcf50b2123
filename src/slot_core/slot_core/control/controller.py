"""Complete controller in one process: the nodes from `/odom` to the tendon angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from slot_core.estimation.state_estimator import Estimate, StateEstimator, read_estimator
from slot_core.gait.gait import GaitPreview, GaitSettings, read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.gait.route import Path
from slot_core.mpc.force_map import (
    ForceMap,
    Nominal,
    TendonCommand,
    make_force_map,
    read_force_map,
    read_springs,
)
from slot_core.mpc.mpc import Mpc, MpcResult, MpcSettings, Status
from slot_core.robot import Array, Robot


@dataclass(frozen=True)
class Tick:
    """Results of all steps of the controller for one odometry reading."""

    estimate: Estimate
    preview: GaitPreview
    result: MpcResult
    command: TendonCommand


class Controller:
    """State estimator, gait scheduler, MPC and force map, in sequence."""

    def __init__(  # noqa: PLR0917
        self,
        robot: Robot,
        mpc: MpcSettings,
        timer: Callable[[], float],
        gait: str,
        velocity: Array | None,
        path: Path | None = None,
        *,
        gaits: GaitSettings | None = None,
    ):
        """Build the steps from `config/*.yaml`; raises ConfigError as they do.

        timer: returns seconds, for the MPC's time budget. velocity: (3,) m/s, m/s, rad/s, or None
        for the gait's `cruise`. path: followed by a stride instead. gaits: other than those of the
        configuration.
        """
        self.estimator = StateEstimator(read_estimator())
        self.scheduler = GaitScheduler(
            gaits or read_gaits(), robot, read_springs(), gait, velocity, path
        )
        self.mpc = Mpc(robot, mpc, timer)
        self.force_map = make_force_map(robot, read_force_map(), mpc.map)

    def poll(self) -> Tick | None:
        """Process the estimator's next estimate; None if none is ready."""
        estimate = self.estimator.poll()
        if estimate is None:
            return None
        preview = self.scheduler.step(estimate.time, estimate.state)
        preview = replace(preview, stamp=estimate.stamp)  # that of the tick
        result = self.mpc.step(estimate.state, preview)
        nominal = self.force_map.nominal(preview, estimate.state)
        command = command_for(self.force_map, result.force, result.status, preview, nominal)
        return Tick(estimate, preview, result, command)


def command_for(
    force_map: ForceMap, force: Array, status: Status | int, preview: GaitPreview, nominal: Nominal
) -> TendonCommand:
    """Tendon command for the MPC's forces (4, 3) N; on STOPPED the last angles are held."""
    if status == Status.STOPPED:
        return force_map.hold(preview)
    return force_map.step(force, nominal)

"""The whole controller in one process: what the nodes do between `/odom` and the tendon angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from slot_core.control.force_map import ForceMap, TendonCommand, read_force_map, read_leg_slope
from slot_core.control.gait import GaitPreview, GaitScheduler, read_gaits
from slot_core.control.mpc.mpc import Mpc, MpcResult, MpcSettings, Status
from slot_core.control.state_estimator import Estimate, StateEstimator, read_estimator
from slot_core.robot import Array, Robot


@dataclass(frozen=True)
class Tick:
    """What every stage made of one odometry reading."""

    estimate: Estimate
    preview: GaitPreview
    result: MpcResult
    command: TendonCommand


class Controller:
    """State estimator, gait scheduler, MPC and force map, one after the other."""

    def __init__(
        self,
        robot: Robot,
        mpc: MpcSettings,
        timer: Callable[[], float],
        gait: str,
        velocity: Array | None,
    ):
        """Configuration from `config/*.yaml`; raises ConfigError as the stages do."""
        self.estimator = StateEstimator(read_estimator())
        self.scheduler = GaitScheduler(read_gaits(), gait, velocity)
        self.mpc = Mpc(robot, mpc, timer)
        self.force_map = ForceMap(robot, read_force_map(), read_leg_slope())

    def poll(self) -> Tick | None:
        """Answer the next odometry reading that the estimator has, or None."""
        estimate = self.estimator.poll()
        if estimate is None:
            return None
        preview = self.scheduler.step(estimate.stamp, estimate.state)
        result = self.mpc.step(estimate.state, preview)
        slope = self.force_map.slope(preview, estimate.state)
        command = command_for(self.force_map, result.force, result.status, preview, slope)
        return Tick(estimate, preview, result, command)


def command_for(
    force_map: ForceMap, force: Array, status: Status | int, preview: GaitPreview, slope: Array
) -> TendonCommand:
    """Angles for the MPC's forces; once it has stopped, the last angles stay."""
    if status == Status.STOPPED:
        return force_map.hold(preview)
    return force_map.step(force, preview, slope)

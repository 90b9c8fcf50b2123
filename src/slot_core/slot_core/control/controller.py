"""Complete controller in one process: the nodes from `/odom` to the tendon angles."""

from dataclasses import dataclass, replace

from slot_core.arrays import Array
from slot_core.control.force_map import (
    TendonCommand,
    make_force_map,
    read_force_map,
    read_springs,
)
from slot_core.control.policy import Policy, TendonPlan
from slot_core.estimation.estimate import Estimate
from slot_core.estimation.inertial_filter import EstimatorSettings
from slot_core.estimation.state_estimator import read_estimator
from slot_core.estimation.unaided_estimator import make_estimator
from slot_core.gait.gait import GaitPreview, GaitSettings, read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.gait.route import Route
from slot_core.robot import RobotParameters


@dataclass(frozen=True)
class Tick:
    """Results of all steps of the controller for one odometry reading."""

    estimate: Estimate
    preview: GaitPreview
    plan: TendonPlan
    command: TendonCommand


class Controller:
    """State estimator, gait scheduler, policy and force map, in sequence."""

    def __init__(  # noqa: PLR0917
        self,
        robot: RobotParameters,
        policy: Policy,
        gait: str,
        velocity: Array | None,
        path: Route | None = None,
        gaits: GaitSettings | None = None,
        estimator: EstimatorSettings | None = None,
    ):
        """Build the steps from `config/*.yaml`; raises ConfigError as they do.

        velocity: (3,) m/s, m/s, rad/s, or None for the gait's `cruise`. path: followed by a stride
        instead. gaits, estimator: in place of the configured ones.
        """
        springs, estimator = read_springs(), estimator or read_estimator()
        self.estimator = make_estimator(estimator, robot, springs)
        self.scheduler = GaitScheduler(
            gaits or read_gaits(), robot, springs, gait, velocity, path
        )
        self.policy = policy
        self.force_map = make_force_map(
            robot, read_force_map(), estimator.timing.command_delay
        )

    def poll(self) -> Tick | None:
        """Process the estimator's next estimate; None if none is ready."""
        estimate = self.estimator.poll()
        if estimate is None:
            return None
        preview = self.scheduler.step(
            estimate.time, estimate.state, estimate.leg_stiffness
        )
        preview = replace(preview, stamp=estimate.stamp)  # of the tick
        plan = self.policy.step(estimate, preview)
        command = self.force_map.step(
            plan, preview, estimate.state, estimate.lead
        )
        self.policy.prepare()
        return Tick(estimate, preview, plan, command)

"""`/mpc_state` and `/gait_preview` to `/tendon_plan`.

The settings of the policy are parameters that can be set while the robot stands; every plan names
those that were changed.
"""

import time
from copy import copy
from functools import partial

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from slot_core import config
from slot_core.control.effort import EffortChoice
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.control.policy import Status, TunedPolicy, policy_class
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.robot import read_robot
from slot_msgs.msg import GaitPreview, MpcState, TendonPlan
from slot_nodes import inputs, messages, qos, runtime, stage_record
from slot_nodes.pace import Pace

PREPARE_AFTER = 0.004  # s after a plan: by then its command is with the servos


class MpcControllerNode(Node):
    """Runs the policy on the newest state and its preview; skips older states."""

    def __init__(self) -> None:
        super().__init__("mpc_controller")
        name = runtime.declare(
            self,
            "policy",
            DEFAULT_POLICY,
            "policy by its name, a Python file with one, or onnx:FILE",
        )
        kind = policy_class(name)
        settings = runtime.declare_settings(
            self, kind.read_settings(name), read_only=False
        )
        simulated = self.get_parameter("use_sim_time").value
        # a plan takes no simulated time
        timer = (lambda: 0.0) if simulated else time.perf_counter
        robot = read_robot()
        self._policy = TunedPolicy(
            lambda settings: kind(robot, settings, timer), settings
        )
        self._record = stage_record.Recorder(self, self._policy)
        # where the clock waits for a plan, time does not run short
        self._effort = None if simulated else EffortChoice()
        self._names = {setting for setting, _, _ in config.leaves(settings)}
        self._pace, self._stamp = Pace(), 0
        self._preparation = runtime.wall_timer(
            self, PREPARE_AFTER, self._prepare
        )
        self._preparation.cancel()
        self._inputs = inputs.TimeSynchronizer("state", "preview")
        self._plans = runtime.publisher(
            self, TendonPlan, "tendon_plan", qos.CONTROL
        )
        inputs.subscribe(
            self,
            MpcState,
            "mpc_state",
            self._on_state,
            qos.STATE,
            numbered=True,
        )
        inputs.subscribe(
            self, GaitPreview, "gait_preview", self._on_preview, qos.STATE
        )
        self.add_on_set_parameters_callback(self._on_parameters)

    def _on_parameters(
        self, parameters: list[Parameter]
    ) -> SetParametersResult:
        """Change settings of the policy, or say why not."""
        given = {
            p.name: runtime.plain_value(p.value)
            for p in parameters
            if p.name in self._names
        }
        try:
            if given:
                self._policy.change(given)
                self.get_logger().info(f"changed: {given}")
        except config.ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_state(self, message: MpcState, number: int) -> None:
        estimate = decode.estimate(message)
        self._step(
            self._inputs.add("state", estimate.stamp, (number, estimate))
        )

    def _on_preview(self, message: GaitPreview) -> None:
        preview = decode.preview(message)
        self._step(self._inputs.add("preview", preview.stamp, preview))

    def _step(self, matched: tuple | None) -> None:
        if matched is None:
            return
        (number, estimate), preview = matched
        if estimate.stamp < self._stamp:
            self._policy.reset()
        self._stamp, start = estimate.stamp, time.perf_counter()
        self._policy.prepare()  # unless it has: a replay does so too
        plan = self._policy.step(estimate, preview)
        elapsed = time.perf_counter() - start
        self._pace.add(number, elapsed, preview.dt)
        self._plans.publish(
            Carried(
                preview.stamp,
                (preview.stamp, plan),
                partial(
                    messages.plan_to_msg,
                    plan,
                    preview,
                    elapsed,
                    copy(self._pace),
                    self._policy.changes,
                ),
                status=int(plan.status),
                fallback_cycles=plan.fallback_cycles,
                period=preview.period,
                velocity=preview.velocity_ahead[0],
                remark=preview.remark,
            )
        )
        if self._effort is not None:
            self._policy.use_effort(self._effort.add(elapsed, preview.dt))
        self._record.put(estimate.stamp)
        self._preparation.reset()
        if plan.status != Status.SOLVED:
            self.get_logger().warning(
                f"{plan.status.name}, fallback cycle {plan.fallback_cycles}: {plan.message}",
                throttle_duration_sec=1.0,
            )

    def _prepare(self) -> None:
        self._preparation.cancel()
        self._policy.prepare()

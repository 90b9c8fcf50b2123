"""`/tendon_plan` to `/desired_joint_angles`."""

from functools import partial

from rclpy.node import Node
from sensor_msgs.msg import JointState

from slot_core.control.force_map import make_force_map, read_force_map
from slot_core.estimation.state_estimator import read_estimator
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.robot import LEGS, read_robot
from slot_msgs.msg import ForceMapStatus, GaitPreview, MpcState, TendonPlan
from slot_nodes import inputs, messages, qos, runtime, stage_record


class ForceMapperNode(Node):
    """Checks and clips the angles of a plan; makes them of its forces where it has none.

    It commands when plan, preview and state of one stamp have been received.
    """

    def __init__(self) -> None:
        super().__init__("force_mapper")
        settings = runtime.declare_settings(self, read_force_map())
        self._map = make_force_map(
            read_robot(), settings, read_estimator().timing.command_delay
        )
        self._record = stage_record.Recorder(self, self._map)
        self._inputs = inputs.TimeSynchronizer("plan", "preview", "state")
        self._angles = runtime.publisher(
            self, JointState, "desired_joint_angles", qos.CONTROL
        )
        self._status = runtime.publisher(
            self, ForceMapStatus, "force_map/status", qos.CONTROL
        )
        # they come before their plan
        self._polled = inputs.PassiveSubscriptions(self)
        self._polled.subscribe(
            MpcState, "mpc_state", self._on_state, qos.CONTROL
        )
        self._polled.subscribe(
            GaitPreview, "gait_preview", self._on_preview, qos.CONTROL
        )
        inputs.subscribe(
            self, TendonPlan, "tendon_plan", self._on_plan, qos.CONTROL
        )

    def _on_state(self, message: MpcState) -> None:
        estimate = decode.estimate(message)
        inputs.require_finite("state", estimate.state)
        self._command(
            estimate.stamp,
            self._inputs.add("state", estimate.stamp, estimate),
        )

    def _on_preview(self, message: GaitPreview) -> None:
        preview = decode.preview(message)
        inputs.require_nominal(preview)
        self._command(
            preview.stamp, self._inputs.add("preview", preview.stamp, preview)
        )

    def _on_plan(self, message: TendonPlan) -> None:
        stamp, plan = decode.plan(message)
        for name in ("angle", "rate", "force"):
            inputs.require_finite(name, getattr(plan, name))
        self._polled.take()
        self._command(stamp, self._inputs.add("plan", stamp, plan))

    def _command(self, stamp: int, matched: tuple | None) -> None:
        self._polled.wake_on_message(matched is None)
        if matched is None:
            return
        plan, preview, estimate = matched
        command = self._map.step(plan, preview, estimate.state, estimate.lead)
        given = stamp, command.angle, command.rate
        self._angles.publish(
            Carried(stamp, given, partial(messages.command_to_msg, *given))
        )
        self._record.put(stamp)
        self._status.publish(
            Carried(
                stamp, None, partial(messages.map_status_to_msg, stamp, command)
            )
        )
        if command.saturated.any():
            legs = ", ".join(
                leg for leg, hit in zip(LEGS, command.saturated) if hit
            )
            self.get_logger().info(
                f"tendon angle at its limit: {legs}", throttle_duration_sec=5.0
            )

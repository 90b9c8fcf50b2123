"""Ground reaction forces to `/desired_joint_angles`, about the nominal angles of the gait."""

from rclpy.node import Node
from sensor_msgs.msg import JointState

from slot_core.control.controller import command_for
from slot_core.estimation.time_synchronizer import TimeSynchronizer
from slot_core.messages import decode
from slot_core.mpc.force_map import make_force_map, read_force_map
from slot_core.mpc.mpc import DEFAULT_PROFILE, read_mpc
from slot_core.robot import LEGS, read_robot
from slot_msgs.msg import ForceMapStatus, GaitPreview, GroundReactionForces, MpcState
from slot_nodes import inputs, messages, qos, runtime


class ForceMapperNode(Node):
    """Maps the forces when forces, preview and state of one stamp have been received."""

    def __init__(self) -> None:
        super().__init__("force_mapper")
        profile = runtime.declare(
            self, "profile", DEFAULT_PROFILE, "profile of the MPC, which names the map"
        )
        settings = runtime.declare_settings(self, read_force_map())
        self._map = make_force_map(read_robot(), settings, read_mpc(profile).map)
        self._nominal = TimeSynchronizer("preview", "state")
        self._inputs = TimeSynchronizer("forces", "nominal")
        self._angles = runtime.publisher(self, JointState, "desired_joint_angles", qos.CONTROL)
        self._status = runtime.publisher(self, ForceMapStatus, "force_map/status", qos.CONTROL)
        inputs.subscribe(self, MpcState, "mpc_state", self._on_state, qos.CONTROL)
        inputs.subscribe(self, GaitPreview, "gait_preview", self._on_preview, qos.CONTROL)
        inputs.subscribe(
            self, GroundReactionForces, "ground_reaction_forces", self._on_forces, qos.CONTROL
        )

    def _on_state(self, message: MpcState) -> None:
        stamp, state, _ = decode.state(message)
        inputs.require_finite("state", state)
        self._prepare(stamp, self._nominal.add("state", stamp, state))

    def _on_preview(self, message: GaitPreview) -> None:
        preview = decode.preview(message)
        inputs.require_nominal(preview)
        self._prepare(preview.stamp, self._nominal.add("preview", preview.stamp, preview))

    def _on_forces(self, message: GroundReactionForces) -> None:
        stamp, *forces = decode.forces(message)
        inputs.require_finite("force", forces[0])
        self._command(stamp, self._inputs.add("forces", stamp, forces))

    def _prepare(self, stamp: int, matched: tuple | None) -> None:
        """Evaluate the legs before the forces arrive, which are last."""
        if matched is None:
            return
        preview, state = matched
        nominal = preview, self._map.nominal(preview, state)
        self._command(stamp, self._inputs.add("nominal", stamp, nominal))

    def _command(self, stamp: int, matched: tuple | None) -> None:
        if matched is None:
            return
        (force, status), nominal = matched
        command = command_for(self._map, force, status, *nominal)
        self._angles.publish(messages.command_to_msg(stamp, command.angle, command.rate))
        self._status.publish(messages.map_status_to_msg(stamp, command))
        if command.saturated.any():
            legs = ", ".join(leg for leg, hit in zip(LEGS, command.saturated) if hit)
            self.get_logger().info(f"tendon angle at its limit: {legs}", throttle_duration_sec=5.0)


def main() -> None:
    """Entry point of the node."""
    runtime.run(ForceMapperNode)

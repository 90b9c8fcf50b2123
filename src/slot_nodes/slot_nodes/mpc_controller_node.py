"""`/mpc_state` and the gait preview to ground reaction forces."""

import time

from rclpy.node import Node

from slot_core import decode
from slot_core.control.mpc import DEFAULT, Mpc, Status, read_mpc
from slot_core.robot import read_robot
from slot_msgs.msg import GaitPreview, GroundReactionForces, MpcState
from slot_nodes import inputs, messages, qos, runtime
from slot_nodes.rendezvous import Rendezvous


class MpcControllerNode(Node):
    """Solves the MPC once for every state and preview of one stamp."""

    def __init__(self) -> None:
        super().__init__("mpc_controller")
        profile = runtime.declare(self, "profile", DEFAULT, "a file of config/mpc, or the default")
        settings = runtime.declare_settings(self, read_mpc(profile))
        self._mpc = Mpc(read_robot(), settings, time.perf_counter)
        self._inputs = Rendezvous("state", "preview")
        self._forces = self.create_publisher(
            GroundReactionForces, "ground_reaction_forces", qos.CONTROL
        )
        self.create_subscription(MpcState, "mpc_state", self._on_state, qos.CONTROL)
        inputs.subscribe(self, GaitPreview, "gait_preview", self._on_preview, qos.CONTROL)

    def _on_state(self, message: MpcState) -> None:
        stamp, *state = decode.state(message)
        self._solve(stamp, self._inputs.add("state", stamp, state))

    def _on_preview(self, message: GaitPreview) -> None:
        preview = decode.preview(message)
        self._solve(preview.stamp, self._inputs.add("preview", preview.stamp, preview))

    def _solve(self, stamp: int, inputs: tuple | None) -> None:
        if inputs is None:
            return
        (state, _), preview = inputs
        result = self._mpc.step(state, preview)
        self._forces.publish(messages.forces_to_msg(stamp, result))
        if result.status != Status.SOLVED:
            self.get_logger().warning(
                f"{result.status.name}, fallback cycle {result.fallback_cycles}: {result.message}",
                throttle_duration_sec=1.0,
            )


def main() -> None:
    """Entry point of the node."""
    runtime.run(MpcControllerNode)

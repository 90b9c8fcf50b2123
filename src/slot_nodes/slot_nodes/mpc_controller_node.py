"""`/mpc_state` and `/gait_preview` to `/ground_reaction_forces`."""

import time

from rclpy.node import Node

from slot_core.control.pace import Pace
from slot_core.estimation.time_synchronizer import TimeSynchronizer
from slot_core.messages import decode
from slot_core.mpc.mpc import DEFAULT_PROFILE, Mpc, Status, read_mpc
from slot_core.robot import read_robot
from slot_msgs.msg import GaitPreview, GroundReactionForces, MpcState
from slot_nodes import inputs, messages, qos, runtime


class MpcControllerNode(Node):
    """Solves the MPC for the newest state and its preview; skips older states."""

    def __init__(self) -> None:
        super().__init__("mpc_controller")
        profile = runtime.declare(
            self, "profile", DEFAULT_PROFILE, "a file of config/mpc, or the default"
        )
        settings = runtime.declare_settings(self, read_mpc(profile))
        self._mpc = Mpc(read_robot(), settings, time.perf_counter)
        self._pace = Pace()
        self._inputs = TimeSynchronizer("state", "preview")
        self._forces = runtime.publisher(
            self, GroundReactionForces, "ground_reaction_forces", qos.CONTROL
        )
        inputs.subscribe(self, MpcState, "mpc_state", self._on_state, qos.STATE, numbered=True)
        inputs.subscribe(self, GaitPreview, "gait_preview", self._on_preview, qos.STATE)

    def _on_state(self, message: MpcState, number: int) -> None:
        stamp, state, _ = decode.state(message)
        self._solve(stamp, self._inputs.add("state", stamp, (number, state)))

    def _on_preview(self, message: GaitPreview) -> None:
        preview = decode.preview(message)
        self._solve(preview.stamp, self._inputs.add("preview", preview.stamp, preview))

    def _solve(self, stamp: int, matched: tuple | None) -> None:
        if matched is None:
            return
        (number, state), preview = matched
        result = self._mpc.step(state, preview)
        self._pace.add(number, result.solve_time, preview.dt)
        self._forces.publish(messages.forces_to_msg(stamp, result, preview.period, self._pace))
        if result.status != Status.SOLVED:
            self.get_logger().warning(
                f"{result.status.name}, fallback cycle {result.fallback_cycles}: {result.message}",
                throttle_duration_sec=1.0,
            )


def main() -> None:
    """Entry point of the node."""
    runtime.run(MpcControllerNode)

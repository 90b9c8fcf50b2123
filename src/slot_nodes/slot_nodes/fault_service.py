"""Service that injects faults into the simulated robot, and the file of a diverged simulation."""

from datetime import datetime
from functools import partial
from pathlib import Path

from rclpy.node import Node

from slot_core.messages import decode
from slot_core.refusal import DivergenceError
from slot_core.simulation.plant import RobotSimulator
from slot_msgs.srv import InjectFault


def serve(node: Node, plant: RobotSimulator) -> None:
    """Create the service `~/inject` for a simulated robot."""
    node.create_service(InjectFault, "~/inject", partial(_inject, node, plant))


def _inject(
    node: Node,
    plant: RobotSimulator,
    request: InjectFault.Request,
    response: InjectFault.Response,
) -> InjectFault.Response:
    try:
        if request.clear:
            plant.faults.clear(request.kind, request.leg)
        else:
            plant.faults.inject(decode.fault(request))
    except ValueError as error:
        response.message = str(error)
        return response
    done = "cleared" if request.clear else "injected"
    node.get_logger().warning(f"fault {done}: {request.kind} at {request.leg}")
    response.success = True
    return response


def save_state(directory: str, scene: str, divergence: DivergenceError) -> str:
    """Write the state of a diverged simulation; return a line with its path or the error."""
    name = f"lost_{datetime.now():%Y%m%d_%H%M%S}.npz"
    path = Path(directory, name).absolute()
    try:
        divergence.save(path, scene)
    except OSError as error:
        return f"its state could not be written: {error}"
    return f"its state is in {path}"

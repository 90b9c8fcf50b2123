"""Drawing of the robot for a viewer, kept up to date by the messages of the graph.

The messages may come from rclpy or, read by the `rosbags` library, from a bag. On the real robot
no topic has the shape of the legs: they are then drawn as without stress, and pale.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.drawing.shapes import (
    LEG_COLOURS,
    PATH_WIDTH,
    Shape,
    Strips,
    bent_legs,
    box_edges,
    force_arrows,
    leg_bars,
    natural_legs,
    path_strip,
    rgb,
    tendon_strips,
    torso_box,
)
from slot_core.messages import decode
from slot_core.robot import LEGS, RobotParameters

NATURAL_NODES = 20  # of a leg whose shape is not known
PATH_STEP = 0.005  # m between two points of a path
PATH_POINTS = 2000  # the oldest points of a longer path are dropped
REFERENCE, DEMANDED = rgb(palette.SECONDARY), rgb(palette.INK)


class Trace:
    """Line through the places where something was, drawn by a name and in a colour."""

    def __init__(self, name: str, colour: Array) -> None:
        self._name, self._colour = name, colour
        self._points: list[Array] = []

    def extend(self, point: Array) -> dict[str, Shape]:
        """The line with one more point (3,) m; nothing if that is closer than PATH_STEP."""
        if (
            self._points
            and np.linalg.norm(point - self._points[-1]) < PATH_STEP
        ):
            return {}
        self._points = [*self._points[-PATH_POINTS + 1 :], point]
        if len(self._points) == 1:
            return {}
        return {self._name: path_strip(np.array(self._points), self._colour)}


class Drawing:
    """Shapes by name, from the newest message of every topic."""

    def __init__(self, robot: RobotParameters, torque_max: float) -> None:
        """torque_max: torque of a servo (N m) at which its tendon is drawn as fully loaded."""
        self._robot = robot
        self._tension_max = torque_max / robot.tendon.spool_radius
        self._position, self._quaternion = (
            np.zeros(3),
            np.array([0.0, 0.0, 0.0, 1.0]),
        )
        self._legs = natural_legs(
            self._position, self._quaternion, robot, NATURAL_NODES
        )
        self._placed = False  # whether a pose has been received
        self._simulated = False  # whether the exact pose has been received
        self._path = Trace("path", LEG_COLOURS[0])
        self._reference_path = Trace("reference_path", REFERENCE)

    def receive(self, topic: str, message: Any) -> dict[str, Shape]:
        """Shapes that a message changes; none of a topic that is not drawn.

        Raises ValueError for a message whose arrays do not fit, and for values that are not finite.
        """
        return self._DRAW[topic](self, message) if topic in self._DRAW else {}

    def _draw_truth(self, message: Any) -> dict[str, Shape]:
        self._simulated = True
        _, position, quaternion, *_ = decode.odometry(message)
        return self._draw_torso(position, quaternion)

    def _draw_estimate(self, message: Any) -> dict[str, Shape]:
        if self._simulated:
            return {}
        state = decode.estimate(message).state
        quaternion = Rotation.from_euler("xyz", _finite(state)[:3]).as_quat()
        shapes = self._draw_torso(state[3:6], quaternion)
        self._legs = natural_legs(
            self._position, quaternion, self._robot, NATURAL_NODES
        )
        return shapes | {"legs": leg_bars(self._legs, self._robot, known=False)}

    def _draw_torso(
        self, position: Array, quaternion: Array
    ) -> dict[str, Shape]:
        self._position, self._quaternion = (
            _finite(position),
            _finite(quaternion),
        )
        self._placed = True
        return {
            "torso": torso_box(position, quaternion, self._robot),
            **self._path.extend(position),
        }

    def _draw_legs(self, message: Any) -> dict[str, Shape]:
        self._simulated = True
        _, tension, force, nodes, directors = decode.legs(message)
        self._legs = bent_legs(nodes, directors, self._quaternion, self._robot)
        return {
            "legs": leg_bars(self._legs, self._robot),
            "tendons": self._tendons(tension),
            "ground_forces": force_arrows(nodes[:, -1], force, LEG_COLOURS),
        }

    def _draw_load(self, message: Any) -> dict[str, Shape]:
        """Tendons with the tension T = torque / radius of the spool, where it is not simulated."""
        if self._simulated or not self._placed:
            return {}
        _, _, torque = decode.joint_loads(message)
        return {
            "tendons": self._tendons(
                _finite(torque) / self._robot.tendon.spool_radius
            )
        }

    def _tendons(self, tension: Array) -> Shape:
        return tendon_strips(
            self._legs, tension, self._robot, self._tension_max
        )

    def _draw_reference(self, message: Any) -> dict[str, Shape]:
        """Reference pose of the torso now, its way over the horizon, and where it was."""
        reference = _finite(decode.preview(message).reference)
        position, size = reference[0, 3:6], np.array(self._robot.torso.size)
        quaternion = Rotation.from_euler("xyz", reference[0, :3]).as_quat()
        return {
            "reference": box_edges(position, quaternion, size, REFERENCE),
            "horizon": path_strip(reference[:, 3:6], REFERENCE),
            **self._reference_path.extend(position),
        }

    def _draw_plan(self, message: Any) -> dict[str, Shape]:
        """Planned forces of the first stage at the tips of the legs, and the predicted motion."""
        if not self._placed:
            return {}
        _, plan = decode.plan(message)
        colours, tips = (
            np.tile(DEMANDED, (len(LEGS), 1)),
            self._legs.nodes[:, -1],
        )
        shapes: dict[str, Shape] = {
            "demanded_forces": force_arrows(
                tips, _finite(plan.force[0]), colours
            )
        }
        if len(plan.pose) and len(plan.foot):
            shapes["predicted_path"] = path_strip(
                _finite(plan.pose)[:, 3:], DEMANDED
            )
            shapes["predicted_feet"] = Strips(
                _finite(plan.foot).swapaxes(0, 1), LEG_COLOURS, PATH_WIDTH
            )
        return shapes

    _DRAW: ClassVar[dict[str, Callable[[Drawing, Any], dict[str, Shape]]]] = {
        "/ground_truth/odom": _draw_truth,
        "/ground_truth/legs": _draw_legs,
        "/mpc_state": _draw_estimate,
        "/joint_states": _draw_load,
        "/gait_preview": _draw_reference,
        "/tendon_plan": _draw_plan,
    }
    TOPICS = tuple(_DRAW)


def _finite(values: Array) -> Array:
    if not np.isfinite(values).all():
        raise ValueError(f"{values.tolist()}: expected finite numbers")
    return values

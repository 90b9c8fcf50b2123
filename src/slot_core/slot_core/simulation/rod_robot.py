"""The simulated robot: torso, four legs, tendons and servos on the floor of a scene."""

from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.dynamics import integrator, observe
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import (
    build_model,
    build_scheme,
    leg_lanes,
    matching_state,
    rest_state,
    work_space,
)
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import (
    KernelRobot,
    counted,
    require_steps,
)
from slot_core.geometry import Transform
from slot_core.matrices import norm, product
from slot_core.refusal import DivergenceError
from slot_core.robot import LEGS, RobotParameters


class RodRobot(KernelRobot):
    """The robot with Cosserat rods as legs (`dynamics/integrator.py`).

    It starts with undeformed legs and slack tendons at `scene.start` and settles under a constant
    command; time zero is the end of settling. Equal inputs give bit-equal results.
    """

    def __init__(
        self, robot: RobotParameters, scene: Scene, servo: ServoSettings
    ) -> None:
        self.parameters = robot
        self.scene = scene
        self.model = build_model(robot, scene, servo)
        self.state = rest_state(self.model, scene.start.height)
        self._work = work_space()
        self._start = matching_state(self.model)
        points, widths = self.state.node.shape, self.state.director.shape
        # written by `observe.everything`
        self._seen = tuple(
            np.zeros(s) for s in (points, points, (4, 3), (3, 3), widths)
        )
        self._connect()
        self._settle()
        _ = self.ground_force  # compiles what a reading calls

    def _connect(self) -> None:
        """Give model and state to the kernels."""
        self._legs = leg_lanes(self.model, self.state)
        scheme = build_scheme(self.scene.solver, self.model.floor)
        self.handle = Handle(
            (
                self.model,
                self.state,
                self._work,
                self._start,
                self._legs,
                scheme,
            )
        )

    def change(
        self, robot: RobotParameters, scene: Scene, servo: ServoSettings
    ) -> None:
        """Go on from the present state with other parameters; pushes stay.

        Raises ConfigError as `build_model` does, and for what would take another state: other
        settings of the solver, another friction law, or branches of the material.
        """
        model = build_model(robot, scene, servo)
        law = scene.floor.friction_law != self.scene.floor.friction_law
        size = len(matching_state(model).buffer)
        branches = size != len(self.state.buffer)
        if scene.solver != self.scene.solver or law or branches:
            raise ConfigError(
                "solver, friction law and branches cannot change in a run"
            )
        model.push[:] = self.model.push
        self.parameters, self.scene, self.model = robot, scene, model
        self._connect()

    def advance(self, steps: int, command: Array) -> None:
        """Advance by `steps` steps with constant commanded tendon angles (4,), rad.

        Raises ValueError for a negative number of steps, a command of the wrong shape, not finite
        or outside [0, angle_max], and DivergenceError when a speed is not finite or exceeds
        `scene.solver.speed_limit`.
        """
        require_steps(steps)
        command = self.checked(command)
        self._legs.command[0] = command
        done, where = integrator.advance(self.handle, steps)
        self.steps += done
        if where >= 0:
            place = self._lost_node() if where else "torso"
            raise DivergenceError(
                f"simulation diverged in step {self.steps + 1} at {self.time:.4f} s: {place} is"
                f" beyond {self.scene.solver.speed_limit} m/s or not a number",
                self.snapshot() | {"command": command},
            )

    def _lost_node(self) -> str:
        """The first node that diverged; of a leg whose tendon angle is not finite, node 0."""
        with np.errstate(over="ignore"):
            speed = norm(self.state.node_velocity)
        sound = speed < self.scene.solver.speed_limit
        sound[:, 0] &= np.isfinite(self.state.tendon_angle)
        leg, node = np.argwhere(~sound)[0]
        return f"leg {LEGS[leg]} node {node}"

    def set_motion(self, velocity: Array, angular_velocity: Array) -> None:
        """Set a rigid motion of torso and legs: (3,) m/s in odom, (3,) rad/s in base_link."""
        super().set_motion(velocity, angular_velocity)
        to_base = Transform(self.rotation, self.position).inverse
        arm = to_base.apply(self.nodes)
        body = product(to_base.rotation, self.velocity) + np.cross(
            self.angular_velocity, arm
        )
        for leg, axes in enumerate(self.model.axes):
            self.state.node_velocity[leg] = product(body[leg], axes.T)

    def set_tip_to_nan(self, leg: int) -> None:
        """Set the tip of leg 0 .. 3 to NaN, so that the simulation diverges; or IndexError."""
        self.state.node[leg, -1] = np.nan

    def snapshot(self) -> dict[str, Any]:
        """Base snapshot, velocities of the nodes, and the start of the last step as `before_..`."""
        before = self._start
        nodes, node_velocity = np.zeros((2, *self.state.node.shape))
        observe.points(self.model, before, nodes, node_velocity)
        return super().snapshot() | {
            "unconverged_steps": self.unconverged_steps,
            "node_velocity": self._observe()[1].copy(),
            "before_nodes": nodes,
            "before_node_velocity": node_velocity,
            "before_position": before.position.copy(),
            "before_rotation": before.rotation.copy(),
            "before_velocity": before.velocity.copy(),
            "before_angular_velocity": before.rate.copy(),
            "before_tendon_angle": before.tendon_angle.copy(),
        }

    unconverged_steps = counted(
        2,
        "Steps accepted with too large a correction because no halvings were left.",
    )

    @property
    def nodes(self) -> Array:
        """(4, N, 3) m, nodes of the legs in odom, clamp first."""
        return self._observe()[0].copy()

    @property
    def directors(self) -> Array:
        """(4, N-1, 3) unit vectors along the width of the segments, to the right, in odom."""
        return self._observe()[4].copy()

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, force of the floor on each leg now."""
        return self._observe()[2].copy()

    def _observe(self) -> tuple[Array, ...]:
        observe.everything(self.handle, *self._seen)
        return self._seen

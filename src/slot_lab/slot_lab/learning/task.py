"""Task of a learner: robot, scene, observations, actions, and the random draws of a reset.

What is drawn are settings of the scene or the servos by dotted name, as `scene.floor.friction`, and
the commanded `velocity`, each uniformly between two ends. Ends that are numbers set all values of
a setting, as the four friction coefficients, to the same number; ends that are lists are drawn
value by value.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from scipy.linalg import block_diag

from slot_core import config
from slot_core.arrays import Array, checked
from slot_core.config import ConfigError
from slot_core.control.walk_actions import ACTIONS, CLIP, observation_size
from slot_core.dynamics.scene import Scene, level_changes, read_scene
from slot_core.dynamics.servo import ServoSettings, read_servo
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.gait.gait import LEFT_RIGHT, GaitSettings, Stride, read_gaits
from slot_core.refusal import quoted
from slot_core.robot import LEGS, RobotParameters, read_robot
from slot_core.simulation.closed_loop import changed
from slot_lab.learning.network import Mirror

SERVO_SCALE = 0.1  # rad
# Factors of the mirror image of a state as in `Estimate`, of a velocity, and of the phase's
# sine and cosine.
MIRRORED_STATE = np.tile([-1.0, 1.0], 6)
MIRRORED_VELOCITY = np.array([1.0, -1.0, -1.0])
HALF_STRIDE = -np.ones(2)
VELOCITY = "velocity"
LONGEST = 3600.0  # s, of an episode
SEEN = ("estimated", "true")  # kinds of observations
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}
DRAWN = ("scene", "servo")  # in the order of `Task._base`
Vector3 = tuple[float, float, float]
Range = tuple[Any, Any]  # both ends, numbers or lists


@dataclass(frozen=True)
class Task:
    """Task; raises ConfigError for what the configuration does not have."""

    level: str = "map"  # of accuracy, a file of config/solver
    scene: str = "flat"
    gait: str = "walk"
    velocity: Vector3 = (0.05, 0.0, 0.0)  # m/s, m/s, rad/s
    actions: str = "amplitudes"
    observations: str = "estimated"
    # observes the servos' angles, which a policy cannot see
    servos: bool = True
    duration: float = 10.0  # s, of an episode
    drawn: tuple[tuple[str, Range], ...] = ()  # names, and ends of their values

    def __post_init__(self) -> None:
        """Check names and kinds."""
        _require("level", self.level, config.names("solver"))
        _require("actions", self.actions, ACTIONS)
        _require("observations", self.observations, SEEN)
        for name, _ in self.drawn:
            if name != VELOCITY and name.partition(".")[0] not in DRAWN:
                raise ConfigError(
                    f"drawn {name}: expected {VELOCITY} or a name below scene, servo"
                )
        if not self.gaits.dt <= self.duration <= LONGEST:
            raise ConfigError(
                f"duration = {self.duration:g}: outside"
                f" [{self.gaits.dt:g}, {LONGEST:g}] s"
            )
        _require("gait", self.gait, self.gaits.strides)
        self.gaits.require_velocity(self.gait, np.array(self.velocity))
        self.world(self.draw(np.random.default_rng(0)))

    @cached_property
    def gaits(self) -> GaitSettings:
        """Settings of the gaits."""
        return read_gaits()

    @cached_property
    def robot(self) -> RobotParameters:
        """The robot, nominal and simulated."""
        return read_robot()

    @cached_property
    def stride(self) -> Stride:
        """The gait."""
        return self.gaits.strides[self.gait]

    @property
    def observed(self) -> int:
        """Number of values of an observation."""
        return observation_size(self.actions) + len(LEGS) * self.servos

    @cached_property
    def _base(self) -> tuple[Scene, ServoSettings]:
        """Scene at the task's level, and servos, before anything is drawn."""
        scene = read_scene(self.scene)
        return config.replace(scene, level_changes(self.level)), read_servo(
            scene.parameters
        )

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """Values by dotted name, drawn between their ends."""
        return {
            name: np.asarray(rng.uniform(*ends)).tolist()
            for name, ends in self.drawn
        }

    def commanded(self, values: Mapping[str, Any]) -> Array:
        """Velocity (3,) among drawn values, or the task's; raises ConfigError out of reach."""
        found = np.array(values.get(VELOCITY, self.velocity), dtype=float)
        self.gaits.require_velocity(self.gait, found)
        return found

    def changes(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Drawn values of scene and servos, numbers repeated for settings of several values."""
        found = {}
        known = {
            f"{part}.{name}": value
            for part, settings in zip(DRAWN, self._base)
            for name, value, _ in config.leaves(settings)
        }
        for name, value in values.items():
            if name != VELOCITY:
                many = isinstance(known.get(name), tuple) and not isinstance(
                    value, list
                )
                found[name] = [value] * len(known[name]) if many else value
        return found

    def world(self, values: Mapping[str, Any]) -> tuple[Scene, ServoSettings]:
        """Scene and servos with drawn values; raises ConfigError for what they do not have."""
        self.commanded(values)
        (scene, servo), named = self._base, self.changes(values)
        return changed(scene, "scene", named), changed(servo, "servo", named)


def make_task(
    drawn: Mapping[str, Range] | None = None, **arguments: Any
) -> Task:
    """Task of keyword arguments, as `gymnasium.make` takes them."""
    if VELOCITY in arguments:
        arguments[VELOCITY] = _plain(arguments[VELOCITY])
    ends = tuple(
        (name, (_plain(low), _plain(high)))
        for name, (low, high) in (drawn or {}).items()
    )
    return Task(drawn=ends, **arguments)


def _plain(end: Any) -> Any:
    """A number, or a tuple of numbers, which can be hashed."""
    return tuple(map(float, end)) if np.ndim(end) else float(end)


def _require(name: str, value: str, known: Any) -> None:
    if value not in known:
        raise ConfigError(
            f"{name} = {quoted(value)}: expected one of {', '.join(known)}"
        )


def require_render_mode(mode: str | None) -> str | None:
    """Return the mode of `render`; raises ConfigError for another one than METADATA has."""
    if mode is not None:
        _require("render_mode", mode, METADATA["render_modes"])
    return mode


def taken_action(action: Any, shape: tuple[int, ...]) -> Array:
    """Return an action within [-1, 1].

    Raises ValueError for another shape, what is no real number, NaN and infinity.
    """
    given = checked("action", action, shape, finite=False)
    if (kind := np.asarray(action).dtype).kind not in "fiu":
        raise ValueError(f"action: {kind} values, expected real numbers")
    if odd := np.argwhere(~np.isfinite(given)).tolist():
        raise ValueError(f"action{odd[0]} = {given[tuple(odd[0])]}: not finite")
    return np.clip(given, -1.0, 1.0)


def frame(robot: SimulatedRobot) -> NDArray[np.uint8]:
    """Image (h, w, 3) of a robot from the side."""
    from slot_lab.report.robot_drawing import (  # noqa: PLC0415 - half a second
        draw_frame,
        snapshot,
    )

    return np.asarray(draw_frame(snapshot(robot), robot.parameters))


def observation_space(task: Task) -> Box:
    """Observations of `walk_actions.py`, and the servos' errors (4) where the task has them."""
    return Box(-CLIP, CLIP, (task.observed,), np.float32)


def action_space(task: Task) -> Box:
    """Actions of the task's kind."""
    return Box(-1.0, 1.0, (ACTIONS[task.actions],), np.float32)


def mirror_of(task: Task) -> Mirror:
    """Left and right exchanged, half a stride later, which is the same gait on the same robot."""
    legs = np.eye(len(LEGS))[LEFT_RIGHT]
    action = {"tendons": legs, "amplitudes": np.diag(MIRRORED_VELOCITY)}[
        task.actions
    ]
    factors = np.concatenate([MIRRORED_STATE, HALF_STRIDE, MIRRORED_VELOCITY])
    return Mirror(
        block_diag(np.diag(factors), action, *[legs] * task.servos), action
    )


def servo_error(commanded: Array, angle: Array) -> Array:
    """Observed errors (m, 4) of the servos' angles (m, 4), rad, by their scale."""
    return np.clip((commanded - angle) / SERVO_SCALE, -CLIP, CLIP)

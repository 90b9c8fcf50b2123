"""Environment `SLOT-Walk-v0`: the simulated robot with its sensors, estimator and gait.

    gymnasium.make("slot_lab.learning:SLOT-Walk-v0", level="standard", scene="slope5")

Between two actions lies the controller of the robot as it is: sensors on their own clocks, state
estimator, gait scheduler, force map and servos. The arguments are `Task`'s. An
episode ends when the robot has fallen, or after `duration`. With `render_mode="rgb_array"`
`render` draws the robot from the side.
"""

from typing import Any

import gymnasium
import numpy as np

from slot_core.arrays import Array
from slot_core.clock import LOCKSTEP_START
from slot_core.control.policy import gait_plan
from slot_core.control.walk_actions import ACTIONS, deviation, observation
from slot_core.dynamics.scene import level_changes
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview
from slot_core.refusal import DivergenceError
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.closed_loop import SENSORS, ClosedLoop
from slot_lab.learning.rewards import (
    Course,
    fallen,
    reward_terms,
    total,
)
from slot_lab.learning.task import (
    METADATA,
    Task,
    action_space,
    frame,
    make_task,
    observation_space,
    require_render_mode,
    servo_error,
    taken_action,
)


class WalkEnv(gymnasium.Env[Any, Any]):
    """One robot at any level of accuracy; equal seeds and actions give equal episodes."""

    metadata = METADATA

    def __init__(
        self,
        task: Task | None = None,
        *,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """Take a task, or its values. render_mode: None or rgb_array. Raises ConfigError."""
        self.render_mode = require_render_mode(render_mode)
        self.task = task or make_task(**arguments)
        self.observation_space = observation_space(self.task)
        self.action_space = action_space(self.task)
        self._limit = round(self.task.duration / self.task.gaits.dt)
        self._made: ClosedLoop | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Draw a scene; the robot stands in it."""
        super().reset(seed=seed, options=options)
        task, values = self.task, self.task.draw(self.np_random)
        levels = {
            f"scene.{name}": value
            for name, value in level_changes(task.level).items()
        }
        self._made = ClosedLoop(
            task.scene,
            task.gait,
            task.commanded(values),
            int(self.np_random.integers(2**31)),
            "gait_alone",
            changes=levels | task.changes(values),
        )
        self._action = np.zeros((1, ACTIONS[task.actions]))
        self._angle = self._commanded = self._loop.plant.robot.tendon_angle
        self._ticks, self._course = 0, Course(task, 1)
        self._course.reset(np.array([0]), self._true_state())
        self._loop.read(self._loop.plant.readings_at_rest(LOCKSTEP_START))
        self._loop.plant.start(LOCKSTEP_START)
        self._take_estimate()
        return self._observed(), {}

    def step(
        self, action: Array
    ) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Walk to the next estimate of the state, some 33 ms.

        Raises ValueError as `taken_action` does, before the robot moves.
        """
        plant, task, preview = self._loop.plant, self.task, self._preview
        taken = taken_action(action, self._action.shape[1:])[None]
        change = deviation(
            task.actions,
            taken,
            task.stride,
            preview.phases,
            preview.velocity_ahead,
        )
        command = self._loop.controller.force_map.step(
            gait_plan(preview, change),
            preview,
            self._estimate.state,
            self._estimate.lead,
        )
        plant.command(command.angle, command.rate)
        self._commanded = command.angle
        diverged = False
        try:
            self._advance()
        except DivergenceError:
            diverged = True
        state = self._true_state()
        self._course.step(self._preview.velocity_ahead[:1], state)
        found = reward_terms(
            state,
            self._course.stray,
            self._preview.reference[:1, :2],
            plant.robot.servo_torque[None],
            taken - self._action,
        )
        self._action, self._ticks = taken, self._ticks + 1
        down = diverged or bool(fallen(state)[0])
        reward = 0.0 if diverged else float(total(found)[0])
        return (
            self._observed(),
            reward,
            down,
            self._ticks >= self._limit and not down,
            {name: float(value[0]) for name, value in found.items()},
        )

    def render(self) -> Any:
        """Image (h, w, 3) of the robot, uint8; None without a render mode."""
        return frame(self._loop.plant.robot) if self.render_mode else None

    @property
    def _loop(self) -> ClosedLoop:
        if self._made is None:
            raise gymnasium.error.ResetNeeded("reset comes first")
        return self._made

    def _advance(self) -> None:
        """Advance to the next estimate; odometry may be lost meanwhile."""
        while True:
            for reading in self._loop.plant.advance_to_reading(*SENSORS):
                if isinstance(reading, JointReading):
                    self._angle = reading.angle
                self._loop.read([reading])
            if self._take_estimate():
                return

    def _take_estimate(self) -> bool:
        """Take the newest estimate and the gait's preview; False without one."""
        found: list[Estimate] = list(
            iter(self._loop.controller.estimator.poll, None)
        )
        for self._estimate in found:
            self._preview: GaitPreview = self._loop.controller.scheduler.step(
                self._estimate.time, self._estimate.state
            )
        return bool(found)

    def _true_state(self) -> Array:
        """State (1, 12) of the simulated robot, as in `Estimate`."""
        robot = self._loop.plant.robot
        turn = robot.rotation @ robot.angular_velocity
        return np.concatenate(
            [robot.rpy, robot.position, turn, robot.velocity]
        )[None]

    def _observed(self) -> Array:
        task, preview = self.task, self._preview
        state = (
            self._true_state()
            if task.observations == "true"
            else np.asarray(self._estimate.state)[None]
        )
        seen = observation(
            np.nan_to_num(state),
            preview.reference[:1],
            preview.phases[:1],
            preview.velocity_ahead[:1],
            self._action,
        )
        if task.servos:
            seen = np.hstack(
                [seen, servo_error(self._commanded, self._angle)[None]]
            )
        return seen[0].astype(np.float32)

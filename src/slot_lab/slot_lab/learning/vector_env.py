"""Vector environment of the walk: many robots step together, on threads of one process.

It is `WalkEnv` without the parts that cost most there. The observations named `estimated` are the
true states with independent noise as large as the errors of the state estimator (ESTIMATE_NOISE).
The gait starts from the posture `stand` (`gait_clock.py`), the servos get a goal three
times in a step, as on the bus. The time step divides the time between two goals; it is at most
the level's, or the given one.
"""

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.control.walk_actions import ACTIONS, deviation, observation
from slot_core.dynamics.scene import NO_SENSORS
from slot_core.dynamics.simulated_robot import KernelRobot
from slot_core.robot import LEGS
from slot_core.simulation.make_robot import make_robot
from slot_core.simulation.many_robots import ANGLE, STATE, TENSION, ManyRobots
from slot_lab.learning.gait_clock import GaitClock
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

Flags = NDArray[np.bool_]
CYCLES = 3  # goals of the servos in a step
ESTIMATE_NOISE = np.repeat([1e-3, 4e-4, 0.01, 2e-3], 3)  # rad, m, rad/s, m/s


class WalkVectorEnv(VectorEnv[Any, Any, Any]):
    """M robots; the next step resets a robot that has fallen or walked its time."""

    metadata = METADATA | {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int,
        task: Task | None = None,
        *,
        threads: int = 1,
        step: float = 0.0,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """Take a task, or its values. step: longest time step, s; 0: the level's.

        render_mode: None or rgb_array. Raises ConfigError.
        """
        self.render_mode = require_render_mode(render_mode)
        self.task = task or make_task(**arguments)
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task)
        self.observation_space = batch_space(
            self.single_observation_space, num_envs
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        scene, _ = self.task.world({})
        if scene.pushes or scene.faults:
            raise ConfigError(
                f"scene {self.task.scene}: its pushes and faults come at times of their own, which"
                " only the environment of one robot has"
            )
        goal = self.task.gaits.dt / CYCLES
        self._steps = math.ceil(goal / (step or scene.solver.step) - 1e-9)
        self._clock, self._threads = GaitClock(self.task, num_envs), threads
        self._course = Course(self.task, num_envs)
        self._limit = round(self.task.duration / self.task.gaits.dt)
        self._robots: ManyRobots | None = None
        self._action = np.zeros((num_envs, ACTIONS[self.task.actions]))
        self._commanded = np.zeros((num_envs, len(LEGS)))
        self._ticks = np.zeros(num_envs, dtype=int)
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: Any = None,  # an integer, or one for each robot
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Draw and build all robots anew; raises ValueError for another number of seeds."""
        count, one = self.num_envs, not np.ndim(seed)
        seeds = [None] * count if one else list(seed)
        if len(seeds) != count:
            raise ValueError(f"seed: {len(seeds)} values, expected {count}")
        super().reset(seed=seed if one else None)
        streams = self.np_random.spawn(self.num_envs)
        self._streams = [
            stream if given is None else np.random.default_rng(given)
            for stream, given in zip(streams, seeds)
        ]
        self._restart(np.arange(self.num_envs))
        return self._observed(), {}

    def step(
        self, actions: Array
    ) -> tuple[Array, Array, Flags, Flags, dict[str, Any]]:
        """Step all robots by the time between two stages of the gait.

        Raises ValueError as `taken_action` does, before a robot moves.
        """
        task, clock, course = self.task, self._clock, self._course
        robots, again = self._many, np.flatnonzero(self._ended)
        action = taken_action(actions, self._action.shape)
        angles = np.stack(
            [
                angle + deviation(task.actions, action, task.stride, *ahead)
                for angle, ahead in zip(clock.angles, clock.ahead())
            ]
        )
        share = (np.arange(CYCLES) / CYCLES)[:, None]
        goals = angles[0][:, None] + share * (angles[1] - angles[0])[:, None]
        goals = np.clip(goals, 0.0, task.robot.tendon.angle_max)
        motion = robots.advance(goals, self._steps)
        self._commanded = goals[:, -1]
        safe = np.where(np.isfinite(motion), motion, 0.0)
        clock.step(safe[:, STATE])
        course.step(clock.velocity, safe[:, STATE])
        state = motion[:, STATE]
        torque = motion[:, TENSION] * task.robot.tendon.spool_radius
        tilt, change = clock.reference[:, :2], action - self._action
        terms = reward_terms(state, course.stray, tilt, torque, change)
        self._action = action
        self._ticks += 1
        terminated, truncated = fallen(state), self._ticks >= self._limit
        reward = total(terms)
        if len(again):
            self._restart(again)
            reward[again] = 0.0
            terminated[again] = truncated[again] = False
        self._ended = terminated | truncated
        return (
            self._observed(),
            reward,
            terminated,
            truncated & ~terminated,
            terms,
        )

    def render(self) -> Any:
        """Images (h, w, 3) of the robots, uint8, one each; None without a render mode."""
        return (
            tuple(map(frame, self._many.robots)) if self.render_mode else None
        )

    @property
    def places(self) -> Array:
        """(M, 2) m, true x and y of the robots in odom."""
        return self._many.motion[:, 3:5].copy()

    @property
    def _many(self) -> ManyRobots:
        if self._robots is None:
            raise gymnasium.error.ResetNeeded("reset comes first")
        return self._robots

    def _restart(self, which: NDArray[np.int64]) -> None:
        """Draw and build these robots anew, at rest."""
        velocity, made = np.zeros((len(which), 3)), []
        for k, index in enumerate(which):
            values = self.task.draw(self._streams[index])
            velocity[k] = self.task.commanded(values)
            made.append(self._made(values))
        if self._robots is None:
            self._robots = ManyRobots(made, self._threads)
        else:
            for index, robot in zip(which, made):
                self._robots.replace(index, robot)
        motion = self._robots.motion[which]
        self._clock.reset(which, velocity, motion[:, STATE])
        self._course.reset(which, motion[:, STATE])
        self._action[which], self._ticks[which], self._ended[which] = (
            0.0,
            0,
            False,
        )
        self._commanded[which] = motion[:, ANGLE]

    def _made(self, values: dict[str, Any]) -> KernelRobot:
        """A robot with drawn values, settled at its start."""
        scene, servo = self.task.world(values)
        scene = config.replace(
            scene,
            NO_SENSORS
            | {"solver.step": self.task.gaits.dt / CYCLES / self._steps},
        )
        robot = make_robot(self.task.robot, scene, servo)
        if not isinstance(robot, KernelRobot):
            raise ConfigError(
                f"level {self.task.level}: has no vector environment"
            )
        return robot

    def _observed(self) -> Array:
        motion = np.nan_to_num(self._many.motion)
        state = motion[:, STATE]
        if self.task.observations == "estimated":
            noise = np.array(
                [stream.standard_normal(12) for stream in self._streams]
            )
            state = state + ESTIMATE_NOISE * noise
        clock = self._clock
        seen = observation(
            state, clock.reference, clock.phase, clock.velocity, self._action
        )
        if self.task.servos:
            seen = np.hstack(
                [seen, servo_error(self._commanded, motion[:, ANGLE])]
            )
        return seen.astype(np.float32)

"""The robot as it is played with: its loop, changes of robot and scene, pushes, and events.

The clock is the robot's: `advance` moves it on by a frame, however long that takes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import LOCKSTEP_START, SECOND, to_seconds
from slot_core.config import ConfigError
from slot_core.control.controller import Tick
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.dynamics.model import Model
from slot_core.dynamics.scene import Push, read_scene
from slot_core.faults import BROKEN, Fault
from slot_core.gait.gait import STAND
from slot_core.geometry import rotate
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY
from slot_core.safety.states import LATCHED, Request, no_change
from slot_core.safety.supervisor import PERIOD
from slot_core.simulation.readings import TrueState
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.play.played_loop import PlayedLoop, Wishes

FRAME = 2 * PERIOD  # s, of the robot's clock
KEPT = 120.0  # s of the robot's clock that can be saved
SEED = 0
Happened: TypeAlias = tuple[int, Any]
"""Time on the robot's clock, ns; a reading, tick or report."""


class PlayedRobot:
    """A robot in a scene under a policy; `ended` says why it has stopped for good, or is ""."""

    def __init__(self, scene: str = "flat", policy: str = DEFAULT_POLICY) -> None:
        """Raises ConfigError for an unknown scene or policy, and for legs that are no rods."""
        if (legs := read_scene(scene).solver.legs) != "spatial":
            raise ConfigError(
                f"scene {scene}: legs of the model {legs!r}; only rods can change"
            )
        self.scene, self.policy = scene, policy
        self.wishes = Wishes()
        self.changes: dict[str, Any] = {}  # of robot, scene and servo, by dotted name
        self.broken: set[str] = set()  # legs whose tendon is broken
        self.reset()

    def reset(self) -> None:
        """Begin anew in the scene, with the wishes, the changes and the broken tendons."""
        self.history: deque[Happened] = deque()  # of the last KEPT seconds
        self._new: list[Happened] = []  # of the present frame
        self.truth: TrueState | None = None  # the last
        self.tick: Tick | None = None
        self.ended = ""
        self.wishes.up = True
        self._pull = np.zeros(3)
        self.loop = PlayedLoop(self.scene, SEED, self.policy, self.wishes, self._keep)
        self.loop.loop.change(self.changes)
        for leg in self.broken:
            self.set_tendon(leg, broken=True)

    def advance(self) -> list[Happened]:
        """Advance by a frame; returns what happened: readings, ticks and reports."""
        if self.ended:
            return []
        self._new = []
        try:
            for _ in self.loop.run(FRAME):
                pass
        except DivergenceError as error:
            self.ended = str(error)
        return self._new

    def set_gait(self, gait: str) -> None:
        """Stand or walk in a gait."""
        self.wishes.gait = gait

    def set_velocity(self, velocity: Array) -> None:
        """Go at v_x, v_y m/s, yaw rate rad/s, (3,)."""
        self.wishes.velocity = velocity

    def set_pose(self, pose: Array | None) -> None:
        """Take a height m, roll, pitch rad, (3,), or the gait's own."""
        self.wishes.pose = pose

    def stand_up(self) -> None:
        """Rise from the floor and stand, never walk; raises ConfigError in ESTOP and FAULT."""
        state = self.loop.supervisor.state
        if state in LATCHED:
            raise ConfigError(no_change(Request.STAND, state))
        self.wishes.gait, self.wishes.up = STAND, True

    def request(self, request: Request) -> None:
        """Make a request to the supervisor."""
        self.loop.request(request)

    def change(self, changes: dict[str, Any]) -> None:
        """Change robot, scene or servo while it moves, by dotted name; raises ConfigError."""
        self.loop.loop.change(changes)
        self.changes |= changes

    def set_slope(self, degrees: float) -> None:
        """Incline the floor, uphill along +x; raises ConfigError."""
        angle = np.radians(degrees)
        self.change(
            {"scene.gravity": [-GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)]}
        )

    def set_policy(self, policy: str) -> None:
        """Go on with another policy; raises ConfigError."""
        self.loop.loop.set_policy(policy)
        self.policy = policy

    def push(self, force: Sequence[float], duration: float) -> None:
        """Push the torso's centre with a force (3,), N, in the heading frame, for a time (s)."""
        x, y = rotate(np.array(force[:2]), float(self.loop.plant.robot.rpy[2]))
        z = force[2]
        self.loop.plant.push(Push(0.0, duration, (x, y, z), (0.0, 0.0, 0.0)))

    def pull(self, force: Array) -> None:
        """Pull at the torso's centre with a force (3,), N, in odom, until the next call."""
        self.loop.plant.robot.push(force - self._pull, np.zeros(3))
        self._pull = force

    def set_tendon(self, leg: str, *, broken: bool) -> None:
        """Break a tendon, or mend it."""
        (self.broken.add if broken else self.broken.discard)(leg)
        if broken:
            self.loop.plant.faults.inject(Fault(BROKEN, leg, 0.0, 0.0, 0.0))
            return
        with suppress(ValueError):  # it is not broken
            self.loop.plant.faults.clear(BROKEN, leg)

    @property
    def model(self) -> Model:
        """Model of the simulated robot as it is now."""
        robot = self.loop.plant.robot
        assert isinstance(robot, RodRobot)
        return robot.model

    @property
    def time(self) -> float:
        """Seconds since the start, on the robot's clock."""
        return max(0.0, to_seconds(self.loop.plant.now - LOCKSTEP_START))

    def _keep(self, time: int, value: Any) -> None:
        self._new.append((time, value))
        self.history.append((time, value))
        while self.history[0][0] < time - KEPT * SECOND:
            self.history.popleft()
        if isinstance(value, TrueState):
            self.truth = value
        elif isinstance(value, Tick):
            self.tick = value

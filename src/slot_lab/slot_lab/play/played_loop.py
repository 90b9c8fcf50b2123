"""Closed loop that follows the wishes of a player, through the supervisor as an operator's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.control.controller import Tick
from slot_core.gait.gait import STAND, Posture
from slot_core.safety.states import RELEASED, TO_RISE, TO_STAND, TO_WALK, Request, State
from slot_core.safety.supervisor import Report
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.readings import ImageReading, Reading, StampedHealth
from slot_core.simulation.supervised_loop import SupervisedLoop

Keep = Callable[[int, Any], None]


@dataclass
class Wishes:
    """Requests of the player to the robot; legs FL FR RL RR."""

    gait: str = STAND
    velocity: Array = field(
        default_factory=lambda: np.zeros(3)
    )  # v_x, v_y m/s, yaw rate rad/s
    pose: Array | None = None  # (3,) height m, roll, pitch rad; None: the gait's own
    up: bool = True  # under torque; False after a fall, a fault or an emergency stop


class PlayedLoop(SupervisedLoop):
    """Supervised loop under wishes, of which `keep` gets every reading, tick and report.

    The wishes are pursued at every report of the supervisor; `refusal` is why not, one line.
    """

    def __init__(
        self, scene: str, seed: int, policy: str, wishes: Wishes, keep: Keep
    ) -> None:
        """keep: called with the time on the robot's clock, ns. Raises ConfigError."""
        super().__init__(scene, STAND, None, seed, policy)
        self.wishes, self.refusal = wishes, ""
        self._keep = keep
        self._asked: tuple[str, tuple[float, ...]] | None = (
            None  # gait and pose, by the scheduler
        )

    def receive(self, reading: Reading) -> None:
        """Keep a reading, unless it is an image, and give it to the state estimator."""
        if not isinstance(reading, ImageReading):
            self._keep(self.plant.now, reading)
        super().receive(reading)

    def receive_joints(self, reading: JointReading) -> None:
        """Keep the joints and give them to the supervisor."""
        self._keep(self.plant.now, reading)
        super().receive_joints(reading)

    def control(self, tick: Tick) -> None:
        """Keep a tick and take its command."""
        self._keep(self.plant.now, tick)
        super().control(tick)

    def supervise(self, report: StampedHealth) -> Report | None:
        """Step the supervisor, then pursue the wishes."""
        self._keep(self.plant.now, report)
        before, found = self.report, super().supervise(report)
        if found is not None:
            self._keep(self.plant.now, found)
            if found.state in RELEASED and not (before and before.state is found.state):
                self.wishes.up = False
            self.refusal = self._pursue(found.state)
        return found

    def request(self, request: Request) -> None:
        """Make a request of the operator now."""
        self.refusal = self.supervisor.request(self.plant.now, request)

    def _request_gait(self, report: Report) -> None:
        """Stand in a new state, until the wishes are pursued."""
        if not report.keeps_gait:
            self._asked = None
            self.loop.controller.scheduler.request(STAND, np.zeros(3))

    def _pursue(self, state: State) -> str:
        """Make the next request; returns why it is refused, or ""."""
        stands = isinstance(self.loop.gaits.find(self.wishes.gait), Posture)
        if state is (State.STANDING if stands else State.WALKING):
            return self._ask()
        wanted = TO_RISE.get(state) or (TO_STAND if stands else TO_WALK).get(state)
        if wanted is None or not self.wishes.up:
            return ""
        return self.supervisor.request(self.plant.now, wanted)

    def _ask(self) -> str:
        """Give gait, pose and velocity to the scheduler; returns why one is refused, or ""."""
        scheduler, wishes = self.loop.controller.scheduler, self.wishes
        pose = () if wishes.pose is None else tuple(wishes.pose)
        gait, posed = self._asked or ("", ())
        try:
            if wishes.gait != gait or (
                posed and not pose
            ):  # the pose returns to the gait's own
                scheduler.request(wishes.gait, np.zeros(3))
                self._asked = wishes.gait, ()
            scheduler.set_velocity(self.plant.now, wishes.velocity)
            if pose and self._asked != (wishes.gait, pose):
                scheduler.set_pose(np.array(pose))
                self._asked = wishes.gait, pose
        except ConfigError as error:
            return str(error)
        return ""

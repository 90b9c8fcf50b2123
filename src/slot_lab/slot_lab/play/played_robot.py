"""The robot as it is played with: wishes, changes of robot and scene, pushes, and events.

Its closed loop follows the wishes of a player through the supervisor, as an operator's. The
clock is the robot's: `advance` moves it on by a frame, however long that takes.
"""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
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
from slot_core.gait.gait import STAND, Posture
from slot_core.geometry import rotate
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY
from slot_core.safety.states import (
    LATCHED,
    RELEASED,
    TO_RISE,
    TO_STAND,
    TO_WALK,
    Request,
    State,
    no_change,
)
from slot_core.safety.supervisor import PERIOD, Report
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.readings import (
    ImageReading,
    Reading,
    StampedHealth,
    TrueState,
)
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.supervised_loop import SupervisedLoop

FRAME = 2 * PERIOD  # s, of the robot's clock
KEPT = 120.0  # s of the robot's clock that can be saved
SEED = 0
Happened: TypeAlias = tuple[int, Any]
"""Time on the robot's clock, ns; a reading, tick or report."""
Keep = Callable[[int, Any], None]


@dataclass
class Wishes:
    """Requests of the player to the robot; legs FL FR RL RR."""

    gait: str = STAND
    # m/s, m/s, rad/s
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    # (3,) height m, roll, pitch rad; None: the gait's own
    pose: Array | None = None
    # under torque; False after a fall, a fault or an emergency stop
    up: bool = True


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
        # gait and pose
        self._asked: tuple[str, tuple[float, ...]] | None = None

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
            if found.state in RELEASED and not (
                before and before.state is found.state
            ):
                self.wishes.up = False
            self.refusal = self._pursue(found.state)
        return found

    def request(self, request: Request) -> None:
        """Make a request of the operator now."""
        self.refusal = self.supervisor.request(self.plant.now, request)

    def request_gait(self, state: State) -> None:
        """Stand in a new state, until the wishes are pursued."""
        self._asked = None
        self.loop.controller.scheduler.request(STAND, np.zeros(3))

    def _pursue(self, state: State) -> str:
        """Make the next request; returns why it is refused, or ""."""
        stands = isinstance(self.loop.gaits.find(self.wishes.gait), Posture)
        if state is (State.STANDING if stands else State.WALKING):
            return self._ask()
        wanted = TO_RISE.get(state) or (TO_STAND if stands else TO_WALK).get(
            state
        )
        if wanted is None or not self.wishes.up:
            return ""
        return self.supervisor.request(self.plant.now, wanted)

    def _ask(self) -> str:
        """Give gait, pose and velocity to the scheduler; returns why one is refused, or ""."""
        scheduler, wishes = self.loop.controller.scheduler, self.wishes
        pose = () if wishes.pose is None else tuple(wishes.pose)
        gait, posed = self._asked or ("", ())
        try:
            # the pose returns to the gait's own
            if wishes.gait != gait or (posed and not pose):
                scheduler.request(wishes.gait, np.zeros(3))
                self._asked = wishes.gait, ()
            scheduler.set_velocity(self.plant.now, wishes.velocity)
            if pose and self._asked != (wishes.gait, pose):
                scheduler.set_pose(np.array(pose))
                self._asked = wishes.gait, pose
        except ConfigError as error:
            return str(error)
        return ""


class PlayedRobot:
    """A robot in a scene under a policy; `ended` says why it has stopped for good, or is ""."""

    def __init__(
        self, scene: str = "flat", policy: str = DEFAULT_POLICY
    ) -> None:
        """Raises ConfigError for an unknown scene or policy, and for legs that are no rods."""
        if (legs := read_scene(scene).solver.legs) != "spatial":
            raise ConfigError(
                f"scene {scene}: legs of the model {legs!r}; only rods can change"
            )
        self.scene, self.policy = scene, policy
        self.wishes = Wishes()
        self.changes: dict[
            str, Any
        ] = {}  # of robot, scene and servo, by dotted name
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
        self.loop = PlayedLoop(
            self.scene, SEED, self.policy, self.wishes, self._keep
        )
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
        forward, down = -GRAVITY * np.sin(angle), -GRAVITY * np.cos(angle)
        self.change({"scene.gravity": [forward, 0.0, down]})

    def set_policy(self, policy: str) -> None:
        """Go on with another policy; raises ConfigError."""
        self.loop.loop.set_policy(policy)
        self.policy = policy

    def push(self, force: Sequence[float], duration: float) -> None:
        """Push the torso's centre with a force (3,), N, in the heading frame, for a time (s)."""
        x, y = rotate(np.array(force[:2]), float(self.loop.plant.robot.rpy[2]))
        self.loop.plant.push(
            Push(0.0, duration, (x, y, force[2]), (0.0, 0.0, 0.0))
        )

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

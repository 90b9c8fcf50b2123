"""The robot as its software sees it: simulator and sensors on one clock of whole time steps."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from slot_core.config import ConfigError
from slot_core.dynamics.scene import Push, Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.dynamixel.state import JointReading
from slot_core.faults import BROKEN, NAN, SLACK, Fault, legs_of, require_simulated_legs
from slot_core.paper.paper_robot import PaperRobot
from slot_core.robot import LEGS, Array, Robot
from slot_core.simulation.kernel_robot import KernelRobot
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.sensors import (
    ImuReading,
    ImuSensor,
    OdometryReading,
    OdometrySensor,
    true_odometry,
)
from slot_core.simulation.tabulated_robot import TabulatedRobot


@dataclass(frozen=True)
class TrueState:
    """What no sensor sees, at `stamp` (ns): exact odometry, tension, ground force and leg shape."""

    stamp: int
    odometry: OdometryReading
    tension: Array  # (4,) N
    ground_force: Array  # (4, 3) N in odom
    nodes: Array  # (4, N, 3) m in odom


Reading = OdometryReading | ImuReading | JointReading | TrueState


@dataclass(frozen=True, order=True)
class _Event:
    """Something to do at `due` (ns); events of one instant in the order they were entered."""

    due: int
    number: int
    action: Callable[[], list[Reading]] = field(compare=False)


MODELS: dict[str, type[SimulatedRobot]] = {
    "rod": RodRobot,
    "map": TabulatedRobot,
    "paper": PaperRobot,
}
SUFFERERS = {SLACK: KernelRobot, BROKEN: KernelRobot, NAN: RodRobot}


def simulate(robot: Robot, scene: Scene, servo: ServoSettings) -> SimulatedRobot:
    """The robot with the legs that `scene.solver.legs` names, settled at its start."""
    return MODELS[scene.solver.legs](robot, scene, servo)


class Plant:
    """RodRobot, servos and sensors on one clock; readings are handed out as they fall due.

    Odometry falls due `delay` after its stamp, everything else at its stamp. The robot is frozen in
    its starting pose until `start` gives the clock a time. Raises ConfigError where the scene has a
    fault that such a robot cannot have.
    """

    def __init__(self, robot: Robot, scene: Scene, servo: ServoSettings, rng: np.random.Generator):
        odometry_rng, imu_rng = rng.spawn(2)
        self.simulator = simulate(robot, scene, servo)
        self.now = 0  # ns
        self._scene = scene
        self._step = round(scene.solver.step * 1e9)
        self._command = self.simulator.tendon_angle.copy()
        self._odometry = OdometrySensor(scene.sensors.odometry, odometry_rng)
        self._imu = ImuSensor(scene.sensors.imu, imu_rng)
        self._at_rest: list[Reading] = []
        self._agenda: list[_Event] = []
        self._number = itertools.count()
        self._faults: dict[tuple[str, str], Fault] = {}  # by kind and leg
        for fault in scene.faults.values():
            self._refuse(fault)

    def present(self, stamp: int) -> list[Reading]:
        """What the sensors read at rest, at `stamp` (ns), without delay; the same for one stamp."""
        if not self._at_rest or stamp != self.now:
            self.now = stamp
            sensors = self._scene.sensors
            imu = self._read_imu() if sensors.imu.enabled else []
            joints = self._read_joints() if sensors.joints else []
            self._at_rest = [*imu, *joints, self._odometry.sample(self.simulator, stamp)]
        return self._at_rest

    def start(self, stamp: int) -> None:
        """Begin at `stamp` (ns); the first readings are due one period later."""
        self.now = stamp
        sensors = self._scene.sensors
        if sensors.imu.enabled:
            self._every(sensors.imu.period, self._read_imu)
        if sensors.joints:
            self._every(sensors.joint_period, self._read_joints)
        self._every(sensors.odometry.period, self._read_odometry)
        for push in self._scene.pushes.values():
            self._plan(push)
        for present in self._faults.values():
            self._end_later(present)
        for fault in self._scene.faults.values():
            self._do(self.now + round(fault.time * 1e9), partial(self.inject, fault))

    def inject(self, fault: Fault) -> None:
        """Let a fault begin now, whatever its time says, in place of one of its kind at that leg.

        Its duration runs on the plant's clock. Raises ConfigError where there can be no such fault.
        """
        self._refuse(fault)
        for leg in fault.legs:
            self._faults[fault.kind, leg] = fault
            self._switch(fault, leg, True)
        if self._agenda:  # the clock runs
            self._end_later(fault)

    def clear(self, kind: str, leg: str) -> None:
        """Take back the faults of a kind at a leg or all; raises ValueError where there is none.

        Errors that a servo has found stay until it is rebooted, a watchdog's trip until it is
        cleared.
        """
        there = [(kind, each) for each in legs_of(kind, leg) if (kind, each) in self._faults]
        if not there:
            raise ValueError(f"no fault {kind!r} at {leg!r}")
        for place in there:
            self._end(*place)

    def command(self, angle: Array) -> None:
        """Hold these tendon angles (4,), rad, from now on; raises ValueError on a bad vector."""
        self._command = self.simulator.checked(angle)

    def advance(self, until: int) -> Iterator[Reading]:
        """Advance to `until` (ns), handing out each reading when it falls due."""
        while self._agenda[0].due <= until:
            event = heapq.heappop(self._agenda)
            self._simulate(event.due)
            yield from event.action()
        self._simulate(until)

    def advance_to_odometry(self) -> Iterator[Reading]:
        """Advance until an odometry reading falls due; it is the last one handed out."""
        while True:
            for reading in self.advance(self._agenda[0].due):
                yield reading
                if isinstance(reading, OdometryReading):
                    return

    def _every(self, period: float, read: Callable[[], list[Reading]]) -> None:
        """Put a periodic reading on the agenda, first after one period."""
        interval = round(period * 1e9)

        def action() -> list[Reading]:
            self._at(self.now + interval, action)
            return read()

        self._at(self.now + interval, action)

    def _at(self, due: int, action: Callable[[], list[Reading]]) -> None:
        heapq.heappush(self._agenda, _Event(due, next(self._number), action))

    def _do(self, due: int, act: Callable[[], None]) -> None:
        """Put something on the agenda that reads nothing."""

        def action() -> list[Reading]:
            act()
            return []

        self._at(due, action)

    def _simulate(self, until: int) -> None:
        """Whole time steps only: the periods of `config/scene` are multiples of the step."""
        steps = (until - self.now) // self._step
        if steps > 0:
            self._move(steps)
            self.now += steps * self._step

    def _move(self, steps: int) -> None:
        self.simulator.advance(steps, self._command)

    def _read_imu(self) -> list[Reading]:
        return [self._imu.sample(self.simulator, self.now)]

    def _read_joints(self) -> list[Reading]:
        sim = self.simulator
        return [JointReading(self.now, sim.tendon_angle, sim.tendon_rate, sim.servo_torque)]

    def _read_odometry(self) -> list[Reading]:
        """The true state now, the odometry after its delay."""
        reading = self._odometry.sample(self.simulator, self.now)
        delay = round(self._scene.sensors.odometry.delay * 1e9)
        self._at(self.now + delay, lambda: [reading])
        return [self._true_state()] if self._scene.sensors.truth else []

    def _plan(self, push: Push) -> None:
        """Put the begin and the end of a push on the agenda; pushes add up."""
        force, moment = np.array(push.force), np.array(push.moment)
        begin = self.now + round(push.time * 1e9)
        self._do(begin, partial(self.simulator.push, force, moment))
        self._do(begin + round(push.duration * 1e9), partial(self.simulator.push, -force, -moment))

    def _end_later(self, fault: Fault) -> None:
        if fault.duration:
            self._do(self.now + round(fault.duration * 1e9), partial(self._expire, fault))

    def _expire(self, fault: Fault) -> None:
        """End a fault where nobody has cleared or replaced it."""
        for leg in fault.legs:
            if self._faults.get((fault.kind, leg)) is fault:
                self._end(fault.kind, leg)

    def _refuse(self, fault: Fault) -> None:
        """Raise ConfigError where this robot cannot have a fault."""
        require_simulated_legs(fault)
        if not isinstance(self.simulator, SUFFERERS[fault.kind]):
            model = self._scene.solver.legs
            raise ConfigError(f"fault {fault.kind!r}: legs of the model {model!r} cannot have it")

    def _end(self, kind: str, leg: str) -> None:
        self._switch(self._faults.pop((kind, leg)), leg, False)

    def _switch(self, fault: Fault, leg: str, on: bool) -> None:
        """Let a fault that has been noted act on a leg, or no longer."""
        if fault.kind != NAN:
            self._set_tendon(leg)
        elif on:
            assert isinstance(self.simulator, RodRobot)
            self.simulator.lose_node(LEGS.index(leg))

    def _set_tendon(self, leg: str) -> None:
        """Let a tendon be as the scene and the present faults have it."""
        assert isinstance(self.simulator, KernelRobot)
        index, state = LEGS.index(leg), self._scene.tendons
        longer = self._faults.get((SLACK, leg))
        slack = state.slack[index] + (longer.value if longer else 0.0)
        broken = state.broken[index] or (BROKEN, leg) in self._faults
        self.simulator.damage_tendon(index, slack, broken)

    def _true_state(self) -> TrueState:
        sim = self.simulator
        odometry = true_odometry(sim, self.now)
        return TrueState(self.now, odometry, sim.tension, sim.ground_force, sim.nodes)

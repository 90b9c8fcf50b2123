"""Controller, supervisor, servos and simulated robot on one clock: the graph, without ROS."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.clock import LOCKSTEP_START, to_ns
from slot_core.control.controller import Tick
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.gait.gait import STAND
from slot_core.robot import RobotParameters, read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Request, State
from slot_core.safety.supervisor import Report, Supervisor
from slot_core.safety.tendon_watch import read_tendon_watch
from slot_core.safety.ticked_supervisor import StartUp, TickedSupervisor
from slot_core.safety.watchdog import Permission
from slot_core.servos.registry import read_brand
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.closed_loop import ClosedLoop, PlantMaker
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.readings import Reading, StampedHealth
from slot_core.simulation.simulated_servos import make_servos


def make_bus_plant(
    robot: RobotParameters,
    scene: Scene,
    servo: ServoSettings,
    rng: np.random.Generator,
) -> RobotSimulator:
    """Simulated robot on emulated servos of the configured brand."""
    return RobotSimulator(robot, scene, servo, rng, read_brand().emulate)


MAKERS: dict[str, PlantMaker] = {
    "sim": RobotSimulator,
    "fake_bus": make_bus_plant,
}


class SupervisedLoop:
    """Closed loop with the supervisor, which stands the robot up and lets it walk.

    The time limits of `config/supervisor.yaml` run on the robot's clock: every event takes the same
    simulated time on every machine. Deterministic like `ClosedLoop`, and equal to
    the graph in lockstep.
    """

    def __init__(
        self,
        scene: str,
        gait: str,
        velocity: Array | None,
        seed: int,
        policy: str = DEFAULT_POLICY,
        *,
        hardware: str = "sim",
        changes: Mapping[str, Any] | None = None,
    ) -> None:
        """Build controller, supervisor, servos and plant; arguments as for `ClosedLoop`.

        hardware: `sim` or `fake_bus`, the driver with emulated servos.
        """
        self.loop = ClosedLoop(
            scene,
            STAND,
            None,
            seed,
            policy,
            changes=changes,
            make=MAKERS[hardware],
        )
        self.plant = self.loop.plant
        self.report: Report | None = None  # the last
        self.running = {*_MESSAGES, "supervisor"}  # nodes whose messages arrive
        found = self.loop.gaits.find(gait)
        self._gait = (
            gait,
            np.array([found.cruise, 0.0, 0.0])
            if velocity is None
            else velocity,
        )
        robot, settings = read_robot(), read_supervisor()
        settings = config.replace(settings, {"estop_required": False})
        self.supervisor = Supervisor(
            robot, settings, read_tendon_watch(robot, settings.tendon)
        )
        walk = [Request.WALK] * (gait != STAND)
        self.ticked = TickedSupervisor(
            self.supervisor, StartUp(Request.READY, Request.STAND, *walk)
        )
        self.servos = make_servos(self.plant, lockstep=True)
        self.servos.watchdog.set_limits(settings.servo_limits)

    def run(self, seconds: float) -> Iterator[Report]:
        """Advance the robot's clock and yield each report of the supervisor, every 20 ms.

        Raises DivergenceError when the simulation diverges.
        """
        if self.report is None:
            self._take(self.plant.readings_at_rest(LOCKSTEP_START))
            report = self.supervise(self.servos.report())
            self.plant.start(LOCKSTEP_START)
            self.servos.start()
            assert report is not None
            yield report
        end = self.plant.now + to_ns(seconds)
        while self.plant.now < end:
            report = self._take(self.plant.advance_to_reading(StampedHealth))
            if report is not None:
                yield report

    def _take(self, readings: Iterable[Reading]) -> Report | None:
        """Take readings in turn; returns the supervisor's report on the servos' reading."""
        report = None
        for reading in readings:
            if isinstance(reading, StampedHealth):
                report = self.supervise(reading)
            elif isinstance(reading, JointReading):
                self.receive_joints(reading)
            else:
                self.receive(reading)
                for tick in iter(self.loop.controller.poll, None):
                    self.control(tick)
        return report

    def receive(self, reading: Reading) -> None:
        """Give a reading to the state estimator."""
        self.loop.read([reading])

    def receive_joints(self, reading: JointReading) -> None:
        """Give the joints to the supervisor."""
        self.receive(reading)
        self.ticked.add(
            "joints",
            reading.stamp,
            lambda now: self.supervisor.receive_joints(
                now, reading.stamp, reading.angle, reading.torque
            ),
        )

    def control(self, tick: Tick) -> None:
        """Give a tick of the controller to the supervisor, and its command to the servos."""
        now = self.plant.now
        for node, receive in _MESSAGES.items():
            if node in self.running:
                self.ticked.add(
                    node, now, partial(receive, self.supervisor, tick)
                )
        if "force_mapper" in self.running:
            # rejected; the supervisor finds the same
            with suppress(ValueError):
                self.servos.offer(
                    now,
                    tick.estimate.stamp,
                    tick.command.angle,
                    tick.command.rate,
                )

    def supervise(self, report: StampedHealth) -> Report | None:
        """Step the supervisor on a report of the servos, which take its permission."""
        if "supervisor" not in self.running:
            return None
        last, now = self.report, report.stamp
        self.report = found = self.ticked.step(now, report.health)
        self.loop.controller.scheduler.set_followed(found.followed)
        changed = last is None or (last.state, last.since) != (
            found.state,
            found.since,
        )
        if changed and not found.keeps_gait:
            self.request_gait(found.state)
        self.servos.permit(
            Permission(
                now,
                found.action,
                found.followed,
                found.reason,
                now,
                walks=found.state is State.WALKING,
            )
        )
        return found

    def request_gait(self, state: State) -> None:
        """Request the gait of a new state: the loop's in WALKING, else to stand."""
        self.loop.controller.scheduler.request(
            *(self._gait if state is State.WALKING else (STAND, np.zeros(3)))
        )


_MESSAGES: dict[str, Callable[[Supervisor, Tick, int], object]] = {
    "state_estimator": lambda s, tick, now: s.receive_estimate(
        now, tick.estimate
    ),
    "mpc_controller": lambda s, tick, now: s.receive_mpc(
        now,
        tick.plan.status,
        tick.plan.fallback_cycles,
        tick.preview.period,
        tick.preview.velocity_ahead[0],
    ),
    "force_mapper": lambda s, tick, now: s.receive_command(
        now, tick.estimate.stamp, tick.command.angle, tick.command.rate
    ),
}
"""Input of the supervisor for the message of each node in a tick."""

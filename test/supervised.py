"""A supervisor with everything it needs to hear, every 10 ms; what fails is taken out by name."""

import dataclasses
import math

import numpy as np

from slot_core import config
from slot_core.control.mpc.mpc import Status
from slot_core.control.state_estimator import Estimate, Validity
from slot_core.leg_table import read_leg_table
from slot_core.robot import read_robot
from slot_core.safety.command_gate import Action
from slot_core.safety.servo_health import ServoHealth
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_core.safety.supervisor import Request, Supervisor
from slot_core.safety.tendon_watch import TendonLoad, read_tendon_watch
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.plant import JointReading

ROBOT = read_robot()
TICK = 10_000_000  # ns
START = 1_000_000_000  # ns
HEIGHT = 0.04  # m, of the standing robot
LOAD = TendonLoad(read_leg_table(("tension_N",)), ROBOT.tendon.spool_radius)


def make(**changes):
    settings = config.replace(read_supervisor(), changes)
    return Supervisor(ROBOT, settings, read_tendon_watch(ROBOT, settings.tendon))


def state(roll=0.0, pitch=0.0):
    x = np.zeros(12)
    x[:2], x[5] = (roll, pitch), HEIGHT
    return x


def load(angle):
    """Torque of the tabulated leg at tendon angles, the robot standing."""
    return LOAD(np.asarray(angle, dtype=float), np.full(4, HEIGHT))[0]


def health(**changes):
    """A driver that does what it is told with four sound servos."""
    sound = ServoHealth(
        action=Action.PASS,
        reason="",
        torque=np.ones(4, dtype=bool),
        silence=np.zeros(4),
        hardware_error=np.zeros(4, dtype=np.int64),
    )
    return dataclasses.replace(sound, **changes)


class Bench:
    """Feeds a supervisor; `silent` holds the inputs that are taken away."""

    def __init__(self, **changes):
        self.supervisor = make(**changes)
        self.nodes = read_supervisor().nodes
        self.now = START
        self.silent = set()
        self.command = np.full(4, 1.1)
        self.angle = np.array([1.0, 1.05, 1.1, 1.15])  # where the servos are
        self.state = state()
        self.validity = Validity.VALID
        self.status, self.fallback_cycles = Status.SOLVED, 0
        self.pressed = False
        self.torque = None  # N m, else that of the tabulated leg
        self.health = None  # of the driver, if there is one
        self.reports = []
        self._ticks = 0

    def tick(self):
        """Inputs and one step; the servos follow at once."""
        self.now += TICK
        now, s = self.now, self.supervisor
        for node in self.nodes:
            if node not in self.silent:
                s.hear(now, node)
        if "estop" not in self.silent:
            s.see_estop(now, self.pressed)
        if "servos" not in self.silent:
            torque = load(self.angle) if self.torque is None else self.torque
            s.see_joints(now, now, self.angle, torque)
        if self.health is not None:
            s.see_health(now, now, self.health)
        if self._ticks % 3 == 0:  # as the odometry, every 30 ms
            self.chain(now)
        self._ticks += 1
        report = s.step(now)
        if report.command.torque:
            self.angle = report.command.angle
        self.reports.append(report)
        return report

    def chain(self, now):
        """What follows from one odometry reading."""
        if "estimate" not in self.silent:
            estimate = Estimate(now, self.state, np.eye(12), self.validity)
            self.supervisor.see_estimate(now, estimate)
        if "solver" not in self.silent:
            self.supervisor.see_solver(now, self.status, self.fallback_cycles)
        if "command" not in self.silent:
            self.supervisor.see_command(now, now, self.command)

    def run(self, seconds):
        return [self.tick() for _ in range(round(seconds * 1e9 / TICK))][-1]

    def until(self, wanted, most):
        """Seconds until a state is reached; inf if it takes longer than `most`."""
        start = self.now
        while self.now - start < most * 1e9:
            if self.tick().state is wanted:
                return (self.now - start) * 1e-9
        return math.inf

    def ask(self, *requests):
        for request in requests:
            assert self.supervisor.request(self.now, request) == ""

    def bring(self, wanted):
        """To one of IDLE, READY, STANDING, WALKING, HOLD, RELAX, ESTOP, FAULT."""
        self.run(0.3)
        way = {
            State.IDLE: [],
            State.READY: [Request.READY],
            State.STANDING: [Request.READY, Request.STAND],
            State.ESTOP: [Request.ESTOP],
        }
        if wanted in way:
            self.ask(*way[wanted])
            return self._settle(wanted)
        self.ask(Request.READY, Request.STAND)
        self.run(1.0)
        self.ask(Request.WALK)
        self.run(1.0)
        if wanted is State.HOLD:
            self.supervisor.see_command(self.now + 1, self.now + 1, np.full(4, math.nan))
            self.silent.add("command")
            self.tick()
        elif wanted is State.RELAX:
            self.ask(Request.RELAX)
        elif wanted is State.FAULT:
            self.state = state(roll=1.0)
            self.until(State.FAULT, 3.0)
            self.state = state()
        return self._settle(wanted)

    def _settle(self, wanted):
        report = self.tick() if wanted not in {State.HOLD, State.RELAX} else None
        assert self.supervisor.state is wanted
        return report


class SupervisedLoop(ClosedLoop):
    """The simulated robot under its controller, with the supervisor before its servos.

    It stands up first; `walk` lets it go. A servo without torque keeps its last goal here.
    """

    def __init__(self, scene, seed=0, **changes):
        super().__init__(scene, "stand", None, seed)
        self.supervisor = make(**{"estop_required": False, **changes})
        self.reports = []  # (s since the start, report)

    def walk(self):
        self.controller.scheduler.request("walk", np.array([0.06, 0.0, 0.0]))
        assert self.supervisor.request(self.plant.now, Request.WALK) == ""

    def ticks(self, seconds):
        """Each tick with the report on its command, the robot standing from the tenth on."""
        s, nodes = self.supervisor, read_supervisor().nodes
        for k, tick in enumerate(self.run(round(seconds / 0.033))):
            now = self.plant.now
            for node in nodes:
                s.hear(now, node)
            s.see_gait(now, tick.preview.period)
            s.see_estimate(now, tick.estimate)
            s.see_solver(now, tick.result.status, tick.result.fallback_cycles)
            s.see_command(now, tick.estimate.stamp, tick.command.angle)
            if k == 15:
                assert s.request(now, Request.READY) == ""
                assert s.request(now, Request.STAND) == ""
            yield tick, self._step()

    def _step(self):
        report = self.supervisor.step(self.plant.now)
        if report.command.torque:
            self.plant.command(report.command.angle)
        self.reports.append((self.plant.now * 1e-9 - 1.0, report))
        return report

    def _read(self, readings):
        super()._read(self._listen(readings))

    def _listen(self, readings):
        for r in readings:
            if isinstance(r, JointReading):
                self.supervisor.see_joints(self.plant.now, r.stamp, r.angle, r.torque)
                self._step()
            yield r

"""Bench of the supervisor: all its inputs every 10 ms, of which tests omit some by name."""

import dataclasses
import math
from functools import partial

import numpy as np

from slot_core import config
from slot_core.control.policy import Status
from slot_core.dynamixel.state import JointReading
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.legs.leg_table import read_leg_table
from slot_core.robot import read_robot
from slot_core.safety.command_gate import Action, Gated
from slot_core.safety.command_watchdog import CommandWatchdog, Permission
from slot_core.safety.servo_health import healthy_servos
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_core.safety.supervisor import Report, Request, Supervisor
from slot_core.safety.tendon_watch import TendonLoad, read_tendon_watch
from slot_core.simulation.closed_loop import ClosedLoop

ROBOT = read_robot()
TICK = 10_000_000  # ns
START = 1_000_000_000  # ns
HEIGHT = 0.04  # m, of the standing robot
LOAD = TendonLoad(read_leg_table(("tension_N",)), ROBOT.tendon.spool_radius)


def make_supervisor(**changes):
    settings = config.replace(read_supervisor(), changes)
    return Supervisor(ROBOT, settings, read_tendon_watch(ROBOT, settings.tendon))


def state(roll=0.0, pitch=0.0):
    x = np.zeros(12)
    x[:2], x[5] = (roll, pitch), HEIGHT
    return x


def load(angle):
    """Torque of the tabulated leg at tendon angles of a standing robot, N m."""
    return LOAD(np.asarray(angle, dtype=float), np.full(4, HEIGHT))[0]


def health(**changes):
    """Health of servos without faults that follow commands."""
    sound = healthy_servos(Action.PASS, "", True, np.full(4, 1.1))
    return dataclasses.replace(sound, **changes)


@dataclasses.dataclass(frozen=True)
class BenchReport(Report):
    """A report of the supervisor with the servos' goals after it."""

    command: Gated

    @classmethod
    def of(cls, report, gated):
        fields = {f.name: getattr(report, f.name) for f in dataclasses.fields(report)}
        return cls(**fields, command=gated)


class Servos:
    """Servos without faults behind the command watchdog."""

    def __init__(self, settings):
        self.watchdog = CommandWatchdog(settings.servo_limits, 0.0, ROBOT.tendon.angle_max)
        self.gated = Gated(Action.OFF, np.zeros(4), False, np.zeros(4, dtype=bool))

    def engage(self, angle):
        """Set the goals to the servos' angles."""
        self.watchdog.engage(angle)
        self.gated = dataclasses.replace(self.gated, angle=np.array(angle))

    def step(self, now, report, angle):
        """Step at `now` with the supervisor's report; the servos are at `angle`."""
        self.watchdog.permit(Permission(now, report.action, report.followed, report.reason))
        if report.action is Action.HOLD and not self.gated.torque:
            self.watchdog.engage(angle)  # torque comes on
        self.gated = self.watchdog.step(now)
        return self.gated

    def health(self, **changes):
        """Health report, with `changes`."""
        gated, watchdog = self.gated, self.watchdog
        sound = healthy_servos(
            gated.action, watchdog.reason, gated.torque, gated.angle, gated.slewed
        )
        return dataclasses.replace(sound, **changes)


class Bench:
    """A supervisor with its inputs; those named in `silent` are omitted."""

    def __init__(self, **changes):
        self.supervisor = make_supervisor(**changes)
        self.nodes = read_supervisor().nodes
        self.now = START
        self.silent = set()
        self.command = np.full(4, 1.1)
        self.angle = np.array([1.0, 1.05, 1.1, 1.15])  # where the servos are
        self.state = state()
        self.validity = Validity.VALID
        self.status, self.fallback_cycles = Status.SOLVED, 0
        self.pressed = False
        self.torque = None  # N m; None: that of the tabulated leg
        self.servos = Servos(config.replace(read_supervisor(), changes))
        self.health = {}  # differences from servos without faults
        self.reports = []
        self._ticks = 0

    def tick(self):
        """All inputs and one step; the servos follow at once."""
        self.now += TICK
        now, s = self.now, self.supervisor
        for node in self.nodes:
            if node not in self.silent:
                s.receive_heartbeat(now, node)
        if "estop" not in self.silent:
            s.receive_estop(now, self.pressed)
        if "servos" not in self.silent:
            torque = load(self.angle) if self.torque is None else self.torque
            s.receive_joints(now, now, self.angle, torque)
            s.receive_health(now, now, self.servos.health(**self.health))
        if self._ticks % 3 == 0:  # as the odometry, every 30 ms
            self._send_cycle(now)
        self._ticks += 1
        report = s.step(now)
        gated = self.servos.step(now, report, self.angle)
        if gated.torque:
            self.angle = gated.angle
        self.reports.append(BenchReport.of(report, gated))
        return self.reports[-1]

    def _send_cycle(self, now):
        """Estimate, status of the MPC and command of one odometry reading."""
        if "estimate" not in self.silent:
            estimate = Estimate(now, self.state, np.eye(12), self.validity)
            self.supervisor.receive_estimate(now, estimate)
        if "mpc" not in self.silent:
            self.supervisor.receive_mpc(now, self.status, self.fallback_cycles)
        if "command" not in self.silent:
            self.supervisor.receive_command(now, now, self.command)
            self.servos.watchdog.offer(now, self.command)

    def run(self, seconds):
        """Ticks for a time; returns the last report."""
        return [self.tick() for _ in range(round(seconds * 1e9 / TICK))][-1]

    def time_until(self, wanted, limit):
        """Seconds until a state is reached; inf if it takes longer than `limit`."""
        start = self.now
        while self.now - start < limit * 1e9:
            if self.tick().state is wanted:
                return (self.now - start) * 1e-9
        return math.inf

    def request(self, *requests):
        """Make requests, with time for the servos to report between them."""
        for k, request in enumerate(requests):
            if k:
                self.run(0.02)
            assert self.supervisor.request(self.now, request) == ""

    def bring_to(self, wanted):
        """Bring the robot to a state; returns the report there, None for HOLD and RELAX."""
        self.run(0.3)
        requests = {
            State.IDLE: [],
            State.READY: [Request.READY],
            State.STANDING: [Request.READY, Request.STAND],
            State.ESTOP: [Request.ESTOP],
        }
        if wanted in requests:
            self.request(*requests[wanted])
            return self._check_state(wanted)
        self.request(Request.READY, Request.STAND)
        self.run(1.0)
        self.request(Request.WALK)
        self.run(1.0)
        if wanted is State.HOLD:
            self.supervisor.receive_command(self.now + 1, self.now + 1, np.full(4, math.nan))
            self.silent.add("command")
            self.tick()
        elif wanted is State.RELAX:
            self.request(Request.RELAX)
        elif wanted is State.FAULT:
            self.state = state(roll=1.0)
            self.time_until(State.FAULT, 3.0)
            self.state = state()
        return self._check_state(wanted)

    def _check_state(self, wanted):
        report = self.tick() if wanted not in {State.HOLD, State.RELAX} else None
        assert self.supervisor.state is wanted
        return report


class DelayedLoop(ClosedLoop):
    """The simulated robot with controller, supervisor and command watchdog; commands may be late.

    It stands up first; `walk` makes it walk. A servo without torque keeps its last goal here.
    """

    def __init__(self, scene, seed=0, delay=lambda tick: 0.0, **changes):
        """`delay`: s, by which the command of a tick is late."""
        super().__init__(scene, "stand", None, seed)
        changes = {"estop_required": False, **changes}
        self.supervisor = make_supervisor(**changes)
        self.servos = Servos(config.replace(read_supervisor(), changes))
        self.servos.engage(self.plant.simulator.tendon_angle)
        self.reports = []  # (s since the start, report)
        self._delay = delay

    def walk(self):
        """Request the gait and WALKING."""
        self.controller.scheduler.request("walk", np.array([0.06, 0.0, 0.0]))
        assert self.supervisor.request(self.plant.now, Request.WALK) == ""

    def ticks(self, seconds):
        """Yield each tick with the report after its command; the robot stands up at tick 15."""
        s, nodes = self.supervisor, read_supervisor().nodes
        for k, tick in enumerate(self.run(round(seconds / 0.033))):
            now = self.plant.now
            for node in nodes:
                s.receive_heartbeat(now, node)
            s.receive_estimate(now, tick.estimate)
            result = tick.plan
            s.receive_from_mpc(now, result.status, result.fallback_cycles, tick.preview.period)
            receive = partial(self._receive_command, tick.estimate.stamp, tick.command.angle)
            if delay := self._delay(k):
                self.plant._schedule_action(now + round(delay * 1e9), receive)
            else:
                receive()
            if k == 14:
                assert s.request(now, Request.READY) == ""
            if k == 15:
                assert s.request(now, Request.STAND) == ""
            yield tick, self._step()

    def _receive_command(self, stamp, angle):
        """A command for the odometry at `stamp`, now."""
        self.supervisor.receive_command(self.plant.now, stamp, angle)
        self.servos.watchdog.offer(self.plant.now, angle)
        self._step()

    def _step(self):
        report = self.supervisor.step(self.plant.now)
        gated = self.servos.step(self.plant.now, report, self.plant.simulator.tendon_angle)
        if gated.torque:
            self.plant.command(gated.angle)
        self.reports.append((self.plant.now * 1e-9 - 1.0, BenchReport.of(report, gated)))
        return self.reports[-1][1]

    def read(self, readings):
        super().read(self._supervise(readings))

    def _supervise(self, readings):
        """Give the supervisor the joint readings on their way to the controller."""
        for r in readings:
            if isinstance(r, JointReading):
                self.supervisor.receive_joints(self.plant.now, r.stamp, r.angle, r.torque)
                self.supervisor.receive_health(self.plant.now, r.stamp, self.servos.health())
                self._step()
            yield r

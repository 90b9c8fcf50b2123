"""A supervisor with all its inputs every 10 ms; what fails is taken out by name."""

import dataclasses
import math

import numpy as np

from slot_core import config
from slot_core.control.mpc.mpc import Status
from slot_core.control.state_estimator import Estimate, Validity
from slot_core.dynamixel.state import JointReading
from slot_core.leg_table import read_leg_table
from slot_core.robot import read_robot
from slot_core.safety.command_gate import Action, Gated
from slot_core.safety.command_watchdog import CommandWatchdog, Permission
from slot_core.safety.servo_health import sound_servos
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
    """Sound servos that follow commands."""
    sound = sound_servos(Action.PASS, "", True, np.full(4, 1.1))
    return dataclasses.replace(sound, **changes)


@dataclasses.dataclass(frozen=True)
class Seen(Report):
    """A report with what the servos then do."""

    command: Gated


class Servos:
    """Sound servos behind the command watchdog, which obey the supervisor."""

    def __init__(self, settings):
        self.watchdog = CommandWatchdog(settings.servo_limits, 0.0, ROBOT.tendon.angle_max)
        self.gated = Gated(Action.OFF, np.zeros(4), False, np.zeros(4, dtype=bool))

    def engage(self, angle):
        """Set goals to where the servos are."""
        self.watchdog.engage(angle)
        self.gated = dataclasses.replace(self.gated, angle=np.array(angle))

    def obey(self, now, report, angle):
        """Step at `now` under a report, the servos standing at `angle`."""
        fast = report.state is State.WALKING
        self.watchdog.permit(Permission(now, report.action, fast, report.reason))
        if report.action is Action.HOLD and not self.gated.torque:
            self.watchdog.engage(angle)  # torque comes on
        self.gated = self.watchdog.step(now)
        return self.gated

    def health(self, **changes):
        """What they report."""
        gated, watchdog = self.gated, self.watchdog
        sound = sound_servos(gated.action, watchdog.reason, gated.torque, gated.angle, gated.slewed)
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
        self.servos = Servos(config.replace(read_supervisor(), changes))
        self.health = {}  # what differs from sound servos
        self.reports = []
        self._ticks = 0

    def tick(self):
        """Inputs and one step; the servos follow at once."""
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
            self.chain(now)
        self._ticks += 1
        report = s.step(now)
        gated = self.servos.obey(now, report, self.angle)
        if gated.torque:
            self.angle = gated.angle
        fields = {f.name: getattr(report, f.name) for f in dataclasses.fields(report)}
        seen = Seen(**fields, command=gated)
        self.reports.append(seen)
        return seen

    def chain(self, now):
        """What follows from one odometry reading."""
        if "estimate" not in self.silent:
            estimate = Estimate(now, self.state, np.eye(12), self.validity)
            self.supervisor.receive_estimate(now, estimate)
        if "solver" not in self.silent:
            self.supervisor.receive_solver(now, self.status, self.fallback_cycles)
        if "command" not in self.silent:
            self.supervisor.receive_command(now, now, self.command)
            self.servos.watchdog.offer(now, self.command)

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
        """Make requests, with time for the servos to report between them."""
        for k, request in enumerate(requests):
            if k:
                self.run(0.02)
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
            self.supervisor.receive_command(self.now + 1, self.now + 1, np.full(4, math.nan))
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
        changes = {"estop_required": False, **changes}
        self.supervisor = make(**changes)
        self.servos = Servos(config.replace(read_supervisor(), changes))
        self.servos.engage(self.plant.simulator.tendon_angle)
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
                s.receive_heartbeat(now, node)
            s.receive_gait(now, tick.preview.period)
            s.receive_estimate(now, tick.estimate)
            s.receive_solver(now, tick.result.status, tick.result.fallback_cycles)
            s.receive_command(now, tick.estimate.stamp, tick.command.angle)
            self.servos.watchdog.offer(now, tick.command.angle)
            if k == 14:
                assert s.request(now, Request.READY) == ""
            if k == 15:
                assert s.request(now, Request.STAND) == ""
            yield tick, self._step()

    def _step(self):
        report = self.supervisor.step(self.plant.now)
        gated = self.servos.obey(self.plant.now, report, self.plant.simulator.tendon_angle)
        if gated.torque:
            self.plant.command(gated.angle)
        self.reports.append((self.plant.now * 1e-9 - 1.0, report))
        return report

    def _read(self, readings):
        super()._read(self._listen(readings))

    def _listen(self, readings):
        for r in readings:
            if isinstance(r, JointReading):
                self.supervisor.receive_joints(self.plant.now, r.stamp, r.angle, r.torque)
                self.supervisor.receive_health(self.plant.now, r.stamp, self.servos.health())
                self._step()
            yield r

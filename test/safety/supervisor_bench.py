"""Bench of the supervisor: all its inputs every 10 ms, of which tests omit some by name."""

import dataclasses
import math

import numpy as np

from slot_core import config
from slot_core.control.policy import Status
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.legs.leg_table import read_leg_table
from slot_core.robot import read_robot
from slot_core.safety.rate_limiter import unchanged
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, Request, State
from slot_core.safety.supervisor import Supervisor
from slot_core.safety.tendon_watch import TendonLoad, read_tendon_watch
from slot_core.safety.watchdog import Permission, ServoHealth, Watchdog

ROBOT = read_robot()
TICK = 10_000_000  # ns
START = 1_000_000_000  # ns
STEP = TICK * 1e-9  # s
CYCLE = (
    3 * STEP
)  # s, between two estimates, commands and statuses of the MPC on the bench
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
    """Health of servos that follow commands, without faults but those of `changes`."""
    return ServoHealth(
        Action.PASS, "", np.ones(4, dtype=bool), np.full(4, 1.1), **changes
    )


class SupervisorBench:
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
        self.sources = {
            "button": False
        }  # of the e-stop, by name: whether it is pressed
        self.torque = None  # N m; None: that of the tabulated leg
        self.watchdog = Watchdog(0.0, ROBOT.tendon.angle_max)
        self.watchdog.set_limits(
            config.replace(read_supervisor(), changes).servo_limits
        )
        self.goals = unchanged(Action.OFF, np.zeros(4), False)  # of the servos
        self.health = {}  # differences from servos without faults
        self.reports, self.torque_on = [], []
        self._ticks = 0

    def tick(self):
        """All inputs and one step; the servos follow at once."""
        self.now += TICK
        now, s = self.now, self.supervisor
        for node in self.nodes:
            if node not in self.silent:
                s.receive_heartbeat(now, node)
        for source, pressed in self.sources.items():
            s.receive_estop(now, source, pressed)
        if "servos" not in self.silent:
            torque = load(self.angle) if self.torque is None else self.torque
            s.receive_joints(now, now, self.angle, torque)
            s.receive_health(now, now, self.servo_health())
        if self._ticks % 3 == 0:  # as the odometry, every 30 ms
            self._send_cycle(now)
        self._ticks += 1
        report = s.step(now)
        self.step_servos(now, report)
        self.reports.append(report)
        return report

    def step_servos(self, now, report):
        """Let the servos take the supervisor's report at `now`."""
        self.watchdog.permit(
            Permission(now, report.action, report.followed, report.reason)
        )
        if report.action is Action.HOLD and not self.goals.torque:
            self.watchdog.engage(self.angle)  # torque comes on
        self.goals = self.watchdog.step(now)
        self.torque_on.append(self.goals.torque)
        if self.goals.torque:
            self.angle = self.goals.angle

    def servo_health(self, **changes):
        """Health report of servos without faults but those of `health` and `changes`."""
        goals, on = self.goals, np.full(4, self.goals.torque)
        sound = ServoHealth(
            goals.action, self.watchdog.reason, on, goals.angle, goals.slewed
        )
        return dataclasses.replace(sound, **self.health, **changes)

    def _send_cycle(self, now):
        """Estimate, status of the MPC and command of one odometry reading."""
        if "estimate" not in self.silent:
            estimate = Estimate(now, self.state, np.eye(12), self.validity)
            self.supervisor.receive_estimate(now, estimate)
        if "mpc" not in self.silent:
            self.supervisor.receive_mpc(now, self.status, self.fallback_cycles)
        if "command" not in self.silent:
            self.supervisor.receive_command(now, now, self.command)
            self.watchdog.offer(now, self.command)

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
            self.supervisor.receive_command(
                self.now + 1, self.now + 1, np.full(4, math.nan)
            )
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


def bench_in(wanted):
    """A bench whose robot is in a state."""
    bench = SupervisorBench()
    bench.bring_to(wanted)
    return bench

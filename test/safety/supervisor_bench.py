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
CYCLE = 3 * STEP  # s, between two estimates, commands and statuses of the MPC
STRIDE = 0.6  # s, period of the gait
HEIGHT = 0.04  # m, of the standing robot
LOAD = TendonLoad(read_leg_table(("tension_N",)), ROBOT.tendon.spool_radius)
OVERLOAD = {"hardware_error": np.array([0x20, 0, 0, 0])}
WAYS = {
    State.IDLE: [],
    State.READY: [Request.READY],
    State.STANDING: [Request.READY, Request.STAND],
    State.WALKING: [Request.READY, Request.STAND, Request.WALK],
    State.ESTOP: [Request.ESTOP],
}


def state(roll=0.0, pitch=0.0, yaw=0.0, velocity=(0.0, 0.0)):
    x = np.zeros(12)
    x[:3], x[5], x[9:11] = (roll, pitch, yaw), HEIGHT, velocity
    return x


def load(angle):
    """Torque of the tabulated leg at tendon angles of a standing robot, N m."""
    return LOAD(np.asarray(angle, dtype=float), np.full(4, HEIGHT))[0]


class SupervisorBench:
    """A supervisor with its inputs; those named in `silent` are omitted."""

    def __init__(self, **changes):
        settings = config.replace(read_supervisor(), changes)
        watch = read_tendon_watch(ROBOT, settings.tendon)
        self.supervisor = Supervisor(ROBOT, settings, watch)
        self.now = START
        self.silent = set()
        self.command = np.full(4, 1.1)
        self.angle = np.array([1.0, 1.05, 1.1, 1.15])  # where the servos are
        self.state = state()
        self.validity, self.message = Validity.VALID, ""
        self.deviation = np.zeros(12)  # of the estimate
        self.status = Status.SOLVED
        self.velocity = np.zeros(3)  # commanded
        self.sources = {"button": False}  # of the e-stop: whether it is pressed
        self.torque = None  # N m; None: that of the tabulated leg
        self.watchdog = Watchdog(ROBOT.tendon.angle_max)
        self.watchdog.set_limits(settings.servo_limits)
        self.goals = unchanged(Action.OFF, np.zeros(4), False)  # of the servos
        self.health = {}  # differences from servos without faults
        self.reports = []

    def tick(self):
        """All inputs and one step; the servos follow at once."""
        self.now += TICK
        now, s = self.now, self.supervisor
        for source, pressed in self.sources.items():
            s.receive_estop(now, source, pressed)
        if "servos" not in self.silent:
            torque = load(self.angle) if self.torque is None else self.torque
            s.receive_joints(now, now, self.angle, torque)
            s.receive_health(now, now, self.servo_health())
        if len(self.reports) % 3 == 0:  # as the odometry, every 30 ms
            self._send_cycle(now)
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
            estimate = Estimate(
                now,
                self.state,
                np.diag(self.deviation**2),
                self.validity,
                message=self.message,
            )
            self.supervisor.receive_estimate(now, estimate)
        if "mpc" not in self.silent:
            self.supervisor.receive_mpc(
                now, self.status, 0, STRIDE, self.velocity
            )
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
        """Make requests, with time for the servos to report after each of them."""
        for request in requests:
            assert self.supervisor.request(self.now, request) == ""
            self.run(0.02)


def bench_in(wanted, settings=None, **inputs):
    """A bench whose robot has been in a state for a second; `inputs` as its attributes."""
    bench = SupervisorBench(**settings or {})
    vars(bench).update(inputs)
    bench.run(0.3)
    for request in WAYS[wanted]:
        bench.request(request)
        bench.run(1.0)
    assert bench.supervisor.state is wanted
    return bench

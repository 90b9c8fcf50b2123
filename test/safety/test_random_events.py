"""No sequence of random inputs makes supervisor and watchdog break a rule of safety."""

import math

import numpy as np
from supervisor_bench import ROBOT, SupervisorBench, load, state

from slot_core.estimation.estimate import Estimate, Validity
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Request, State

SETTINGS = read_supervisor()
RELAX_MAX = SETTINGS.gate.relax_time + SETTINGS.timing.torque_change + 0.02  # s
OFF = (State.IDLE, State.ESTOP, State.FAULT)


def random_input(rng, bench, supervisor, steady):
    """One random input, valid or not; returns the request to make, or None."""
    now = bench.now
    wrong = rng.choice(
        [0.0, 1.0, math.nan, math.inf, -1e9], p=[0.9, 0.04, 0.03, 0.02, 0.01]
    )
    stamp = (
        now
        - int(rng.integers(0, 40_000_000))
        + int(rng.choice([0, 10**12], p=[0.99, 0.01]))
    )
    kind = rng.integers(8)
    if kind <= 1:
        near = np.clip(bench.angle + rng.normal(0, 0.02, 4), 0, 2.0)
        angle = (
            near if rng.random() < 0.95 else rng.uniform(0, 2.0, 4)
        ) + wrong
        if not supervisor.receive_command(now, stamp, angle):
            bench.watchdog.offer(steady, angle)
    elif kind == 2:
        tilt = state(*rng.normal(0, 0.13, 2))
        valid = rng.choice(
            list(Validity), p=[0.85, 0.03, 0.06, 0.02, 0.02, 0.02]
        )
        supervisor.receive_estimate(
            now,
            Estimate(stamp, tilt + wrong, np.zeros((12, 12)), Validity(valid)),
        )
    elif kind == 3:
        angle = np.clip(bench.angle + rng.normal(0, 0.01, 4), 0, 2.0)
        torque = load(angle)
        angle[rng.integers(4)] += wrong
        supervisor.receive_joints(now, now, angle, torque)
        bits = rng.choice([0, 0x20], size=4, p=[0.9995, 0.0005])
        supervisor.receive_health(
            now, now, bench.servo_health(hardware_error=bits)
        )
    elif kind == 4:
        supervisor.receive_mpc(
            now,
            int(rng.choice([0, 1, 4], p=[0.9, 0.09, 0.01])),
            0,
            0.6,
            rng.normal(0, 0.05, 3),
        )
    elif kind == 5:
        supervisor.receive_estop(
            now, str(rng.integers(2)), bool(rng.random() < 0.002)
        )
    elif kind == 6:
        return Request(
            rng.choice(
                [*Request, *[Request.READY, Request.STAND, Request.WALK] * 6]
            )
        )
    return None


def test_no_sequence_of_events_violates_the_safety_rules():
    """10,000 random events: range, torque, latched states and the end of RELAX."""
    rng, bench = np.random.default_rng(11), SupervisorBench()
    supervisor, limit = bench.supervisor, ROBOT.tendon.angle_max
    before, relaxing, visited, steady = State.IDLE, 0.0, set(), 0
    for _ in range(10_000):
        jump = int(
            rng.choice([0, -(10**10), 10**10], p=[0.9996, 0.0002, 0.0002])
        )
        tick = int(rng.integers(0, 6_000_000))
        bench.now += tick + jump
        steady += tick
        request = random_input(rng, bench, supervisor, steady)
        granted = (
            request is not None and supervisor.request(bench.now, request) == ""
        )
        middle = supervisor.state
        report = supervisor.step(bench.now)
        bench.step_servos(steady, report)
        # 1: goals are finite and within the range
        assert all(
            0.0 <= angle <= limit for angle in bench.goals.angle.tolist()
        )
        # 2: torque only where the state allows it
        assert not (report.state in OFF and bench.goals.torque)
        # 3: latched states are left only by a granted reset
        for old, new in ((before, middle), (middle, report.state)):
            if old in {State.ESTOP, State.FAULT} and new not in {
                old,
                State.ESTOP,
            }:
                assert (granted, request, new) == (
                    True,
                    Request.RESET,
                    State.IDLE,
                )
        # 4: RELAX ends
        relaxing = (
            relaxing + tick * 1e-9
            if State.RELAX is before is report.state
            else 0.0
        )
        assert relaxing <= RELAX_MAX
        before = report.state
        visited.add(before)
    assert visited == set(State)

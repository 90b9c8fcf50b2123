"""The gait of many robots is that of the gait scheduler; their course that of the command."""

import numpy as np
import pytest

from slot_core.control.force_map import read_springs
from slot_core.gait.gait import moved
from slot_core.gait.gait_scheduler import GaitScheduler

pytest.importorskip("gymnasium", reason="needs scripts/setup --learn")
from slot_lab.learning.gait_clock import GaitClock
from slot_lab.learning.rewards import PLACE, Course
from slot_lab.learning.task import make_task

TASK = make_task()
DT = TASK.gaits.dt
VELOCITY = np.array([[0.05, 0.0, 0.0], [0.03, -0.02, 0.02]])
TICKS = 90


def test_angles_phase_velocity_and_reference_are_those_of_the_scheduler():
    """For robots that lag behind, drift and turn."""
    schedulers = [
        GaitScheduler(TASK.gaits, TASK.robot, read_springs(), TASK.gait, v)
        for v in VELOCITY
    ]
    clock, state = GaitClock(TASK, 2), np.zeros((2, 12))
    rng = np.random.default_rng(0)
    state[:, 5] = 0.04
    clock.reset(np.arange(2), VELOCITY, state)
    for tick in range(TICKS):
        if tick:
            clock.step(state)
        # The preview's posture is linear over its stages, whatever the height does: during the
        # blend, angles a step ahead differ.
        most = 0.02 if tick < 41 else 1e-9
        for i, scheduler in enumerate(schedulers):
            preview = scheduler.step(round(1e9 * DT * tick), state[i])
            if tick:
                ahead, angle = preview.velocity_ahead[0], preview.tendon_angle
                assert clock.phase[i] == pytest.approx(preview.phase, abs=1e-12)
                assert clock.velocity[i] == pytest.approx(ahead, abs=1e-12)
                assert clock.angles[0, i] == pytest.approx(angle[0], abs=1e-9)
                assert clock.angles[1, i] == pytest.approx(angle[1], abs=most)
                assert clock.reference[i] == pytest.approx(
                    preview.reference[0], abs=1e-9
                )
        state = state.copy()
        state[:, 3:5] += DT * np.array([[0.04, 0.005], [0.01, 0.0]])
        state[:, 2] += DT * np.array([0.01, -0.02])
        state[:, [0, 1]] = 0.02 * rng.standard_normal((2, 2))


def test_gaps_are_those_of_the_stray_and_not_of_the_swing():
    faster, aside, turn = 0.004, 0.03, 0.1
    course, state = Course(TASK, 2), np.zeros((2, 12))
    place = np.array([[0.1, 0.2, 0.7], [0.0, 0.0, -3.0]])  # x, y, yaw
    state[:, PLACE] = place
    course.reset(np.arange(2), state)
    for tick in range(1, TICKS):
        place = moved(place, VELOCITY, DT)
        swing = np.sin(2 * np.pi * DT * tick / TASK.stride.period)
        way = np.array([faster * DT * tick + 0.01 * swing, aside, 0.0])
        state[:, PLACE] = moved(place, np.tile(way, (2, 1)), 1.0)
        state[:, PLACE[2]] += turn + 0.03 * swing + 2 * np.pi
        course.step(VELOCITY, state)
    assert course.place == pytest.approx(place, abs=1e-12)
    assert course.stray[::2] == pytest.approx(
        np.tile([[faster], [turn]], 2), abs=1e-3
    )
    assert course.stray[1] == pytest.approx([aside] * 2)

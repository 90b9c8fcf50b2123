"""The gait of many robots is that of the gait scheduler."""

import numpy as np
import pytest

from slot_core.control.force_map import read_springs
from slot_core.gait.gait_scheduler import GaitScheduler

pytest.importorskip("gymnasium", reason="needs scripts/setup --learn")
from slot_lab.learning.gait_clock import GaitClock
from slot_lab.learning.task import make_task

VELOCITY = np.array([[0.05, 0.0, 0.0], [0.03, -0.02, 0.02]])
TICKS = 90


@pytest.fixture(scope="module")
def walked():
    """Clock and schedulers over the ticks, for robots that lag behind, drift and turn."""
    task = make_task()
    dt, rng = task.gaits.dt, np.random.default_rng(0)
    schedulers = [
        GaitScheduler(task.gaits, task.robot, read_springs(), task.gait, v)
        for v in VELOCITY
    ]
    clock, state, rows = GaitClock(task, 2), np.zeros((2, 12)), []
    state[:, 5] = 0.04
    for tick in range(TICKS):
        if tick == 0:
            clock.reset(np.arange(2), VELOCITY, state)
        else:
            clock.step(state)
        previews = [
            scheduler.step(round(1e9 * dt * tick), s)
            for scheduler, s in zip(schedulers, state)
        ]
        rows.append(
            (previews, clock.angles, clock.reference, clock.phase, clock.velocity)
        )
        state = state.copy()
        state[:, 3:5] += dt * np.array([[0.04, 0.005], [0.01, 0.0]])
        state[:, 2] += dt * np.array([0.01, -0.02])
        state[:, [0, 1]] = 0.02 * rng.standard_normal((2, 2))
    return rows


def test_angles_phase_velocity_and_reference_are_those_of_the_scheduler(walked):
    for previews, angles, reference, phase, velocity in walked[1:]:
        for i, preview in enumerate(previews):
            assert phase[i] == pytest.approx(preview.phase, abs=1e-12)
            assert velocity[i] == pytest.approx(preview.velocity_ahead[0], abs=1e-12)
            assert angles[0, i] == pytest.approx(preview.tendon_angle[0], abs=1e-9)
            assert reference[i] == pytest.approx(preview.reference[0], abs=1e-9)


def test_angles_a_step_ahead_differ_during_the_blend_only(walked):
    for tick, (previews, angles, *_) in enumerate(walked[1:]):
        # the preview's posture is linear over its stages, whatever the height does
        most = 0.02 if tick < 40 else 1e-9
        for i, preview in enumerate(previews):
            assert angles[1, i] == pytest.approx(preview.tendon_angle[1], abs=most)


def test_robots_that_start_anew_do_not_change_the_others():
    task, state = make_task(), np.zeros((2, 12))
    clocks = [GaitClock(task, 2), GaitClock(task, 2)]
    for clock in clocks:
        clock.reset(np.arange(2), VELOCITY, state)
        for _ in range(20):
            clock.step(state)
    clocks[0].reset(np.array([1]), VELOCITY[:1], state[:1])
    assert (clocks[0].angles[:, 0] == clocks[1].angles[:, 0]).all()
    assert clocks[0].phase[1] == 0.0 < clocks[1].phase[1]

"""Disturbance observer: a payload, a drift and a tendon that is too long are found."""

import numpy as np
import pytest
from nominal_walk import WALK, torso_of

from slot_core.predictive.disturbance_observer import DisturbanceObserver
from slot_core.predictive.nominal_robot import NominalRobot
from slot_core.predictive.settings import read_predictive
from slot_core.robot import GRAVITY, read_robot
from slot_core.simulation.closed_loop import ClosedLoop

SETTINGS, DT, ANGLE = read_predictive(), 0.033, 1.3
SCALE = np.array([0.02, 0.02, 0.007, 0.002, 0.002, 0.002])


def watched(ticks, drift=(0.0, 0.0, 0.0), wrench=(0.0, 0.0, 0.0)):
    """The observer after it has seen a nominal robot on which a wrench acts, and that drifts."""
    plant, model = (NominalRobot(read_robot(), SETTINGS.nominal, DT) for _ in range(2))
    observer = DisturbanceObserver(model, SETTINGS.observer, SCALE, DT)
    plant.set_wrench(np.array(wrench), 0.0)
    state, command = np.zeros(12), np.full((2, 4), ANGLE)
    state[5] = 0.05
    real = plant.at_rest(state, command[0])
    for _ in range(ticks):
        observer.repeat()
        observer.correct(state)
        model.set_wrench(observer.wrench, 0.0)
        observer.add(model.measured(real, state), state, command)
        real = plant.after(plant.measured(real, state), command)
        state = torso_of(plant, real)
        state[[3, 4, 2]] += DT * np.array(drift)
    return observer


def test_without_a_disturbance_nothing_is_found():
    observer = watched(60)
    assert np.abs(observer.wrench).max() < 1e-9
    assert np.abs(observer.drift).max() < 1e-9


def test_a_wrench_is_found():
    wrench = np.array([-3.0, 0.1, -0.15])
    assert watched(300, wrench=wrench).wrench == pytest.approx(wrench, rel=0.1)


def test_a_drift_is_found_in_the_heading_frame():
    drift = (0.01, -0.005, 0.02)
    assert watched(120, drift=drift).drift == pytest.approx(drift, abs=1e-3)


def test_a_steady_drift_is_no_misfit_but_a_robot_that_moves_otherwise_is():
    observer = watched(120, drift=(0.03, 0.0, 0.05), wrench=(-3.0, 0.0, 0.0))
    assert not observer.is_far
    assert observer.misfit < 1.0
    observer.repeat()
    found = observer.drift[0]
    far = []
    for k in range(200):
        state = np.concatenate([observer._repeated, np.zeros(6)])
        state[2] += 0.2 * (-1) ** k * (k < 60)
        observer.correct(state)
        far.append(observer.is_far)
    assert far.index(True) in range(3, 20)
    assert not far[-1]  # once it moves as the model again
    assert abs(observer.drift[0]) < 0.01 * found


def test_a_forgotten_motion_leaves_the_estimates():
    observer = watched(120, wrench=(-3.0, 0.0, 0.0))
    before = observer.wrench.copy()
    observer.forget()
    observer.repeat()
    observer.correct(np.zeros(12))
    np.testing.assert_array_equal(observer.wrench, before)


@pytest.mark.parametrize("mass", [0.2, 0.4])
def test_a_payload_of_the_walking_robot_is_weighed(mass):
    changes = {"scene.payload.mass": mass}
    last = list(ClosedLoop("flat", "walk", WALK, 1, "predictive", changes=changes).run(200))[-60:]
    weight = np.mean([-tick.plan.report.wrench[0] for tick in last])
    empty = list(ClosedLoop("flat", "walk", WALK, 1, "predictive").run(200))[-60:]
    weight += np.mean([tick.plan.report.wrench[0] for tick in empty])  # of the model's own error
    assert weight / GRAVITY == pytest.approx(mass, rel=0.3)

"""Disturbance observer: a wrench and a drift are found, and a robot unlike its model."""

import numpy as np
import pytest
from nominal_walk import ROBOT, SETTINGS, torso_of

from slot_core.rollout_mpc.disturbance_observer import DisturbanceObserver
from slot_core.rollout_mpc.nominal_robot import NominalRobot

DT, ANGLE = 0.033, 1.3
SCALE = np.array([0.02, 0.02, 0.007, 0.002, 0.002, 0.002])


class Watch:
    """The observer, and a nominal robot on which a wrench acts and that drifts."""

    def __init__(self, drift=(0.0, 0.0, 0.0), wrench=(0.0, 0.0, 0.0)):
        self.plant, self.model = (
            NominalRobot(ROBOT, SETTINGS.nominal, DT) for _ in range(2)
        )
        self.observer = DisturbanceObserver(
            self.model, SETTINGS.observer, SCALE, DT
        )
        self.plant.set_wrench(np.array(wrench), 0.0)
        self.state, self.command = np.eye(12)[5] * 0.05, np.full((2, 4), ANGLE)
        self.real = self.plant.at_rest(self.state, self.command[0])
        self.drift = np.array(drift)

    def go_on(self, ticks, yaw=0.0, walks=True):
        """The observer after so many ticks, with an error of their yaw (rad)."""
        for _ in range(ticks):
            self.model.set_wrench(self.observer.wrench, 0.0)
            seen = self.state + np.eye(12)[2] * yaw
            start = self.model.measured(self.real, self.state)
            self.observer.observe(start, seen, self.command[0], walks)
            self.real = self.plant.after(
                self.plant.measured(self.real, self.state), self.command
            )
            self.state = torso_of(self.plant, self.real)
            self.state[[3, 4, 2]] += DT * self.drift
        return self.observer


NOTHING, WRENCH, DRIFT = (
    (0.0, 0.0, 0.0),
    (-3.0, 0.1, -0.15),
    (0.01, -0.005, 0.02),
)


@pytest.mark.parametrize(
    ("wrench", "drift"),
    [(NOTHING, NOTHING), (WRENCH, NOTHING), (NOTHING, DRIFT)],
)
def test_a_wrench_and_a_drift_in_the_heading_frame_are_found(wrench, drift):
    found = Watch(drift, wrench).go_on(300 if wrench is WRENCH else 120)
    assert found.wrench == pytest.approx(wrench, rel=0.1, abs=1e-9)
    assert found.drift == pytest.approx(drift, abs=1e-3)


def test_a_steady_drift_is_no_misfit_but_for_a_robot_that_moves_otherwise_the_floor_grips():
    watch = Watch(drift=(0.03, 0.0, 0.05), wrench=(-3.0, 0.0, 0.0))
    assert watch.go_on(120).misfit < 1.0
    frictions = [
        watch.go_on(1, 0.1 * (-1) ** k) and watch.model.friction
        for k in range(60)
    ]
    assert frictions.index(SETTINGS.observer.friction) in range(3, 20)
    assert frictions[-1] == SETTINGS.observer.friction


def test_a_turn_in_place_is_no_sign_of_a_floor_that_grips():
    watch = Watch()
    for k in range(60):
        watch.go_on(1, 0.1 * (-1) ** k, walks=False)
    assert watch.model.friction == SETTINGS.nominal.friction


def test_a_forgotten_motion_leaves_the_estimates():
    watch = Watch(wrench=(-3.0, 0.0, 0.0))
    before = watch.go_on(120).wrench.copy()
    watch.observer.forget()
    np.testing.assert_array_equal(
        watch.go_on(SETTINGS.observer.window).wrench, before
    )
    assert not np.array_equal(watch.go_on(1).wrench, before)

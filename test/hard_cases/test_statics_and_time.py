"""The fold, long standing, and time steps from 0.5 to 10 ms."""

import numpy as np
import pytest

from benchmarks.robot.hard_cases import FOLDS, STEPS
from benchmarks.robot.stress import examine
from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot

HELD = config.replace(read_servo(), {"model": "torque_speed"})  # holds its angle under load


@pytest.mark.parametrize("name", FOLDS)
def test_the_path_through_the_fold_stays_within_its_limits(name):
    record = examine(FOLDS[name])
    assert record.holds(FOLDS[name].limits), record


@pytest.mark.parametrize("name", STEPS)
def test_a_time_step_stays_within_its_limits(name):
    record = examine(STEPS[name])
    assert record.holds(STEPS[name].limits), record
    assert not record.unconverged


def stand(scene, seconds, **changes):
    """Largest displacement of torso or nodes, mm, over the whole time and over its last sixth."""
    changes = {name.replace("__", "."): value for name, value in changes.items()}
    sim = RodRobot(read_robot(), config.replace(read_scene(scene), changes), HELD)
    places = []
    for _ in range(7):
        places.append(np.append(sim.nodes.reshape(-1, 3), [sim.position], axis=0))
        sim.advance(round(seconds / 6 / sim.scene.solver.step), sim.tendon_angle)
    moved = [np.linalg.norm(place - places[-1], axis=1).max() for place in places]
    return 1e3 * moved[0], 1e3 * moved[-2]


@pytest.mark.parametrize("step", [1e-3, 5e-4])
def test_a_minute_of_standing_on_bristles_creeps_less_than_a_tenth_of_a_millimetre(step):
    # It has settled for 1 s; the remaining oscillation has decayed after ten more.
    moved, late = stand("stick", 60.0, solver__step=step)
    assert moved < 0.1
    assert late < 1e-6  # no creep: rounding over 10 000 steps


def test_viscous_friction_creeps_where_bristles_hold():
    """On an incline of 5 deg, at eps tan(slope) / mu = 0.2 mm/s."""
    creeping = stand("slope5", 3.0)[1] / 0.5
    sticking = stand("slope5", 3.0, floor__friction_law="bristle")[1] / 0.5
    assert 0.1 < creeping < 0.3  # mm/s
    assert sticking < 0.01 * creeping

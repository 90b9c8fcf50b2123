"""Falls, pulls, ends of ranges, folds, time steps: finite, no energy gain, same result at h/2."""

import dataclasses

import numpy as np
import pytest

from benchmarks.robot.hard_cases import (
    FOLDS,
    IMPACTS,
    PARAMETERS,
    PULLS,
    STEPS,
    examine,
)
from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot

HELD = config.replace(
    read_servo(), {"model": "torque_speed"}
)  # holds its angle under load
CONVERGED = {**PULLS, **PARAMETERS, **STEPS}  # in every step
CASES = {**IMPACTS, **FOLDS, **CONVERGED}


@pytest.mark.parametrize("name", CASES)
def test_a_hard_case_stays_within_its_limits(name):
    record = examine(CASES[name])
    assert record.holds(CASES[name].limits), record
    assert not (name in CONVERGED and record.unconverged)


@pytest.mark.parametrize(
    "name", ["full pull within one step, in the air", "contact of 1e7 N/m", "EA x 100"]
)
def test_the_case_diverges_without_halving(name):
    case = CASES[name]
    assert examine(case).halvings > 0
    whole = dataclasses.replace(case, scene={**case.scene, "solver.halvings": 0})
    assert "beyond 100.0 m/s" in examine(whole).lost


def test_the_correction_limit_must_scale_with_the_contact_stiffness():
    """At 1e7 N/m a correction that is acceptable on the soft floor gains energy."""
    case = PARAMETERS["contact of 1e7 N/m"]
    # Allows a position error of 0.25 mm, as on the floor of 2e4 N/m.
    loose = {**case.scene, "solver.correction_limit": 0.3}
    assert examine(dataclasses.replace(case, scene=loose)).gained > case.limits.gained


def test_every_step_with_a_pivot_that_is_not_positive_is_halved():
    """Also with an unlimited correction; halving at such pivots alone would not save the case."""
    case = PARAMETERS["EA x 100"]
    scene = config.replace(
        read_scene("flat"), {**case.scene, "solver.correction_limit": 1e6}
    )
    sim = RodRobot(read_robot(), scene, read_servo())
    case.start(sim)
    seen = []
    for _ in range(100):
        before = sim.indefinite_steps, sim.halvings
        sim.advance(1, np.full(4, 1.1))
        seen.append((sim.indefinite_steps > before[0], sim.halvings > before[1]))
    assert (True, True) in seen
    assert (True, False) not in seen


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
def test_a_minute_of_standing_on_bristles_creeps_less_than_a_tenth_of_a_millimetre(
    step,
):
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

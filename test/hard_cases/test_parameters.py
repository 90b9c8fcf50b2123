"""Material, contact, friction, nodes and masses at the ends of their ranges."""

import dataclasses

import numpy as np
import pytest

from benchmarks.robot.hard_cases import PARAMETERS
from benchmarks.robot.stress import examine
from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_at_the_end_of_its_range_stays_within_its_limits(name):
    record = examine(PARAMETERS[name])
    assert record.holds(PARAMETERS[name].limits), record
    assert not record.unconverged


@pytest.mark.parametrize("name", ["contact of 1e7 N/m", "EA x 100"])
def test_the_case_diverges_without_halving(name):
    case = PARAMETERS[name]
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
    scene = config.replace(read_scene("flat"), {**case.scene, "solver.correction_limit": 1e6})
    sim = RodRobot(read_robot(), scene, read_servo())
    case.start(sim)
    seen = []
    for _ in range(100):
        before = sim.indefinite_steps, sim.halvings
        sim.advance(1, np.full(4, 1.1))
        seen.append((sim.indefinite_steps > before[0], sim.halvings > before[1]))
    assert (True, True) in seen
    assert (True, False) not in seen

"""Material, contact, friction, nodes and masses at the ends of their ranges."""

import dataclasses

import pytest

from slot_core.evaluation.hard_cases import PARAMETERS
from slot_core.evaluation.stress import examine


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_at_the_end_of_its_range_keeps_its_limits(name):
    record = examine(PARAMETERS[name])
    assert record.holds(PARAMETERS[name].limits), record
    assert not record.unconverged


@pytest.mark.parametrize("name", ["contact of 1e7 N/m", "EA x 100"])
def test_it_is_the_halving_that_keeps_it(name):
    case = PARAMETERS[name]
    assert examine(case).halvings > 0
    whole = dataclasses.replace(case, scene={**case.scene, "solver.halvings": 0})
    assert "beyond 100.0 m/s" in examine(whole).lost


def test_the_limit_of_the_correction_follows_the_contact():
    """At 1e7 N/m a correction that the soft floor bears is energy from nowhere."""
    case = PARAMETERS["contact of 1e7 N/m"]
    # What leaves a node misplaced by 0.25 mm, as on the floor of 2e4 N/m.
    loose = {**case.scene, "solver.correction_limit": 0.3}
    assert examine(dataclasses.replace(case, scene=loose)).gained > case.limits.gained

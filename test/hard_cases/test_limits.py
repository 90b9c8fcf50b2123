"""Falls, pulls, ends of ranges, folds, time steps: finite, no energy gain, same result at h/2."""

import dataclasses

import pytest
from stress_cases import (
    FOLDS,
    IMPACTS,
    IN_SPACE,
    PARAMETERS,
    PULLS,
    STEPS,
    examine,
)

CONVERGED = {**PULLS, **PARAMETERS, **STEPS}  # in every step
CASES = {**IMPACTS, **FOLDS, **IN_SPACE, **CONVERGED}


@pytest.mark.parametrize("name", CASES)
def test_a_hard_case_stays_within_its_limits(name):
    record = examine(CASES[name])
    assert record.holds(CASES[name].limits), record
    assert not (name in CONVERGED and record.unconverged)


@pytest.mark.parametrize(
    "name",
    ["full pull within one step, in the air", "contact of 1e7 N/m", "EA x 100"],
)
def test_the_case_diverges_without_halving(name):
    case = CASES[name]
    assert examine(case).halvings > 0
    whole = dataclasses.replace(
        case, scene={**case.scene, "solver.halvings": 0}
    )
    assert "beyond 100.0 m/s" in examine(whole).lost

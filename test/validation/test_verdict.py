"""Verdict of a comparison: explained or not, with its reason."""

import math

import numpy as np
import pytest

from slot_lab.calibration.fit import FitProblem, Parameter, estimate
from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED, Verdict


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        (
            Verdict(30.0, 20),
            EXPLAINED,
            "verdict: explained: chi-square 30 on 20 degrees of",
        ),
        (
            Verdict(2100.0, 1000),
            NOT_EXPLAINED,
            "2.1 each, limit 2",
        ),  # no chance with so many
        (Verdict(9.0, 2), EXPLAINED, "4.5 each, limit 4.61"),  # 1 % by chance
        (Verdict(181.0, 10), NOT_EXPLAINED, "18.1 each"),
        (Verdict(math.nan, 10), NOT_EXPLAINED, "nan"),
        (
            Verdict(1.0, 10, ["scene.floor.friction"]),
            NOT_EXPLAINED,
            "at its bound: scene.floor.friction",
        ),
        (Verdict(0.0, 0), NOT_EXPLAINED, "no more data than free parameters"),
    ],
)
def test_a_verdict_is_by_the_residuals_per_degree_of_freedom_and_the_bounds(
    given, code, said
):
    assert given.code == code
    assert said in given.line


def test_a_parameter_at_its_bound_is_named_if_the_data_determine_it():
    """a would be 1.2; c is at its bound too, but has no influence."""
    x = np.arange(20.0)
    parameters = tuple(Parameter(name, 0.5, 0.0, 1.0) for name in "abc")
    problem = FitProblem(
        parameters, lambda v: v[0] + v[1] * x, 1.2 + 0.3 * x, np.ones(20)
    )
    assert estimate(problem, [1.0, 0.32, 1.0]).at_bound("abc") == ["a"]
    assert estimate(problem, [0.9, 0.32, 1.0]).at_bound("abc") == []

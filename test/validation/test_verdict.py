"""Verdict of a comparison: explained or not, with its reason."""

import math

import pytest

from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED, Verdict


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        (Verdict(30.0, 20), EXPLAINED, "verdict: explained: chi-square 30 on 20 degrees of"),
        (Verdict(2100.0, 1000), NOT_EXPLAINED, "2.1 each, limit 2"),  # no chance with so many
        (Verdict(9.0, 2), EXPLAINED, "4.5 each, limit 4.61"),  # 1 % by chance
        (Verdict(181.0, 10), NOT_EXPLAINED, "18.1 each"),
        (Verdict(math.nan, 10), NOT_EXPLAINED, "nan"),
        (Verdict(1.0, 10, ["scene.floor.friction"]), NOT_EXPLAINED,
         "at its bound: scene.floor.friction"),
        (Verdict(0.0, 0), NOT_EXPLAINED, "no more data than free parameters"),
    ],
)  # fmt: skip
def test_a_verdict_is_by_the_residuals_per_degree_of_freedom_and_the_bounds(given, code, said):
    assert given.code == code
    assert said in given.line

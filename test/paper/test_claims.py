"""The paper's claims and tables: the arithmetic behind the verdicts."""

import math

import pytest

from slot_core.robot import read_robot
from slot_paper.claims import CLAIMS, VERDICTS
from slot_paper.force_map import ForceAngleLine
from slot_paper.tables import judge


def test_every_claim_has_one_of_four_verdicts_and_a_reason():
    assert len(CLAIMS) > 40
    for claim in CLAIMS:
        assert claim.verdict in VERDICTS
        assert claim.place
        assert claim.reason
    assert len({claim.text for claim in CLAIMS}) == len(CLAIMS)


def test_what_the_papers_own_numbers_refute_is_so():
    weight, line = read_robot().weight, ForceAngleLine(6.91, 0.107)
    assert pytest.approx(1.58) == 4 * 0.35 + 0.18  # ms, of a step of 0.1 ms
    assert 3 * 6.0 < weight < 4 * 6.0
    assert math.degrees(line.angle(6.0)) == pytest.approx(120.65, abs=0.01)
    assert math.degrees(line.angle(5.532)) == pytest.approx(116.28, abs=0.01)
    assert math.degrees(line.angle(weight / 4)) == pytest.approx(114.1, abs=0.1)
    assert math.hypot(0.052, 0.09) == pytest.approx(0.104, abs=1e-4)
    assert pytest.approx(0.495) == 15 * 0.033


@pytest.mark.parametrize(
    ("judged", "paper", "ours", "verdict"),
    [
        ("equal", 2.0, 2.009, "reproduced"),
        ("equal", 2.0, 2.011, "not reproduced"),
        ("equal", 0.0, 0.0, "reproduced"),
        ("smaller", 2.0, 1.0, "better"),
        ("smaller", 2.0, 2.009, "equal"),
        ("smaller", 2.0, 3.0, "worse"),
        ("larger", 2.0, 3.0, "better"),
        ("larger", 0.08, 0.08, "equal"),
        ("larger", "never", 3.0, ""),
        ("", 2.0, 2.0, ""),
    ],
)
def test_a_figure_is_judged_by_its_number(judged, paper, ours, verdict):
    assert judge(judged, paper, ours) == verdict

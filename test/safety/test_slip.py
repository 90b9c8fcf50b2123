"""Supervised walks on slopes: the supervisor says that the robot slides, and stops it."""

import math

import pytest

from slot_core.robot import GRAVITY
from slot_core.safety.states import State
from slot_core.simulation.supervised_loop import SupervisedLoop


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("across_deg", "line", "ends"),
    [
        (0.0, "", State.WALKING),
        (9.0, "slides", State.WALKING),
        (14.0, "slides", State.HOLD),
    ],
)
def test_a_walk_across_a_slope_says_that_it_slides(
    across_deg, line, ends, seed
):
    """Limits 15 and 50 mm/s; slides 2, 28, and more than 70 mm/s aside over 5 s."""
    slope = math.radians(across_deg)
    down = (0.0, -GRAVITY * math.sin(slope), -GRAVITY * math.cos(slope))
    *_, report = SupervisedLoop(
        "flat", "walk", None, seed, changes={"scene.gravity": down}
    ).run(7.0)
    assert report.state is ends
    assert [w[:6] for w in report.warnings] == [line] * bool(line)

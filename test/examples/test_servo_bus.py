"""The example of the servo bus moves one tendon and ends with torque off."""

import re
import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "scripts" / "examples" / "servo_bus.py"


def test_the_example_moves_one_tendon_to_its_goal_and_ends_with_torque_off(capsys):
    end = runpy.run_path(str(EXAMPLE))
    lines = capsys.readouterr().out.splitlines()
    angles = [
        float(angle) for line in lines for angle in re.findall(r"([\d.]+) rad", line)
    ]
    assert angles[0] == pytest.approx(0.2, abs=0.002)  # one count of the encoder
    # below the goal by the droop of a proportional controller under load
    assert angles[-1] == pytest.approx(1.0, abs=0.03)
    assert end["servos"].angles()[1:] == pytest.approx(0.2, abs=0.03)
    assert lines[-1] == "torque off"
    assert end["servos"].powered() == ()

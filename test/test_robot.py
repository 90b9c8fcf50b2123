"""Geometry, masses and frames of the robot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.robot import LEGS, read_parameters, read_robot


@pytest.fixture
def robot():
    return read_robot()


def test_legs_are_those_of_the_paper_in_the_order_fl_fr_rl_rr(robot):
    assert LEGS == ("FL", "FR", "RL", "RR")
    # x forward, y left (REP-103)
    corners = [[1, 1], [1, -1], [-1, 1], [-1, -1]]
    reach = robot.feet - robot.clamps
    for places in (robot.clamps, robot.outward, reach):
        assert np.sign(places[:, :2]).tolist() == corners
    assert np.linalg.norm(reach[:, :2], axis=1) == pytest.approx(
        robot.leg.reach
    )
    # the authors drew the leg from z = 21.75 mm down to the floor
    assert -reach[:, 2] == pytest.approx(0.02175, abs=1e-5)
    # the paper rounds the leg to 0.04 kg; the tapered leg of 1200 kg/m^3 weighs 0.039 kg
    assert robot.leg.mass == pytest.approx(0.04, abs=1.1e-3)
    assert robot.mass == pytest.approx(2.16, abs=5e-3)


def test_arc_length_agrees_with_a_fine_polyline(robot):
    x = np.linspace(0, robot.leg.reach, 200_001)
    z = np.polyval(robot.leg.natural_shape, x)
    # a polyline's error is of the order of (curvature dx)^2 L: far below 1e-10 here
    polyline = np.hypot(np.diff(x), np.diff(z)).sum()
    assert robot.leg.arc_length() == pytest.approx(polyline, abs=1e-10)


def test_torso_inertia_is_that_of_a_box(robot):
    share = np.random.default_rng(0).random((400_000, 3)) - 0.5
    square = robot.torso.mass * np.mean((share * robot.torso.size) ** 2, axis=0)
    # the Monte Carlo error of 4e5 samples is about 0.2 %
    sampled = square.sum() - square
    assert np.diag(robot.torso.inertia) == pytest.approx(sampled, rel=0.01)


def test_legs_raise_the_inertia_by_their_mass_times_distance_squared(robot):
    """I_z grows by 4 m r^2, to about twice, with an r between clamp and foot."""
    added = robot.inertia[2, 2] - robot.torso.inertia[2, 2]
    r = np.sqrt(added / (4 * robot.leg.mass))
    assert np.hypot(*robot.clamps[0, :2]) < r < np.hypot(*robot.feet[0, :2])
    # by symmetry
    assert robot.inertia == pytest.approx(
        np.diag(robot.inertia.diagonal()), abs=1e-15
    )


def test_clamp_heights_are_those_of_the_rotated_torso(robot):
    low, high = [0.03, -0.3, -0.3], [0.07, 0.3, 0.3]
    posture = np.random.default_rng(0).uniform(low, high, (20, 3))
    turns = (Rotation.from_euler("xy", tilt) for tilt in posture[:, 1:])
    turned = np.array([turn.apply(robot.clamps) for turn in turns])[..., 2]
    expected = turned + posture[:, :1]
    assert robot.clamp_heights(*posture.T) == pytest.approx(expected)
    assert robot.clamp_heights(*posture[0]) == pytest.approx(expected[0])


def test_the_parameter_set_named_in_the_robots_file_changes_its_values_and_nothing_else(
    robot, own_config
):
    paper = read_robot("paper")
    assert paper.leg.young_modulus == 1e7  # as printed
    assert paper == config.replace(robot, read_parameters("paper"))
    path = own_config / "robot.yaml"
    path.write_text(path.read_text().replace("calibrated", "paper"))
    assert read_robot() == paper != read_robot("calibrated")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            "{leg.width: 0.02}",
            r"^parameters/own\.yaml: leg\.width is set in robot\.yaml too",
        ),
        ("{leg.wiidth: 0.02}", r"leg\.wiidth is not a setting"),
        ("{width: 0.02}", r"width is not a setting"),
        ("{leg.width.deep: 1}", r"leg\.width\.deep is not a setting"),
        ("{leg.slack: 1}", r"leg\.slack is not a setting"),
        (
            "{leg.young_modulus: 1.0}",
            r"leg\.young_modulus = 1\.0: outside \[100000\.0, .*\] Pa",
        ),
        (
            "{leg.young_modulus: soft}",
            r"leg\.young_modulus = 'soft': expected a number",
        ),
        ("{leg.young_modulus: 1e7}", r"tendon\.offset is missing"),
        ("[1]", r"^parameters/own\.yaml: values is missing"),
        ("", r"^parameters/own\.yaml: values is missing"),
    ],
)
def test_an_invalid_parameter_set_is_refused(own_config, values, message):
    (own_config / "parameters" / "own.yaml").write_text(f"values: {values}")
    with pytest.raises(config.ConfigError, match=message):
        read_robot("own")


def test_an_unknown_or_missing_parameter_set_is_refused_with_the_known_ones(
    own_config,
):
    known = r"'parameters/x' \(known: calibrated, paper, relaxing, synthetic\)"
    with pytest.raises(config.ConfigError, match=known):
        read_robot("x")
    (own_config / "robot.yaml").write_text("torso: {}")
    with pytest.raises(
        config.ConfigError, match=r"^robot\.yaml: parameters is miss"
    ):
        read_robot()

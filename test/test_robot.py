"""Geometry, masses and frames of the robot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.robot import LEGS, read_parameters, read_robot


@pytest.fixture
def robot():
    return read_robot()


def test_leg_order_is_front_left_front_right_rear_left_rear_right(robot):
    assert LEGS == ("FL", "FR", "RL", "RR")
    # x forward, y left (REP-103)
    assert np.sign(robot.clamps[:, :2]).tolist() == [[1, 1], [1, -1], [-1, 1], [-1, -1]]
    assert np.sign(robot.outward[:, :2]).tolist() == [
        [1, 1],
        [1, -1],
        [-1, 1],
        [-1, -1],
    ]


def test_mass_is_that_of_the_paper(robot):
    # the paper rounds the leg to 0.04 kg; the tapered leg of 1200 kg/m^3 weighs 0.039 kg
    assert robot.leg.mass == pytest.approx(0.04, abs=1.1e-3)
    assert robot.mass == pytest.approx(2.16, abs=5e-3)


def test_arc_length_agrees_with_a_fine_polyline(robot):
    x = np.linspace(0, robot.leg.reach, 200_001)
    z = np.polyval(robot.leg.natural_shape, x)
    # a polyline's error is of the order of (curvature dx)^2 L: far below 1e-10 here
    assert robot.leg.arc_length() == pytest.approx(
        np.hypot(np.diff(x), np.diff(z)).sum(), abs=1e-10
    )


def test_torso_inertia_is_that_of_a_box(robot):
    a, b, c = robot.torso.size
    rng = np.random.default_rng(0)
    points = (rng.random((400_000, 3)) - 0.5) * [a, b, c]
    square = points.T @ points / len(points) * robot.torso.mass
    sampled = np.trace(square) * np.eye(3) - square
    # the Monte Carlo error of 4e5 samples is about 0.2 %
    assert np.diag(robot.torso.inertia) == pytest.approx(np.diag(sampled), rel=0.01)


def test_legs_raise_the_inertia_by_their_mass_times_distance_squared(robot):
    """The legs raise the inertia to 1.8 to 2.2 times that of the torso.

    The mass of a leg lies 0.07 to 0.28 m from the centre, so I_z grows by 4 m r^2 with an r in
    between.
    """
    added = robot.inertia[2, 2] - robot.torso.inertia[2, 2]
    r = np.sqrt(added / (4 * robot.leg.mass))
    assert np.hypot(*robot.clamps[0, :2]) < r < np.hypot(*robot.feet[0, :2])
    off_diagonal = robot.inertia - np.diag(np.diag(robot.inertia))
    assert np.abs(off_diagonal).max() < 1e-15  # by symmetry


def test_feet_stand_below_the_clamps_on_the_natural_shape(robot):
    reach = robot.feet - robot.clamps
    assert np.linalg.norm(reach[:, :2], axis=1) == pytest.approx(robot.leg.reach)
    # the authors drew the leg from z = 21.75 mm down to the floor
    assert -reach[:, 2] == pytest.approx(0.02175, abs=1e-5)


def test_clamp_heights_are_those_of_the_rotated_torso(robot):
    posture = np.random.default_rng(0).uniform(
        [0.03, -0.3, -0.3], [0.07, 0.3, 0.3], (20, 3)
    )
    rotated = [
        Rotation.from_euler("xy", [r, p]).apply(robot.clamps) for _, r, p in posture
    ]
    expected = np.array(rotated)[..., 2] + posture[:, :1]
    assert robot.clamp_heights(*posture.T) == pytest.approx(expected)
    assert robot.clamp_heights(*posture[0]) == pytest.approx(expected[0])


def test_another_parameter_set_changes_its_values_and_nothing_else(robot):
    paper, values = read_robot("paper"), read_parameters("paper")
    assert paper.leg.young_modulus == 1e7  # as printed
    assert paper == config.replace(robot, values)


def test_robot_uses_the_parameter_set_named_in_its_file(own_config):
    path = own_config / "robot.yaml"
    path.write_text(
        path.read_text().replace("parameters: calibrated", "parameters: paper")
    )
    assert read_robot() == read_robot("paper") != read_robot("calibrated")


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


def test_an_unknown_parameter_set_names_the_known_ones():
    with pytest.raises(
        config.ConfigError,
        match=r"'parameters/x' \(known: calibrated, paper, relaxing, synthetic\)",
    ):
        read_robot("x")


def test_a_robot_without_a_parameter_set_is_refused(own_config):
    (own_config / "robot.yaml").write_text("torso: {}")
    with pytest.raises(
        config.ConfigError, match=r"^robot\.yaml: parameters is missing"
    ):
        read_robot()

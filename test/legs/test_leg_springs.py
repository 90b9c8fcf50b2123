"""Legs as springs: the table of their statics against scipy's interpolation."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from slot_core import config
from slot_core.dynamics.scene import level_changes, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.fingerprint import LEG, fingerprint, misfit
from slot_core.legs.leg_table import (
    COLUMNS,
    legs_message,
    read_leg_springs,
    read_leg_table,
    rest_pose,
    stiffness_ratio,
)
from slot_core.robot import read_robot
from slot_core.simulation.make_robot import make_robot

ROBOT = read_robot()
STANDING = np.array([1.3, 1.3, 1.2, 1.2])  # rad, nose up by 1.2 deg
AT_REST = [(0.75, 0.0, 0.4), (1.0, 0.0, 0.1), (1.0, 0.4, 0.8), (1.3, 0.8, 0.4)]
SLOPE_MIN = 4.0  # N/rad


@pytest.fixture(scope="module")
def springs():
    return read_leg_springs(SLOPE_MIN)


@pytest.fixture(scope="module")
def table():
    return read_leg_table(COLUMNS)


def test_force_slope_stiffness_and_contact_are_those_of_a_bilinear_interpolation(
    springs, table
):
    """By SciPy, with angle and height moved to the table's edges; arrays of any shape."""
    rng, shape = np.random.default_rng(0), (500, 4)
    angle, height = (
        rng.uniform(-0.2, 2.4, shape),
        rng.uniform(-0.01, 0.15, shape),
    )
    grid = table.angle, table.height
    inside = [np.clip(v, g[0], g[-1]) for v, g in zip((angle, height), grid)]
    exact = RegularGridInterpolator(grid, table.table)(
        np.stack(inside, axis=-1)
    )
    force, slope, stiffness, contact = np.moveaxis(exact, -1, 0)
    found = springs.at(angle, height)
    # both bounds are active somewhere
    assert slope.min() < SLOPE_MIN
    assert stiffness.max() > 0.0
    np.testing.assert_allclose(found.force, force, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found.slope, np.maximum(slope, SLOPE_MIN), atol=1e-12
    )
    np.testing.assert_allclose(
        found.stiffness, np.minimum(stiffness, 0.0), atol=1e-10
    )
    np.testing.assert_allclose(found.contact, contact, rtol=0, atol=1e-14)


def test_the_angle_of_a_force_is_the_least_one_that_gives_it(springs, table):
    """Beyond the fold the force falls and rises again: more than one angle may carry it.

    A force beyond the table has its largest or smallest angle.
    """
    rng = np.random.default_rng(2)
    height = rng.uniform(0.03, 0.075, 500)
    force = rng.uniform(2.0, ROBOT.weight / 4 * 1.05, 500)
    angle = springs.angle(force, height)
    np.testing.assert_allclose(
        springs.at(angle, height).force, force, rtol=0, atol=1e-9
    )
    below = np.linspace(0.0, angle - 1e-6, 500)
    assert (springs.at(below, np.tile(height, (500, 1))).force < force).all()
    beyond = springs.angle(np.array([1e3, -1e3]), np.array([0.04, 0.04]))
    assert beyond == pytest.approx([table.angle[-1], table.angle[0]])


@pytest.mark.parametrize(
    "content", ["", "theta_deg,height_m\n1,2\n", "a,b\n1\n2,3\n"]
)
def test_a_table_that_is_no_grid_is_rejected(tmp_path, monkeypatch, content):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    (tmp_path / "leg_map.csv").write_text(content)
    with pytest.raises(config.ConfigError, match=r"^leg_map\.csv: "):
        read_leg_springs(SLOPE_MIN)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"leg.young_modulus": 0.82 * ROBOT.leg.young_modulus}, ""),
        ({"leg.azimuth_deg": [60.0, -60.0, 120.0, -120.0]}, ""),  # of a gait
        (
            {"leg.young_modulus": 1.3 * ROBOT.leg.young_modulus},
            "leg.young_modulus = 2.6e+07 Pa, robot.yaml says 3.38e+07 Pa;",
        ),
        (
            {"leg.reach": 0.15, "leg.width": 0.025},
            "leg.reach = 0.19 m, robot.yaml says 0.15 m; scripts/tune leg makes",
        ),
        (
            {"leg.natural_shape": [6.356, -1.5, 0.0, 0.02175]},
            "leg.natural_shape = 6.356 -1.81 0 0.02175, robot.yaml says 6.356",
        ),
    ],
)
def test_the_leg_of_another_print_is_its_own_and_of_another_one_the_parameter_is_named(
    changes, line
):
    found = misfit(
        fingerprint(ROBOT, LEG), config.replace(ROBOT, changes), "leg_map.csv"
    )
    assert found.startswith(line and f"leg_map.csv was made for {line}")
    assert bool(found) == bool(line)


@pytest.mark.parametrize(("modulus", "payload", "friction"), AT_REST)
def test_height_and_angles_at_rest_tell_the_stiffness_ratio(
    springs, modulus, payload, friction
):
    """Rods that stood up: within 6 %: 4 % by friction, 3 % by the cable, which does not scale."""
    robot = config.replace(
        ROBOT, {"leg.young_modulus": modulus * ROBOT.leg.young_modulus}, "robot"
    )
    changes = {
        **level_changes("coarse"),
        "start.tendon_angle_deg": 0.0,
        "payload.mass": payload,
        "floor.friction": [friction] * 4,
        "floor.friction_other": [friction] * 4,
    }
    scene = config.replace(read_scene("flat"), changes, "scene")
    rods = make_robot(robot, scene, read_servo())
    lying = np.array([rods.position[2], *rods.rpy[:2]])
    assert lying == pytest.approx(
        rest_pose(ROBOT, springs, rods.tendon_angle), abs=5e-4
    )
    for share in np.linspace(0.0, 1.0, 50):
        rods.advance(5, share * STANDING)
    rods.advance(500, STANDING)
    pose = np.array([rods.position[2], *rods.rpy[:2]])
    ratio = modulus * ROBOT.mass / (ROBOT.mass + payload)
    assert stiffness_ratio(
        ROBOT, springs, rods.tendon_angle, pose
    ) == pytest.approx(ratio, rel=0.06)
    expected = rest_pose(ROBOT, springs, rods.tendon_angle, ratio)
    assert pose[0] == pytest.approx(expected[0], abs=2.5e-3)
    assert pose[1:] == pytest.approx(expected[1:], abs=np.radians(0.3))


@pytest.mark.parametrize(
    ("ratio", "stiffness", "line"),
    [
        (0.95, np.nan, ""),
        (
            0.84,
            np.nan,
            "legs 16% softer than the table, or 0.4 kg more load",
        ),
        (0.84, 1.0, "legs 0% stiffer than the table, 0.4 kg more load"),
        (1.09 * 1.2, 1.5, "legs 50% stiffer than the table, 0.3 kg more load"),
    ],
)
def test_the_line_on_the_legs_tells_modulus_and_load_apart_where_torque_is_known(
    ratio, stiffness, line
):
    assert legs_message(ratio, stiffness, ROBOT.mass) == line

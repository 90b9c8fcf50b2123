"""Legs as springs: the table of their statics against scipy's interpolation."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from slot_core.config import ConfigError
from slot_core.legs.leg_springs import COLUMNS, LegSprings, read_leg_springs
from slot_core.legs.leg_table import LegTable, read_leg_table
from slot_core.robot import read_robot

ROBOT = read_robot()
SLOPE_MIN = 4.0  # N/rad


@pytest.fixture(scope="module")
def springs():
    return read_leg_springs(SLOPE_MIN)


@pytest.fixture(scope="module")
def table():
    return read_leg_table(COLUMNS)


def interpolated(table, angle, height):
    """Columns (n, 4) by scipy, with angle and height moved to the table's edges."""
    inside = [
        np.clip(v, g[0], g[-1])
        for v, g in ((angle, table.angle), (height, table.height))
    ]
    grid = table.angle, table.height
    return RegularGridInterpolator(grid, table.table)(np.column_stack(inside))


def test_force_slope_stiffness_and_contact_are_those_of_a_bilinear_interpolation(
    springs, table
):
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(-0.2, 2.4, 2000), rng.uniform(-0.01, 0.15, 2000)
    found, expected = springs.at(angle, height), interpolated(table, angle, height).T
    np.testing.assert_allclose(found.force, expected[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        found.slope, np.maximum(expected[1], SLOPE_MIN), atol=1e-12
    )
    np.testing.assert_allclose(
        found.stiffness, np.minimum(expected[2], 0.0), atol=1e-10
    )
    np.testing.assert_allclose(found.contact, expected[3], rtol=0, atol=1e-14)


def test_the_bounds_of_slope_and_stiffness_are_active_somewhere_in_the_table(table):
    """Else the test above would not notice that they were missing."""
    assert table.table[..., 1].min() < SLOPE_MIN
    assert table.table[..., 2].max() > 0.0


def test_angles_of_any_shape_give_statics_of_that_shape(springs, table):
    rng = np.random.default_rng(1)
    angle, height = rng.uniform(0, 2, (15, 4)), rng.uniform(0.02, 0.1, (15, 4))
    found = springs.at(angle, height)
    expected = interpolated(table, angle.ravel(), height.ravel())
    np.testing.assert_allclose(found.force.ravel(), expected[:, 0], atol=1e-12)
    assert {values.shape for values in found} == {(15, 4)}


def test_the_angle_of_a_force_gives_that_force(springs):
    rng = np.random.default_rng(2)
    height = rng.uniform(0.03, 0.075, 500)
    force = rng.uniform(2.0, ROBOT.weight / 4 * 1.05, 500)
    angle = springs.angle(force, height)
    np.testing.assert_allclose(
        springs.at(angle, height).force, force, rtol=0, atol=1e-9
    )


def test_the_angle_of_a_force_is_the_least_one(springs):
    """Beyond the fold the force falls and rises again: more than one angle may carry it."""
    height = np.full(4, 0.04)
    angle = springs.angle(np.full(4, ROBOT.weight / 4), height)
    below = np.linspace(0.0, angle[0] - 1e-6, 500)
    assert springs.at(below, np.full(500, 0.04)).force.max() < ROBOT.weight / 4


def test_a_force_beyond_the_table_gives_its_largest_or_smallest_angle(springs, table):
    found = springs.angle(np.array([1e3, -1e3]), np.array([0.04, 0.04]))
    assert found == pytest.approx([table.angle[-1], table.angle[0]])


def test_a_table_of_two_by_two_is_enough():
    corners = np.zeros((2, 2, 4))
    corners[..., 0] = [[0.0, -1.0], [10.0, 9.0]]
    small = LegSprings(
        LegTable(np.array([0.0, 1.0]), np.array([0.0, 0.1]), corners), 1.0
    )
    assert small.at(np.array(0.5), np.array(0.05)).force == pytest.approx(4.5)
    assert small.angle(np.array([4.5]), np.array([0.05])) == pytest.approx([0.5])


@pytest.mark.parametrize("content", ["", "theta_deg,height_m\n1,2\n", "a,b\n1\n2,3\n"])
def test_a_table_that_is_no_grid_is_rejected(tmp_path, monkeypatch, content):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    (tmp_path / "leg_map.csv").write_text(content)
    with pytest.raises(ConfigError, match=r"^leg_map\.csv: "):
        read_leg_springs(SLOPE_MIN)

"""Legs as springs: the table of their statics against scipy's interpolation."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from slot_core.config import ConfigError
from slot_core.legs.leg_springs import COLUMNS, read_leg_springs
from slot_core.legs.leg_table import read_leg_table
from slot_core.robot import read_robot

ROBOT = read_robot()
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
    found = springs.at(angle, height).force
    np.testing.assert_allclose(found, force, rtol=0, atol=1e-9)
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
    with pytest.raises(ConfigError, match=r"^leg_map\.csv: "):
        read_leg_springs(SLOPE_MIN)

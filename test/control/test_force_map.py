"""Force map: tendon angles from ground reaction forces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.control.force_map import ForceMap, LegSlope, read_force_map, read_leg_slope
from slot_core.control.gait import GaitPreview
from slot_core.robot import read_robot

HEIGHT = 0.06
THETA = np.radians([0.0, 60.0, 120.0])
HEIGHTS = np.array([0.02, 0.06, 0.10])
SLOPES = np.array([[5.0, 6.0, 7.0], [8.0, 9.0, 10.0], [11.0, 12.0, 13.0]])


def preview(angle_deg=60.0, load=5.3):
    shape = (15, 4)
    return GaitPreview(
        stamp=0,
        gait="stand",
        phase=0.0,
        period=1.0,
        dt=0.033,
        contact=np.ones(shape, bool),
        friction=np.full(shape, 0.4),
        normal_force=np.full(shape, load),
        tendon_angle=np.full(shape, np.radians(angle_deg)),
        reference=np.zeros((15, 12)),
    )


def forces(*normal):
    return np.column_stack([np.zeros((4, 2)), normal])


def state(height=HEIGHT, rpy=(0, 0, 0)):
    x = np.zeros(12)
    x[0:3], x[5] = rpy, height
    return x


def mapped(force_map, force, demand, torso):
    return force_map.step(force, demand, force_map.slope(demand, torso))


@pytest.fixture
def make():
    def build(**changes):
        settings = config.replace(read_force_map(), changes)
        return ForceMap(read_robot(), settings, LegSlope(THETA, HEIGHTS, SLOPES))

    return build


def test_the_paper_map_is_the_line_of_the_paper(make):
    command = mapped(make(map="paper"), forces(0.0, 2.0, 4.0, 5.0), preview(), state())
    expected = (np.array([0.0, 2.0, 4.0, 5.0]) + 6.91) / 0.107
    assert np.degrees(command.angle) == pytest.approx(expected)
    assert not command.saturated.any()


def test_the_paper_map_saturates_at_the_limit_of_the_servo(make):
    """6 N, the paper's bound, needs 120.65 deg; the servo's limit of 116.28 deg is 5.532 N."""
    command = mapped(make(map="paper"), forces(5.53, 5.54, 6.0, 1.0), preview(), state())
    assert command.saturated.tolist() == [False, True, True, False]
    assert command.angle[1:3] == pytest.approx(read_robot().tendon.angle_max)
    assert np.degrees(command.angle_unclamped[2]) == pytest.approx(120.65, abs=0.01)


def test_the_normal_force_of_the_gait_gives_its_nominal_angle(make):
    command = mapped(make(), forces(5.3, 5.3, 5.3, 5.3), preview(), state())
    assert np.degrees(command.angle) == pytest.approx(60.0)


def test_a_deviation_is_divided_by_the_slope_at_angle_and_height(make):
    command = mapped(make(), forces(5.3, 5.8, 4.8, 6.3), preview(), state())
    assert command.slope == pytest.approx(9.0)
    assert command.angle - np.radians(60) == pytest.approx(np.array([0, 0.5, -0.5, 1.0]) / 9.0)


def test_the_slope_of_a_leg_is_that_at_the_clamp_height_of_a_tilted_torso(make):
    rpy = (0.05, -0.08, 0.7)
    command = mapped(make(), forces(*[5.3] * 4), preview(), state(HEIGHT, rpy))
    rotation = Rotation.from_euler("ZYX", rpy[::-1]).as_matrix()
    heights = HEIGHT + (read_robot().clamps @ rotation.T)[:, 2]
    assert command.slope == pytest.approx(9.0 + (heights - 0.06) / 0.04)


def test_the_correction_is_bounded(make):
    command = mapped(make(correction_max_deg=10.0), forces(0, 50, 5.3, 5.3), preview(), state())
    assert np.degrees(command.angle) == pytest.approx([50.0, 70.0, 60.0, 60.0])


def test_angles_stay_within_their_limits_for_any_force(make):
    rng = np.random.default_rng(1)
    force_map, limit = make(correction_max_deg=120.0), read_robot().tendon.angle_max
    for _ in range(200):
        demand = preview(rng.uniform(0, 116))
        command = mapped(
            force_map, forces(*rng.normal(5, 20, 4)), demand, state(rng.uniform(0, 0.2))
        )
        assert command.angle.min() >= 0.0
        assert command.angle.max() <= limit
        assert (command.saturated == (command.angle != command.angle_unclamped)).all()


def test_hold_repeats_the_last_angles(make):
    force_map = make()
    assert np.degrees(force_map.hold(preview(70.0)).angle) == pytest.approx(70.0)
    last = mapped(force_map, forces(5.0, 5.3, 5.6, 5.9), preview(), state())
    held = force_map.hold(preview(70.0))
    assert held.map == "hold"
    assert (held.angle == last.angle).all()


def test_the_slope_is_bilinear_and_constant_beyond_the_edge():
    slope = LegSlope(THETA, HEIGHTS, SLOPES)
    inside = slope(np.radians([30.0, 90.0]), np.array([0.04, 0.09]))
    assert inside == pytest.approx([7.0, 11.25])
    assert slope(np.array([9.0]), np.array([-1.0])) == pytest.approx(11.0)


def test_the_shipped_table_has_the_slope_of_the_robots_stance():
    """About 0.177 N/deg at 63 deg and 40 mm. The bound is coarse; the table has its own test."""
    slope = read_leg_slope()(np.radians([63.0]), np.array([0.04]))
    assert np.radians(slope) == pytest.approx(0.177, rel=0.25)


@pytest.mark.parametrize("content", ["", "theta_deg,height_m\n1,2\n", "a,b\n1\n2,3\n"])
def test_a_table_that_is_no_grid_is_rejected(tmp_path, monkeypatch, content):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    (tmp_path / "leg_map.csv").write_text(content)
    with pytest.raises(config.ConfigError, match=r"^leg_map\.csv: "):
        read_leg_slope()

"""Height maps compared with SciPy's interpolation and with an inclined plane."""

import numpy as np
import pytest
from numba import njit
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.terrain import Terrain, ground, read_terrain
from slot_core.robot import GRAVITY, read_robot
from slot_core.simulation.rod_robot import RodRobot

SPACING = 0.05
HEIGHT = np.random.default_rng(5).normal(0.0, 0.01, (7, 10))
Y, X = ((np.arange(n) - (n - 1) / 2) * SPACING for n in HEIGHT.shape)
EXACT = RegularGridInterpolator((Y, X), HEIGHT)


@njit
def ground_at(terrain, x, y):
    below = ground(terrain, x, y)
    return below.height, below.slope_x, below.slope_y


def test_heights_match_scipy():
    for x, y in np.random.default_rng(6).uniform(
        [X[0], Y[0]], [X[-1], Y[-1]], (300, 2)
    ):
        assert ground_at(Terrain(HEIGHT, SPACING), x, y)[0] == pytest.approx(
            EXACT((y, x)), abs=1e-15
        )


def test_slopes_are_the_derivatives_of_the_heights():
    step = 1e-6
    inner = np.random.default_rng(7).uniform(
        0.02, 0.98, (300, 2)
    ) + np.random.default_rng(8).integers(0, [9, 6], (300, 2))
    for x, y in inner * SPACING + [
        X[0],
        Y[0],
    ]:  # the central differences stay within a cell
        _, a, b = ground_at(Terrain(HEIGHT, SPACING), x, y)
        # Bilinear: differences along the axes are exact up to rounding, 1e-17 / 1e-6.
        assert a == pytest.approx(
            (EXACT((y, x + step)) - EXACT((y, x - step))) / 2e-6, abs=1e-9
        )
        assert b == pytest.approx(
            (EXACT((y + step, x)) - EXACT((y - step, x))) / 2e-6, abs=1e-9
        )


def test_beyond_its_edge_the_floor_continues_at_the_height_of_the_edge():
    for x, y in [(-1.0, 0.013), (1.0, 0.013), (0.021, -1.0), (0.021, 1.0), (2.0, -3.0)]:
        height, a, b = ground_at(Terrain(HEIGHT, SPACING), x, y)
        edge = np.clip(x, X[0], X[-1]), np.clip(y, Y[0], Y[-1])
        assert height == pytest.approx(EXACT(edge[::-1]), abs=1e-15)
        assert a == 0.0 or abs(x) < 0.5
        assert b == 0.0 or abs(y) < 0.5


def test_an_empty_name_is_the_plane():
    assert read_terrain("", 1.0).height.shape == (1, 1)


SLOPE = np.radians(10.0)
PLANE = np.tan(SLOPE) * np.tile(
    (np.arange(5) - 2.0) * 0.5, (4, 1)
)  # 2 m x 1.5 m, rising along x
TURN = Rotation.from_rotvec([0.0, -SLOPE, 0.0]).as_matrix()  # the plane's axes to odom


@pytest.fixture
def maps(tmp_path, monkeypatch):
    """A configuration directory with the height map of an inclined plane."""
    scenes = tmp_path / "scene"
    scenes.mkdir()
    np.savetxt(scenes / "plane.csv", PLANE, delimiter=",", fmt="%.18e")
    scene = read_scene("flat")
    robot, servo = read_robot(), read_servo()
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))

    def make(**changes):
        changes = {name.replace("__", "."): value for name, value in changes.items()}
        return RodRobot(robot, config.replace(scene, changes), servo)

    return make


@pytest.mark.parametrize("law", ["viscous", "bristle"])
@pytest.mark.parametrize(("friction", "pulled"), [(0.4, 1.1), (0.1, 1.1), (0.3, 0.0)])
def test_an_inclined_height_map_is_a_plane_under_tilted_gravity(
    maps, law, friction, pulled
):
    """For 0.5 s after a fall from 20 mm: standing, sliding, or lying on the torso's corners."""
    common = {
        "start__settle": 0.0,
        "start__height": 0.04,
        "floor__friction": [friction] * 4,
        "floor__torso_friction": friction,
        "floor__friction_law": law,
    }
    gravity = TURN.T @ [0.0, 0.0, -GRAVITY]
    flat = maps(gravity=gravity.tolist(), **common)
    tilted = maps(floor__height_map="plane.csv", floor__spacing=0.5, **common)
    tilted.state.position[:] = TURN @ flat.position
    tilted.state.rotation[:] = TURN
    for sim in (flat, tilted):
        sim.advance(500, np.full(4, pulled))
    # Rounding, amplified by contacts that open and close.
    np.testing.assert_allclose(tilted.position, TURN @ flat.position, atol=1e-8)
    np.testing.assert_allclose(tilted.rotation, TURN @ flat.rotation, atol=1e-7)
    np.testing.assert_allclose(tilted.nodes, flat.nodes @ TURN.T, atol=1e-7)
    np.testing.assert_allclose(
        tilted.ground_force, flat.ground_force @ TURN.T, atol=1e-3
    )
    assert tilted.energy() == pytest.approx(flat.energy(), abs=1e-6)
    if pulled == 0.0:
        corners = flat.position + flat.model.torso.corners @ flat.rotation.T
        assert corners[:, 2].min() < 1e-4  # the torso lies on the floor

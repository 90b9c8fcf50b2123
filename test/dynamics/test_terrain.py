"""Height maps compared with SciPy's interpolation and with an inclined plane."""

import numpy as np
import pytest
from numba import njit
from rod_robots import simulator
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from slot_core.dynamics.contact import Terrain, ground
from slot_core.robot import GRAVITY

SPACING = 0.05
HEIGHT = np.random.default_rng(5).normal(0.0, 0.01, (7, 10))
Y, X = ((np.arange(n) - (n - 1) / 2) * SPACING for n in HEIGHT.shape)
EXACT = RegularGridInterpolator((Y, X), HEIGHT)


@njit
def ground_at(terrain, x, y):
    below = ground(terrain, x, y)
    return below.height, below.slope_x, below.slope_y


def test_heights_are_bilinear_as_scipys_also_beyond_the_edge_and_slopes_their_derivatives():
    """Beyond its edge the floor continues at the height of the edge."""
    step, end = 1e-6, np.array([X[-1], Y[-1]])
    rng, corners = (
        np.random.default_rng(7),
        [(-1.0, 0.013), (0.021, 1.0), (2.0, -3.0)],
    )
    # the central differences stay within a cell
    inner = rng.uniform(0.02, 0.98, (300, 2)) + rng.integers(
        0, [9, 6], (300, 2)
    )
    for x, y in [*(inner * SPACING - end), *corners]:
        height, *slopes = ground_at(Terrain(HEIGHT, SPACING), x, y)
        points = np.array([x, y]) + step * np.array(
            [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]
        )
        exact = EXACT(np.clip(points, -end, end)[:, ::-1])
        assert height == pytest.approx(exact[0], abs=1e-15)
        # Bilinear: differences along the axes are exact up to rounding, 1e-17 / 1e-6.
        derivatives = (exact[[1, 3]] - exact[[2, 4]]) / (2 * step)
        assert slopes == pytest.approx(derivatives, abs=1e-9)


SLOPE = np.radians(10.0)
# 2 m x 1.5 m, rising along x
PLANE = np.tan(SLOPE) * np.tile((np.arange(5) - 2.0) * 0.5, (4, 1))
TURN = Rotation.from_rotvec(
    [0.0, -SLOPE, 0.0]
).as_matrix()  # the plane's axes to odom


@pytest.mark.parametrize("law", ["viscous", "bristle"])
@pytest.mark.parametrize(
    ("friction", "pulled"), [(0.4, 1.1), (0.1, 1.1), (0.3, 0.0)]
)
def test_an_inclined_height_map_is_a_plane_under_tilted_gravity(
    own_config, law, friction, pulled
):
    """For 0.5 s after a fall from 20 mm: standing, sliding, or lying on the torso's corners."""
    np.savetxt(
        own_config / "scene/plane.csv", PLANE, delimiter=",", fmt="%.18e"
    )
    common = {
        "start__settle": 0.0,
        "start__height": 0.04,
        "floor__friction": [friction] * 4,
        "floor__torso_friction": friction,
        "floor__friction_law": law,
    }
    gravity = TURN.T @ [0.0, 0.0, -GRAVITY]
    flat = simulator(servo="pid", gravity=gravity.tolist(), **common)
    uneven = {"floor__height_map": "plane.csv", "floor__spacing": 0.5}
    tilted = simulator(servo="pid", **uneven, **common)
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
    if pulled == 0.0:
        corners = flat.position + flat.model.torso.corners @ flat.rotation.T
        assert corners[:, 2].min() < 1e-4  # the torso lies on the floor

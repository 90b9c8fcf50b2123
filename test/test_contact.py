"""Contact with the floor against Coulomb's law."""

import numpy as np
import pytest
from numba import njit

from slot_core import config
from slot_core.dynamics.contact import grip, press
from slot_core.dynamics.model import build_floor
from slot_core.dynamics.rod import discretise
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulator import Simulator
from slot_core.robot import GRAVITY, read_robot

ROBOT = read_robot()
ROD = discretise(ROBOT.leg, 22, ROBOT.tendon.end_fraction)
MU, STIFFNESS, DAMPING = 0.4, 2e4, 5.0


def floor(**changes):
    """The floor of the scene `flat` with changes of its settings."""
    changes = {f"floor.{name}": value for name, value in changes.items()}
    return build_floor(config.replace(read_scene("flat"), changes).floor, ROD)


@njit
def law(floor, friction, gap, v):
    """Normal force and viscous drag of a point."""
    normal = press(STIFFNESS, DAMPING, gap, v[2])
    tangential = (v[0], v[1], 0.0)
    hold = grip(floor, friction * normal, 0.0, STIFFNESS, DAMPING, tangential, tangential)
    return normal, hold.drag


def test_the_floor_only_pushes():
    assert law(floor(), MU, 1e-6, np.array([0.0, 0.0, -1.0])) == (0.0, 0.0)  # above, falling
    assert law(floor(), MU, -1e-6, np.array([0.1, 0.0, 1.0])) == (0.0, 0.0)  # below, leaving fast
    normal, _ = law(floor(), MU, -1e-3, np.zeros(3))
    assert normal == pytest.approx(20.0, rel=1e-12)


@pytest.mark.parametrize("speed", [1e-5, 1e-3, 0.1, 10.0])
def test_friction_stays_below_the_cone_and_reaches_it(speed):
    v = speed * np.array([0.6, 0.8, 0.0])
    normal, drag = law(floor(), MU, -1e-3, v)
    expected = MU * normal * speed / np.hypot(speed, floor().friction_velocity)
    assert drag * speed == pytest.approx(expected, rel=1e-12)
    assert drag * speed < MU * normal


@pytest.fixture(scope="module")
def sliding():
    """A standing robot, given 0.8 m/s along a heading of 30 deg, for 0.2 s."""
    sim = Simulator(read_robot(), read_scene("flat"), read_servo())
    command = sim.tendon_angle
    sim.set_motion(0.8 * np.array([np.cos(np.pi / 6), 0.5, 0.0]), np.zeros(3))
    before = sim.momentum()[0]
    sim.advance(200, command)
    return sim, before, sim.momentum()[0]


def test_a_sliding_robot_decelerates_at_mu_g(sliding):
    """Impulse of friction = mu times the impulse of the floor, whatever the legs do meanwhile."""
    sim, before, after = sliding
    normal = sim.robot.weight * 0.2 + (after - before)[2]
    lost = np.linalg.norm(before[:2]) - np.linalg.norm(after[:2])
    # All feet slide, but they swing across the heading while they splay: their friction is not
    # all along it. The speed of sliding itself costs (eps/v)^2 = 1e-5.
    assert lost == pytest.approx(0.4 * normal, rel=0.02)
    assert lost / sim.robot.mass / 0.2 == pytest.approx(0.4 * GRAVITY, rel=0.05)


def test_a_sliding_robot_keeps_its_heading(sliding):
    _, before, after = sliding
    turned = np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0])
    assert abs(turned) < 0.03  # the robot's own shape is not isotropic


def test_feet_at_rest_hold_below_the_friction_angle():
    """On an incline of 5 deg (tan = .087) a robot with friction .4 creeps, and does not slide."""
    sim = Simulator(read_robot(), read_scene("slope5"), read_servo())
    x = sim.position[0]
    sim.advance(1000, sim.tendon_angle)
    creep = abs(sim.position[0] - x)
    # Regularised friction creeps at about eps tan(slope) / mu = 0.2 mm/s; sliding would go 0.4 m.
    assert creep < 1e-3


def test_a_floor_without_friction_lets_it_slide():
    scene = config.replace(
        read_scene("slope5"), {"floor.friction": [0.0] * 4, "floor.torso_friction": 0.0}
    )
    sim = Simulator(read_robot(), scene, read_servo())
    before = sim.momentum()[0][0]
    sim.advance(300, sim.tendon_angle)
    gained = sim.momentum()[0][0] - before
    # Exact but for the iteration: nothing but gravity acts along the floor.
    assert gained == pytest.approx(sim.robot.mass * scene.gravity[0] * 0.3, rel=1e-9)

"""The paper's model: its equations, its step limit, terms without effect, load paths, its robot."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, read_robot
from slot_paper.leg import PaperLegs, read_paper
from slot_paper.robot import PaperRobot

ROBOT = read_robot()
PRINTED = read_paper()
FULL = 116.28 / 270 * 1.5 / 0.010  # N, tension at the largest tendon angle
SOFT = {"young_modulus": 1e6}
AIRBORNE = {"contact_stiffness": 0.0, "contact_damping": 0.0, "friction": 0.0}
# below the limit of the tip's contact
STABLE = {"young_modulus": 1e6, "step": 4e-5}
UNSETTLED = {"start.settle": 0.0}


def leg(**changes):
    return PaperLegs(ROBOT, config.replace(PRINTED, changes))


def simulator(start=UNSETTLED, scene="flat", **changes):
    scene = config.replace(read_scene(scene), start)
    return PaperRobot(
        ROBOT, scene, read_servo(), config.replace(PRINTED, changes)
    )


def pull_and_release(leg, seconds, every=10):
    """The paper's profile in `seconds`: sine ramp, hold, cosine decay, zero; yields the time, s."""
    ramp, hold, decay = np.array([2.4, 0.2, 2.0]) * seconds / 5.0
    for k in range(round(seconds / leg.settings.step / every)):
        t = k * every * leg.settings.step
        falling = math.cos(
            math.pi / 2 * min(1.0, max(0.0, (t - ramp - hold) / decay))
        )
        tension = FULL * math.sin(math.pi / 2 * min(1.0, t / ramp)) * falling
        leg.advance(every, [tension])
        yield t


def printed_forces(legs, tension):
    """Forces and moments (N, 3) on the nodes of a leg, one by one as in section III-D."""
    s, n, out = (
        legs.settings,
        legs.settings.nodes,
        np.zeros((legs.settings.nodes, 3)),
    )
    (x, z), (vx, vz), theta, omega = (
        legs.node[0],
        legs.velocity[0],
        legs.angle[0],
        legs.rate[0],
    )
    dx, h = 0.190 / (n - 1), np.linspace(0.0135, 0.0035, n)
    x0 = np.linspace(0, 0.190, n)
    z0 = 6.356 * x0**3 - 1.810 * x0**2 + 0.02175
    for i in range(n - 1):
        length = math.hypot(x[i + 1] - x[i], z[i + 1] - z[i])
        axial = s.young_modulus * 0.02 * h[i] * (length - dx) / dx
        direction = math.atan2(z[i + 1] - z[i], x[i + 1] - x[i])
        bend = (
            s.young_modulus
            * 0.02
            * h[i] ** 3
            / 12
            / dx
            * (theta[i + 1] - theta[i])
        )
        part = axial * math.cos(direction), axial * math.sin(direction), -bend
        out[i] += part
        out[i + 1] -= part
    slope = np.gradient(z0) / np.gradient(x0)
    for i in range(n):
        if i < 2 * n // 3:
            nx, nz = np.array([-slope[i], 1.0]) / math.hypot(1.0, slope[i])
            out[i] += tension * np.array([nx, nz, -h[i] / 2 * nx])
        if z[i] < 0:
            out[i, 1] += (
                s.contact_stiffness * -z[i] + s.contact_damping * -vz[i]
            )
        if z[i] <= 0:
            weight = (ROBOT.leg.mass + ROBOT.mass / 4) * GRAVITY
            out[i, 0] -= s.friction * weight * np.sign(vx[i])
        out[i, :2] -= s.restoring_stiffness * np.array(
            [x[i] - x0[i], z[i] - z0[i]]
        )
        out[i] -= s.damping * np.array([vx[i], vz[i], omega[i]])
        out[i, 1] -= legs.mass[i] * GRAVITY
    return out


def test_a_step_integrates_the_printed_equations_of_a_leg():
    legs, rng = leg(**STABLE), np.random.default_rng(1)
    legs.node += 2e-3 * rng.normal(size=legs.node.shape)
    legs.velocity += rng.normal(size=legs.velocity.shape)
    legs.angle += 0.01 * rng.normal(size=legs.angle.shape)
    legs.rate += rng.normal(size=legs.rate.shape)
    assert 0 < (legs.node[0, 1] < 0.0).sum() < PRINTED.nodes
    h, forces = legs.settings.step, printed_forces(legs, 10.0)
    velocity, rate, node = (
        x[0].copy() for x in (legs.velocity, legs.rate, legs.node)
    )
    legs.advance(1, [10.0])
    np.testing.assert_allclose(legs.base_force[0], forces[0, :2])
    forces[0, 0] = 0.0  # the guide of the base
    velocity += h * forces[:, :2].T / legs.mass
    np.testing.assert_allclose(legs.velocity[0], velocity, rtol=1e-9)
    np.testing.assert_allclose(legs.node[0], node + h * velocity, rtol=1e-12)
    np.testing.assert_allclose(
        legs.rate[0], rate + h * forces[:, 2] / legs.inertia
    )
    area = 0.02 * np.linspace(0.0135, 0.0035, PRINTED.nodes)
    np.testing.assert_allclose(
        legs.inertia, 0.5 * 1200 * area * legs.spacing**2
    )
    assert legs.mass.sum() == pytest.approx(ROBOT.leg.mass, rel=0.02)


@pytest.mark.parametrize("changes", [SOFT, {"step": 5e-5}])
def test_below_the_step_limit_a_pulled_and_released_leg_comes_to_rest(changes):
    moving, found = leg(**changes), []
    for _ in pull_and_release(moving, 1.0):
        found.append((moving.node[0, 1, 0], np.abs(moving.velocity).max()))
    height, speed = np.array(found).T
    assert height.max() - height[0] > 0.07  # m: the leg was lifted
    # m/s; the profile itself moves the base at 0.3 m/s
    assert speed.max() < 2.0
    assert height[-1] == pytest.approx(height[0], abs=1e-3)
    assert speed[-1] < 0.1


@pytest.mark.parametrize("tension", [10.0, 40.0])
def test_a_sudden_pull_diverges_above_the_step_limit_of_the_contact(tension):
    """At the printed step d h / m of the tip is 3.8: it rebounds faster than it came."""
    k, d, m = PRINTED.contact_stiffness, PRINTED.contact_damping, leg().mass[-1]
    # semi-implicit Euler on m a = -k z - d v is stable while k h^2 / m + 2 d h / m < 4
    limit = (math.sqrt(d * d + 4 * k * m) - d) / k
    assert limit == pytest.approx(4.4e-5, rel=0.01)
    leg(**STABLE).advance(5000, [tension])
    leg(**SOFT, **AIRBORNE).advance(5000, [tension])
    with pytest.raises(DivergenceError, match="node 30"):
        leg(**SOFT).advance(10000, [tension])


def test_bending_stiffness_changes_the_angles_which_overflow_and_no_position():
    plain, changed = leg(**SOFT), leg(**SOFT)
    changed.bending = 100.0 * changed.bending
    for _ in zip(pull_and_release(plain, 1.0), pull_and_release(changed, 1.0)):
        np.testing.assert_array_equal(plain.node, changed.node)
        np.testing.assert_array_equal(plain.velocity, changed.velocity)
    assert not np.isfinite(plain.angle).any()
    assert np.isfinite(plain.node).all()


def test_a_step_integrates_the_printed_equations_of_the_torso():
    sim, rng = simulator(**STABLE), np.random.default_rng(2)
    r = Rotation.from_rotvec([0.1, -0.2, 0.3])
    v, w = rng.normal(size=(2, 3))
    sim.legs.base_force[:] = force = 20.0 * rng.normal(size=(4, 2))
    sim.state.rotation[:], sim.state.velocity[:], sim.state.rate[:] = (
        r.as_matrix(),
        v,
        w,
    )
    p, h = sim.position, 4e-5
    sim._step_torso(h)
    a, b, c = ROBOT.torso.size
    corner = (
        np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
        * [a, b, 0]
        / 2
    )
    outward = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / math.sqrt(2)
    on_torso = np.column_stack([force[:, :1] * outward, force[:, 1]])
    inertia = 2.0 / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    total = r.apply(on_torso.sum(axis=0)) - [0.1, 0.1, 200] * v
    total[2] -= 1500 * (p[2] - 0.0218) + 2.0 * GRAVITY
    v, w = (
        v + h * total / 2.0,
        w + h * np.cross(corner, on_torso).sum(axis=0) / inertia,
    )
    np.testing.assert_allclose(sim.velocity, v)
    np.testing.assert_allclose(sim.angular_velocity, w)
    np.testing.assert_allclose(sim.position, p + h * v)
    turned = (r * Rotation.from_rotvec(h * w)).as_matrix()
    np.testing.assert_allclose(sim.rotation, turned, atol=1e-14)


def test_the_torsos_spring_carries_the_robot_and_no_leg_does():
    sim = simulator({"start.tendon_angle_deg": 63.0}, **STABLE)
    sag = ROBOT.torso.mass * GRAVITY / PRINTED.torso_stiffness
    assert sim.position[2] == pytest.approx(0.0218 - sag, abs=1e-5)
    assert sim.specific_force == pytest.approx([0.0, 0.0, GRAVITY], abs=1e-2)
    assert np.abs(sim.angular_velocity).max() < 1e-9
    assert not sim.ground_force.any()


def test_unsupported_scenes_and_steps_are_refused_and_the_printed_numbers_diverge():
    with pytest.raises(config.ConfigError, match="gravity along z alone"):
        simulator(scene="slope5", **STABLE)
    with pytest.raises(config.ConfigError, match=r"no multiple of 0\.0003 s"):
        simulator(step=3e-4)
    with pytest.raises(
        DivergenceError, match=r"^simulation .* at 0\.00\d0 s: leg FL node"
    ):
        simulator({})

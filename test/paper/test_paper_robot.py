"""The paper's model: its step limit, terms without effect, load paths, and its robot."""

import functools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.paper.numbers import read_paper
from slot_core.paper.paper_robot import PaperLeg, PaperRobot
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, read_robot
from slot_core.simulation import plant
from slot_core.simulation.readings import OdometryReading

ROBOT = read_robot()
PRINTED = read_paper()
FULL = 116.28 / 270 * 1.5 / 0.010  # N, tension at the largest tendon angle
SOFT = {"young_modulus": 1e6}
AIRBORNE = {"contact_stiffness": 0.0, "contact_damping": 0.0, "friction": 0.0}
STABLE = {"young_modulus": 1e6, "step": 4e-5}  # below the limit of the tip's contact


def leg(**changes):
    return PaperLeg(ROBOT, config.replace(PRINTED, changes))


def simulator(scene="flat", start=None, **changes):
    scene = config.replace(
        read_scene(scene), {f"start.{k}": v for k, v in (start or {}).items()}
    )
    return PaperRobot(ROBOT, scene, read_servo(), config.replace(PRINTED, changes))


def pull_and_release(leg, seconds, every=10):
    """The paper's profile in `seconds`: sine ramp, hold, cosine decay, zero; yields the leg."""
    ramp, hold, decay = np.array([2.4, 0.2, 2.0]) * seconds / 5.0
    for k in range(round(seconds / leg.settings.step / every)):
        t = k * every * leg.settings.step
        falling = math.cos(math.pi / 2 * min(1.0, max(0.0, (t - ramp - hold) / decay)))
        leg.advance(every, FULL * math.sin(math.pi / 2 * min(1.0, t / ramp)) * falling)
        yield leg


@pytest.mark.parametrize("changes", [SOFT, {"step": 5e-5}])
def test_below_the_step_limit_a_pulled_and_released_leg_comes_to_rest(changes):
    heights, speeds = [], []
    for moving in pull_and_release(leg(**changes), 1.0):
        heights.append(moving.nodes[0, 1])
        speeds.append(np.abs(moving.velocities).max())
    assert max(heights) - heights[0] > 0.07  # m: the leg was lifted
    assert max(speeds) < 2.0  # m/s; the profile itself moves the base at 0.3 m/s
    assert heights[-1] == pytest.approx(heights[0], abs=1e-3)
    assert speeds[-1] < 0.1


def largest_frequency(model):
    """rad/s, of the leg at its initial shape: stretch, geometric stiffness, restoring springs."""
    count = len(model.mass)
    stiffness = model.restoring * np.eye(2 * count)
    for i in range(count - 1):
        chord = model.initial[i + 1] - model.initial[i]
        length = np.hypot(*chord)
        along = np.outer(chord, chord) / length**2
        force = model.axial[i] * (length / model.spacing - 1)
        block = model.axial[i] / model.spacing * along + force / length * (
            np.eye(2) - along
        )
        stiffness[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += np.kron(
            [[1, -1], [-1, 1]], block
        )
    root = np.sqrt(np.repeat(model.mass, 2))
    free = np.arange(1, 2 * count)  # x of the base is held
    return math.sqrt(
        np.linalg.eigvalsh((stiffness / np.outer(root, root))[np.ix_(free, free)])[-1]
    )


def is_stable(step, **changes):
    try:
        leg(step=step, **changes).advance(4000, 0.0)
    except DivergenceError:
        return False
    return True


@pytest.mark.parametrize("modulus", [1e6, 1e7])
def test_the_step_limit_in_the_air_is_two_over_the_highest_frequency(modulus):
    changes = AIRBORNE | {"young_modulus": modulus}
    limit = 2 / largest_frequency(leg(**changes).model)
    # The closed form neglects linear damping, which lowers the limit by c h / (2 m), 1 to 2 %.
    assert is_stable(0.95 * limit, **changes)
    assert not is_stable(1.02 * limit, **changes)
    assert (limit > PRINTED.step) == (modulus == 1e6)


def contact_limit(model):
    """s: semi-implicit Euler on m a = -k z - d v is stable while k h^2 / m + 2 d h / m < 4."""
    k, d, m = model.contact_stiffness, model.contact_damping, model.mass[-1]
    return (math.sqrt(d * d + 4 * k * m) - d) / k


@pytest.mark.parametrize("tension", [10.0, 40.0])
def test_a_sudden_pull_diverges_above_the_step_limit_of_the_contact(tension):
    """At the printed step d h / m of the tip is 3.8: it rebounds faster than it came."""
    limit = contact_limit(leg().model)
    assert limit == pytest.approx(4.4e-5, rel=0.01)
    leg(**STABLE).advance(25000, tension)
    leg(**SOFT, **AIRBORNE).advance(10000, tension)
    with pytest.raises(DivergenceError, match="node 30"):
        leg(**SOFT).advance(10000, tension)


@pytest.mark.parametrize("factor", [0.0, 100.0])
def test_bending_stiffness_changes_the_angles_and_no_position(factor):
    plain, changed = leg(**SOFT), leg(**SOFT)
    changed.model.bending[:] *= factor
    plain.advance(20, 1.0)
    changed.advance(20, 1.0)
    assert np.abs(plain.angles).max() > 1e-3
    assert np.abs(plain.angles - changed.angles).max() > 1e-4
    for one, other in zip(pull_and_release(plain, 1.0), pull_and_release(changed, 1.0)):
        np.testing.assert_array_equal(one.nodes, other.nodes)
        np.testing.assert_array_equal(one.velocities, other.velocities)


def test_the_angle_state_overflows_within_a_tenth_of_a_second_without_an_error():
    pulled = leg(**SOFT)
    for moving in pull_and_release(pulled, 1.0):
        if moving.time > 0.1:
            break
    assert not np.isfinite(pulled.angles).any()
    assert np.isfinite(pulled.nodes).all()


def test_the_bending_moments_are_anti_restoring():
    """One node turned, no damping: the moments turn it further and its neighbours the other way."""
    model = leg(**SOFT, damping=0.0)
    model.state.angle[0, 10] = 1e-6
    model.advance(1, 0.0)
    assert model.angles[10] > 1e-6
    assert model.angles[9] < 0.0 > model.angles[11]


@pytest.mark.parametrize("stiffness", [400.0, 800.0, 1600.0])
def test_the_lift_is_the_tension_over_the_stiffness_of_a_restoring_spring(stiffness):
    pulled = leg(**SOFT, **AIRBORNE, restoring_stiffness=stiffness)
    start = pulled.nodes
    for moving in pull_and_release(pulled, 1.0):
        if moving.time > 0.5:  # the tension is constant
            break
    # The first segment, stretched by up to 110 % and far from vertical, carries up to 3 % of it.
    assert (pulled.nodes - start)[0, 1] == pytest.approx(FULL / stiffness, rel=0.035)


def test_the_floor_carries_no_load_of_a_pulled_leg():
    pulled = leg(**SOFT, damping=1.0)  # damped, so that it comes to rest
    start = pulled.nodes
    for moving in pull_and_release(pulled, 1.0):
        if moving.time > 0.5:
            break
    pulled.advance(10000, FULL)
    model = pulled.model
    load = FULL * model.pull[:, 1].sum() - model.mass.sum() * GRAVITY
    springs = model.restoring * (pulled.nodes - start)[:, 1].sum()
    assert springs == pytest.approx(load, rel=1e-6)
    assert pulled.nodes[:, 1].min() > 0.0
    stretch = np.hypot(*np.diff(pulled.nodes, axis=0).T) / model.spacing - 1
    assert stretch.max() == pytest.approx(
        0.72, abs=0.01
    )  # of a "homogeneous, elastic" material


class Transcription:
    """Second implementation of a leg, in whole arrays, with the printed angles of the segments."""

    def __init__(self, settings, tip_only=False, base_load=0.0):
        s, n = settings, settings.nodes
        self.s, self.tip_only, self.base_load = s, tip_only, base_load
        self.dx = 0.190 / (n - 1)
        thickness = 0.0135 - 0.010 * np.linspace(0, 1, n)
        area = 0.02 * thickness
        self.EA, self.EI = (
            s.young_modulus * area,
            s.young_modulus * 0.02 * thickness**3 / 12,
        )
        self.I = 0.5 * 1200 * area * self.dx**2
        self.m = 1200 * self.dx * area / 2
        self.m[1:-1] = 1200 * self.dx * (area[:-2] + area[1:-1]) / 2
        self.x0 = np.linspace(0, 0.190, n)
        self.z0 = 6.356 * self.x0**3 - 1.810 * self.x0**2 + 0.02175
        dx, dz = np.gradient(self.x0), np.gradient(self.z0)
        pulled = np.arange(n) < 2 * n // 3
        self.nx, self.nz = (
            pulled * -dz / np.hypot(dx, dz),
            pulled * dx / np.hypot(dx, dz),
        )
        self.arm = thickness / 2
        self.x, self.z, self.theta = self.x0.copy(), self.z0.copy(), np.zeros(n)
        self.vx, self.vz, self.omega = np.zeros((3, n))

    def internal(self):
        dx, dz = np.diff(self.x), np.diff(self.z)
        axial = self.EA[:-1] * (np.hypot(dx, dz) - self.dx) / self.dx
        direction = np.arctan2(dz, dx)
        bend = self.EI[:-1] / self.dx * np.diff(self.theta)
        parts = (axial * np.cos(direction), axial * np.sin(direction), -bend)
        return [np.append(part, 0) - np.append(0, part) for part in parts]

    def floor(self):
        weight = (ROBOT.leg.mass + ROBOT.mass / 4) * GRAVITY
        reached = np.arange(len(self.z)) >= (len(self.z) - 1 if self.tip_only else 0)
        normal = self.s.contact_stiffness * -self.z + self.s.contact_damping * -self.vz
        friction = -self.s.friction * weight * np.sign(self.vx)
        return reached * (self.z <= 0) * friction, reached * (self.z < 0) * normal

    def step(self, tension, h):
        s = self.s
        fx, fz, my = self.internal()
        friction, normal = self.floor()
        fx += tension * self.nx + friction - s.restoring_stiffness * (self.x - self.x0)
        fz += tension * self.nz + normal - s.restoring_stiffness * (self.z - self.z0)
        fx -= s.damping * self.vx
        fz -= s.damping * self.vz + self.m * GRAVITY
        fz[0] -= self.base_load
        my -= self.arm * tension * self.nx + s.damping * self.omega
        self.force = fx[0], fz[0]
        self.vx, self.vz, self.omega = (
            self.vx + h * fx / self.m,
            self.vz + h * fz / self.m,
            self.omega + h * my / self.I,
        )
        self.vx[0] = 0.0
        self.x, self.z = self.x + h * self.vx, self.z + h * self.vz
        self.theta = self.theta + h * self.omega


def test_the_kernel_integrates_the_printed_equations_of_a_leg():
    """Pulled up and dropped on the floor, 600 steps: before chaos amplifies the rounding errors."""
    kernel = leg(**STABLE)
    plain = Transcription(kernel.settings)
    touched = 0
    for k in range(600):
        tension = 10.0 if k < 100 else 0.0
        kernel.advance(1, tension)
        plain.step(tension, kernel.settings.step)
        touched += plain.z.min() < 0.0
    assert touched > 10
    np.testing.assert_allclose(
        kernel.nodes, np.column_stack([plain.x, plain.z]), atol=1e-11
    )
    np.testing.assert_allclose(
        kernel.angles, plain.theta, rtol=1e-6
    )  # they grow by 1e20 or more


def test_the_kernel_integrates_the_printed_equations_of_the_robot():
    sim = simulator(start={"settle": 0.0}, **STABLE)
    command = np.radians([20.0, 5.0, 10.0, 15.0])
    sim.advance(20, command)
    plain = [Transcription(sim.settings, True, 2.0 * GRAVITY / 4) for _ in range(4)]
    p, v, w, r = (
        np.array([0.0, 0.0, 0.0218]),
        np.zeros(3),
        np.zeros(3),
        Rotation.identity(),
    )
    a, b, c = ROBOT.torso.size
    inertia = 2.0 / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    corner = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]]) * [
        a / 2,
        b / 2,
        0,
    ]
    outward = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / math.sqrt(2)
    h, touched, earlier = 4e-5, 0, v
    for k in range(20 * 25):
        earlier = v if k == 19 * 25 else earlier
        touched += min(each.z[-1] for each in plain) < 0.0
        for each, angle in zip(plain, command):
            each.step(angle / math.radians(270) * 1.5 / 0.010, h)
        force = np.array(
            [[*(each.force[0] * o), each.force[1]] for each, o in zip(plain, outward)]
        )
        total = r.apply(force.sum(axis=0)) - [0.1 * v[0], 0.1 * v[1], 200 * v[2]]
        total[2] -= 1500 * (p[2] - 0.0218) + 2.0 * GRAVITY
        v = v + h * total / 2.0
        p = p + h * v
        w = w + h * np.cross(corner, force).sum(axis=0) / inertia
        r = r * Rotation.from_rotvec(h * w)
    assert touched > 10
    np.testing.assert_allclose(
        sim.nodes[..., 2], [each.z for each in plain], atol=1e-11
    )
    np.testing.assert_allclose(sim.position, p, atol=1e-11)
    np.testing.assert_allclose(sim.rotation, r.as_matrix(), atol=1e-10)
    np.testing.assert_allclose(sim.velocity, v, atol=1e-9)
    np.testing.assert_allclose(sim.angular_velocity, w, atol=1e-8)
    expected = r.inv().apply((v - earlier) / 1e-3 + [0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(sim.specific_force, expected, atol=1e-6)


def test_the_ground_force_is_that_of_the_tips_below_the_floor():
    sim = simulator(start={"settle": 0.0}, **STABLE)
    sim.legs.node[:2, -1, 1] = -1e-5
    sim.legs.node[2:, -1, 1] = 1e-5
    sim.legs.velocity[:, -1] = [-0.2, -0.3]
    friction = (
        PRINTED.friction * (ROBOT.leg.mass + ROBOT.mass / 4) * GRAVITY / math.sqrt(2)
    )
    normal = 1e5 * 1e-5 + 10.0 * 0.3
    expected = [
        [friction, friction, normal],
        [friction, -friction, normal],
        [0, 0, 0],
        [0, 0, 0],
    ]
    np.testing.assert_allclose(sim.ground_force, expected, atol=1e-12)


@pytest.mark.parametrize("theta_deg", [40.0, 63.0, 100.0])
def test_the_torsos_spring_carries_the_robot_at_one_height_for_every_command(theta_deg):
    """The tips are off the floor, and no leg carries weight of the torso."""
    sim = simulator(start={"tendon_angle_deg": theta_deg}, **STABLE)
    sim.advance(500, sim.tendon_angle)
    sag = ROBOT.torso.mass * GRAVITY / PRINTED.torso_stiffness
    assert sim.position[2] == pytest.approx(0.0218 - sag, abs=1e-6)
    assert sim.specific_force == pytest.approx([0.0, 0.0, GRAVITY], abs=1e-3)
    np.testing.assert_array_equal(sim.ground_force, 0.0)
    model, heights = sim.model, sim.nodes[..., 2]
    springs = model.restoring * (heights - model.initial[:, 1]).sum(axis=1)
    load = (
        sim.tension * model.pull[:, 1].sum()
        - model.mass.sum() * GRAVITY
        - model.base_load
    )
    assert springs == pytest.approx(load, rel=1e-6)


def test_equal_commands_keep_the_robot_still_and_unequal_ones_accelerate_it_in_yaw():
    sim = simulator(**STABLE)
    assert np.abs(sim.angular_velocity).max() < 1e-9
    sim.advance(500, np.radians([90.0, 30.0, 50.0, 75.0]))
    before = sim.angular_velocity[2]
    sim.advance(200, sim.tendon_angle)
    pull = sim.legs.force[:, 0, None] * ROBOT.outward
    moment = np.cross(ROBOT.clamps, pull)[:, 2].sum()
    gained = sim.angular_velocity[2] - before
    assert gained == pytest.approx(0.2 * moment / ROBOT.torso.inertia[2, 2], rel=1e-3)
    assert abs(gained) > 10.0  # rad/s in 0.2 s; yaw has neither spring nor damper


def test_the_printed_numbers_diverge_with_time_leg_and_node():
    message = r"^simulation diverged at 0\.00\d0 s: leg FL node \d+ is beyond 1000\.0 m/s or not a"
    with pytest.raises(DivergenceError, match=message):
        simulator()


def test_a_plant_runs_the_papers_robot(monkeypatch):
    changed = functools.partial(PaperRobot, settings=config.replace(PRINTED, STABLE))
    monkeypatch.setitem(plant.MODELS, "paper", changed)
    scene = config.replace(read_scene("paper"), {"start.settle": 0.1})
    robot = plant.RobotSimulator(ROBOT, scene, read_servo(), np.random.default_rng(1))
    robot.start(0)
    robot.command(np.full(4, 1.0))
    *others, odometry = robot.advance_to_odometry()
    assert isinstance(odometry, OdometryReading)
    kinds = {type(reading) for reading in others}
    assert kinds == {plant.ImuReading, plant.JointReading, plant.TrueState}
    np.testing.assert_array_equal(robot.robot.tendon_angle, 1.0)
    assert robot.robot.servo_torque == pytest.approx(
        np.full(4, 1.0 / math.radians(270) * 1.5)
    )


def test_unsupported_scenes_and_steps_are_refused_by_name():
    with pytest.raises(ConfigError, match="gravity along z alone"):
        simulator("slope5", **STABLE)
    with pytest.raises(ConfigError, match=r"no multiple of 0\.0003 s"):
        simulator(step=3e-4)

"""The robot with tabulated legs, against the table read by SciPy, rigid bodies and rods.

Legs as springs: the table of their statics against scipy's interpolation.
"""

import math
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator, make_interp_spline
from scipy.optimize import brentq, fixed_point
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.scene import level_changes, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs import leg_table
from slot_core.legs.fingerprint import LEG, fingerprint, misfit
from slot_core.legs.leg_table import (
    COLUMNS,
    legs_message,
    read_leg_springs,
    read_leg_table,
    rest_pose,
    stiffness_ratio,
)
from slot_core.legs.tabulated_kernels import YIELD
from slot_core.legs.tabulated_robot import SPRINGS, TabulatedRobot
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, read_robot
from slot_core.simulation.make_robot import make_robot

ROBOT = read_robot()
# A servo that holds its angle under load; the bus's position loop yields.
SERVO = config.replace(read_servo(), {"model": "torque_speed"})
ELASTIC = config.replace(ROBOT, {"leg.damping_time": 0.0})
SMOOTH = {"floor.friction": (0.0,) * 4, "floor.torso_friction": 0.0}
STANCE = math.radians(63.0)


def simulator(robot=ROBOT, name="map", **changes):
    scene = config.replace(read_scene(name), {"start.settle": 0.0} | changes)
    return TabulatedRobot(robot, scene, SERVO)


def read(name):
    """Column of the table over angle (rad) and height (m), interpolated by SciPy."""
    made = read_leg_table((name,))
    grid = (made.angle, made.height)
    table = RegularGridInterpolator(grid, made.table[..., 0])
    return lambda angle, drop: float(table((angle, drop)))


@pytest.mark.parametrize("theta_deg", [50.0, 63.0, 80.0])
def test_without_friction_each_leg_carries_a_quarter_of_the_weight_at_the_height_of_the_table(
    theta_deg,
):
    angle, force = math.radians(theta_deg), read("force_N")
    height = brentq(
        lambda h: force(angle, h) - ROBOT.weight / 4, 0.015, 0.12, xtol=1e-12
    )
    changes = {
        "start.settle": 30.0,
        "start.tendon_angle_deg": theta_deg,
    } | SMOOTH
    sim = simulator(**changes)
    # The bounce decays within a second.
    assert sim.tendon_angle == pytest.approx(np.full(4, angle), abs=1e-9)
    assert sim.position[2] == pytest.approx(height, abs=1e-7)
    tension = read("tension_N")(angle, height)
    assert sim.tension == pytest.approx(np.full(4, tension), rel=1e-5)
    assert sim.ground_force[:, 2] == pytest.approx(
        np.full(4, ROBOT.weight / 4), rel=1e-5
    )
    foot = sim.nodes[:, 1] - sim.nodes[:, 0]
    outward = np.einsum("lj,lj->l", foot, ROBOT.outward)
    assert outward == pytest.approx(
        np.full(4, read("contact_x_m")(angle, height)), abs=1e-6
    )
    assert sim.nodes[:, 1, 2] == pytest.approx(np.zeros(4), abs=1e-9)


def test_gravity_and_a_push_accelerate_mass_and_inertia_of_torso_and_legs():
    """In flight with hanging feet, for 0.2 s."""
    sim, t = simulator(**{"start.height": 0.5, "solver.theta": 0.5}), 0.2
    force, moment = np.array([3.0, -2.0, 1.0]), np.array([0.0, 0.0, 0.02])
    sim.push(force, moment)
    sim.advance(200, np.zeros(4))
    acceleration = force / ROBOT.mass - [0.0, 0.0, GRAVITY]
    place = [0.0, 0.0, 0.5] + acceleration * t**2 / 2
    assert sim.position == pytest.approx(place, abs=1e-9)
    assert sim.velocity == pytest.approx(acceleration * t, rel=1e-9)
    spin = np.linalg.solve(ROBOT.inertia, moment * t)
    assert sim.angular_velocity == pytest.approx(spin, rel=1e-9, abs=1e-12)
    assert not sim.ground_force.any()
    drop = sim.nodes[:, 0, 2] - sim.nodes[:, 1, 2]
    # lowest height without force in the table
    assert drop == pytest.approx(np.full(4, 0.03))


def forces_by_hand(angle, height, rotation):
    """Force (3,), N, and moment (3,), N m, of frictionless feet on a tilted torso, base_link."""
    names = ("force_N", "contact_x_m", "foot_m_per_m")
    force, reach, path = (read(name) for name in names)
    up, total, moment = rotation.as_matrix()[2], np.zeros(3), np.zeros(3)
    for clamp, outward in zip(ROBOT.clamps, ROBOT.outward):

        def drop(x, clamp=clamp, outward=outward):
            return (height + up @ (clamp + x * outward)) / up[2]

        x = fixed_point(
            lambda x, drop=drop: reach(angle, drop(x)), 0.16, xtol=1e-13
        )
        low = drop(x)
        push = (
            up * force(angle, low) / (up[2] - up @ outward * path(angle, low))
        )
        total += push
        moment += np.cross(clamp + x * outward - [0.0, 0.0, low], push)
    return total, moment


@pytest.mark.parametrize("rpy_deg", [(0, 5, 0), (4, 0, 0), (3, -6, 20)])
def test_forces_on_a_tilted_torso_are_those_of_the_table_at_its_four_feet(
    rpy_deg,
):
    rotation = Rotation.from_euler("xyz", rpy_deg, degrees=True)
    step, height = 1e-6, 0.06
    sim = simulator(**{"solver.step": step, "start.height": height} | SMOOTH)
    sim.state.tendon_angle[:] = math.radians(75)
    sim.state.rotation[:] = rotation.as_matrix()
    sim.state.node[:, 0, 0] = 0.16
    sim.advance(1, sim.tendon_angle)
    force, moment = forces_by_hand(math.radians(75), height, rotation)
    # The two iterations for the places of the feet leave 1e-3; the servo turned by 1e-10 rad.
    assert sim.specific_force * ROBOT.mass == pytest.approx(
        force, rel=2e-3, abs=2e-3
    )
    turning = ROBOT.inertia @ sim.angular_velocity / step
    assert turning == pytest.approx(moment, rel=5e-3, abs=5e-4)


def stored(angle):
    """Integral of the table's force over the height (m), J, at a tendon angle (rad)."""
    force, knots = read("force_N"), np.linspace(0.015, 0.12, 22)
    values = [force(angle, h) for h in knots]
    return make_interp_spline(knots, values, k=1).antiderivative()


def foot_springs(along, sideways, coupled, turn):
    """(3, 3) stiffness of a leg over the displacements of its foot; N/m, N, N m/rad."""
    return np.array([[along, 0, 0], [0, sideways, coupled], [0, coupled, turn]])


def energy(sim, line, stiffness):
    """J, of a robot on held spools: torso, legs in their planes (`line`), feet (3, 3), bristles."""
    v, w, node = sim.velocity, sim.angular_velocity, sim.state.node
    grip = sim.model.floor.bristle * sim.model.floor.stiffness[-1]
    moving = ROBOT.mass * v @ v + w @ ROBOT.inertia @ w
    bent = (node[:, YIELD] @ stiffness * node[:, YIELD]).sum()
    bent += grip * (sim.state.bristle**2).sum()
    weight = ROBOT.mass * GRAVITY * sim.position[2]
    return (moving + bent) / 2 + weight - line(-node[:, 0, 2]).sum()


@pytest.mark.parametrize("robot", [ELASTIC, ROBOT])
def test_energy_does_not_grow_in_a_bounce(robot):
    """On held spools, without friction; potential energy: integral of the table's force."""
    angle, changes = (
        math.radians(70.0),
        {"solver.step": 5e-4, "start.height": 0.085},
    )
    line, sim = stored(angle), simulator(robot, **changes | SMOOTH)
    sim.state.tendon_angle[:] = angle
    energies = [ROBOT.mass * GRAVITY * 0.085 - 4 * line(0.085)]
    for _ in range(800):
        sim.advance(1, sim.tendon_angle)
        z, v = sim.position[2], sim.velocity[2]
        energies.append(ROBOT.mass * (v * v / 2 + GRAVITY * z) - 4 * line(z))
    # J: dissipated by theta = 0.55 and beta
    assert energies[0] - energies[-1] > 1e-3
    # J, rounding; each step dissipates about 1e-6 J
    assert np.diff(energies).max() < 1e-9


@pytest.mark.parametrize("law", ["viscous", "bristle"])
@pytest.mark.parametrize("robot", [ELASTIC, ROBOT])
def test_energy_of_a_robot_that_slides_and_turns_does_not_grow(robot, law):
    """Its feet stick, bend their legs, turn, and slip; equal stiffness of the legs everywhere."""
    line, values = stored(STANCE), (3e3, 100.0, -8.0, 0.8)
    stiffness = foot_springs(*values)
    sim = simulator(robot, **{"floor.friction_law": law, "start.settle": 5.0})
    sim.legs.table[:, :, SPRINGS] = values
    # Where contact and material shift differently, a leg of a tilted torso is no exact potential.
    sim.legs.table[:, :, 1], sim.legs.table[:, :, 3:5] = 0.165, 0.0
    sim.advance(2000, sim.tendon_angle)
    sim.set_motion(np.array([0.5, -0.3, 0.0]), np.array([0.0, 0.0, 3.0]))
    energies = [energy(sim, line, stiffness)]
    for _ in range(500):
        sim.advance(1, sim.tendon_angle)
        energies.append(energy(sim, line, stiffness))
    assert energies[0] - energies[-1] > 0.3  # J
    # J; the factor of a bristle that slips is that of the iteration before: 7e-6 of 7e-4 a step
    assert np.diff(energies).max() < (1e-6 if law == "viscous" else 1e-5)


@pytest.mark.parametrize("sideways", [1e-3, 1e9])
@pytest.mark.parametrize("law", ["viscous", "bristle"])
def test_soft_and_stiff_legs_are_stable_at_steps_of_5_ms(sideways, law):
    sim = simulator(**{"solver.step": 5e-3, "floor.friction_law": law})
    sim.legs.table[:, :, SPRINGS] = 10 * sideways, sideways, 0.0, sideways
    for command in (np.full(4, STANCE), np.radians([90.0, 30.0, 50.0, 75.0])):
        sim.advance(1000, command)
        # A foot holds at most mu N, 4 N; this bounds the shift of a stiff leg to some nanometres.
        assert (sideways * np.abs(sim.state.node[:, YIELD, 1])).max() < 4.0
        assert np.abs(sim.velocity).max() < 5e-3  # m/s: at rest after 5 s


def test_moment_about_the_vertical_turns_a_stuck_robot_by_the_springs_of_its_legs():
    """Each foot resists along the leg, sideways and to its turn by leg and bristles in series."""
    sim, moment = (
        simulator(
            **{"floor.friction_law": "bristle", "start.settle": 10.0} | SMOOTH
        ),
        0.1,
    )
    sim.model.friction[:] = 2.0
    before, height = sim.rpy[2], sim.position[2]
    sim.push(np.zeros(3), np.array([0.0, 0.0, moment]))
    sim.advance(5000, sim.tendon_angle)
    foot = ROBOT.clamps + read("contact_x_m")(STANCE, height) * ROBOT.outward
    lever, offset = (foot * ROBOT.outward).sum(1), (foot * sim.legs.left).sum(1)
    names = ("longitudinal_N_per_m", "sideways_N_per_m")
    names += ("sideways_N_per_rad", "turn_N_m_per_rad")
    leg = foot_springs(*(read(name)(STANCE, height) for name in names))
    floor = sim.model.floor  # of an edge
    grip = 2 * floor.stiffness[-1] * np.array([1, 1, floor.half_width**2])
    held = np.linalg.inv(np.linalg.inv(leg) + np.diag(1.0 / grip))
    turned = np.array([-offset, lever, np.ones(4)])  # of the foot, per angle
    stiffness = (turned * (held @ turned)).sum()
    moved = np.abs(sim.state.node[:, YIELD]).min(axis=0)
    assert (moved > [1e-6, 1e-4, 1e-4]).all()  # m, m, rad
    # The angle is 2e-3; changes of the bristles' directions are of second order in it.
    assert sim.rpy[2] - before == pytest.approx(moment / stiffness, rel=5e-3)


def test_newton_step_is_exact_where_feet_stick():
    """The tangent of feet that yield to stuck edges: a second iteration changes nothing."""
    ends = []
    for iterations in (1, 4):
        sim = simulator(
            **{
                "floor.friction_law": "bristle",
                "start.settle": 5.0,
                "solver.iterations": iterations,
                "solver.step": 1e-3,
            }
        )
        sim.model.friction[:] = 50.0
        still = sim.velocity, sim.angular_velocity
        sim.push(np.array([0.5, -0.3, 0.0]), np.array([0.01, 0.02, 0.05]))
        sim.advance(1, sim.tendon_angle)
        change = sim.velocity - still[0], sim.angular_velocity - still[1]
        ends.append(np.concatenate(change))
    assert np.abs(ends[0][:2]).max() > 1e-5
    assert ends[0] == pytest.approx(ends[1], rel=2e-3, abs=1e-7)


def test_error_is_of_first_order_in_the_step():
    def end(step):
        sim = simulator(**{"solver.step": step})
        for command in (
            np.full(4, STANCE),
            np.radians([90.0, 30.0, 50.0, 75.0]),
        ):
            sim.advance(round(0.3 / step), command)
        return np.append(sim.position, sim.rpy)

    exact = end(2.5e-5)
    errors = [np.abs(end(step) - exact).max() for step in (4e-3, 2e-3, 1e-3)]
    assert errors[2] < 0.7 * errors[1] < 0.49 * errors[0]
    assert errors[0] < 2e-3


def test_robot_sticks_on_a_slope_with_bristles_and_creeps_with_viscous_friction():
    tilted = (GRAVITY * math.sin(0.1), 0.0, -GRAVITY * math.cos(0.1))
    drift = {}
    for law in ("viscous", "bristle"):
        # A foot creeps against the spring of its leg with mu N / (eps k_y), 12 s.
        sim = simulator(
            gravity=tilted, **{"floor.friction_law": law, "start.settle": 60.0}
        )
        before = sim.position
        sim.advance(2000, sim.tendon_angle)
        drift[law] = (sim.position - before)[0]
    assert abs(drift["bristle"]) < 1e-6
    # Four feet of friction mu N v / sqrt(v^2 + eps^2) = N tan(0.1): v = eps s / sqrt(1 - s^2).
    share = math.tan(0.1) / 0.4
    assert drift["viscous"] == pytest.approx(
        2e-3 * share / math.sqrt(1 - share**2), rel=0.1
    )


def test_slack_tendon_equals_a_spool_turned_back_and_broken_one_has_no_tension():
    slack = {"tendons.slack": (0.002,) * 4, "start.settle": 30.0} | SMOOTH
    turned = simulator(
        **slack | {"start.tendon_angle_deg": 63.0 + math.degrees(0.2)}
    )
    plain = simulator(**{"start.settle": 30.0} | SMOOTH)
    assert turned.position[2] == pytest.approx(plain.position[2], abs=1e-9)
    broken = simulator(**{"tendons.broken": (True,) * 4, "start.settle": 1.0})
    assert not broken.tension.any()
    assert broken.position[2] < 0.018  # the torso lies on the floor


SPATIAL = {"solver.legs": "spatial"}  # of the scene `flat`, 22 nodes


def test_standing_and_stepping_agree_with_the_rods_within_a_millimetre_and_a_half():
    paths = []
    for name, legs in (("map", {}), ("flat", SPATIAL)):
        scene = config.replace(read_scene(name), {"start.settle": 0.0} | legs)
        sim, path = make_robot(ROBOT, scene, read_servo()), []
        for k in range(150):
            late = np.radians([90.0, 30.0, 50.0, 75.0])
            sim.advance(10, np.full(4, STANCE) if k < 50 else late)
            path.append(sim.position)
        paths.append(np.array(path))
    # 1.1 mm
    assert np.sqrt(np.sum((paths[0] - paths[1]) ** 2, axis=1).mean()) < 1.5e-3


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"floor.height_map": "uneven.csv"}, r"floor\.height_map"),
        ({"floor.contact": "tip"}, r"floor\.contact"),
        ({"floor.stiffness": 1e4}, r"floor\.stiffness"),
        ({"floor.line_stiffness": 1e5}, r"floor\.line_stiffness"),
        ({"solver.halvings": 3}, r"solver\.halvings"),
    ],
)
def test_scene_that_the_table_does_not_cover_is_refused_with_the_name_of_the_setting(
    changes, named
):
    with pytest.raises(config.ConfigError, match=named):
        simulator(**changes)


@pytest.mark.parametrize(
    ("speed", "spin", "message"),
    [
        (0.0, 15.0, r"tilted by more than 60 deg"),
        (1e3, 0.0, r"beyond 100\.0 m/s or not a number"),
    ],
)
def test_torso_tilted_too_far_or_lost_is_a_divergence(speed, spin, message):
    sim = simulator(**{"start.height": 0.5})
    sim.set_motion(np.array([speed, 0.0, 0.0]), np.array([spin, 0.0, 0.0]))
    with pytest.raises(DivergenceError, match=message):
        sim.advance(300, np.zeros(4))


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


def test_a_table_and_the_leg_that_it_was_made_for_are_read_at_once(
    monkeypatch,
):
    read = Mock(wraps=leg_table.read_text)
    monkeypatch.setattr(leg_table, "read_text", read)
    read_leg_table(COLUMNS)
    assert read.call_count == 1


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


def test_a_robot_at_rest_on_a_slope_leans_downhill(springs):
    """Pitches on slopes of 8 deg, up and down along +x: of massless legs two thirds of the rods'."""
    pitch, expected = np.zeros(2), np.zeros(2)
    for k, slope in enumerate(np.radians([8.0, -8.0])):
        up = np.array([np.sin(slope), 0.0, np.cos(slope)])
        changes = {**level_changes("coarse"), "gravity": [*(-GRAVITY * up)]}
        scene = config.replace(read_scene("flat"), changes, "scene")
        rods = make_robot(ROBOT, scene, read_servo())
        rods.advance(500, STANDING)
        pitch[k] = rods.rpy[1]
        held = rest_pose(ROBOT, springs, rods.tendon_angle, lean=up[:2])
        expected[k] = held[2]
    assert np.diff(pitch) / 2 == pytest.approx(np.radians(0.78), rel=0.1)
    assert np.diff(expected) == pytest.approx(0.67 * np.diff(pitch), rel=0.1)


@pytest.mark.parametrize(
    ("ratio", "stiffness", "line"),
    [
        (1.0, 0.85, ""),
        (0.93, np.nan, "legs 7% softer than the table, or 0.2 kg more load"),
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

"""The robot on rods: conservation, an independent solver of its equations, standing, refusals."""

import numpy as np
import pytest
from leg_energy import mass_matrix, strains
from rod_robots import FLOATING, ROBOT, simulator
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import GRAVITY
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.leg_tests.level_leg import at_nodes


class VerticalDrop:
    """Vertical fall of a level robot with four equal legs: one leg with a quarter of the torso.

    Unknowns: height of the clamp, then x and z of the nodes. Independent implementation of the
    equations of rod, tendon and contact, for SciPy's implicit Runge-Kutta method.
    """

    def __init__(self, sim, angle):
        self.model, self.angle = sim.model, angle
        self.mass = mass_matrix(self.model.rod)
        self.mass[0, 0] += self.model.torso.mass / 4

    def start(self, height, speed):
        node = self.model.rod.node + np.array([0.0, height])
        velocity = np.tile([0.0, speed], (len(node), 1))
        return np.concatenate([node.ravel(), velocity.ravel()])

    def rate(self, _, y):
        node, velocity = y.reshape(2, -1, 2)
        force = self.internal(node, velocity) + self.contact(node, velocity)
        force[:, 1] -= GRAVITY * self.mass.sum(axis=1)
        acceleration = np.zeros_like(force)
        acceleration[:, 1] = np.linalg.solve(self.mass, force[:, 1])
        acceleration[1:, 0] = np.linalg.solve(self.mass[1:, 1:], force[1:, 0])
        return np.concatenate([velocity.ravel(), acceleration.ravel()])

    def internal(self, node, velocity):
        rod, tendon = self.model.rod, self.model.tendon
        chord, change = np.diff(node, axis=0), np.diff(velocity, axis=0)
        length = np.hypot(*chord.T)
        along = chord / length[:, None]
        across = along[:, ::-1] * [-1, 1] / length[:, None]
        stretch_rate = np.sum(along * change, axis=1)
        turn_rate = np.diff(np.sum(across * change, axis=1), prepend=0.0)
        extension, bend = strains(rod, node)
        bulge = -2.0 * rod.shortening * bend
        stretch_rate += bulge * turn_rate
        slack = tendon.relaxed - tendon.around @ rod.rest_angle
        cable = tendon.along @ extension + tendon.around @ bend - slack
        cable_rate = tendon.along @ stretch_rate + tendon.around @ turn_rate
        pull = tendon.stiffness * (cable + tendon.spool_radius * self.angle)
        pull = max(0.0, pull + tendon.damping * cable_rate)
        stretched = extension + rod.damping_time * stretch_rate
        bent = bend + rod.damping_time * turn_rate
        axial = rod.axial * stretched + pull * tendon.along
        moment = rod.bending * bent + pull * tendon.around + bulge * axial
        end = (
            axial[:, None] * along
            + (moment - np.append(moment[1:], 0.0))[:, None] * across
        )
        return np.vstack([end, [0, 0]]) - np.vstack([[0, 0], end])

    def contact(self, node, velocity):
        floor, gap = self.model.floor, node[:, 1]
        stiffness, damping = at_nodes(floor.stiffness), at_nodes(floor.damping)
        normal = np.maximum(0.0, -stiffness * gap - damping * velocity[:, 1])
        normal[gap >= 0.0] = 0.0
        slip = velocity[:, 0]
        drag = (
            self.model.friction[0, 0] * normal / np.hypot(slip, floor.friction_velocity)
        )
        return np.column_stack([-drag * slip, normal])


DROP = {
    "height": 0.05,
    "speed": -0.4,
    "angle": 1.2,
}  # m, m/s, rad: suddenly taut, 70 N a tendon


def dropped(step, seconds, theta):
    sim = simulator(
        servo="ideal",  # the jerk of the tendon at the start would turn a torque-limited servo back
        start__height=DROP["height"],
        start__settle=0.0,
        solver__nodes=7,
        solver__step=step,
        solver__theta=theta,
        solver__iterations=6,
    )
    sim.set_motion(np.array([0.0, 0.0, DROP["speed"]]), np.zeros(3))
    sim.state.tendon_angle[:] = DROP["angle"]
    sim.advance(round(seconds / step), np.full(4, DROP["angle"]))
    return sim


def drop_error(sims, seconds):
    """Largest distance of a node from the solution of Radau's method, m, for each simulator."""
    exact = VerticalDrop(sims[0], DROP["angle"])
    y0 = exact.start(DROP["height"], DROP["speed"])
    y = solve_ivp(
        exact.rate, (0, seconds), y0, method="Radau", rtol=1e-9, atol=1e-11
    ).y[:, -1]
    node, velocity = y.reshape(2, -1, 2)
    errors = []
    for sim in sims:
        shape = sim.nodes[0] - sim.nodes[0, 0]
        found = np.column_stack(
            [np.hypot(shape[:, 0], shape[:, 1]), sim.nodes[0, :, 2]]
        )
        errors.append(np.abs(found - node).max())
    return errors, node, exact.contact(node, velocity)[:, 1].sum()


def test_suddenly_taut_legs_agree_with_an_independent_solver_to_second_order():
    seconds = 2e-3
    sims = [dropped(step, seconds, 0.5) for step in (1e-4, 2.5e-5)]
    errors, _, force = drop_error(sims, seconds)
    assert force == 0.0  # still in the air
    assert errors[1] < 3e-7  # m; they move by 0.5 mm
    assert np.log2(errors[0] / errors[1]) / 2 > 1.8


def test_landing_agrees_with_an_independent_solver():
    """Taut legs hit the floor at 0.9 m/s and slide apart; state 80 ms after the start."""
    seconds = 0.08
    errors, node, force = drop_error([dropped(2.5e-5, seconds, 0.55)], seconds)
    assert force > 1.0  # N: it has landed
    assert (
        node[0, 1] > ROBOT.torso.size[2] / 2
    )  # contact of the torso is not in the reference
    assert errors[0] < 2e-5  # m, of first order in the step; the motion is 20 mm


@pytest.mark.parametrize(
    ("theta_deg", "height"), [(40, 0.017), (57, 0.033), (75, 0.056), (100, 0.087)]
)
def test_standing_heights_equal_those_of_an_earlier_implementation(theta_deg, height):
    """With the same parameters and friction 0.3; the heights are rounded to 1 mm."""
    sim = simulator(floor__friction=[0.3] * 4, start__tendon_angle_deg=float(theta_deg))
    sim.advance(1000, sim.tendon_angle)
    assert sim.position[2] == pytest.approx(height, abs=2e-3)
    assert np.abs(sim.rpy).max() < 1e-3


def step_response(step):
    sim = simulator(solver__step=step, start__settle=0.6)
    sim.advance(round(0.15 / step), np.radians([90.0, 30.0, 50.0, 75.0]))
    return np.concatenate([sim.position, 0.1 * sim.rpy])


def test_error_of_a_step_command_falls_with_the_time_step():
    fine = step_response(2e-5)
    errors = [np.linalg.norm(step_response(step) - fine) for step in (1e-3, 2.5e-4)]
    assert errors[0] < 5e-4  # m
    assert (
        np.log2(errors[0] / errors[1]) / 2 > 0.8
    )  # theta = .55 and the servo's lag: first order


@pytest.mark.parametrize("speed", [1.0, 3.0])
def test_robot_stands_after_an_impact_that_adds_no_energy(speed):
    sim = simulator(start__height=0.03, start__settle=0.0)
    sim.set_motion(np.array([0.1, 0.0, -speed]), np.array([0.5, 0.2, 0.0]))
    before, peak = sim.energy(), 0.0
    for _ in range(300):  # after 2 s it still oscillates by some mm
        sim.advance(10, np.full(4, 1.1))
        peak = max(peak, sim.energy())
    # The servos add 4 x 70 N over 8 mm = 2 J; the legs store 1 J at the start.
    assert peak < before + 2.5
    assert sim.position[2] == pytest.approx(0.04, abs=5e-3)
    assert np.abs(sim.rpy[:2]).max() < 0.01


def test_one_call_of_many_steps_equals_many_calls_of_one():
    one, many = simulator(start__settle=0.1), simulator(start__settle=0.1)
    command = np.array([1.2, 0.8, 1.0, 1.4])
    one.advance(50, command)
    for _ in range(50):
        many.advance(1, command)
    np.testing.assert_array_equal(one.nodes, many.nodes)
    assert one.time == many.time == pytest.approx(0.05)


def test_angles_and_quaternion_equal_those_of_scipy():
    sim = simulator(start__settle=0.0)
    for angles in np.random.default_rng(2).uniform(-1.5, 1.5, (20, 3)):
        sim.state.rotation[:] = Rotation.from_euler("xyz", angles).as_matrix()
        np.testing.assert_allclose(sim.rpy, angles, atol=1e-12)
        expected = Rotation.from_euler("xyz", angles).as_quat(canonical=True)
        np.testing.assert_allclose(sim.quaternion, expected, atol=1e-12)


def test_step_without_halvings_left_is_counted_as_unconverged():
    changes = {
        "start__height": 0.03,
        "start__settle": 0.0,
        "solver__correction_limit": 1e-15,
    }
    for halvings in (0, 2):
        sim = simulator(**changes, solver__halvings=halvings)
        sim.set_motion(np.array([0.0, 0.0, -1.0]), np.zeros(3))
        sim.advance(50, np.full(4, 1.1))
        assert sim.unconverged_steps > 0
        assert sim.halvings >= halvings * sim.unconverged_steps


def test_walking_steps_are_neither_halved_nor_indefinite():
    sim = simulator()
    for k in range(20):
        sim.advance(
            50, np.radians([[90.0, 30.0, 50.0, 75.0], [30.0, 90.0, 75.0, 50.0]][k % 2])
        )
    assert (sim.halvings, sim.indefinite_steps, sim.unconverged_steps) == (0, 0, 0)


PULLED = np.array([0.2, 0.6, 1.0, 1.4])  # rad


def test_directors_are_across_their_segments_and_turn_with_the_clamp():
    """A floating robot that has tumbled, with legs pulled unequally."""
    sim = simulator(**FLOATING)
    sim.set_motion(np.zeros(3), np.array([3.0, 4.0, 5.0]))
    sim.advance(100, PULLED)
    assert np.degrees(np.arccos(sim.rotation[2, 2])) > 20.0
    sim.state.node_velocity[:, :, 1] += (
        3.0 * np.linspace(0.0, 1.0, 22) ** 2
    )  # m/s, to the left
    sim.advance(10, PULLED)
    directors, along = sim.directors, np.diff(sim.nodes, axis=1)
    np.testing.assert_allclose(np.linalg.norm(directors, axis=2), 1.0, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("lki,lki->lk", along, directors), 0.0, atol=1e-12
    )
    right = np.cross(ROBOT.outward, [0.0, 0.0, 1.0]) @ sim.rotation.T
    turned = np.degrees(np.arccos(np.einsum("lki,li->lk", directors, right)))
    assert turned[:, 0].max() < 1.0  # a segment of 9 mm, the thickest
    assert turned[:, -1].min() > 2.0


def test_a_change_to_equal_parameters_in_a_run_changes_nothing_to_the_last_bit():
    nodes, command = [], np.radians([70.0, 60.0, 50.0, 80.0])
    for changes in (False, True):
        sim = simulator(servo="pid", start__settle=0.1)
        sim.advance(20, command)
        if changes:
            sim.change(sim.parameters, sim.scene, read_servo())
        sim.advance(20, command)
        nodes.append(sim.nodes)
    assert (nodes[0] == nodes[1]).all()


def test_a_change_in_a_run_ends_where_a_robot_with_those_parameters_does():
    scene = config.replace(
        read_scene("flat"), {"payload.mass": 0.5, "start.settle": 3.0}
    )
    wanted, sim = RodRobot(ROBOT, scene, read_servo()), simulator()
    sim.change(ROBOT, scene, read_servo())
    sim.advance(3000, np.full(4, np.radians(scene.start.tendon_angle_deg)))
    assert sim.position[2] == pytest.approx(
        wanted.position[2], abs=2e-4
    )  # feet slide otherwise

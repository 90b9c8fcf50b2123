"""The robot on rods: conservation, an independent solver of its equations, standing, refusals.

An installed copy uses the kernels of the repository's cache.

Many robots on threads of one process: each moves as it does alone.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from leg_energy import mass_matrix, strains
from rod_robots import FLOATING, ROBOT, simulator
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import slot_core
from slot_core import config
from slot_core.dynamics import observe
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import GRAVITY
from slot_core.simulation.make_robot import make_robot
from slot_core.simulation.many_robots import ANGLE, STATE, TENSION, ManyRobots
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

    def rate(self, _, y):
        node, velocity = y.reshape(2, -1, 2)
        force = self.internal(node, velocity) + self.contact(node, velocity)
        force[:, 1] -= GRAVITY * self.mass.sum(axis=1)
        acceleration = np.zeros_like(force)
        acceleration[:, 1] = np.linalg.solve(self.mass, force[:, 1])
        acceleration[1:, 0] = np.linalg.solve(self.mass[1:, 1:], force[1:, 0])
        return np.concatenate([velocity.ravel(), acceleration.ravel()])

    def internal(self, node, velocity):
        """(N, 2) N: derivatives of the strains times elastic, damping and tendon forces."""
        rod, tendon, count = self.model.rod, self.model.tendon, node.size
        shift = 1e-6 * np.eye(count).reshape(count, -1, 2)
        up, down = (
            np.concatenate(strains(rod, node + s * shift), axis=-1)
            for s in (1, -1)
        )
        slope = (up - down) / 2e-6
        strain, rate = (
            np.concatenate(strains(rod, node)),
            velocity.ravel() @ slope,
        )
        pulled = np.concatenate([tendon.along, tendon.around])
        cable = (
            pulled @ strain + tendon.around @ rod.rest_angle - tendon.relaxed
        )
        cable += tendon.spool_radius * self.angle
        pull = tendon.stiffness * cable + tendon.damping * (pulled @ rate)
        stress = np.concatenate([rod.axial, rod.bending])
        stress *= strain + rod.damping_time * rate
        stress += max(0.0, pull) * pulled
        return -(slope @ stress).reshape(-1, 2)

    def contact(self, node, velocity):
        floor, gap = self.model.floor, node[:, 1]
        stiffness, damping = at_nodes(floor.stiffness), at_nodes(floor.damping)
        normal = np.maximum(0.0, -stiffness * gap - damping * velocity[:, 1])
        normal[gap >= 0.0] = 0.0
        slip = velocity[:, 0]
        drag = (
            self.model.friction[0, 0]
            * normal
            / np.hypot(slip, floor.friction_velocity)
        )
        return np.column_stack([-drag * slip, normal])


# m, m/s, rad: suddenly taut, 70 N a tendon
DROP = {"height": 0.05, "speed": -0.4, "angle": 1.2}


def drop_errors(steps, seconds, theta, rtol):
    """Largest distance of a node from the solution of Radau's method, m, for each time step.

    Also the nodes (N, 2), m, and the normal force, N, of that solution, of the tolerance `rtol`.
    """
    sims = []
    for step in steps:
        solver = {"step": step, "theta": theta, "nodes": 7, "iterations": 6}
        # the jerk of the tendon at the start would turn a torque-limited servo back
        sim = simulator(
            servo="ideal",
            start__height=DROP["height"],
            start__settle=0.0,
            **{f"solver__{name}": value for name, value in solver.items()},
        )
        sim.set_motion(np.array([0.0, 0.0, DROP["speed"]]), np.zeros(3))
        sim.state.tendon_angle[:] = DROP["angle"]
        sim.advance(round(seconds / step), np.full(4, DROP["angle"]))
        sims.append(sim)
    exact = VerticalDrop(sim, DROP["angle"])
    begin = exact.model.rod.node + np.array([0.0, DROP["height"]])
    falling = np.tile([0.0, DROP["speed"]], (len(begin), 1))
    y0, options = (
        np.concatenate([begin, falling]).ravel(),
        {"rtol": rtol, "atol": 1e-3 * rtol},
    )
    y = solve_ivp(exact.rate, (0, seconds), y0, method="Radau", **options).y[
        :, -1
    ]
    node, velocity = y.reshape(2, -1, 2)
    errors = []
    for sim in sims:
        reach = np.linalg.norm((sim.nodes[0] - sim.nodes[0, 0])[:, :2], axis=1)
        errors.append(
            np.abs(np.column_stack([reach, sim.nodes[0, :, 2]]) - node).max()
        )
    return errors, node, exact.contact(node, velocity)[:, 1].sum()


def test_suddenly_taut_legs_agree_with_an_independent_solver_to_second_order():
    errors, _, force = drop_errors((1e-4, 2.5e-5), 2e-3, 0.5, 1e-7)
    assert force == 0.0  # still in the air
    assert errors[1] < 3e-7  # m; they move by 0.5 mm
    assert np.log2(errors[0] / errors[1]) / 2 > 1.8


def test_landing_agrees_with_an_independent_solver():
    """Taut legs hit the floor at 0.9 m/s and slide apart; state 80 ms after the start."""
    errors, node, force = drop_errors([2.5e-5], 0.08, 0.55, 1e-6)
    assert force > 1.0  # N: it has landed
    # contact of the torso is not in the reference
    assert node[0, 1] > ROBOT.torso.size[2] / 2
    # m, of first order in the step; the motion is 20 mm
    assert errors[0] < 2e-5


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


def test_directors_are_across_their_segments_and_turn_with_the_clamp():
    """A floating robot that has tumbled, with legs pulled unequally."""
    sim = simulator(**FLOATING)
    sim.set_motion(np.zeros(3), np.array([3.0, 4.0, 5.0]))
    sim.advance(110, np.array([0.2, 0.6, 1.0, 1.4]))
    across = np.einsum("lki,lki->lk", np.diff(sim.nodes, axis=1), sim.directors)
    np.testing.assert_allclose(across, 0.0, atol=1e-12)
    right = np.cross(ROBOT.outward, [0.0, 0.0, 1.0]) @ sim.rotation.T
    # a segment of 9 mm, the thickest
    np.testing.assert_allclose(sim.directors[:, 0], right, atol=np.radians(1.0))


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
    # feet slide otherwise
    assert sim.position[2] == pytest.approx(wanted.position[2], abs=2e-4)


def test_an_installed_copy_uses_the_kernels_that_the_setup_has_compiled(
    tmp_path,
):
    package = Path(slot_core.__file__).parent
    shutil.copytree(
        package,
        tmp_path / "slot_core",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    script = """if True:
        from slot_core.dynamics import observe
        print(observe.__file__, observe.points._cache.path((), observe.points.targetctx))
    """
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    file, cache = done.stdout.split()
    assert Path(file).is_relative_to(tmp_path)
    assert cache == str(
        observe.points._cache.path((), observe.points.targetctx)
    )


# rad: robots, goals, legs
GOALS = np.linspace(0.9, 1.6, 3 * 2 * 4).reshape(3, 2, 4)
FRICTION = (0.2, 0.4, 0.7)


def robot(level="map", **changes):
    solver = {
        f"solver.{name}": v
        for name, v in config.load(f"solver/{level}").items()
    }
    return make_robot(
        ROBOT,
        config.replace(read_scene("flat"), solver | changes),
        read_servo(),
    )


def robots(level):
    return [robot(level, **{"floor.friction": [mu] * 4}) for mu in FRICTION]


@pytest.mark.parametrize("level", ["map", "coarse"])
@pytest.mark.parametrize("threads", [1, 2])
def test_each_robot_moves_to_the_last_bit_as_it_does_alone(level, threads):
    alone, together = robots(level), ManyRobots(robots(level), threads)
    for row, one, goals in zip(together.advance(GOALS, 10), alone, GOALS):
        for goal in goals:
            one.advance(10, goal)
        turning = one.rotation @ one.angular_velocity
        expected = np.concatenate(
            [one.rpy, one.position, turning, one.velocity]
        )
        assert row[STATE] == pytest.approx(expected, rel=1e-13, abs=1e-15)
        assert row[3:6].tolist() == one.position.tolist()
        assert row[ANGLE].tolist() == one.tendon_angle.tolist()
        assert row[TENSION].tolist() == one.tension.tolist()


@pytest.mark.parametrize("level", ["map", "coarse"])
def test_a_robot_that_diverged_is_nan_until_it_is_replaced_and_the_others_go_on(
    level,
):
    together, lost = ManyRobots(robots(level)), robot(level)
    together.replace(1, lost)
    lost.push(np.array([0.0, 0.0, 1e7]), np.zeros(3))
    for _ in range(2):
        finite = np.isfinite(together.advance(GOALS, 5)).all(axis=1)
        assert finite.tolist() == [True, False, True]
    together.replace(1, robot(level))
    assert np.isfinite(together.advance(GOALS, 5)).all()


@pytest.mark.parametrize(
    ("goals", "named"),
    [
        (GOALS[:2], "goals: shape"),
        (np.full((3, 1, 4), np.nan), "not finite"),
        (np.full((3, 1, 4), 9.0), r"not in \[0, "),
    ],
)
def test_goals_that_no_servo_can_take_and_robots_on_other_legs_are_refused(
    goals, named
):
    together = ManyRobots(robots("map"))
    before = together.motion.copy()
    with pytest.raises(ValueError, match=named):
        together.advance(goals, 5)
    assert (together.motion == before).all()
    with pytest.raises(ValueError, match="robot 1: legs of another model"):
        ManyRobots([robot("map"), robot("coarse")])

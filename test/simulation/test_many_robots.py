"""Many robots on threads of one process: each moves as it does alone."""

import numpy as np
import pytest

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.make_robot import make_robot
from slot_core.simulation.many_robots import ANGLE, STATE, TENSION, ManyRobots

ROBOT, SERVO = read_robot(), read_servo()
# rad: robots, goals, legs
GOALS = np.linspace(0.9, 1.6, 3 * 2 * 4).reshape(3, 2, 4)
FRICTION = (0.2, 0.4, 0.7)


def robot(level="map", **changes):
    solver = {
        f"solver.{name}": v
        for name, v in config.load(f"solver/{level}").items()
    }
    return make_robot(
        ROBOT, config.replace(read_scene("flat"), solver | changes), SERVO
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

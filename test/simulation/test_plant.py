"""Pushes and faults act on the simulated robot; commands go on at their rate."""

import numpy as np
import pytest

from slot_core import config
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.safety.states import State
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.readings import TrueState
from slot_core.simulation.supervised_loop import SupervisedLoop

START, MILLISECOND = 7_000_000_000, 1_000_000  # ns
FORCE, MOMENT = [0.0, 4.0, 1.0], [0.1, 0.0, 0.2]
FIRST = {"time": 0.1, "duration": 0.05, "force": FORCE, "moment": MOMENT}
SECOND = {
    "time": 0.12,
    "duration": 0.1,
    "force": [2.0, 0.0, 0.0],
    "moment": [0.0, 0.0, 0.0],
}


def plant(**pushes):
    changes = {"pushes": pushes, "start.settle": 0.3}
    scene = config.replace(read_scene("flat"), changes)
    return RobotSimulator(read_robot(), scene, read_servo(), np.random.default_rng(0))


def acting_pushes(plant, milliseconds):
    """(n, 6) external force and moment in each millisecond after the start."""
    plant.start(START)
    acting = []
    for k in range(milliseconds):
        acting.append(plant.robot.model.push.copy())
        list(plant.advance(START + (k + 1) * MILLISECOND))
    return np.array(acting)


def test_pushes_act_from_their_time_for_their_duration_and_add_up():
    acting = acting_pushes(plant(first=FIRST, second=SECOND), 300)
    expected = np.zeros((300, 6))
    expected[100:150] += [*FORCE, *MOMENT]
    expected[120:220, 0] += 2.0
    np.testing.assert_allclose(acting, expected, atol=1e-15)


def test_push_between_two_time_steps_does_not_shift_the_clock():
    odd = {**FIRST, "time": 0.1004, "duration": 0.0501}
    each = plant(first=odd)
    acting = acting_pushes(each, 200)
    assert each.now == START + 200 * MILLISECOND
    # Whole time steps: the push acts in 50 of them.
    assert np.count_nonzero(acting[:, 1]) == pytest.approx(50, abs=1)
    assert not acting[-1].any()


def test_a_push_that_the_robot_does_not_support_is_refused_at_once():
    scene = config.replace(
        read_scene("paper"), {"pushes": {"first": FIRST}, "start.settle": 0.0}
    )
    with pytest.raises(
        ConfigError, match="legs of the model 'paper' do not support pushes"
    ):
        RobotSimulator(read_robot(), scene, read_servo(), np.random.default_rng(0))


def test_a_command_goes_on_at_its_rate_for_a_tenth_of_a_second():
    """The ideal servo shows it: it follows its goal, which moves every 10 ms."""
    ideal = config.replace(
        read_servo(), {"model": "ideal", "lag": 1e-3, "ideal_rpm": 1000.0}
    )
    scene = config.replace(read_scene("flat"), {"start.settle": 0.3})
    each = RobotSimulator(read_robot(), scene, ideal, np.random.default_rng(0))
    each.start(START)
    begin, rate = each.robot.tendon_angle, np.array([1.0, -0.5, 0.0, 2.0])
    each.command(begin, rate)
    for milliseconds, moved in [
        (9, 0.0),
        (19, 0.01),
        (99, 0.09),
        (200, 0.1),
        (300, 0.1),
    ]:
        list(each.advance(START + milliseconds * MILLISECOND))
        assert each.robot.tendon_angle == pytest.approx(begin + moved * rate, abs=1e-5)


@pytest.mark.parametrize(("legs", "segments"), [("spatial", 21), ("map", 0)])
def test_the_truth_has_the_directors_of_the_legs_that_have_a_width(legs, segments):
    changes = {"solver.legs": legs, "solver.halvings": 0, "start.settle": 0.1}
    scene = config.replace(read_scene("flat"), changes)
    made = RobotSimulator(read_robot(), scene, read_servo(), np.random.default_rng(0))
    made.start(START)
    truth = [
        r for r in made.advance(START + 40 * MILLISECOND) if isinstance(r, TrueState)
    ][-1]
    assert truth.directors.shape == (4, segments, 3)
    assert truth.nodes.shape[1] == {0: 2}.get(segments, segments + 1)


LOADS = [{"scene.payload.mass": 2.0}, {"robot.torso.mass": 4.0}]


@pytest.mark.parametrize("hardware", ["sim", "fake_bus"])
@pytest.mark.parametrize("load", LOADS, ids=["payload", "torso"])
def test_a_robot_of_twice_its_weight_settles_before_time_zero_and_ends_in_a_stand(
    load, hardware
):
    """It lies on its belly; after `start.settle` alone it would still bounce."""
    loop = SupervisedLoop("flat", "stand", None, 0, hardware=hardware, changes=load)
    assert np.linalg.norm(loop.plant.robot.velocity) < 0.01
    states = [report.state for report in loop.run(4.0)]
    assert states[-1] is State.STANDING
    assert State.HOLD not in states


def test_a_robot_that_does_not_come_to_rest_is_refused():
    ice = {
        "floor.friction": [0.0] * 4,
        "floor.torso_friction": 0.0,
        "start.settle": 0.3,
    }
    scene = config.replace(read_scene("slope5"), ice)
    with pytest.raises(
        ConfigError, match=r"start\.settle = 0\.3: after 10 s more the torso still"
    ):
        RobotSimulator(read_robot(), scene, read_servo(), np.random.default_rng(0))

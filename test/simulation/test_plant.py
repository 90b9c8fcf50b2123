"""Pushes and faults act on the simulated robot; commands go on at their rate."""

import numpy as np
import pytest
from rod_robots import plant

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.safety.states import State
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


def make(name="flat", servo=None, **changes):
    scene = config.replace(read_scene(name), {"start.settle": 0.3} | changes)
    return plant(scene, servo)


@pytest.mark.parametrize("shift", [0.0, 4e-4])
def test_pushes_act_from_their_time_for_their_duration_and_add_up(shift):
    """External force and moment in each millisecond; a begin between two steps shifts no clock."""
    first = FIRST | {"time": 0.1 + shift}
    plant, acting = make(pushes={"first": first, "second": SECOND}), []
    plant.start(START)
    for k in range(1, 301):
        acting.append(plant.robot.model.push.copy())
        list(plant.advance(START + k * MILLISECOND))
        assert plant.now == START + k * MILLISECOND
    expected, begin = np.zeros((300, 6)), 100 + np.ceil(shift).astype(int)
    expected[begin : begin + 50] += [*FORCE, *MOMENT]
    expected[120:220, 0] += 2.0
    np.testing.assert_allclose(acting, expected, atol=1e-15)


def test_a_command_goes_on_at_its_rate_for_a_tenth_of_a_second():
    """The ideal servo shows it: it follows its goal, which moves every 10 ms."""
    quick = {"model": "ideal", "lag": 1e-3, "ideal_rpm": 1000.0}
    plant = make(servo=config.replace(read_servo(), quick))
    plant.start(START)
    begin, rate = plant.robot.tendon_angle, np.array([1.0, -0.5, 0.0, 2.0])
    plant.command(begin, rate)
    for milliseconds, moved in [(9, 0.0), (19, 0.01), (99, 0.09), (300, 0.1)]:
        list(plant.advance(START + milliseconds * MILLISECOND))
        goal = begin + moved * rate
        assert plant.robot.tendon_angle == pytest.approx(goal, abs=1e-5)


LOADS = [{"scene.payload.mass": 2.0}, {"robot.torso.mass": 4.0}]


@pytest.mark.parametrize("hardware", ["sim", "fake_bus"])
@pytest.mark.parametrize("load", LOADS, ids=["payload", "torso"])
def test_a_robot_of_twice_its_weight_settles_before_time_zero_and_ends_in_a_stand(
    load, hardware
):
    """It lies on its belly; after `start.settle` alone it would still bounce."""
    loop = SupervisedLoop(
        "flat", "stand", None, 0, hardware=hardware, changes=load
    )
    assert np.linalg.norm(loop.plant.robot.velocity) < 0.01
    states = [report.state for report in loop.run(4.0)]
    assert states[-1] is State.STANDING
    assert State.HOLD not in states


ICE = {"floor.friction": [0.0] * 4, "floor.torso_friction": 0.0}
RESTLESS = r"start\.settle = 0\.3: after 10 s more the torso still"
UNSUPPORTED = "legs of the model 'paper' do not support pushes"


@pytest.mark.parametrize(
    ("scene", "changes", "message"),
    [
        ("slope5", ICE, RESTLESS),
        (
            "paper",
            {"pushes": {"first": FIRST}, "start.settle": 0.0},
            UNSUPPORTED,
        ),
    ],
)
def test_a_restless_robot_and_a_push_that_its_legs_do_not_support_are_refused(
    scene, changes, message
):
    with pytest.raises(config.ConfigError, match=message):
        make(scene, **changes)

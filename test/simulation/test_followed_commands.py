"""The controller corrects only what the servos follow: standing up, without solutions, in HOLD."""

import numpy as np

from slot_core.safety.states import Request, State
from slot_core.simulation.supervised_loop import SupervisedLoop


def heights(loop, seconds):
    """Heights of the torso, mm, every 20 ms."""
    return np.array(
        [1e3 * loop.plant.robot.position[2] for _ in loop.run(seconds)]
    )


def test_a_robot_that_has_lain_slack_stands_up_without_a_leap():
    """It flies up to 46 mm of its own. With the correction at work in READY it leapt to 73 mm."""
    loop = SupervisedLoop("flat", "stand", None, 0)
    list(loop.run(2.0))
    loop.supervisor.request(loop.plant.now, Request.RELAX)
    next(report for report in loop.run(3.0) if report.state is State.IDLE)
    list(loop.run(1.0))
    assert not loop.supervisor.request(loop.plant.now, Request.READY)
    list(loop.run(1.0))
    assert loop.plant.robot.position[2] < 0.02
    assert not loop.supervisor.request(loop.plant.now, Request.STAND)
    height = heights(loop, 5.0)
    assert height.max() < 50.0
    assert np.abs(height[150:] - 40.0).max() < 1.0


def test_after_a_second_without_solutions_a_standing_robot_does_not_drop():
    """The last angles are held."""
    loop = SupervisedLoop("flat", "stand", None, 0)
    problem = loop.loop.controller.policy._problem
    change = problem.change
    list(loop.run(5.0))
    problem.change = lambda *_: None
    list(loop.run(1.0))
    assert loop.report.state is State.HOLD
    problem.change = change
    height = heights(loop, 4.0)
    assert loop.report.state is State.STANDING
    assert height.min() > 35.0


def test_a_walk_goes_on_after_a_hold_of_four_seconds():
    loop = SupervisedLoop("flat", "walk", np.array([0.05, 0.0, 0.0]), 0)
    list(loop.run(6.0))
    observer = loop.loop.controller.policy.observer
    loop.running.discard("mpc_controller")
    next(report for report in loop.run(1.0) if report.state is State.HOLD)
    before = observer.wrench.copy()
    list(loop.run(3.5))
    assert loop.report.state is State.HOLD
    np.testing.assert_array_equal(observer.wrench, before)
    loop.running.add("mpc_controller")
    begin = loop.plant.robot.position[0]
    assert {report.state for report in loop.run(8.0)} == {
        State.HOLD,
        State.WALKING,
    }
    assert loop.plant.robot.position[0] - begin > 0.05 * 6.0

"""The played robot: every command, change and push has its effect while the robot moves."""

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.control.controller import Tick
from slot_core.safety.states import Request, State
from slot_lab.play.played_robot import FRAME, PlayedRobot

UP = 3.0  # s, to stand up and settle


def run(robot, seconds):
    for _ in range(round(seconds / FRAME)):
        robot.advance()
    return robot.truth.odometry


def state(robot, seconds):
    """State after a while."""
    run(robot, seconds)
    return robot.loop.report.state


@pytest.fixture
def standing():
    robot = PlayedRobot()
    assert state(robot, UP) is State.STANDING
    return robot


@pytest.fixture
def walking(standing):
    standing.wishes.gait, standing.wishes.velocity = (
        "walk",
        np.array([0.05, 0.0, 0.0]),
    )
    assert state(standing, 2.0) is State.WALKING
    return standing


def test_it_walks_where_it_is_wished_to_and_turns(walking):
    for velocity, axis in (
        ([0.05, 0, 0], 0),
        ([0, 0.03, 0], 1),
        ([-0.05, 0, 0], 0),
    ):
        walking.wishes.velocity = np.array(velocity, dtype=float)
        before = run(walking, 2.0).position
        way = run(walking, 2.0).position - before
        assert way[axis] == pytest.approx(2.0 * velocity[axis], rel=0.4)
    walking.wishes.velocity = np.array([0.0, 0.0, 0.1])
    before = run(walking, 2.0).quaternion[2]
    assert run(walking, 2.0).quaternion[2] - before > 0.5 * np.sin(0.1)


def test_it_walks_on_after_it_had_to_stand(walking):
    since = walking.loop.report.since
    walking.loop.request(Request.STAND)
    before = run(walking, 2.0).position[0]
    assert walking.loop.report.state is State.WALKING
    assert walking.loop.report.since > since
    assert run(walking, 2.0).position[0] - before > 0.06


def test_it_takes_a_pose_and_says_which_it_does_not(standing):
    before = standing.truth.odometry.position[2]
    standing.wishes.pose = np.array([before - 0.008, 0.0, np.radians(3.0)])
    after = run(standing, 3.0)
    assert after.position[2] < before - 0.005
    assert 2 * np.degrees(after.quaternion[1]) == pytest.approx(3.0, abs=1.0)
    standing.wishes.pose = np.array([1.0, 0.0, 0.0])
    run(standing, 0.1)
    assert "height" in standing.loop.refusal


@pytest.mark.parametrize(
    "change",
    [
        {"scene.payload.mass": -1.0},
        {"scene.solver.nodes": 5},
        {"gait.transition": 1.0},
        {"scene.floor.friction_law": "bristle"},
        {"scene.none": 1},
    ],
)
def test_what_cannot_change_is_refused_and_nothing_changes(change):
    robot = PlayedRobot()
    model = robot.loop.plant.robot.model
    with pytest.raises(ConfigError):
        robot.change(change)
    assert robot.loop.plant.robot.model is model
    assert robot.changes == {}


def test_once_a_broken_tendon_is_mended_and_the_robot_reset_it_walks(walking):
    walking.set_tendon("RR", broken=True)
    assert state(walking, 1.0) is not State.WALKING
    for _ in range(2):  # the second time it is mended already
        walking.set_tendon("RR", broken=False)
    run(walking, 8.0)
    walking.request(Request.RESET)
    walking.wishes.up = True
    assert state(walking, 8.0) is State.WALKING


def test_a_push_ends_and_a_pull_and_a_broken_tendon_outlive_a_change(standing):
    standing.push([0.0, 6.0, 0.0], 0.2)
    assert run(standing, 0.12).velocity[1] > 0.01
    run(standing, 0.2)
    assert not standing.loop.plant.robot.model.push.any()
    standing.set_tendon("FL", broken=True)
    for force in (4.0, 2.0, 0.0, 1.0):
        standing.pull(np.array([force, 0.0, 0.0]))
        run(standing, 0.04)
        assert standing.loop.plant.robot.model.push[0] == force
    standing.change({"scene.payload.mass": 0.1})
    model = standing.loop.plant.robot.model
    assert model.fault[1].tolist() == [0.0, 1.0, 1.0, 1.0]
    assert model.push.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_after_an_emergency_stop_it_rises_only_on_request(walking):
    walking.loop.request(Request.ESTOP)
    assert state(walking, 1.0) is State.ESTOP
    with pytest.raises(
        ConfigError, match="STAND refused in ESTOP: reset first"
    ):
        walking.stand_up()
    walking.set_gait("crawl")
    assert state(walking, 1.0) is State.ESTOP
    walking.request(Request.RESET)
    assert state(walking, 1.0) is State.IDLE
    walking.stand_up()
    assert state(walking, 5.0) is State.STANDING
    walking.set_gait("walk")
    assert state(walking, 3.0) is State.WALKING


def test_it_goes_on_under_another_policy(walking):
    for policy in ("force_mpc", "gait_alone"):
        walking.set_policy(policy)
        assert state(walking, 1.0) is State.WALKING
    with pytest.raises(ConfigError):
        walking.set_policy("none")
    assert walking.policy == "gait_alone"


def test_a_reset_keeps_changes_and_wishes_and_a_lost_simulation_needs_one(
    walking,
):
    walking.change({"scene.payload.mass": 0.2})
    walking.set_tendon("RL", broken=True)
    walking.loop.plant.robot.set_tip_to_nan(0)
    walking.advance()
    assert "diverged" in walking.ended
    assert walking.advance() == []
    walking.reset()
    assert walking.time == 0.0
    model = walking.loop.plant.robot.model
    assert model.payload[0] == 0.2
    assert model.fault[1].tolist() == [1.0, 1.0, 0.0, 1.0]
    walking.set_tendon("RL", broken=False)
    assert state(walking, 6.0) is State.WALKING


@pytest.mark.parametrize("scene", ["map", "paper", "none"])
def test_a_scene_without_rods_is_refused(scene):
    with pytest.raises(ConfigError, match=r"rods|none"):
        PlayedRobot(scene)


def test_it_keeps_what_happened_for_a_limited_time(standing, monkeypatch):
    ticks = [value for _, value in standing.history if isinstance(value, Tick)]
    assert len(ticks) == pytest.approx(UP / 0.033, abs=2)
    monkeypatch.setattr("slot_lab.play.played_robot.KEPT", 1.0)
    run(standing, FRAME)
    first, last = standing.history[0][0], standing.history[-1][0]
    assert last - first == pytest.approx(1e9, abs=2e7)

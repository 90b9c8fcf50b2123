"""The environments of the walk: their interface, what they draw, and the robot that they hold."""

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.simulation.closed_loop import ClosedLoop

gymnasium = pytest.importorskip(
    "gymnasium", reason="needs scripts/setup --learn"
)
from gymnasium.envs.registration import EnvSpec  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

from slot_lab.learning import NAME, rewards  # noqa: E402
from slot_lab.learning.task import level_changes, make_task  # noqa: E402
from slot_lab.learning.vector_env import WalkVectorEnv  # noqa: E402
from slot_lab.learning.walk_env import WalkEnv  # noqa: E402

FRICTION = {"scene.floor.friction": (0.2, 0.6)}
SHORT = {"duration": 0.4, "drawn": FRICTION}


def walked(env, count, seed=3):
    """Observations of so many steps without an action."""
    first, still = env.reset(seed=seed)[0], np.zeros(env.action_space.shape)
    return np.array([first, *(env.step(still)[0] for _ in range(count))])


@pytest.mark.parametrize("actions", ["amplitudes", "tendons"])
@pytest.mark.parametrize("observations", ["estimated", "true"])
def test_gymnasium_finds_no_fault_in_it_and_its_images(actions, observations):
    env = gymnasium.make(
        NAME, actions=actions, observations=observations, **SHORT
    )
    check_env(env.unwrapped)


def test_gymnasium_makes_both_environments_again_from_their_specs_as_text():
    for make in (gymnasium.make, gymnasium.make_vec):
        env = make(NAME, level="coarse", **SHORT)
        spec = EnvSpec.from_json(env.spec.to_json())
        assert make(spec).unwrapped.task == env.unwrapped.task
    assert isinstance(env.unwrapped, WalkVectorEnv)


@pytest.mark.parametrize(
    ("action", "named"),
    [
        (np.zeros((2, 4)), r"action: shape \(2, 4\), expected \(2, 3\)"),
        ([[0.0], [0.0, 0.0]], r"action: expected numbers of shape \(2, 3\)"),
        ([["0"] * 3] * 2, "action: <U1 values, expected real numbers"),
        ([[0, 0, 0], [0, np.nan, 0]], r"action\[1, 1\] = nan: not finite"),
    ],
)
def test_an_action_that_is_none_is_refused_and_moves_no_robot(action, named):
    env = WalkVectorEnv(2, render_mode="rgb_array", **SHORT)
    env.reset(seed=[1, 2])
    before = env.places
    with pytest.raises(ValueError, match=named):
        env.step(action)
    assert (env.places == before).all()
    with pytest.raises(ValueError, match="seed: 3 values, expected 2"):
        env.reset(seed=[1, 2, 3])
    assert env.observation_space.contains(env.step(np.zeros((2, 3)))[0])
    assert {(i.shape, i.dtype.name) for i in env.render()} == {
        ((260, 640, 3), "uint8")
    }


@pytest.mark.parametrize("level", ["map", "coarse"])
def test_without_actions_it_is_the_closed_loop_with_the_gait_alone(level):
    env, changes = WalkEnv(level=level), level_changes(level)
    walked(env, 20)
    scene = {f"scene.{name}": value for name, value in changes.items()}
    seed = int(np.random.default_rng(3).integers(2**31))  # what a reset draws
    velocity = np.array(env.task.velocity)
    loop = ClosedLoop(
        "flat", "walk", velocity, seed, "gait_alone", changes=scene
    )
    for _ in loop.run(21):
        position = loop.plant.robot.position
    assert env._loop.plant.robot.position.tolist() == position.tolist()


def test_many_robots_walk_as_far_as_the_one_with_sensors_and_servo_bus():
    arguments = {"level": "coarse", "observations": "true", "duration": 9.0}
    one, many = WalkEnv(**arguments), WalkVectorEnv(1, **arguments)
    for env in (one, many):
        walked(env, 180)
    x, y = one._loop.plant.robot.position[:2]
    assert many._robots.motion[0, 3] == pytest.approx(x, rel=0.1)
    assert many._robots.motion[0, 4] == pytest.approx(y, abs=0.02)
    assert many._course.place == pytest.approx(one._course.place, abs=0.01)


def test_an_episode_ends_after_its_time_and_the_next_step_begins_another():
    env = WalkVectorEnv(2, level="map", **SHORT)
    env.reset(seed=1)
    ends = [env.step(np.zeros((2, 3)))[2:4] for _ in range(14)]
    assert [bool(truncated.all()) for _, truncated in ends] == [
        *[False] * 11,
        True,
        False,
        False,
    ]
    assert not any(terminated.any() for terminated, _ in ends)
    assert env._ticks.tolist() == [1, 1]


def test_a_robot_that_falls_ends_its_episode_alone_and_without_a_reward():
    still, both = (
        np.zeros((2, 3)),
        [WalkVectorEnv(2, level="map") for _ in range(2)],
    )
    for env in both:
        env.reset(seed=1)
    both[0]._robots.robots[0].push(np.zeros(3), np.array([3.0, 0.0, 0.0]))
    steps = [[env.step(still) for env in both] for _ in range(30)]
    fell = [bool(terminated[0]) for (_, _, terminated, _, _), _ in steps]
    assert any(fell)
    assert steps[fell.index(True)][0][1][0] == 0.0
    for beside, without in steps:  # the other robot goes on as if it were alone
        assert (beside[0][1] == without[0][1]).all()


def test_what_is_drawn_is_set_for_all_values_or_for_each():
    drawn = {
        "scene.floor.friction": (0.2, 0.6),
        "scene.payload.place": ([0.0, -0.02, 0.0], [0.0, 0.02, 0.0]),
        "servo.lag": (0.01, 0.02),
        "velocity": ([0.02, 0.0, 0.0], [0.04, 0.0, 0.0]),
    }
    task = make_task(drawn=drawn)
    values = task.draw(np.random.default_rng(1))
    scene, servo = task.world(values)
    (friction,), (x, y, z) = set(scene.floor.friction), scene.payload.place
    assert 0.2 <= friction <= 0.6
    assert x == z == 0.0 < abs(y) <= 0.02
    assert 0.01 <= servo.lag <= 0.02
    assert 0.02 <= task.commanded(values)[0] <= 0.04


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"level": "exact"}, "level = 'exact': expected one of coarse"),
        (
            {"actions": "legs"},
            "actions = 'legs': expected one of tendons, amplitudes",
        ),
        ({"observations": "all"}, "observations = 'all'"),
        ({"gait": "stand"}, "gait = 'stand': expected one of "),
        ({"duration": 0.0}, r"duration = 0: outside \[0.033, 3600\] s"),
        ({"velocity": (0.5, 0, 0)}, r"v_x = 0.5: gait walk reaches"),
        (
            {"drawn": {"robot.leg.width": (1, 2)}},
            "drawn robot.leg.width: expected velocity or",
        ),
        (
            {"drawn": {"scene.floor.mu": (0.1, 0.2)}},
            "scene: floor.mu is not a setting",
        ),
        (
            {"drawn": {"scene.floor.friction": (-2.0, -1.0)}},
            r"friction\[0\] = -",
        ),
        ({"render_mode": "human"}, "'human': expected one of rgb_array"),
        ({"scene": "push"}, "its pushes and faults come at times of their own"),
    ],
)
def test_a_wrong_task_is_refused_with_name_value_and_limit(arguments, named):
    with pytest.raises(ConfigError, match=named):
        WalkVectorEnv(1, **{"velocity": (0.0, 0.0, 0.0), **arguments})


@pytest.mark.parametrize(
    ("strayed", "term", "value"),
    [
        ((rewards.SPEED, 0.0, 0.0), "speed", -1.0),
        ((0.0, -1.5 * rewards.ASIDE, 0.0), "aside", -2.25),
        ((0.0, 1.0, 0.0), "aside", rewards.WORST),
        ((0.0, 0.0, -1.5 * rewards.TURN), "yaw", -2.25),
    ],
)
def test_speed_place_and_heading_off_the_course_cost(strayed, term, value):
    others = (np.zeros((1, size)) for size in (2, 4, 3))
    stray = np.array(strayed)[:, None]
    terms = rewards.reward_terms(np.zeros((1, 12)), stray, *others)
    expected = dict.fromkeys(rewards.WEIGHTS, 0.0) | {
        "walking": 1.0,
        term: value,
    }
    assert terms == pytest.approx(expected, abs=1e-9)

"""The rollout MPC: its phases, its faults, and what it does for a robot.

Disturbance observer: a wrench and a drift are found, and a robot unlike its model.

Rollouts of the nominal robot against the simulated robot, step by step.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from slot_core.control.effort import CALM, Effort, EffortChoice
from slot_core.control.force_map import read_springs
from slot_core.control.policy import Status
from slot_core.dynamics.servo import read_servo
from slot_core.gait.route import Route
from slot_core.geometry import rpy_of
from slot_core.key_frame import capture, restore
from slot_core.legs.tabulated_robot import TabulatedRobot
from slot_core.robot import read_robot
from slot_core.rollout_mpc.disturbance_observer import DisturbanceObserver
from slot_core.rollout_mpc.nominal_robot import NominalRobot, nominal_scene
from slot_core.rollout_mpc.posture_feedback import PostureFeedback
from slot_core.rollout_mpc.rollout_mpc import RolloutMpc
from slot_core.rollout_mpc.settings import read_rollout_mpc
from slot_core.simulation.closed_loop import ClosedLoop

ROBOT, SETTINGS = read_robot(), read_rollout_mpc()
WALK = np.array([0.05, 0.0, 0.0])
LIMITS, STAGES = SETTINGS.limits, SETTINGS.stages
OBSERVER = SETTINGS.observer


@pytest.fixture(scope="module")
def walking():
    """Ticks of a robot that starts to walk from the posture `stand`."""
    return list(ClosedLoop("flat", "walk", WALK, 1, "rollout_mpc").run(60))


def torso_of(model, start):
    """State (12,) of the torso of a nominal robot, as of an estimate."""
    torso = model.robot.state
    torso.buffer[:] = start
    rpy, omega = rpy_of(torso.rotation), torso.rotation @ torso.rate
    return np.concatenate([rpy, torso.position, omega, torso.velocity])


def follow(policy, ticks):
    plans = []
    for tick in ticks:
        plans.append(step(policy, tick))
        policy.prepare()
    return plans


def step(policy, tick, **preview):
    """A plan, with changes of the preview."""
    return policy.step(tick.estimate, replace(tick.preview, **preview))


def after(ticks):
    """A policy that has planned for these ticks."""
    policy = RolloutMpc(ROBOT, SETTINGS, lambda: 0.0)
    follow(policy, ticks)
    return policy


def with_state(tick, index, value):
    """The tick with another element of its state."""
    state = tick.estimate.state.copy()
    state[index] = value
    return replace(tick, estimate=replace(tick.estimate, state=state))


def test_effort_falls_with_each_tick_short_of_time_and_comes_back_after_a_while():
    choice = EffortChoice()
    assert [choice.add(s, 0.033) for s in (0.001, 0.02, 0.02, 0.02)] == [
        Effort.FULL,
        Effort.SLOPES,
        Effort.GAIT,
        Effort.GAIT,
    ]
    later = [choice.add(0.001, 0.033) for _ in range(2 * CALM)]
    assert later[CALM - 2 :: CALM - 1][:2] == [Effort.GAIT, Effort.SLOPES]
    assert later[-1] is Effort.FULL


def test_with_less_effort_fewer_plans_are_rolled_out(walking, monkeypatch):
    policy, rolled = after(walking[:30]), []
    roll_out = policy._model.roll_out
    monkeypatch.setattr(
        policy._model,
        "roll_out",
        lambda start, plans: (
            rolled.append(len(plans)) or roll_out(start, plans)
        ),
    )
    counts = []
    for at, effort in zip((30, 32, 34, 36), (*Effort, Effort.FULL)):
        for tick in walking[at : at + 2]:
            policy.effort = effort
            policy.prepare()
            assert step(policy, tick).message == effort
            rolled.clear()
        policy.prepare()
        counts.append(max(rolled))
    assert counts == [21, 5, 1, 21]


def test_the_messages_of_plans_are_enough_to_repeat_them_from_a_key_frame(
    walking,
):
    efforts = [*Effort, Effort.GAIT, Effort.SLOPES, *[Effort.FULL] * 3] * 4
    policy, frames, plans = after(walking[:30]), [], []
    for number, tick in enumerate(walking[30:54]):
        policy.effort = efforts[number]
        policy.prepare()
        plans.append(step(policy, tick))
        if number % 2:  # else the node has not prepared yet
            policy.effort = efforts[number + 1]
            policy.prepare()
        frames.append(capture(policy))
    for begin in range(8):
        repeated = RolloutMpc(ROBOT, SETTINGS, lambda: 0.0)
        restore(repeated, frames[begin])
        for tick, plan in list(zip(walking[30:], plans))[begin + 1 :]:
            repeated.effort = Effort.of(plan.message)
            repeated.prepare()
            assert np.array_equal(step(repeated, tick).angle, plan.angle)


def test_a_missed_estimate_moves_the_plan_on(walking):
    skipped, every, anew = (
        step(after(walking[:number]), walking[39]) for number in (38, 39, 0)
    )
    assert skipped.status == Status.SOLVED
    off, begun = (
        np.abs(plan.angle - every.angle).mean() for plan in (skipped, anew)
    )
    assert off < 0.5 * begun


@pytest.mark.parametrize(("index", "value"), [(3, 5.0), (2, 2.0)])
def test_a_jump_of_the_place_begins_the_plan_anew_and_moves_no_leg_by_much(
    walking, index, value
):
    tick, reference = walking[40], walking[40].preview.reference.copy()
    expected = step(after(walking[:40]), tick).angle[0]
    reference[:, index] += value
    moved = with_state(tick, index, tick.estimate.state[index] + value)
    plan = step(after(walking[:40]), moved, reference=reference)
    assert plan.status == Status.SOLVED
    assert np.abs(plan.angle[0] - expected).max() < 1.2 * LIMITS.deviation


def test_where_the_servos_do_not_follow_the_plan_is_the_gaits(walking):
    policy, gait = after(walking[:30]), walking[30].preview.tendon_angle
    plan = step(policy, walking[30], corrected=False)
    np.testing.assert_array_equal(plan.angle, gait[:STAGES])
    assert plan.force.shape == (STAGES, 4, 3)
    assert step(policy, walking[31]).status == Status.SOLVED


def test_rejected_states_move_the_last_plan_on_towards_the_gait_and_then_stop(
    walking,
):
    policy, ticks = after(walking[:30]), walking[30 : 30 + LIMITS.cycles + 2]
    missed = follow(policy, [with_state(tick, 5, math.nan) for tick in ticks])
    used, stopped = missed[: LIMITS.cycles], missed[LIMITS.cycles :]
    assert {plan.status for plan in used} == {Status.REJECTED}
    assert [plan.fallback_cycles for plan in missed] == list(
        range(1, len(missed) + 1)
    )
    assert used[0].message == "state[5] = nan: outside [-10000, 10000]"
    # a column of a bag keeps its shape, whoever has made the plan
    assert {plan.force.shape for plan in missed} == {(STAGES, 4, 3)}
    first, last = (
        np.abs(used[k].angle[0] - ticks[k].preview.tendon_angle[0]).max()
        for k in (0, LIMITS.cycles - 1)
    )
    assert last < 0.25 * first + 0.01  # rad: the wrench is still carried
    assert {plan.status for plan in stopped} == {Status.STOPPED}
    said = f"fallback used up after {LIMITS.cycles} cycles; state"
    assert stopped[-1].message.startswith(said)
    assert not len(stopped[-1].angle)
    again = step(policy, walking[45])
    assert (again.status, again.fallback_cycles) == (Status.SOLVED, 0)


def test_a_late_plan_a_rollout_that_diverges_and_an_unsolved_problem_are_faults(
    walking,
):
    clock = iter(np.arange(0.0, 100.0, LIMITS.time_budget * 1.1))
    late = RolloutMpc(ROBOT, SETTINGS, lambda: next(clock))
    # no plan to fall back on
    assert step(late, walking[0]).status == Status.STOPPED
    short = walking[0].preview.tendon_angle[:5]
    plan = step(after([]), walking[0], tendon_angle=short)
    assert plan.status == Status.STOPPED
    said = "no plan yet; preview.tendon_angle: shape (5, 4), needs (24, 4)"
    assert plan.message == said
    # rad, beyond what its legs can carry
    plan = step(after(walking[:30]), with_state(walking[30], 1, 1.3))
    assert (plan.status, plan.message) == (
        Status.NOT_SOLVED,
        "the rollout diverges",
    )
    policy, said = after(walking[:30]), "the quadratic programme is not solved"
    policy._problem.change = lambda *_: None
    plan = step(policy, walking[30])
    assert (plan.status, plan.message) == (Status.NOT_SOLVED, said)


def test_a_corner_is_followed_closer_than_by_the_gait_alone():
    """Distances from the path, mm."""
    found, corner = {}, np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.3]])
    for policy in ("gait_alone", "rollout_mpc"):
        path = Route(corner, "kept")
        loop = ClosedLoop("flat", "walk", WALK, 1, policy, path=path)
        places = [1e3 * loop.plant.robot.position[:2] for _ in loop.run(300)]
        x, y = np.array(places[90:]).T
        before = np.hypot(x - np.clip(x, 0, 200), y)
        behind = np.hypot(x - 200, y - np.maximum(y, 0))
        found[policy] = np.sqrt(np.mean(np.minimum(before, behind) ** 2))
    assert found["rollout_mpc"] < 0.4 * found["gait_alone"]


def test_a_torso_that_the_legs_cannot_carry_sinks(walking):
    """Without it the angles of soft legs all stand at their limit, and the stride is gone."""
    policy, preview = after(walking[:30]), walking[30].preview
    assert policy._nominal(preview)[1] == pytest.approx(0.0, abs=5e-4)
    policy.observer.wrench[:] = -8.0, 0.0, 0.0
    nominal, sag = policy._nominal(preview)
    assert (nominal == ROBOT.tendon.angle_max).any()
    assert 1e-3 < sag < 8.0 / SETTINGS.observer.stiffness[0]


def rough_walk(seed, friction_after):
    """Way (m) in 15 s on rubber; the friction is judged after so many s. Also its last tick."""
    changes = {
        "scene.floor.friction": [1.1] * 4,
        "policy.observer.friction_after": friction_after,
    }
    loop = ClosedLoop(
        "flat", "walk", WALK, seed, "rollout_mpc", changes=changes
    )
    *_, last = loop.run(450)
    return float(loop.plant.robot.position[0]), last


def test_on_a_floor_that_grips_it_walks_and_the_model_learns_of_it():
    """Mean of three seeds; of six, it walks 0.50 to 0.65 m, and 0.21 to 0.56 m without."""
    ways = {after: [] for after in (100.0, OBSERVER.friction_after)}
    for friction_after, found in ways.items():
        for seed in range(1, 4):
            way, last = rough_walk(seed, friction_after)
            found.append(way)
            assert last.plan.status is Status.SOLVED
            learned = friction_after == OBSERVER.friction_after
            said = "the floor grips: friction 0.8 in the model"
            assert last.plan.message == (said if learned else "")
    without, with_it = (np.mean(found) for found in ways.values())
    assert with_it > 1.3 * without


def test_the_feedback_of_a_posture_begins_at_the_last_command_and_adds_up_the_error():
    """Against the closed form of the filtered error, f_n = e (1 - (1 - filter)^n)."""
    posture, limits = SETTINGS.posture, replace(SETTINGS.limits, decay=0.0)
    shares, stiffness = np.arange(12.0).reshape(4, 3) / 10, np.full(4, 5.0)
    feedback = PostureFeedback(posture, limits, shares)
    error, gait = np.array([-1e-3, 2e-3, 1e-3]), np.full(4, 1.2)
    carried, uneven = gait + 0.05, np.array([0.02, -0.02, 0.01, -0.01])
    last = carried + 0.1 + uneven
    for _ in range(20):
        last = feedback.angle(error, gait, carried, last, stiffness)
    seen = 1.0 - (1.0 - posture.filter) ** np.arange(1, 21)
    wrench = error * posture.stiffness
    wrench *= posture.gain * seen.sum() + seen[-1]
    expected = carried + uneven - shares @ wrench / stiffness
    assert last == pytest.approx(expected, abs=1e-12)
    feedback.forget()
    again = feedback.angle(np.zeros(3), gait, gait, gait, stiffness)
    assert again == pytest.approx(gait, abs=1e-15)


def test_the_feedback_of_a_posture_leaves_a_torso_that_rises_or_is_far_to_the_plan():
    feedback = PostureFeedback(
        SETTINGS.posture, SETTINGS.limits, np.ones((4, 3))
    )
    far, still = np.array(SETTINGS.posture.reach), np.zeros(3)
    assert not feedback.reaches(still, 2 * SETTINGS.posture.rise_max)
    assert not feedback.reaches(-far, 0.0)
    assert feedback.reaches(0.9 * far, 0.0)
    feedback.angle(still, *np.ones((4, 4)))
    assert feedback.reaches(still, 2 * SETTINGS.posture.rise_max)


DT, ANGLE = 0.033, 1.3
SCALE = np.array([0.02, 0.02, 0.007, 0.002, 0.002, 0.002])


class Watch:
    """The observer, and a nominal robot on which a wrench acts and that drifts."""

    def __init__(self, drift=(0.0, 0.0, 0.0), wrench=(0.0, 0.0, 0.0)):
        self.plant, self.model = (
            NominalRobot(ROBOT, SETTINGS.nominal, DT) for _ in range(2)
        )
        self.observer = DisturbanceObserver(
            self.model, SETTINGS.observer, SCALE, DT
        )
        self.plant.set_wrench(np.array(wrench), 0.0)
        self.state, self.command = np.eye(12)[5] * 0.05, np.full((2, 4), ANGLE)
        self.real = self.plant.at_rest(self.state, self.command[0])
        self.drift, self.ticks = np.array(drift), 0

    def go_on(self, ticks, walks=True, swing=0.0):
        """The observer after so many ticks, in which the legs swing by so much, rad."""
        for _ in range(ticks):
            self.ticks += 1
            phase = 0.3 * self.ticks + np.array([0.0, np.pi, np.pi, 0.0])
            self.command = np.vstack(
                [self.command[1], ANGLE + swing * np.sin(phase)]
            )
            self.model.set_wrench(self.observer.wrench, 0.0)
            start = self.model.measured(self.real, self.state)
            self.observer.observe(start, self.state, self.command[0], walks)
            self.real = self.plant.after(
                self.plant.measured(self.real, self.state), self.command
            )
            self.state = torso_of(self.plant, self.real)
            self.state[[3, 4, 2]] += DT * self.drift
        return self.observer


NOTHING, WRENCH, DRIFT = (
    (0.0, 0.0, 0.0),
    (-3.0, 0.1, -0.15),
    (0.01, -0.005, 0.02),
)


@pytest.mark.parametrize(
    ("wrench", "drift"),
    [(NOTHING, NOTHING), (WRENCH, NOTHING), (NOTHING, DRIFT)],
)
def test_a_wrench_and_a_drift_in_the_heading_frame_are_found(wrench, drift):
    found = Watch(drift, wrench).go_on(300 if wrench is WRENCH else 120)
    assert found.wrench == pytest.approx(wrench, rel=0.1, abs=1e-9)
    assert found.drift == pytest.approx(drift, abs=1e-3)
    assert found.taken == pytest.approx((0.0, *drift[1:]), abs=1e-3)


def test_the_model_has_the_friction_that_explains_the_motion():
    """Of a floor that grips, and then of one that does not; a turn in place tells nothing."""
    nominal, grips = SETTINGS.nominal.friction, SETTINGS.observer.friction
    watch = Watch(drift=(0.03, 0.0, 0.05), wrench=(-3.0, 0.1, 0.0))
    watch.plant.friction = 1.0
    watch.go_on(240, walks=False, swing=0.7)
    assert watch.model.friction == nominal
    watch.go_on(240, swing=0.7)
    assert watch.model.friction == grips
    watch.plant.friction = nominal
    watch.go_on(120, swing=0.7)
    assert watch.model.friction == nominal


@pytest.mark.parametrize(
    ("nominal", "gripping", "grips"),
    [
        (0.95, 0.83, False),
        (1.9, 1.9, False),
        (1.1, 0.86, True),
        (2.5, 2.5, True),
    ],
)
def test_a_floor_grips_when_the_nominal_one_is_far_off_or_clearly_worse(
    nominal, gripping, grips
):
    """Spreads of a fast walk on friction .5 and .6, and of a crawl and a walk on friction 1."""
    observer, spread = Watch().observer, np.array([nominal, gripping])
    scale = np.sqrt(1.0 / 3.0) * observer._scale
    for k in range(400):
        observer._judge((-1.0) ** k * spread[:, None] * scale)
    friction = observer._model.friction
    assert friction == (OBSERVER if grips else NOMINAL).friction


def test_drift_and_wrench_are_no_sign_of_a_floor_that_grips():
    watch = Watch(drift=(0.03, 0.0, 0.05), wrench=(-3.0, 0.1, 0.0))
    for _ in range(10):
        watch.go_on(30, swing=0.7)
        assert watch.model.friction == SETTINGS.nominal.friction


def test_a_forgotten_motion_leaves_the_estimates():
    watch = Watch(wrench=(-3.0, 0.0, 0.0))
    before = watch.go_on(120).wrench.copy()
    watch.observer.forget()
    np.testing.assert_array_equal(
        watch.go_on(SETTINGS.observer.window).wrench, before
    )
    assert not np.array_equal(watch.go_on(1).wrench, before)


NOMINAL, ROLLED = SETTINGS.nominal, 22  # stages of a rollout
STANDING = np.array([0.02, -0.01, 0.4, 0.1, -0.2, 0.055, 0, 0, 0, 0, 0, 0])


def plans(count, seed=0):
    """Angles (count, ROLLED + 1, 4) that wander about those of a standing robot."""
    steps = np.random.default_rng(seed).normal(0.0, 0.1, (count, ROLLED + 1, 4))
    return np.clip(1.3 + np.cumsum(steps, axis=1), 0.0, ROBOT.tendon.angle_max)


@pytest.fixture
def model():
    return NominalRobot(ROBOT, NOMINAL, DT)


def test_a_rollout_is_the_motion_of_the_simulated_robot(model):
    """Each of the plans of a call, without effect on the others; on a slope."""
    model.gravity = gravity = np.array([-0.5, 0.3, -9.8])
    several = plans(3)
    start = model.at_rest(STANDING, several[0, 0])
    found = model.roll_out(start, several)
    step = DT / (NOMINAL.cycles * NOMINAL.steps)
    robot = TabulatedRobot(ROBOT, nominal_scene(NOMINAL, step), read_servo())
    robot.model.gravity[:] = gravity
    robot.legs.table[:] = model.robot.legs.table
    for plan, pose, force in zip(several, found.pose, found.force):
        robot.state.buffer[:] = start
        for k in range(ROLLED):
            for share in np.arange(NOMINAL.cycles) / NOMINAL.cycles:
                angle = plan[k] + share * (plan[k + 1] - plan[k])
                robot.advance(NOMINAL.steps, angle)
            np.testing.assert_allclose(
                force[k], robot.ground_force, rtol=0, atol=1e-9
            )
            # rounding
            there = [*robot.rpy, *robot.position]
            np.testing.assert_allclose(pose[k], there, rtol=0, atol=1e-11)


def test_a_measured_state_has_the_torso_of_the_estimate_and_the_legs_of_the_model(
    model,
):
    start = model.at_rest(STANDING, np.full(4, 1.3))
    moved = np.array(
        [0.1, -0.2, 3, 1, 2, 0.05, 0.3, 0.2, -0.1, 0.04, 0.03, -0.02]
    )
    torso = torso_of(model, model.measured(start, moved))
    np.testing.assert_allclose(torso, moved, rtol=0, atol=1e-14)
    angle = model.robot.state.tendon_angle
    assert angle == pytest.approx(np.full(4, 1.3), abs=0.05)  # it sags


def test_a_rollout_that_diverges_is_nan_and_spoils_no_other(model):
    start, plan = model.at_rest(STANDING, np.full(4, 1.3)), plans(1)
    good = model.roll_out(start, plan).pose
    # rad, beyond 60 deg
    over = model.measured(start, STANDING + 1.2 * np.eye(12)[1])
    found = model.roll_out(over, plan)
    assert np.isnan([*found.pose.flat, *found.force.flat]).all()
    np.testing.assert_array_equal(model.roll_out(start, plan).pose, good)


@pytest.mark.parametrize("ratio", [0.65, 1.5])
def test_legs_of_another_stiffness_hold_the_torso_where_the_gait_says(
    model, ratio
):
    """Within 3 mm: the servos sag, and the feet stick."""
    model.stiffness = ratio
    height, springs = np.full(4, 0.045), read_springs()
    angle = springs.angle(np.full(4, ROBOT.weight / 4), height, ratio)
    start = model.at_rest(0.045 * np.eye(12)[5], angle)
    pose = model.roll_out(start, np.tile(angle, (1, 61, 1))).pose[0, -1]
    assert pose[5] == pytest.approx(0.045, abs=3e-3)
    model.stiffness = 1.0
    pose = model.roll_out(start, np.tile(angle, (1, 61, 1))).pose[0, -1]
    assert abs(pose[5] - 0.045) > 8e-3

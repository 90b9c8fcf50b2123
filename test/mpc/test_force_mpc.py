"""The MPC as a policy: rejected inputs, fallback, status, profiles."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.mpc.cases import random_case, standing, torso
from slot_core import config
from slot_core.control.policy import Status
from slot_core.estimation.estimate import Estimate
from slot_core.mpc.force_mpc import ForceMpc
from slot_core.mpc.settings import read_mpc
from slot_core.mpc.solver import Solution
from slot_core.robot import read_robot

ROBOT = read_robot()
# no time budget: the tests must not depend on the load of the machine
SETTINGS = config.replace(read_mpc("force_mpc"), {"acceptance.time_budget": np.inf})
H, HOVER = SETTINGS.horizon, ROBOT.weight / 4


def new_mpc(**changes):
    names = {name.replace("__", "."): value for name, value in changes.items()}
    return ForceMpc(ROBOT, config.replace(SETTINGS, names), lambda: 0.0)


def preview(stages=H + 1, **changes):
    return standing(stages, **{"normal_force": np.full((stages, 4), HOVER)} | changes)


def known(values):
    """An estimate of anything."""
    return Estimate(0, values, np.zeros((12, 12)), 0)


def damaged(field, index, value):
    """A preview with one element replaced."""
    array = np.array(getattr(preview(), field), dtype=float)
    array[index] = value
    return preview(**{field: array})


REJECTED = {
    "state[5] = nan": (torso(p=(0, 0, np.nan)), preview()),
    "state[9] = inf": (torso(v=(np.inf, 0, 0)), preview()),
    "state[0] = 1e+300": (torso(rpy=(1e300, 0, 0)), preview()),
    "state: shape (13,)": (known(np.zeros(13)), preview()),
    "state: shape (12, 1)": (known(np.zeros((12, 1))), preview()),
    "state: shape ()": (known(None), preview()),
    "state: not numbers": (known(["upright"] * 12), preview()),
    "preview.friction[3, 2] = -0.1": (torso(), damaged("friction", (3, 2), -0.1)),
    "preview.friction[0, 0] = nan": (torso(), damaged("friction", (0, 0), np.nan)),
    "preview.contact[1, 1] = 2": (torso(), damaged("contact", (1, 1), 2)),
    "preview.normal_force[2, 0] = -inf": (
        torso(),
        damaged("normal_force", (2, 0), -np.inf),
    ),
    "preview.reference[15, 5] = nan": (torso(), damaged("reference", (15, 5), np.nan)),
    "preview.reference[0, 3] = inf": (torso(), damaged("reference", (0, 3), np.inf)),
    "preview.tendon_angle[1, 3] = nan": (
        torso(),
        damaged("tendon_angle", (1, 3), np.nan),
    ),
    f"preview.contact: shape ({H - 1}, 4)": (torso(), preview(stages=H - 1)),
    "preview.friction: shape (16, 3)": (torso(), preview(friction=np.ones((H + 1, 3)))),
    "preview.normal_force: shape (64,)": (torso(), preview(normal_force=np.ones(64))),
    "preview.dt = 0:": (torso(), preview(dt=0.0)),
    "preview.dt = nan": (torso(), preview(dt=np.nan)),
    "preview.dt = 0.5": (torso(), preview(dt=0.5)),
}


@pytest.mark.parametrize("fault", REJECTED)
def test_bad_input_is_rejected_before_the_solver_and_named(fault):
    mpc = new_mpc()
    good = mpc.step(torso(p=(0, 0, 0.03)), preview())
    result = mpc.step(*REJECTED[fault])
    assert result.status == Status.REJECTED
    assert fault in result.message
    assert "\n" not in result.message
    assert result.report.iterations == 0
    expected = HOVER + SETTINGS.fallback.decay * (good.force[0, :, 2] - HOVER)
    np.testing.assert_allclose(result.force[0, :, 2], expected)
    again = mpc.step(torso(), preview())  # the bad input has no later effect
    assert again.status == Status.SOLVED
    np.testing.assert_allclose(
        again.force[0, :, 2], HOVER, atol=1e-6
    )  # solver tolerance


class LateFrom:
    """A timer by which every cycle from number `cycle` on takes one second."""

    def __init__(self, cycle):
        self.calls, self.cycle = itertools.count(), cycle

    def __call__(self):
        call = next(self.calls)  # two calls per cycle
        return float(call % 2) if call // 2 >= self.cycle else 0.0


GAIT_FORCE = np.tile([5.4, 5.2, 5.1, 5.3], (H + 1, 1))  # N, normal forces of the gait


def late():
    settings = config.replace(SETTINGS, {"acceptance.time_budget": 0.5})
    return (
        ForceMpc(ROBOT, settings, LateFrom(1)),
        torso(),
        preview(normal_force=GAIT_FORCE),
    )


def iteration_limit():
    # standing takes 8 iterations and this case 11; the limit is 9
    x0, ahead = random_case(np.random.default_rng(130), H + 1)
    ahead.contact[0], ahead.friction[0], ahead.normal_force[:] = True, 0.4, GAIT_FORCE
    return new_mpc(solver__iterations=9, force_max=5.5), x0, ahead


def violation():
    # standing is well within all limits; an interior point does not satisfy a friction of zero
    mpc = new_mpc(acceptance__violation_max=0.0)
    slipping = torso(rpy=(0.5, -0.5, 0), v=(0.1, 0, 0))
    return (
        mpc,
        slipping,
        preview(normal_force=GAIT_FORCE, friction=np.zeros((H + 1, 4))),
    )


def bad_input():
    return new_mpc(), known(np.full(12, np.nan)), preview(normal_force=GAIT_FORCE)


FAILURES = {
    late: Status.LATE,
    iteration_limit: Status.NOT_SOLVED,
    violation: Status.NOT_SOLVED,
    bad_input: Status.REJECTED,
}


@pytest.mark.parametrize("failure", FAILURES)
def test_fallback_decays_to_the_normal_forces_of_the_gait_and_stops_after_the_configured_cycles(
    failure,
):
    mpc, *bad = failure()
    good = torso(), preview(normal_force=GAIT_FORCE)
    last, rule = mpc.step(*good), SETTINGS.fallback
    assert last.status == Status.SOLVED
    reference = np.zeros((4, 3))
    reference[:, 2] = GAIT_FORCE[0]
    for n in range(1, rule.cycles + 1):
        result = mpc.step(*bad)
        assert (result.status, result.fallback_cycles) == (FAILURES[failure], n)
        assert result.message
        expected = reference + rule.decay**n * (last.force[0] - reference)
        if not bad[1].friction.any():
            expected[:, :2] = 0.0  # the present limits hold
        np.testing.assert_allclose(result.force[0], expected, atol=1e-12)  # roundoff
    for n in (rule.cycles + 1, rule.cycles + 2):
        stopped = mpc.step(*bad)
        assert (stopped.status, stopped.fallback_cycles) == (Status.STOPPED, n)
        assert not stopped.force.any()
        assert f"after {rule.cycles} cycles" in stopped.message


def test_a_nan_solution_reported_as_solved_is_not_accepted(monkeypatch):
    solutions = [
        np.full(24 * H, HOVER),
        np.full(24 * H, np.nan),
    ]  # a feasible input, then not
    solutions[0].reshape(H, 8, 3)[..., :2] = 0.0

    answers = iter([solutions[0], *solutions])  # the first solve is at construction
    solve = lambda _: Solution(next(answers), fault="", iterations=1)  # noqa: E731
    monkeypatch.setattr("slot_core.mpc.force_problem.ForceProblem.solve", solve)
    mpc = new_mpc()
    assert mpc.step(torso(), preview()).status == Status.SOLVED
    result = mpc.step(torso(), preview())
    assert (result.status, result.message) == (Status.NOT_SOLVED, "solution not finite")
    np.testing.assert_allclose(result.force[0, :, 2], HOVER)


@pytest.mark.parametrize("cause", ["iteration limit", "bad input"])
def test_without_an_earlier_feasible_solution_the_status_is_stopped(cause):
    mpc = new_mpc(solver__iterations=1) if cause == "iteration limit" else new_mpc()
    x0 = torso() if cause == "iteration limit" else known(np.full(12, np.inf))
    result = mpc.step(x0, preview())
    assert result.status == Status.STOPPED
    assert not result.force.any()
    assert "no feasible input yet" in result.message


def test_fallback_puts_no_force_on_a_lifted_leg():
    mpc, *good = late()
    assert mpc.step(*good).status == Status.SOLVED
    contact = np.ones((H + 1, 4), dtype=bool)
    contact[0, 2] = False
    for x0, status in (
        (torso(), Status.LATE),
        (known(np.full(12, np.nan)), Status.REJECTED),
    ):
        result = mpc.step(x0, preview(contact=contact))
        assert result.status == status
        assert not result.force[0, 2].any()
        assert np.all(result.report.slack_normal_max >= 0)


def test_status_values_are_those_of_the_message():
    path = Path(__file__).parents[2] / "slot_msgs/msg/TendonPlan.msg"
    constants = re.findall(r"^uint8 (\w+) = (\d+)", path.read_text(), re.MULTILINE)
    assert {name: int(value) for name, value in constants} == Status.__members__

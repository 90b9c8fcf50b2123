"""Policies: the contract, their names, a user's policies.

Counters of late and skipped controller cycles; how fast time goes on.
"""

import math

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.control.policies import POLICIES
from slot_core.control.policy import Status, make_policy, policy_class
from slot_core.robot import LEGS, read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_nodes.pace import Pace, Speed

OWN = """
import numpy as np
from slot_core.control.policy import Policy, TendonPlan
class Own(Policy):
    def step(self, estimate, preview):
        return TendonPlan(preview.tendon_angle + 0.01, preview.rate, np.zeros((15, 4, 3)))
POLICY = Own
"""


def ticks(policy):
    return list(ClosedLoop("flat", "stand", None, 0, policy).run(40))


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_plans_angles_or_forces_with_a_map_that_has_a_name(name):
    for tick in ticks(name):
        plan, stages = tick.plan, len(tick.plan.force)
        assert plan.force.shape == (stages, len(LEGS), 3)
        assert plan.rate.shape == (len(LEGS),)
        if plan.status != Status.STOPPED:
            assert len(plan.angle) == (0 if plan.map else stages)
            assert tick.command.map == (plan.map or "planned")


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_that_was_reset_plans_as_a_new_one(name):
    used, fresh = (
        make_policy(name, read_robot(), lambda: 0.0) for _ in range(2)
    )
    recorded = ticks("rollout_mpc")
    for tick in recorded:
        used.step(tick.estimate, tick.preview)
    used.reset()
    for tick in recorded:
        a, b = (p.step(tick.estimate, tick.preview) for p in (used, fresh))
        np.testing.assert_array_equal(a.angle, b.angle)
        np.testing.assert_array_equal(a.force, b.force)


@pytest.mark.parametrize(
    ("name", "added"), [("gait_alone", 0.0), ("own.py", 0.01)]
)
def test_the_gait_alone_and_a_users_policy_named_by_its_file(
    tmp_path, name, added
):
    (tmp_path / "own.py").write_text(OWN)
    for tick in ticks(str(tmp_path / name) if name.endswith(".py") else name):
        np.testing.assert_array_equal(
            tick.command.angle, tick.preview.tendon_angle[0] + added
        )


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        (
            "magic",
            None,
            "policy 'magic': expected one of rollout_mpc, place, .* a file",
        ),
        (
            "predictive",
            None,
            "policy 'predictive': it is named rollout_mpc now",
        ),
        ("forces", None, "policy 'forces': it is named force_mpc now"),
        ("missing.py", None, "missing.py: FileNotFoundError"),
        (
            "broken.py",
            "import nothing_of_this_name",
            "broken.py: ModuleNotFoundError: No module",
        ),
        ("empty.py", "", "empty.py: AttributeError: .*POLICY"),
    ],
)
def test_a_policy_that_is_not_there_is_refused_in_one_line(
    tmp_path, name, text, reason
):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=reason) as refused:
        policy_class(str(tmp_path / name) if name.endswith(".py") else name)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("numbers", "skipped"), [((7, 8, 12, 13), 3), ((100, 1, 2, 5), 2)]
)
def test_long_cycles_and_skipped_inputs_are_counted_also_after_a_restart(
    numbers, skipped
):
    pace = Pace()
    for number, elapsed in zip(numbers, (0.01, 0.03, 0.031, 0.05)):
        pace.add(number, elapsed, 0.03)
    assert (pace.overruns, pace.skipped) == (2, skipped)


def test_the_speed_is_that_of_the_last_second_also_if_nothing_is_reported_any_more():
    speed = Speed(1.0)
    for k in range(61):
        assert math.isnan(speed.until(k / 30 - 1e-9)) == (k <= 30)
        speed.add(k / 30, 100.0 + (k if k <= 30 else 30 + 0.6 * (k - 30)) / 30)
    for now, expected in ((2.0, 0.6), (2.5, 0.3), (9.0, 0.0)):
        assert speed.until(now) == pytest.approx(expected, abs=0.02)

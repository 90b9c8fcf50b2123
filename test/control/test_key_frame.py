"""A key frame holds all that an object depends on: one made afresh goes on to the last bit."""

import dataclasses
import json
from typing import NamedTuple

import numpy as np
import pytest
from estimator_streams import SETTINGS, Walk, arriving, noisy, run, same

from slot_core import config
from slot_core.control.controller import Controller
from slot_core.control.force_map import read_springs
from slot_core.control.policies import POLICIES
from slot_core.control.policy import make_policy
from slot_core.estimation.unaided_estimator import make_estimator
from slot_core.gait.route import Route
from slot_core.key_frame import StateParts, capture, restore
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop

VELOCITY = np.array([0.05, 0.0, 0.05])


@pytest.mark.parametrize(
    ("source", "seed", "places"),
    [("topic", 0, 6), ("topic", 1, 6), ("topic", 2, 6), ("none", 0, 2)],
)
def test_an_estimator_goes_on_from_a_key_frame_at_any_message(
    source, seed, places
):
    """Odometry that comes up to 60 ms late, in part lost, amid the IMU's samples."""
    rng = np.random.default_rng(seed)
    walk = noisy(Walk(), 3.0, seed)
    kept = [m for m in walk if m[0] == "imu" or not 1.2e9 < m[1] < 1.5e9]
    messages = arriving(kept, lambda: rng.uniform(0.0, 0.06))
    settings = config.replace(
        SETTINGS, {"odometry.source": source, "agreement.enabled": True}
    )
    for at in [0, 1, *rng.integers(2, len(messages), places)]:
        first, second = (
            make_estimator(settings, read_robot(), read_springs())
            for _ in range(2)
        )
        run(messages[:at], estimator=first)
        restore(second, capture(first))
        assert same(
            *(run(messages[at:], estimator=each)[0] for each in (first, second))
        )


@pytest.mark.parametrize("policy", [*POLICIES])
def test_scheduler_policy_and_map_go_on_from_key_frames_in_a_walk(policy):
    ticks = list(ClosedLoop("flat", "walk", VELOCITY, 1, policy).run(50))
    first, second = (
        Controller(
            read_robot(),
            make_policy(policy, read_robot(), lambda: 0.0),
            "walk",
            VELOCITY,
            Route(np.array([[0.0, 0.0], [0.02, 0.0], [0.2, 0.1]]), "along"),
        )
        for _ in range(2)
    )

    def step(controller, estimate):
        controller.policy.prepare()
        preview = controller.scheduler.step(estimate.time, estimate.state)
        plan = controller.policy.step(estimate, preview)
        command = controller.force_map.step(
            plan, preview, estimate.state, estimate.lead
        )
        return preview, plan, command

    for tick in ticks[:32]:
        step(first, tick.estimate)
    for name in ("scheduler", "policy", "force_map"):
        text = capture(getattr(first, name))
        assert 0 < len(text) < 150_000
        restore(getattr(second, name), text)
    for tick in ticks[32:]:
        found, expected = (
            [*map(dataclasses.asdict, step(controller, tick.estimate))]
            for controller in (second, first)
        )
        np.testing.assert_equal(found, expected)


class Value(NamedTuple):
    rows: np.ndarray


class Thing:
    STATE = StateParts("rows", "number", "value", values=(Value,))

    def __init__(self):
        self.rows, self.number, self.value = np.zeros((2, 3)), 0.1, None


def test_numbers_come_back_to_the_last_bit_and_with_their_types():
    first, second = Thing(), Thing()
    first.rows[:] = [[np.nan, -0.0, 5e-324], [np.inf, 1 / 3, 2**60]]
    first.number, first.value = 2**62 + 1, Value(np.array([True, False]))
    restore(second, capture(first))
    assert second.rows.tobytes() == first.rows.tobytes()
    assert second.number == first.number
    assert second.value.rows.dtype == bool


def test_what_no_key_frame_can_hold_is_refused():
    thing = Thing()
    thing.value = object()
    with pytest.raises(TypeError, match="object is no part of a key frame"):
        capture(thing)
    assert capture(object()) == ""


@pytest.mark.parametrize(
    "change",
    [
        {"rows": {"array": ["<f8", [3, 2], "A" * 64]}},  # another shape
        {"rows": {"array": ["|O8", [2, 3], "A" * 64]}},
        {"rows": {"array": ["<f8", [2, 3], "AAAA"]}},
        {"rows": 1.0},
        {"value": {"Popen": {"args": "true"}}},  # not a class of this state
        {"value": {"Value": {}}},
        {"more": 1},
    ],
)
def test_a_key_frame_of_a_stranger_is_refused_before_a_kernel_sees_it(change):
    text = json.dumps(json.loads(capture(Thing())) | change)
    with pytest.raises(ValueError, match="no key frame of Thing"):
        restore(Thing(), text)
    with pytest.raises(ValueError, match="no key frame of Thing"):
        restore(Thing(), "[" * 100_000)

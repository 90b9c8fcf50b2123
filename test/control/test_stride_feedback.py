"""Feedback once a stride on a linear plant whose effects and disturbances are known."""

import dataclasses

import numpy as np
import pytest

from slot_core.gait.gait import read_gaits
from slot_core.gait.stride_feedback import OFFSET_SIGNS, StrideFeedback, Target
from slot_core.geometry import wrapped

WALK = read_gaits().strides["walk"]
SETTINGS = WALK.feedback
EFFECT = np.array(SETTINGS.effect)
DT, TICKS = 0.033, 21
HOME = np.array([WALK.height, 0.0, 0.0])
NONE = np.zeros(6)
LIMITS = np.array([*SETTINGS.velocity_max, *[np.radians(SETTINGS.offset_max_deg)] * 3])


class Plant:
    """A torso whose means over a stride are command, effect of the corrections, disturbance."""

    def __init__(self, velocity=(0.05, 0.0, 0.0), effect=EFFECT, yaw=0.0, **changes):
        settings = dataclasses.replace(SETTINGS, **changes)
        self.feedback = StrideFeedback(dataclasses.replace(WALK, feedback=settings))
        self.velocity, self.effect = np.array(velocity), effect
        self.time, self.state = 0.0, np.zeros(12)
        self.state[2] = yaw
        self.gap = []

    def stride(self, disturbance=NONE, walking=1.0):
        """Errors (6,) of the means over a stride against the command."""
        output = self.effect @ self.feedback.corrections + disturbance
        output[:3] += self.velocity
        self.state[[5, 0, 1]] = HOME + output[3:]
        if self.feedback.place is None:
            self.tick(0.0, output)
        for _ in range(TICKS):
            self.tick(DT, output)
        self.feedback.finish(Target(self.velocity, HOME, walking))
        return output - np.r_[self.velocity, 0, 0, 0]

    def tick(self, dt, output):
        c, s = np.cos(self.state[2]), np.sin(self.state[2])
        v_x, v_y, rate = output[:3]
        self.state[3:5] += dt * np.array([c * v_x - s * v_y, s * v_x + c * v_y])
        self.state[2] += dt * rate
        self.time += dt
        self.feedback.move(dt, self.state, self.velocity)
        self.feedback.add(self.time, self.state)
        self.gap.append(self.feedback.place[:2] - self.state[3:5])

    def run(self, strides, disturbance=NONE):
        return np.array([self.stride(np.array(disturbance)) for _ in range(strides)])


DISTURBANCES = {
    "slow": [-0.015, 0, 0, 0, 0, 0],
    "drift": [0, 0.01, 0, 0, 0, 0],
    "yaw": [0, 0, 0.04, 0, 0, 0],
    "payload": [0, 0, 0, -0.006, 0.02, -0.015],
    "all": [-0.01, 0.008, -0.03, -0.004, 0.02, 0.015],
}


@pytest.mark.parametrize("disturbance", DISTURBANCES.values(), ids=DISTURBANCES)
@pytest.mark.parametrize("yaw", [0.0, 3.0])
def test_a_constant_disturbance_leaves_no_error(disturbance, yaw):
    plant = Plant(yaw=yaw)
    errors = plant.run(60, disturbance)
    assert np.abs(errors[0]).max() >= np.abs(disturbance).max() - 1e-12
    np.testing.assert_allclose(errors[-1] / SETTINGS.scale, 0.0, atol=0.02)
    assert np.abs(plant.gap[-1]).max() < 1e-3  # m: it is back at its reference place


@pytest.mark.parametrize("wrong", [0.6, 1.5])
def test_effects_that_are_half_or_double_the_identified_ones_still_leave_no_error(wrong):
    errors = Plant(effect=wrong * EFFECT).run(80, DISTURBANCES["all"])
    np.testing.assert_allclose(errors[-1] / SETTINGS.scale, 0.0, atol=0.05)


def test_a_gain_of_zero_does_nothing():
    plant = Plant(gain=0.0)
    plant.run(10, DISTURBANCES["all"])
    assert not plant.feedback.corrections.any()


def test_a_part_of_a_stride_corrects_nothing_and_the_next_whole_one_does():
    """Where a blend ends amid a stride, the mean of the rest of it is mostly sway."""
    plant = Plant()
    output = plant.effect @ plant.feedback.corrections + np.array(DISTURBANCES["all"])
    for _ in range(TICKS // 2):
        plant.tick(DT, output)
    plant.feedback.finish(Target(plant.velocity, HOME, 1.0))
    assert not plant.feedback.corrections.any()
    plant.stride(np.array(DISTURBANCES["all"]))
    assert plant.feedback.corrections.any()


@pytest.mark.parametrize("disturbance", [[-0.2, 0, 0, 0, 0, 0], [0, 0, 0, -0.05, 0.5, -0.5]])
def test_saturated_knobs_stay_within_their_bounds_and_recover_within_a_few_strides(disturbance):
    """As after a start without saturation: the bounds leave no integral to unwind."""
    plant = Plant(position_gain=0.0, heading_gain=0.0)
    for _ in range(40):
        plant.stride(np.array(disturbance))
        assert (np.abs(plant.feedback.corrections) <= LIMITS + 1e-12).all()
    assert (np.abs(plant.feedback.corrections) > 0.99 * LIMITS).any()  # it is saturated
    errors = np.abs(plant.run(12) / SETTINGS.scale)
    assert errors[0].max() > 3.0
    # the gain of a stride is 0.5: eight strides leave a hundredth, and the regularisation more
    assert errors[8:].max() < 0.05 * errors[0].max()


def test_the_reference_place_is_never_further_than_its_lead():
    plant = Plant()
    plant.run(20, [-0.2, 0.1, 0, 0, 0, 0])
    distance = np.linalg.norm(plant.gap, axis=1)
    assert distance.max() <= SETTINGS.lead + 1e-12
    assert distance.max() == pytest.approx(SETTINGS.lead)  # and it was as far


def test_the_reference_heading_is_never_further_than_its_lead():
    plant = Plant()
    for _ in range(20):
        plant.stride(np.array([0, 0, 1.5, 0, 0, 0]))  # turns all round
        gap = plant.feedback.place[2] - plant.state[2]
        assert abs(wrapped(gap)) <= SETTINGS.heading_lead + 0.06
    assert abs(plant.state[2]) > 2 * np.pi


def test_a_robot_beside_its_path_is_brought_back_to_it():
    plant = Plant()
    plant.run(2)
    plant.state[4] += 0.03  # pushed to the left
    plant.run(60)
    assert plant.state[4] == pytest.approx(0.0, abs=2e-3)


def test_the_yaw_may_pass_half_a_turn_within_a_stride():
    plant = Plant(velocity=(0.0, 0.0, 0.15), yaw=np.pi - 0.05)
    for _ in range(3):
        plant.stride()
        plant.state[2] = wrapped(plant.state[2])
    np.testing.assert_allclose(plant.feedback.corrections / LIMITS, 0.0, atol=1e-6)


def test_less_than_three_ticks_are_no_stride():
    feedback = StrideFeedback(WALK)
    for time in (0.0, 0.033):
        feedback.move(0.033, np.zeros(12), np.array([0.05, 0, 0]))
        feedback.add(time, np.zeros(12))
    feedback.finish(Target(np.array([0.05, 0.0, 0.0]), HOME, 1.0))
    assert not feedback.corrections.any()


def test_while_it_turns_in_place_v_x_and_v_y_are_left_alone():
    plant = Plant(velocity=(0.0, 0.0, 0.1))
    for _ in range(10):
        plant.stride(np.array([0.01, -0.01, 0.02, 0, 0, 0]), walking=0.0)
    assert np.abs(plant.feedback.velocity[:2]).max() < 1e-6
    assert abs(plant.feedback.velocity[2]) > 1e-3


def test_a_reset_keeps_the_corrections_and_forgets_the_place():
    plant = Plant()
    plant.run(5, DISTURBANCES["all"])
    corrections = plant.feedback.corrections.copy()
    plant.feedback.reset()
    assert plant.feedback.place is None
    assert (plant.feedback.corrections == corrections).all()
    plant.state[3:5] += 5.0  # carried away meanwhile
    plant.stride()
    assert np.abs(plant.gap[-1]).max() < SETTINGS.lead


def test_what_is_lost_while_the_robot_starts_to_walk_and_turn_is_regained():
    plant = Plant(velocity=(0.02, 0.0, 0.1))
    for _ in range(TICKS):  # it stands: the stride is not whole yet
        plant.time += DT
        plant.feedback.move(DT, plant.state, plant.velocity)
        plant.feedback.forget_stride()
    lost = DT * (TICKS - 1)
    assert plant.feedback.place == pytest.approx([0.02 * lost, 0.0, 0.1 * lost], abs=1e-3)
    plant.run(30)
    assert plant.state[2] == pytest.approx(0.1 * (plant.time - DT), abs=5e-3)
    assert np.abs(plant.gap[-1]).max() < 1e-3


@pytest.mark.parametrize(
    ("correction", "legs"), [(0, [1, 1, 1, 1]), (1, [1, -1, 1, -1]), (2, [1, 1, -1, -1])]
)
def test_offsets_are_common_left_minus_right_and_front_minus_rear(correction, legs):
    """Legs in the order FL FR RL RR; half the difference at each."""
    feedback = StrideFeedback(WALK)
    feedback.corrections[3 + correction] = 0.1
    assert feedback.offset == pytest.approx(0.1 * np.array(legs))
    assert OFFSET_SIGNS.shape == (3, 4)

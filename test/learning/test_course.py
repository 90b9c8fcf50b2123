"""The course of the walk follows the commanded velocity; the swing of a stride is no gap."""

import numpy as np
import pytest

from slot_core.gait.reference import moved

pytest.importorskip("gymnasium", reason="needs scripts/setup --learn")
from slot_lab.learning.rewards import PLACE, Course
from slot_lab.learning.task import make_task

TASK = make_task()
DT, PERIOD = TASK.gaits.dt, TASK.stride.period
VELOCITY = np.array([[0.05, 0.0, 0.0], [0.03, -0.02, 0.02]])
START = np.array([[0.1, 0.2, 0.7], [0.0, 0.0, -3.0]])  # x, y, yaw
TICKS = 90


def begun(place):
    course, state = Course(TASK, 2), np.zeros((2, 12))
    state[:, PLACE] = place
    course.reset(np.arange(2), state)
    return course, state


def test_the_course_goes_on_without_a_robot_that_stands_still():
    course, state = begun(START)
    place = START
    for _ in range(TICKS):
        course.step(VELOCITY, state)
        place = moved(place, VELOCITY, DT)
    assert course.place == pytest.approx(place, abs=1e-12)
    assert course.faster[0] == pytest.approx(-0.05)


def test_gaps_are_those_of_the_stray_and_not_of_the_swing():
    faster, aside, turn = 0.004, 0.03, 0.1
    (course, state), place = begun(START), START
    for tick in range(1, TICKS):
        place = moved(place, VELOCITY, DT)
        swing = np.sin(2 * np.pi * DT * tick / PERIOD)
        way = np.array([faster * DT * tick + 0.01 * swing, aside, 0.0])
        state[:, PLACE] = moved(place, np.tile(way, (2, 1)), 1.0)
        state[:, PLACE[2]] += turn + 0.03 * swing + 2 * np.pi
        course.step(VELOCITY, state)
    assert course.faster == pytest.approx([faster] * 2, abs=1e-3)
    assert course.aside == pytest.approx([aside] * 2)
    assert course.turn == pytest.approx([turn] * 2, abs=1e-3)


def test_a_robot_that_starts_anew_does_not_change_the_other():
    course, state = begun(START)
    for _ in range(TICKS):
        course.step(VELOCITY, state)
    other = course.faster[0], course.aside[0], course.turn[0]
    course.reset(np.array([1]), state[1:])
    assert (course.faster[0], course.aside[0], course.turn[0]) == other
    assert (course.place[1] == state[1, PLACE]).all()
    assert (course.faster[1], course.aside[1], course.turn[1]) == (0.0, 0.0, 0.0)

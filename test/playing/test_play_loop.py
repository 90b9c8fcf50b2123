"""The loop of scripts/play without a browser: its pace, what it refuses, what it says."""

import numpy as np
import pytest

from slot_bringup.playing.page_server import start_server
from slot_bringup.playing.play_page import PlayPage
from slot_bringup.playing.robot_display import PLANNED
from slot_core.safety.states import Request, State
from slot_lab.play.played_robot import FRAME, PlayedRobot


class Played:
    """A page and its wall clock, which goes on by what is slept, and by `cost` (s) a look."""

    def __init__(self, server, bags):
        self.now, self.cost = 0.0, 0.0
        self.page = PlayPage(server, PlayedRobot(), bags)
        self.robot = self.page.robot

    def clock(self):
        self.now += self.cost
        return self.now

    def sleep(self, seconds):
        self.now += seconds

    def run(self, seconds):
        """Text of the page after a while."""
        end = self.now + seconds
        self.page.run(lambda: self.now >= end, self.clock, self.sleep)
        return self.page._text.content


@pytest.fixture
def played(tmp_path):
    server = start_server("127.0.0.1", 0, "")
    yield Played(server, tmp_path)
    server.stop()


def test_the_robot_keeps_up_with_the_wall_clock_and_says_where_it_cannot(
    played,
):
    text = played.run(3.0)
    assert played.robot.time == pytest.approx(3.0, abs=2 * FRAME)
    assert played.robot.loop.report.state is State.STANDING
    assert "STANDING" in text
    assert "1.00 of real time" in text
    played.cost = 0.03
    assert "slower than 1.00 of real time: 0." in played.run(4.0)
    behind = played.now - played.robot.time
    assert behind > 1.0
    played.cost = 0.0
    played.run(1.0)
    assert played.now - played.robot.time > behind - 0.3  # it does not catch up


def test_slow_motion_pause_and_steps(played):
    """A payload that is placed while the robot is paused is drawn there."""
    played.page.do(lambda _: played.page._set_speed(0.25))
    played.page.do(lambda r: r.change({"scene.payload.mass": 0.2}))
    played.run(2.0)
    played.page._on_time("pause or go on")
    place = [0.02, 0.01, 0.03]
    played.page.do(lambda r: r.change({"scene.payload.place": place}))
    assert "paused" in played.run(1.0)
    np.testing.assert_allclose(played.page._payload.position, place)
    before = played.robot.time
    assert before == pytest.approx(0.5, abs=2 * FRAME)
    for _ in range(3):
        played.page._on_time("step")
    played.run(1.0)
    assert played.robot.time == pytest.approx(before + 3 * FRAME, abs=1e-6)
    played.page._on_time("pause or go on")
    played.run(1.0)
    assert played.robot.time > before + 0.2


def test_where_no_policy_acts_there_is_no_plan_and_no_arrow_of_a_force(played):
    """The feet keep their names."""
    view = played.page.display.view
    assert "the plan follows its model" in played.run(1.0)
    forces = {"ground_forces", "demanded_forces", "predicted_path"}
    assert forces < set(view._shown)
    played.page.do(lambda r: r.request(Request.ESTOP))
    text = played.run(0.5)
    assert "no torque until it is reset: " in text
    assert set(PLANNED).isdisjoint(view._shown)
    assert "plan" not in text
    assert set(view._labels) == {"FL", "FR", "RL", "RR"}


def slope(gravity):
    return np.degrees(np.arctan2(-gravity[0], -gravity[2]))


@pytest.mark.parametrize(
    ("label", "value", "found"),
    [
        ("gait", "walk", lambda r: r.wishes.gait),
        ("v_x (m/s)", 0.05, lambda r: r.wishes.velocity[0]),
        ("v_y (m/s)", 0.02, lambda r: r.wishes.velocity[1]),
        ("yaw rate (rad/s)", 0.01, lambda r: r.wishes.velocity[2]),
        ("height (mm)", 50.0, lambda r: 1e3 * r.wishes.pose[0]),
        ("roll (deg)", 4.0, lambda r: np.degrees(r.wishes.pose[1])),
        ("pitch (deg)", -3.0, lambda r: np.degrees(r.wishes.pose[2])),
        (
            "the gait's own height and tilt",
            False,
            lambda r: r.wishes.pose is None,
        ),
        ("policy", "gait_alone", lambda r: r.policy),
        ("friction RL", 0.2, lambda r: r.model.friction[0, 2]),
        ("slope (deg)", 10.0, lambda r: slope(r.changes["scene.gravity"])),
        ("payload (kg)", 0.5, lambda r: r.model.payload[0]),
        (
            "supply voltage (V)",
            9.5,
            lambda r: r.changes["scene.supply_voltage"],
        ),
        ("tendon FR broken", True, lambda r: r.model.fault[1, 1] == 0.0),
        ("push to", "left", lambda r: "left" if r.model.push[1] > 5.0 else ""),
        ("push to", "back", lambda r: "back" if r.model.push[0] < -5.0 else ""),
    ],
)
def test_a_control_reaches_the_robot(played, label, value, found):
    handles = played.page.server.gui._gui_input_handle_from_uuid.values()
    control = next(
        each for each in handles if getattr(each, "label", "") == label
    )
    played.run(0.1)
    control.value = value
    played.run(0.1)
    assert found(played.robot) == pytest.approx(value)


def test_a_refusal_is_shown_as_text_and_the_next_act_takes_it_away(played):
    played.page.do(lambda r: r.change({"scene.payload.mass": -1.0}))
    assert "payload.mass = -1.0: outside" in played.run(0.2)
    played.page.do(lambda r: r.change({"scene.payload.mass": 0.1}))
    assert "outside" not in played.run(0.2)
    played.page.do(lambda r: r.change({"scene.<b>": 1}))
    assert "&lt;b&gt;" in played.run(0.2)

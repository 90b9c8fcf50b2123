"""The loop of scripts/play without a browser: its pace, what it refuses, what it says."""

import numpy as np
import pytest

from slot_bringup.playing.live_plots import legend
from slot_bringup.playing.main_page import start_server
from slot_bringup.playing.play_page import PlayPage
from slot_core.drawing.shapes import Bars
from slot_core.robot import LEGS
from slot_core.safety.states import State
from slot_lab.play.played_robot import FRAME, PlayedRobot
from slot_lab.report import traces


class Wall:
    """A clock that goes on by what is slept, and by `cost` (s) at every look."""

    def __init__(self):
        self.now, self.cost = 0.0, 0.0

    def clock(self):
        self.now += self.cost
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class Played:
    """A page with its wall clock."""

    def __init__(self, server, bags):
        self.wall = Wall()
        self.page = PlayPage(server, PlayedRobot(), bags)
        self.robot = self.page.robot

    def run(self, seconds):
        end = self.wall.now + seconds
        self.page.run(lambda: self.wall.now >= end, self.wall.clock, self.wall.sleep)

    @property
    def text(self):
        return self.page._text.content


@pytest.fixture
def played(tmp_path):
    server = start_server("127.0.0.1", 0, "")
    yield Played(server, tmp_path)
    server.stop()


def test_the_robot_keeps_up_with_the_wall_clock_and_says_so(played):
    played.run(3.0)
    assert played.robot.time == pytest.approx(3.0, abs=2 * FRAME)
    assert played.robot.loop.report.state is State.STANDING
    assert "STANDING" in played.text
    assert "1.00 of real time" in played.text


def test_a_machine_that_is_too_slow_is_reported_and_does_not_catch_up(played):
    played.wall.cost = 0.03
    played.run(4.0)
    assert "slower than 1.00 of real time: 0." in played.text
    assert played.robot.time < 3.0
    behind = played.wall.now - played.robot.time
    played.wall.cost = 0.0
    played.run(1.0)
    assert played.wall.now - played.robot.time > behind - 0.3


def test_slow_motion_pause_and_steps(played):
    played.page.do(lambda _: played.page._set_speed(0.25))
    played.run(2.0)
    assert played.robot.time == pytest.approx(0.5, abs=2 * FRAME)
    played.page._on_time("pause")
    played.run(1.0)
    before = played.robot.time
    assert before == pytest.approx(0.5, abs=2 * FRAME)
    for _ in range(3):
        played.page._on_time("step")
    played.run(1.0)
    assert played.robot.time == pytest.approx(before + 3 * FRAME, abs=1e-6)
    assert "paused" in played.text
    played.page._on_time("go on")
    played.run(1.0)
    assert played.robot.time > before + 0.2


def test_a_payload_that_is_placed_while_the_robot_is_paused_is_drawn_there(played):
    played.page.do(lambda r: r.change({"scene.payload.mass": 0.2}))
    played.run(0.2)
    played.page._on_time("pause")
    played.run(0.2)
    place = [0.02, 0.01, 0.03]
    played.page.do(lambda r: r.change({"scene.payload.place": place}))
    played.run(0.2)
    np.testing.assert_allclose(played.page._payload.position, place)


CONTROLS = [
    ("gait", "walk", lambda r: r.wishes.gait),
    ("v_x (m/s)", 0.05, lambda r: r.wishes.velocity[0]),
    ("v_y (m/s)", 0.02, lambda r: r.wishes.velocity[1]),
    ("yaw rate (rad/s)", 0.01, lambda r: r.wishes.velocity[2]),
    ("height (mm)", 50.0, lambda r: 1e3 * r.wishes.pose[0]),
    ("roll (deg)", 4.0, lambda r: np.degrees(r.wishes.pose[1])),
    ("pitch (deg)", -3.0, lambda r: np.degrees(r.wishes.pose[2])),
    ("the gait's own height and tilt", False, lambda r: r.wishes.pose is None),
    ("policy", "gait_alone", lambda r: r.policy),
    ("friction RL", 0.2, lambda r: r.model.friction[0, 2]),
    ("slope (deg)", 10.0, lambda r: slope(r.changes["scene.gravity"])),
    ("payload (kg)", 0.5, lambda r: r.model.payload[0]),
    ("supply voltage (V)", 9.5, lambda r: r.changes["scene.supply_voltage"]),
    ("tendon FR broken", True, lambda r: r.model.fault[1, 1] == 0.0),
    ("push to", "left", lambda r: "left" if r.model.push[1] > 5.0 else ""),
    ("push to", "back", lambda r: "back" if r.model.push[0] < -5.0 else ""),
]


def slope(gravity):
    return np.degrees(np.arctan2(-gravity[0], -gravity[2]))


@pytest.mark.parametrize(("label", "value", "found"), CONTROLS)
def test_a_control_reaches_the_robot(played, label, value, found):
    handles = played.page.server.gui._gui_input_handle_from_uuid.values()
    control = next(each for each in handles if getattr(each, "label", "") == label)
    control.value = value
    played.run(0.1)
    assert found(played.robot) == pytest.approx(value)


def test_legs_that_are_pale_until_their_shape_is_known_then_get_it_with_their_colours(
    played,
):
    view = played.page.display.view
    for sections, colour in ((20, 128), (5, 255)):
        corners, colours = np.zeros((1, sections, 4, 3)), np.full((1, 3), colour / 255)
        view.update({"legs": Bars(corners, colours)})
        assert view.handle("legs").color == (colour,) * 3
        assert view.handle("legs").faces.max() == 4 * sections - 1


def test_the_floor_is_below_the_robot_wherever_it_goes_and_its_lines_stay_in_place(
    played,
):
    view = played.page.display.view
    view.centre(np.array([7.34, -5.01, 0.06]))
    np.testing.assert_allclose(view._floor.position, [7.3, -5.0, 0.0])
    np.testing.assert_allclose(view._root.position, [-7.34, 5.01, 0.0])


def test_plots_count_from_the_first_moment_and_name_their_curves(played):
    plots = played.page.display._plots
    for second in range(3):
        plots.advance(1_795_707_820_000_000_000 + second * 10**9)
    plots.show()
    np.testing.assert_allclose(plots._plots["height"]._handle.data[0], [0.0, 1.0, 2.0])
    said = legend(traces.PLOTS["force"])
    assert all(
        f"> {leg} {which}<" in said for leg in LEGS for which in ("ground", "demanded")
    )


def test_a_refusal_is_shown_and_the_next_act_takes_it_away(played):
    played.page.do(lambda r: r.change({"scene.payload.mass": -1.0}))
    played.run(0.2)
    assert "payload.mass = -1.0: outside" in played.text
    played.page.do(lambda r: r.change({"scene.payload.mass": 0.1}))
    played.run(0.2)
    assert "outside" not in played.text


def test_a_simulation_that_diverges_asks_for_a_reset(played):
    played.run(1.0)
    played.page.do(lambda r: r.loop.plant.robot.set_tip_to_nan(0))
    played.run(0.5)
    assert "diverged" in played.text
    assert ": reset" in played.text
    played.page._on_time("reset")
    played.run(0.5)
    assert "diverged" not in played.text


def test_what_the_player_is_told_is_no_markup(played):
    played.page.do(lambda r: setattr(r.wishes, "gait", "stand"))
    played.page.do(lambda r: r.change({"scene.<b>": 1}))
    played.run(0.2)
    assert "&lt;b&gt;" in played.text

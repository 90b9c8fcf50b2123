"""The loop of scripts/play without a browser: its pace, what it refuses, what it says."""

import numpy as np
import pytest

from slot_bringup.playing.live_plots import legend
from slot_bringup.playing.main_page import main, start_server
from slot_bringup.playing.play_page import PlayPage
from slot_bringup.playing.robot_display import view_for
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


def test_the_robot_is_in_sight_and_on_a_phone_above_the_panel_as_well():
    for width, height, lowest in ((390, 844, 0.4), (360, 640, 0.4), (1200, 700, 0.9)):
        x, y = on_page(*view_for(width / height), width / height)
        assert np.abs(x).max() < 1.0
        assert 0.1 < y.min() < y.max() < lowest


def on_page(position, look_at, aspect):
    """Feet and top of the robot: x over half the width, share of the height from the top."""
    feet = [[x, y, 0.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    ahead = np.subtract(look_at, position)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    way = np.array([*feet, [0.0, 0.0, 0.08]]) - position
    half = np.tan(np.radians(75.0) / 2) * (
        way @ ahead
    )  # of the height, in viser's own view
    return (way @ right) / half / aspect, (
        1.0 - (way @ np.cross(right, ahead)) / half
    ) / 2


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


def test_what_happened_is_saved_and_a_second_bag_of_a_second_is_refused(
    played, tmp_path
):
    played.run(1.0)
    played.page._on_time("save")
    played.run(0.2)
    (bag,) = tmp_path.iterdir()
    assert f"messages are in {bag}" in played.text


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


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scene", "none"], "none"),
        (["--policy", "none"], "none"),
        (["--scene", "paper"], "rods"),
        (["--port", "70000"], "outside"),
        (["--host", "no.such.host.invalid"], "no.such.host"),
    ],
)
def test_what_cannot_be_played_is_refused_in_one_line(refusal, arguments, reason):
    assert reason in refusal(main, *arguments)

"""The page of scripts/play in headless Chromium: the panel Drive acts on the robot."""

import threading

import numpy as np
import pytest
from browser import PROGRAM, Browser, wait_for

from slot_bringup.playing.main_page import address, start_server
from slot_bringup.playing.play_page import PlayPage
from slot_core.safety.states import State
from slot_lab.play.played_loop import Wishes
from slot_lab.play.played_robot import PlayedRobot

pytestmark = pytest.mark.skipif(not PROGRAM, reason="no Chromium: scripts/setup --test has one")
ROW = "[...document.querySelectorAll('label')].find(l => l.innerText == {label!r})"
ROW += ".closest('div').parentElement"
TAB = "[...document.querySelectorAll('[role=tab]')].find(t => t.innerText == {!r})"
BUTTON = "[...{row}.querySelectorAll('button')].find(b => b.innerText == {text!r})"
OPTION = "[...document.querySelectorAll('[role=option]')].find(o => o.innerText == {!r})"


class Hand:
    """Uses the page as a person would, and sees the robot in it."""

    def __init__(self, page, server, browser):
        self.page, self.server, self.browser = page, server, browser

    @property
    def robot(self):
        return self.page.robot

    @property
    def model(self):
        return self.robot.loop.plant.robot.model

    def see(self, shows):
        wait_for(lambda: shows(self))

    def open(self, tab):
        self.browser.click(TAB.format(tab))

    def slide(self, label, value):
        field = f"{ROW.format(label=label)}.querySelector('input[inputmode]')"
        wait_for(lambda: self.browser.run(f"!!{field.replace('.closest', '?.closest')}"))
        self.browser.run(f"{field}.focus(); {field}.select()")
        self.browser.call("Input.insertText", text=f"{value:g}")
        self.browser.run(f"{field}.blur()")

    def choose(self, label, option):
        self.browser.click(f"{ROW.format(label=label)}.querySelector('input')")
        self.browser.click(OPTION.format(option))

    def tick(self, label):
        self.browser.click(f"{ROW.format(label=label)}.querySelector('input[type=checkbox]')")

    def press(self, label, text):
        self.browser.click(BUTTON.format(row=ROW.format(label=label), text=text))


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """The page and a browser that shows it; it runs until the end of the module."""
    ended = threading.Event()
    server = start_server("127.0.0.1", 0, "")
    page = PlayPage(server, PlayedRobot(), tmp_path_factory.mktemp("bags"))
    runner = threading.Thread(target=page.run, args=(ended.is_set,))
    runner.start()
    try:
        place = address("127.0.0.1", server.get_port(), "")
        with Browser(tmp_path_factory.mktemp("chromium"), place) as browser:
            hand = Hand(page, server, browser)
            hand.see(lambda h: "yaw rate" in h.browser.text())
            yield hand
    finally:
        ended.set()
        runner.join()
        server.stop()


@pytest.fixture
def hand(shared):
    """The page with a robot that stands, as at the start."""

    def begin(robot):
        robot.wishes, robot.changes = Wishes(), {}
        robot.reset()

    done = threading.Event()
    shared.page.do(begin)
    shared.page.do(lambda _: done.set())
    assert done.wait(60.0)
    shared.see(lambda h: h.robot.loop.report and h.robot.loop.report.state is State.STANDING)
    return shared


def preview(hand):
    return hand.robot.tick.preview


def test_it_walks_turns_and_stops_by_sliders_and_keys(hand):
    hand.open("Drive")
    hand.choose("gait", "walk")
    hand.slide("v_x (m/s)", 0.05)
    hand.see(lambda h: h.robot.truth.odometry.position[0] > 0.02)
    hand.slide("v_y (m/s)", 0.02)
    hand.slide("yaw rate (rad/s)", 0.01)
    hand.see(lambda h: np.allclose(preview(h).command.velocity, [0.05, 0.02, 0.01]))
    hand.see(lambda h: h.robot.truth.odometry.position[1] > 0.01)
    hand.browser.key("M")
    hand.see(lambda h: not preview(h).command.velocity.any())
    for key, axis, sign in (("I", 0, 1), ("J", 2, 1), ("U", 1, 1), ("O", 1, -1), ("L", 2, -1)):
        before = hand.robot.wishes.velocity[axis]
        hand.browser.key(key)
        hand.see(lambda h: sign * (h.robot.wishes.velocity[axis] - before) > 0)  # noqa: B023
    hand.browser.key("H")
    hand.see(lambda h: h.robot.loop.report.state is State.STANDING)


def test_it_takes_a_pose_and_gives_it_up_again(hand):
    hand.open("Drive")
    hand.slide("height (mm)", 50)
    hand.see(lambda h: h.robot.truth.odometry.position[2] > 0.047)
    hand.slide("roll (deg)", 4)
    hand.slide("pitch (deg)", -3)
    hand.see(lambda h: np.allclose(preview(h).command.pose, [0.05, *np.radians([4, -3])]))
    hand.see(lambda h: h.robot.truth.odometry.quaternion[0] > np.sin(np.radians(3) / 2))
    hand.tick("the gait's own height and tilt")
    hand.see(lambda h: h.robot.truth.odometry.position[2] < 0.042)


def test_policy_and_operator(hand):
    hand.open("Drive")
    hand.choose("policy", "gait_alone")
    hand.see(lambda h: "none are estimated" in h.browser.text())
    hand.choose("policy", "predictive")
    hand.see(lambda h: h.robot.policy == "predictive")
    for button, state in (
        ("relax", State.IDLE), ("stand up", State.STANDING), ("e-stop", State.ESTOP)
    ):  # fmt: skip
        hand.press("operator", button)
        hand.see(lambda h: h.robot.loop.report.state is state)  # noqa: B023
    hand.see(lambda h: "ESTOP" in h.browser.text())

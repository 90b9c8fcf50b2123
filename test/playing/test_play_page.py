"""The page of scripts/play in headless Chromium: keys, gamepad, mouse and a slider reach the robot.

Real time: the page keeps pace with the wall clock, while Chromium draws without a GPU.
"""

import threading
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from documentation.browser import PROGRAM, playing, wait_for
from slot_core.safety.states import State
from slot_lab.play.played_robot import Wishes

pytestmark = [
    pytest.mark.skipif(
        not PROGRAM, reason="no Chromium: scripts/setup --test has one"
    ),
    pytest.mark.real_time,
]
ROW = "[...document.querySelectorAll('label')].find(l => l.innerText == {label!r})"
ROW += ".closest('div').parentElement"
TAB = "[...document.querySelectorAll('[role=tab]')].find(t => t.innerText == {!r})"
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

    @property
    def ahead(self):
        """Velocity of the gait."""
        return self.robot.tick.preview.command.velocity

    def see(self, shows):
        wait_for(lambda: shows(self), said=self.browser.text)

    def open(self, tab):
        def selected():  # a click may come before the page is complete
            self.browser.click(TAB.format(tab))
            return self.browser.run(f"{TAB.format(tab)}.ariaSelected") == "true"

        wait_for(selected, said=self.browser.text)

    def slide(self, label, value):
        field = f"{ROW.format(label=label)}.querySelector('input[inputmode]')"
        there = f"!!{field.replace('.closest', '?.closest')}"
        wait_for(lambda: self.browser.run(there))

        def typed():  # the page may take a value back while it draws another
            self.browser.run(f"{field}.focus(); {field}.select()")
            self.browser.call("Input.insertText", text=f"{value:g}")
            self.browser.run(f"{field}.blur()")
            return float(self.browser.run(f"{field}.value")) == value

        wait_for(typed, said=self.browser.text)

    def choose(self, label, option):
        self.browser.click(f"{ROW.format(label=label)}.querySelector('input')")
        self.browser.click(OPTION.format(option))

    def pixel(self, point):
        """Where a point (3,) of the torso, m in base_link, is on the screen."""
        (client,) = self.server.get_clients().values()
        camera, odometry = client.camera, self.robot.truth.odometry
        place = Rotation.from_quat(odometry.quaternion).apply(point)
        place[2] += odometry.position[2]
        w, x, y, z = camera.wxyz
        seen = (
            Rotation.from_quat([x, y, z, w])
            .inv()
            .apply(place - camera.position)
        )
        middle = np.array(self.browser.run("[innerWidth, innerHeight]")) / 2
        return middle + middle[1] / np.tan(camera.fov / 2) * seen[:2] / seen[2]


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """The page and a browser that shows it; it runs until the end of the module."""
    with playing(tmp_path_factory.mktemp("page")) as shown:
        yield Hand(*shown)


@pytest.fixture
def hand(shared):
    """The page with a robot that stands, as at the start."""

    def begin(robot):
        robot.wishes, robot.changes = Wishes(), {}
        robot.reset()

    done = threading.Event()
    for act in (begin, lambda _: done.set()):
        shared.page.do(act)
    assert done.wait(60.0)
    loop = shared.robot.loop
    shared.see(lambda _: loop.report and loop.report.state is State.STANDING)
    return shared


def test_a_slider_and_keys_act_and_a_dropdown_gives_the_keys_back(hand):
    """The key of the e-stop acts in a field of a number, too."""
    hand.open("Drive")
    hand.choose("gait", "walk")
    hand.slide("v_x (m/s)", 0.05)
    hand.see(lambda h: h.robot.truth.odometry.position[0] > 0.02)
    for key, axis, sign in (
        ("ArrowLeft", 2, 1),
        (",", 1, 1),
        (".", 1, -1),
        ("ArrowRight", 2, -1),
    ):
        before = hand.robot.wishes.velocity[axis]
        hand.browser.key(key)
        hand.see(lambda h: sign * (h.robot.wishes.velocity[axis] - before) > 0)  # noqa: B023
    hand.browser.key("0")
    hand.see(lambda h: not h.ahead.any())
    hand.browser.key("u")
    hand.see(lambda h: h.robot.wishes.pose is not None)
    hand.browser.key("s")
    hand.see(lambda h: h.robot.loop.report.state is State.STANDING)
    field = f"{ROW.format(label='v_x (m/s)')}.querySelector('input[inputmode]')"
    hand.browser.run(f"{field}.focus()")
    hand.browser.key(" ")
    hand.see(lambda h: h.robot.loop.report.state is State.ESTOP)


GAMEPAD = "[{{connected: true, mapping: 'standard', axes: {axes}, buttons: [{{pressed: {a}}}]}}]"


def hold(hand, axes, a="false"):
    """Hold the sticks of a gamepad, and its button A."""
    hand.browser.run(
        f"navigator.getGamepads = () => {GAMEPAD.format(axes=axes, a=a)}"
    )


def test_a_gamepad_walks_steers_and_stops(hand):
    hand.open("Drive")
    hold(hand, [0, 0, 0, 0], a="true")
    hand.see(lambda h: h.robot.wishes.gait == "walk")
    hold(hand, [0, -1, -0.9, 0])
    hand.see(lambda h: (h.robot.wishes.velocity[[0, 2]] > 0.0).all())
    hand.see(lambda h: h.ahead[0] > 0.02)
    assert hand.robot.wishes.velocity[1] == 0.0
    hold(hand, [0, 0, 0, 0])
    hand.see(lambda h: not h.ahead.any())
    hold(hand, [0.9, 0.3, 0, 0])
    hand.see(lambda h: h.robot.wishes.velocity[1] < 0.0)
    hand.browser.run("navigator.getGamepads = () => [null]")  # it is unplugged
    hand.see(lambda h: not h.robot.wishes.velocity.any())


def test_the_mouse_pulls_at_the_torso_and_places_the_payload(hand):
    corner = hand.pixel([0.04, -0.03, 0.017])
    hand.browser.drag(corner, (corner[0] + 150, corner[1]))
    hand.see(lambda h: np.linalg.norm(h.model.push) > 1.0)
    hand.browser.mouse("mouseReleased", corner[0] + 150, corner[1])
    hand.see(lambda h: not h.model.push.any())
    hand.open("World")
    hand.slide("payload (kg)", 0.3)
    hand.see(lambda h: h.model.payload[0] == 0.3)

    def placed():  # after it was dragged once
        x, y, top = hand.model.payload[1:]
        hand.browser.drag(
            hand.pixel([x, y, top]), goal := hand.pixel([-0.04, 0.02, top])
        )
        hand.browser.mouse("mouseReleased", *goal)
        # until the page has acted; the robot sinks under the load meanwhile
        time.sleep(0.5)
        return np.allclose(hand.model.payload[1:3], [-0.04, 0.02], atol=0.02)

    wait_for(placed, said=hand.browser.text)


def test_the_page_draws_its_plots_and_requests_nothing_from_elsewhere(hand):
    hand.open("Plots")
    hand.see(
        lambda h: h.browser.run("!!document.querySelector('.uplot canvas')")
    )
    asked = "performance.getEntriesByType('resource').map(e => e.name)"
    found = hand.browser.run(f"[location.href, ...{asked}]")
    allowed = hand.browser.run("location.origin"), "blob:", "data:"
    assert [each for each in found if not each.startswith(allowed)] == []

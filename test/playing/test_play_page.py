"""The page of scripts/play in headless Chromium: keys, gamepad, mouse and a slider reach the robot.

Real time: the page keeps pace with the wall clock, while Chromium draws without a GPU.
"""

import threading
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from documentation.browser import PROGRAM, opened, playing, wait_for
from slot_core.safety.states import State
from slot_lab.play.played_robot import Wishes

pytestmark = [
    pytest.mark.skipif(
        not PROGRAM, reason="no Chromium: scripts/setup --test has one"
    ),
    pytest.mark.real_time,
]
ROW = "xpath=ancestor::div[1]/.."


class Hand:
    """Uses the page as a person would, and sees the robot in it."""

    def __init__(self, page, server, window):
        self.page, self.server, self.window = page, server, window

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
        wait_for(lambda: shows(self), said=self.text)

    def text(self):
        return self.window.inner_text("body")

    def field(self, label):
        """The number beside a slider."""
        row = self.window.get_by_text(label, exact=True).locator(ROW)
        return row.locator("input[inputmode]")

    def slide(self, label, value):
        field = self.field(label)

        def typed():  # the page may take a value back while it draws another
            field.fill(f"{value:g}")
            field.blur()
            return float(field.input_value()) == value

        wait_for(typed, said=self.text)

    def choose(self, label, option):
        self.window.get_by_role("combobox", name=label, exact=True).click()
        self.window.get_by_role("option", name=option, exact=True).click()

    def drag(self, begin, end):
        """Drag with the mouse from one point to another, without letting go."""
        self.window.mouse.move(*begin)
        self.window.mouse.down()
        self.window.mouse.move(*end, steps=8)

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
        middle = np.array(self.window.evaluate("[innerWidth, innerHeight]")) / 2
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
    opened(hand.window, "Drive")
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
        hand.window.keyboard.press(key)
        hand.see(lambda h: sign * (h.robot.wishes.velocity[axis] - before) > 0)  # noqa: B023
    hand.window.keyboard.press("0")
    hand.see(lambda h: not h.ahead.any())
    hand.window.keyboard.press("u")
    hand.see(lambda h: h.robot.wishes.pose is not None)
    hand.window.keyboard.press("s")
    hand.see(lambda h: h.robot.loop.report.state is State.STANDING)
    hand.field("v_x (m/s)").focus()
    hand.window.keyboard.press("Space")
    hand.see(lambda h: h.robot.loop.report.state is State.ESTOP)


GAMEPAD = "[{{connected: true, mapping: 'standard', axes: {axes}, buttons: [{{pressed: {a}}}]}}]"


def hold(hand, axes, a="false"):
    """Hold the sticks of a gamepad, and its button A."""
    hand.window.evaluate(
        f"navigator.getGamepads = () => {GAMEPAD.format(axes=axes, a=a)}"
    )


def test_a_gamepad_walks_steers_and_stops(hand):
    opened(hand.window, "Drive")
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
    hand.window.evaluate(
        "navigator.getGamepads = () => [null]"
    )  # it is unplugged
    hand.see(lambda h: not h.robot.wishes.velocity.any())


def test_the_mouse_pulls_at_the_torso_and_places_the_payload(hand):
    corner = hand.pixel([0.04, -0.03, 0.017])
    hand.drag(corner, (corner[0] + 150, corner[1]))
    hand.see(lambda h: np.linalg.norm(h.model.push) > 1.0)
    hand.window.mouse.up()
    hand.see(lambda h: not h.model.push.any())
    opened(hand.window, "World")
    hand.slide("payload (kg)", 0.3)
    hand.see(lambda h: h.model.payload[0] == 0.3)

    def placed():  # after it was dragged once
        x, y, top = hand.model.payload[1:]
        hand.drag(hand.pixel([x, y, top]), hand.pixel([-0.04, 0.02, top]))
        hand.window.mouse.up()
        # until the page has acted; the robot sinks under the load meanwhile
        time.sleep(0.5)
        return np.allclose(hand.model.payload[1:3], [-0.04, 0.02], atol=0.02)

    wait_for(placed, said=hand.text)


def test_the_page_draws_its_plots_and_requests_nothing_from_elsewhere(hand):
    opened(hand.window, "Plots")
    hand.window.locator(".uplot canvas").first.wait_for()
    asked = "performance.getEntriesByType('resource').map(e => e.name)"
    found = hand.window.evaluate(f"[location.href, ...{asked}]")
    allowed = hand.window.evaluate("location.origin"), "blob:", "data:"
    assert [each for each in found if not each.startswith(allowed)] == []

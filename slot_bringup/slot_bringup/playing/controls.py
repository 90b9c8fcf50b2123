"""Controls of the page: what they are called, their ranges, and what they do to the robot.

Callbacks run in threads of viser; what they want is done by `do`, between two frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from slot_core.control.policy import POLICIES
from slot_core.dynamics.scene import read_scene
from slot_core.gait.gait import STAND, read_gaits
from slot_core.robot import LEGS, read_robot
from slot_core.safety.requests import Request
from slot_lab.play.played_robot import PlayedRobot

Act = Callable[[PlayedRobot], object]
Do = Callable[[Act], None]
PUSH_TIME = 0.2  # s
PUSH_MAX = 20.0  # N
STEEPEST = 15.0  # deg
LARGEST_PAYLOAD = 1.0  # kg
PAYLOAD_RADIUS = 0.012  # m
KEY_SHARE = 0.25  # of the largest velocity, per key


@dataclass(frozen=True)
class Range:
    """Range of a slider."""

    low: float
    high: float
    step: float
    start: float


def add_drive(gui: viser.GuiApi, robot: PlayedRobot, do: Do) -> None:
    """Gait, velocity, pose, policy; requests to the supervisor."""
    gaits = read_gaits()
    gait = gui.add_dropdown("gait", tuple(gaits.gaits), initial_value=robot.wishes.gait)
    gait.on_update(lambda _: do(lambda r: setattr(r.wishes, "gait", gait.value)))
    policy = gui.add_dropdown("policy", tuple(POLICIES), initial_value=robot.policy)
    policy.on_update(lambda _: do(lambda r: r.set_policy(policy.value)))
    most = np.max([each.speeds for each in gaits.gaits.values()], axis=0)
    labels = "v_x (m/s)", "v_y (m/s)", "yaw rate (rad/s)"
    speeds = [
        _slider(gui, label, Range(-top, top, 0.005, 0.0))
        for label, top in zip(labels, np.ceil(200 * most) / 200)
    ]

    def drive(_: object = None) -> None:
        velocity = np.array([speed.value for speed in speeds], dtype=float)
        do(lambda r: setattr(r.wishes, "velocity", velocity))

    for speed in speeds:
        speed.on_update(drive)
    _add_keys(gui, speeds, drive, gait)
    _add_pose(gui, do)
    asked = gui.add_button_group("operator", ("stand up", "relax", "e-stop"))
    asked.on_click(lambda _: do(REQUESTS[asked.value]))


def _rise(robot: PlayedRobot) -> None:
    robot.wishes.up = True


REQUESTS: dict[str, Act] = {
    "stand up": _rise,
    "relax": lambda r: r.loop.request(Request.RELAX),
    "e-stop": lambda r: r.loop.request(Request.ESTOP),
}


def _add_keys(
    gui: viser.GuiApi, speeds: Sequence[Any], drive: Callable[[], None], gait: Any
) -> None:
    """Keys that change velocity and gait."""

    def change(index: int, sign: int) -> None:
        slider = speeds[index]
        wanted = slider.value + sign * KEY_SHARE * slider.max
        slider.value = min(max(wanted, slider.min), slider.max)
        drive()

    def stop() -> None:
        for slider in speeds:
            slider.value = 0.0
        drive()

    def choose(name: str) -> None:
        gait.value = name

    actions: dict[tuple[str, str], Callable[[], None]] = {
        ("I", "faster forward"): lambda: change(0, 1),
        ("K", "slower, back"): lambda: change(0, -1),
        ("J", "turn left"): lambda: change(2, 1),
        ("L", "turn right"): lambda: change(2, -1),
        ("U", "to the left"): lambda: change(1, 1),
        ("O", "to the right"): lambda: change(1, -1),
        ("M", "no velocity"): stop,
        ("G", "gait walk"): lambda: choose("walk"),
        ("H", "gait stand"): lambda: choose(STAND),
    }
    for (key, label), act in actions.items():
        add_key(gui, key, label, act)


def add_key(gui: viser.GuiApi, key: Any, label: str, act: Callable[[], None]) -> None:
    """A key of the keyboard, which the list of commands names too."""
    gui.add_command(label, hotkey=key).on_trigger(lambda _: act())


def _add_pose(gui: viser.GuiApi, do: Do) -> None:
    gaits = read_gaits()
    reached = [each.height_range for each in gaits.gaits.values()]
    low, high = 1e3 * min(r[0] for r in reached), 1e3 * max(r[1] for r in reached)
    tilt = math.degrees(gaits.tilt_max)
    own: Any = gui.add_checkbox("the gait's own height and tilt", initial_value=True)
    start = 1e3 * gaits.find(STAND).height
    height = _slider(gui, "height (mm)", Range(low, high, 1.0, start))
    roll, pitch = (_slider(gui, f"{n} (deg)", Range(-tilt, tilt, 0.1, 0.0)) for n in ANGLES)

    def pose(_: object = None) -> None:
        values = np.array([1e-3 * height.value, *np.radians([roll.value, pitch.value])])
        do(lambda r: setattr(r.wishes, "pose", None if own.value else values))

    def moved(_: object = None) -> None:
        own.value = False
        pose()

    own.on_update(pose)
    for slider in (height, roll, pitch):
        slider.on_update(moved)


ANGLES = ("roll", "pitch")


def add_world(gui: viser.GuiApi, robot: PlayedRobot, do: Do) -> None:
    """Floor, payload, legs, supply and tendons."""
    scene = read_scene(robot.scene)
    friction = [
        _slider(gui, f"friction {leg}", Range(0.0, 1.5, 0.05, mu))
        for leg, mu in zip(LEGS, scene.floor.friction)
    ]
    for slider in friction:
        slider.on_update(lambda _: do(_change("scene.floor.friction", [f.value for f in friction])))
    slope = _slider(gui, "slope (deg)", Range(-STEEPEST, STEEPEST, 0.5, _slope(scene.gravity)))
    slope.on_update(lambda _: do(lambda r: r.set_slope(slope.value)))
    mass = _slider(gui, "payload (kg)", Range(0.0, LARGEST_PAYLOAD, 0.02, scene.payload.mass))
    mass.on_update(lambda _: do(lambda r: _load(r, mass.value)))
    modulus = read_robot(scene.parameters).leg.young_modulus
    stiff = _slider(gui, "stiffness of the legs (%)", Range(50.0, 150.0, 1.0, 100.0))
    stiff.on_update(lambda _: do(_change("robot.leg.young_modulus", stiff.value / 100 * modulus)))
    volts = _slider(gui, "supply voltage (V)", Range(9.0, 12.0, 0.1, scene.supply_voltage))
    volts.on_update(lambda _: do(_change("scene.supply_voltage", volts.value)))
    for leg in LEGS:
        _add_tendon(gui, leg, do)


def _add_tendon(gui: viser.GuiApi, leg: str, do: Do) -> None:
    box = gui.add_checkbox(f"tendon {leg} broken", initial_value=False)
    box.on_update(lambda _: do(lambda r: r.set_tendon(leg, broken=box.value)))


def add_push(gui: viser.GuiApi, do: Do) -> None:
    """A push of the torso from one side."""
    force = _slider(gui, "push (N)", Range(0.0, PUSH_MAX, 0.5, 6.0))
    side = gui.add_button_group("push to", tuple(SIDES))

    def push(_: object) -> None:
        x, y = SIDES[side.value]
        wanted = force.value * x, force.value * y, 0.0
        do(lambda r: r.push(wanted, PUSH_TIME))

    side.on_click(push)
    gui.add_markdown("Drag the torso with the mouse to pull at it; drag the payload to its place.")


SIDES = {"left": (0, 1), "right": (0, -1), "front": (1, 0), "back": (-1, 0)}


def _load(robot: PlayedRobot, mass: float) -> None:
    """Set the payload's mass; a first payload lies on the middle of the torso."""
    scene = read_scene(robot.scene)
    changes: dict[str, Any] = {"scene.payload.mass": mass}
    if not scene.payload.mass and "scene.payload.place" not in robot.changes:
        changes["scene.payload.place"] = [0.0, 0.0, on_top(robot)]
    robot.change(changes)


def on_top(robot: PlayedRobot) -> float:
    """Height of a payload's centre above that of the torso on which it lies, m."""
    return robot.loop.plant.robot.parameters.torso.size[2] / 2 + PAYLOAD_RADIUS


def _slope(gravity: Sequence[float]) -> float:
    return math.degrees(math.atan2(-gravity[0], -gravity[2]))


def _change(name: str, value: Any) -> Act:
    return lambda robot: robot.change({name: value})


def _slider(gui: viser.GuiApi, label: str, r: Range) -> Any:
    start = min(max(float(r.start), float(r.low)), float(r.high))
    return gui.add_slider(label, float(r.low), float(r.high), float(r.step), start)

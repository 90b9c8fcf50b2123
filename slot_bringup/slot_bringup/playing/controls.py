"""Controls of the page: their names, their ranges, and their effects on the robot.

Callbacks run in threads of viser, in any order; what they want is done by `do`, between two frames,
and reads the sliders only then.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from typing import Any, TypeAlias, TypeVar

import numpy as np
import viser

from slot_bringup.playing.graph_robot import GraphRobot
from slot_core.arrays import Array
from slot_core.control.policies import POLICIES
from slot_core.dynamics.scene import read_scene
from slot_core.faults import ALL_LEGS, BROKEN, KINDS, Fault
from slot_core.gait.gait import STAND, read_gaits
from slot_core.robot import LEGS, read_robot
from slot_core.safety.states import Request
from slot_lab.play.played_robot import PlayedRobot

Robot = TypeVar("Robot")
DrivableRobot: TypeAlias = PlayedRobot | GraphRobot  # of the panel Drive
Act = Callable[[Robot], object]
Do = Callable[[Act[Robot]], None]
PUSH_TIME = 0.2  # s
PUSH_MAX = 20.0  # N
STEEPEST = 15.0  # deg
LARGEST_PAYLOAD = 1.0  # kg
PAYLOAD_RADIUS = 0.012  # m
KEY_SHARE = 0.25  # of a slider's half range, per key


def add_drive(
    gui: viser.GuiApi, do: Do[DrivableRobot], start: str = STAND
) -> None:
    """Gait, of which `start` is the present one, velocity, pose; requests to the supervisor."""
    gaits = read_gaits()
    gait: Any = gui.add_dropdown(
        "gait", tuple(gaits.gaits), initial_value=start
    )
    _bind(do, gait, lambda r, name: r.set_gait(name))
    most = np.max([each.speeds for each in gaits.gaits.values()], axis=0)
    speeds = [
        _slider(gui, label, (-top, top), 0.005, 0.0)
        for label, top in zip(
            ("v_x (m/s)", "v_y (m/s)", "yaw rate (rad/s)"),
            np.ceil(200 * most) / 200,
        )
    ]

    def drive(_: object) -> None:
        do(lambda r: r.set_velocity(_values(speeds)))

    for speed in speeds:
        speed.on_update(drive)
    pose = _add_pose(gui, do)
    _add_keys(gui, speeds, pose)
    for key, name in {"G": "walk", "H": STAND}.items():
        add_key(gui, key, f"gait {name}", partial(setattr, gait, "value", name))
    asked = gui.add_button_group("operator", tuple(REQUESTS))

    def ask(_: object) -> None:
        if asked.value == STAND_UP:
            # a gait that is chosen again makes the robot walk again
            gait.value = STAND
        do(REQUESTS[asked.value])

    asked.on_click(ask)
    add_key(gui, "X", "e-stop", lambda: do(REQUESTS["e-stop"]))
    reset = gui.add_button_group("after a stop", (RESET,))
    reset.on_click(lambda _: do(lambda r: r.request(Request.RESET)))


STAND_UP, RESET = "stand up", "reset e-stop or fault"
REQUESTS: dict[str, Act[DrivableRobot]] = {
    STAND_UP: lambda r: r.stand_up(),
    "relax": lambda r: r.request(Request.RELAX),
    "e-stop": lambda r: r.request(Request.ESTOP),
}


def add_policy(gui: viser.GuiApi, do: Do[PlayedRobot], start: str) -> None:
    """The policy, which a key changes too."""
    policy = gui.add_dropdown("policy", tuple(POLICIES), initial_value=start)
    _bind(do, policy, lambda r, name: r.set_policy(name))
    add_key(gui, "Y", "next policy", partial(_next, policy))


# Sliders of SPEED_KEYS: v_x, v_y, yaw rate; of POSE_KEYS, with Shift: height, roll, pitch.
SPEED_KEYS = {
    "I": (0, 1, "faster forward"),
    "K": (0, -1, "slower, back"),
    "U": (1, 1, "to the left"),
    "O": (1, -1, "to the right"),
    "J": (2, 1, "turn left"),
    "L": (2, -1, "turn right"),
}
POSE_KEYS = {
    "I": (2, 1, "nose down"),
    "K": (2, -1, "nose up"),
    "U": (0, 1, "higher"),
    "O": (0, -1, "lower"),
    "J": (1, -1, "roll left"),
    "L": (1, 1, "roll right"),
}


def _add_keys(
    gui: viser.GuiApi, speeds: Sequence[Any], pose: Sequence[Any]
) -> None:
    """Keys that move the sliders of velocity and, with Shift, of the pose."""
    for sliders, keys, modifier in (
        (speeds, SPEED_KEYS, None),
        (pose, POSE_KEYS, "shift"),
    ):
        for key, (index, sign, label) in keys.items():
            add_key(
                gui, key, label, partial(_nudge, sliders[index], sign), modifier
            )

    def stop() -> None:
        for slider in speeds:
            slider.value = 0.0

    add_key(gui, "M", "no velocity", stop)


def _nudge(slider: Any, sign: int) -> None:
    wanted = slider.value + sign * KEY_SHARE * (slider.max - slider.min) / 2
    slider.value = min(max(wanted, slider.min), slider.max)


def _next(dropdown: Any) -> None:
    options = dropdown.options
    dropdown.value = options[(options.index(dropdown.value) + 1) % len(options)]


def add_key(
    gui: viser.GuiApi,
    key: Any,
    label: str,
    act: Callable[[], None],
    modifier: Any = None,
) -> None:
    """A key of the keyboard, which the list of commands names too."""
    gui.add_command(label, hotkey=key, modifier=modifier).on_trigger(
        lambda _: act()
    )


def _add_pose(gui: viser.GuiApi, do: Do[DrivableRobot]) -> tuple[Any, Any, Any]:
    """Height, roll and pitch; returns their sliders."""
    gaits = read_gaits()
    reached = [each.height_range for each in gaits.gaits.values()]
    low, high = (
        1e3 * min(r[0] for r in reached),
        1e3 * max(r[1] for r in reached),
    )
    tilt = math.floor(10 * math.degrees(gaits.tilt_max)) / 10
    own: Any = gui.add_checkbox(
        "the gait's own height and tilt", initial_value=True
    )
    start = 1e3 * gaits.find(STAND).height
    height = _slider(gui, "height (mm)", (low, high), 1.0, start)
    roll, pitch = (
        _slider(gui, f"{name} (deg)", (-tilt, tilt), 0.1, 0.0)
        for name in ("roll", "pitch")
    )

    def take(robot: DrivableRobot) -> None:
        z, *tilts = _values((height, roll, pitch))
        robot.set_pose(
            None if own.value else np.array([1e-3 * z, *np.radians(tilts)])
        )

    def pose(_: object) -> None:
        do(take)

    def moved(event: object) -> None:
        own.value = False
        pose(event)

    own.on_update(pose)
    for slider in (height, roll, pitch):
        slider.on_update(moved)
    return height, roll, pitch


def add_world(
    gui: viser.GuiApi, robot: PlayedRobot, do: Do[PlayedRobot]
) -> None:
    """Floor, payload, legs, supply and tendons."""
    scene = read_scene(robot.scene)
    friction = [
        _slider(gui, f"friction {leg}", (0.0, 1.5), 0.05, mu)
        for leg, mu in zip(LEGS, scene.floor.friction)
    ]

    def rub(robot: PlayedRobot, _: float) -> None:
        robot.change({"scene.floor.friction": _values(friction).tolist()})

    for slider in friction:
        _bind(do, slider, rub)
    # Pa, of a percent
    modulus = read_robot(scene.parameters).leg.young_modulus / 100
    slope = math.degrees(math.atan2(-scene.gravity[0], -scene.gravity[2]))
    for label, limits, step, start, act in (
        (
            "slope (deg)",
            (-STEEPEST, STEEPEST),
            0.5,
            slope,
            PlayedRobot.set_slope,
        ),
        (
            "payload (kg)",
            (0.0, LARGEST_PAYLOAD),
            0.02,
            scene.payload.mass,
            _load,
        ),
        (
            "stiffness of the legs (%)",
            (50.0, 150.0),
            1.0,
            100.0,
            lambda r, share: r.change(
                {"robot.leg.young_modulus": share * modulus}
            ),
        ),
        (
            "supply voltage (V)",
            (9.0, 12.0),
            0.1,
            scene.supply_voltage,
            lambda r, voltage: r.change({"scene.supply_voltage": voltage}),
        ),
    ):
        _bind(do, _slider(gui, label, limits, step, start), act)
    for leg in LEGS:
        box = gui.add_checkbox(f"tendon {leg} broken", initial_value=False)

        def set_broken(
            robot: PlayedRobot, broken: bool, leg: str = leg
        ) -> None:
            robot.set_tendon(leg, broken=broken)

        _bind(do, box, set_broken)


def add_push(gui: viser.GuiApi, do: Do[PlayedRobot]) -> None:
    """A push of the torso from one side."""
    force = _slider(gui, "push (N)", (0.0, PUSH_MAX), 0.5, 6.0)
    side = gui.add_button_group("push to", tuple(SIDES))

    def push(_: object) -> None:
        x, y = SIDES[side.value]
        wanted = force.value * x, force.value * y, 0.0
        do(lambda r: r.push(wanted, PUSH_TIME))

    side.on_click(push)
    gui.add_markdown(
        "Drag the torso with the mouse to pull at it; drag the payload to its place."
    )


SIDES = {"left": (0, 1), "right": (0, -1), "front": (1, 0), "back": (-1, 0)}


def add_faults(gui: viser.GuiApi, do: Do[GraphRobot]) -> None:
    """A fault of the simulated robot of a graph."""
    kind = gui.add_dropdown("kind", KINDS, initial_value=BROKEN)
    leg = gui.add_dropdown("leg", (*LEGS, ALL_LEGS))
    value = gui.add_number("value", 0.0, step=0.001)
    duration = gui.add_number("duration (s)", 0.0, min=0.0, step=0.1)
    act = gui.add_button_group("fault", ("inject", "clear"))

    def inject(_: object) -> None:
        wanted = (
            kind.value,
            leg.value,
            value.value,
            duration.value,
            act.value == "clear",
        )
        do(lambda r: r.inject(*wanted))

    act.on_click(inject)
    docs = {field.name: field.metadata["doc"] for field in fields(Fault)}
    gui.add_markdown(
        f"Value of {docs['value']}. Duration 0: until it is cleared."
    )


def _load(robot: PlayedRobot, mass: float) -> None:
    """Set the payload's mass; a first payload lies on the middle of the torso."""
    changes: dict[str, Any] = {"scene.payload.mass": mass}
    loaded = read_scene(robot.scene).payload.mass
    if not loaded and "scene.payload.place" not in robot.changes:
        changes["scene.payload.place"] = [0.0, 0.0, on_top(robot)]
    robot.change(changes)


def on_top(robot: PlayedRobot) -> float:
    """Height of a payload's centre above the centre of the torso on which it lies, m."""
    return robot.loop.plant.robot.parameters.torso.size[2] / 2 + PAYLOAD_RADIUS


def _values(sliders: Sequence[Any]) -> Array:
    return np.array([slider.value for slider in sliders], dtype=float)


def _slider(
    gui: viser.GuiApi,
    label: str,
    limits: tuple[float, float],
    step: float,
    start: float,
) -> Any:
    low, high = map(float, limits)  # viser takes no numbers of NumPy
    return gui.add_slider(
        label, low, high, step, min(max(float(start), low), high)
    )


def _bind(
    do: Do[Robot], control: Any, act: Callable[[Robot, Any], object]
) -> None:
    """Let a control act on the robot with its value whenever that is changed."""
    control.on_update(lambda _: do(lambda robot: act(robot, control.value)))

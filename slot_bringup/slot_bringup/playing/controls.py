"""Controls of the page: their names, their ranges, and their effects on the robot.

Callbacks run in threads of viser, in any order; what they want is done by `do`, between two frames,
and reads the sliders only then.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from html import escape
from typing import Any, TypeAlias, TypeVar

import numpy as np
import viser

from slot_bringup.operator_screen import KEYS
from slot_bringup.playing.graph_robot import GraphRobot
from slot_bringup.steering import POSE_KEYS, VELOCITY_KEYS, Step
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
KEY_OF = {request: key for key, request in KEYS.items()}
ARROWS = {
    "arrowup": "\u2191",
    "arrowdown": "\u2193",
    "arrowleft": "\u2190",
    "arrowright": "\u2192",
}
RED = 200, 16, 16
TABLE = "font-size:0.875em;line-height:1.6em;margin:0.5em 1em;border-spacing:0.7em 0"
# The button keeps its place at the top while the panel is scrolled.
LARGE = """<style>
button[id="ID"] { height: 3.2em !important; font-size: 1.3em; font-weight: bold; }
div:has(> button[id="ID"]) { position: sticky; top: 0; z-index: 9; padding-top: 0.5em; }
</style>"""


class Keys:
    """Keys of the page, named as those of the operator's terminal; `show` lists all that are bound."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._gui = gui
        self._meanings: dict[str, str] = {}

    def bind(self, key: str, meaning: str, act: Callable[[], None]) -> str:
        """Bind a key, with Shift if it is an upper-case letter; returns the name that is shown."""
        name: Any = {" ": "space"}.get(key, key)
        shift = len(key) == 1 and key.isupper()
        self._gui.add_command(
            meaning,
            hotkey=name.upper() if len(key) == 1 and key.isalpha() else name,
            modifier="shift" if shift else None,
        ).on_trigger(lambda _: act())
        shown = ARROWS.get(name, f"Shift+{key}" if shift else name.upper())
        self._meanings[shown] = meaning
        return shown

    def show(self) -> None:
        """List the keys, one a line."""
        rows = "".join(
            f"<tr><td><kbd>{escape(key)}</kbd></td><td>{escape(meaning)}</td></tr>"
            for key, meaning in self._meanings.items()
        )
        self._gui.add_html(f'<table style="{TABLE}">{rows}</table>')


def add_estop(gui: viser.GuiApi, do: Do[DrivableRobot]) -> Keys:
    """The e-stop, above all else and larger, whose key acts wherever the focus is.

    Returns the keys of the page.
    """
    keys = Keys(gui)

    def stop() -> None:
        do(lambda r: r.request(Request.ESTOP))

    shown = keys.bind(KEY_OF["estop"], "e-stop", stop)
    button = gui.add_button(f"E-STOP ({shown})", color=RED, order=-1.0)
    button.on_click(lambda _: stop())
    gui.add_html(LARGE.replace("ID", button._impl.uuid))
    return keys


def add_drive(
    gui: viser.GuiApi, do: Do[DrivableRobot], keys: Keys, start: str = STAND
) -> None:
    """Gait, of which `start` is the present one, velocity, pose; requests to the supervisor."""
    gaits = read_gaits()
    gait: Any = gui.add_dropdown(
        "gait", tuple(gaits.gaits), initial_value=start
    )
    _bind(do, gait, lambda r, name: r.set_gait(name))

    def walk() -> None:
        if gait.value == STAND:
            gait.value = "walk"
        else:
            do(lambda r: r.set_gait(gait.value))

    def stand_up() -> None:
        # a gait that is chosen again makes the robot walk again
        gait.value = STAND
        do(lambda r: r.stand_up())

    acts: dict[str, Callable[[], None]] = {}
    for name, label, act in (
        ("walk", "walk", walk),
        ("stand", "stand up", stand_up),
        ("relax", "relax", lambda: do(lambda r: r.request(Request.RELAX))),
        (
            "reset",
            "reset e-stop or fault",
            lambda: do(lambda r: r.request(Request.RESET)),
        ),
    ):
        acts[f"{label} ({keys.bind(KEY_OF[name], label, act)})"] = act
    *moves, reset = acts
    for label, options in ("operator", moves), ("after a stop", [reset]):
        asked = gui.add_button_group(label, options)
        asked.on_click(lambda event: acts[event.target.value]())
    most = np.max([each.speeds for each in gaits.gaits.values()], axis=0)
    speeds = [
        _slider(gui, label, (-top, top), 0.005, 0.0)
        for label, top in zip(
            ("v_x (m/s)", "v_y (m/s)", "yaw rate (rad/s)"),
            np.ceil(200 * most) / 200,
        )
    ]
    for speed in speeds:
        speed.on_update(lambda _: do(lambda r: r.set_velocity(_values(speeds))))
    pose = _add_pose(gui, do)
    for sliders, bound in (speeds, VELOCITY_KEYS), (pose, POSE_KEYS):
        for key, (meaning, step) in bound.items():
            keys.bind(key, meaning, partial(_nudge, sliders, step))


def _nudge(sliders: Sequence[Any], step: Step) -> None:
    """Move the slider that has a sign by a share of its range; all to zero if none has."""
    for slider, sign in zip(sliders, step):
        wanted = slider.value + sign * KEY_SHARE * (slider.max - slider.min) / 2
        if not any(step):
            slider.value = 0.0
        elif sign:
            slider.value = min(max(wanted, slider.min), slider.max)


def add_policy(
    gui: viser.GuiApi, do: Do[PlayedRobot], keys: Keys, start: str
) -> None:
    """The policy, which a key changes too."""
    policy: Any = gui.add_dropdown(
        "policy", tuple(POLICIES), initial_value=start
    )
    _bind(do, policy, lambda r, name: r.set_policy(name))
    following = dict(zip(policy.options, policy.options[1:]))

    def change() -> None:
        policy.value = following.get(policy.value, policy.options[0])

    keys.bind("y", "next policy", change)


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

    def moved(_: object) -> None:
        own.value = False
        do(take)

    own.on_update(lambda _: do(take))
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
    for slider in friction:
        _bind(
            do,
            slider,
            lambda r, _: r.change(
                {"scene.floor.friction": _values(friction).tolist()}
            ),
        )
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

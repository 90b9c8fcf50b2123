"""Curves and states of a run over time, for a viewer, from the messages of the graph.

The messages may be rclpy's or those that the `rosbags` library reads from a bag.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.control.policy import Status
from slot_core.drawing import palette
from slot_core.geometry import rotate, rpy_of
from slot_core.messages import decode
from slot_core.robot import GRAVITY, LEGS

Values: TypeAlias = dict[str, Array]
States: TypeAlias = dict[str, str]


@dataclass(frozen=True)
class Curve:
    """Curves of one quantity from one source: name and colour of each."""

    names: tuple[str, ...]
    colours: tuple[str, ...]


@dataclass(frozen=True)
class Plot:
    """Curves that share their axes, by the second part of the names of `values`."""

    title: str
    curves: dict[str, Curve]


def _of_legs(suffix: str, *, pale: bool = False) -> Curve:
    return Curve(
        tuple(f"{leg} {suffix}" for leg in LEGS),
        tuple(
            palette.LEG_COLOURS[leg] + ("70" if pale else "") for leg in LEGS
        ),
    )


SOURCES = {
    "true": Curve(("true",), (palette.TRUE,)),
    "estimated": Curve(("estimated",), (palette.INK,)),
    "reference": Curve(("reference",), (palette.SECONDARY,)),
}
"""Curves of a quantity of the torso."""
PLOTS = {
    "velocity": Plot("v_x (m/s)", SOURCES),
    "height": Plot("height (mm)", SOURCES),
    "roll": Plot("roll (deg)", SOURCES),
    "pitch": Plot("pitch (deg)", SOURCES),
    "angle": Plot(
        "tendon angle (deg)",
        {
            "measured": _of_legs("measured"),
            "commanded": _of_legs("commanded", pale=True),
        },
    ),
    "force": Plot(
        "vertical force (N)",
        {
            "ground": _of_legs("ground"),
            "demanded": _of_legs("demanded", pale=True),
        },
    ),
    "tension": Plot("tendon tension (N)", {"simulated": _of_legs("simulated")}),
    "disturbance": Plot(
        "disturbances found",
        {
            "mpc": Curve(
                (
                    "load (100 g)",
                    "slip x (cm/s)",
                    "slip y (cm/s)",
                    "turn (deg/s)",
                ),
                (palette.INK, *list(palette.LEG_COLOURS.values())[:3]),
            )
        },
    ),
    "solve_time": Plot(
        "solve time of the MPC (ms)",
        {"mpc": Curve(("solve time",), (palette.INK,))},
    ),
}
STATES = {"supervisor": "supervisor", "mpc": "MPC", "gait": "gait"}
"""Titles by key of `states`."""


def values(topic: str, message: Any) -> Values:
    """Values (n,) of curves by `plot/curve`; none of a topic that has no curve."""
    return _VALUES[topic](message) if topic in _VALUES else {}


def states(topic: str, message: Any) -> States:
    """Names of states by a key of STATES; none of a topic that has no state."""
    return _STATES[topic](message) if topic in _STATES else {}


def _torso(
    source: str, forward: float, height: float, roll: float, pitch: float
) -> Values:
    scaled = {
        "velocity": forward,
        "height": 1e3 * height,
        "roll": math.degrees(roll),
        "pitch": math.degrees(pitch),
    }
    return {
        f"{name}/{source}": np.array([value]) for name, value in scaled.items()
    }


def _of_truth(message: Any) -> Values:
    _, position, quaternion, velocity, *_ = decode.odometry(message)
    rotation = Rotation.from_quat(quaternion)
    roll, pitch, yaw = rpy_of(rotation.as_matrix())
    return _torso(
        "true",
        rotate(rotation.apply(velocity)[:2], -yaw)[0],
        position[2],
        roll,
        pitch,
    )


def _of_state(source: str, x: Array) -> Values:
    """Values of the twelve states (12,)."""
    return _torso(source, rotate(x[9:11], -x[2])[0], x[5], x[0], x[1])


def _of_legs_truth(message: Any) -> Values:
    _, tension, force, *_ = decode.legs(message)
    return {"force/ground": force[:, 2], "tension/simulated": tension}


def disturbances(wrench: Array, drift: Array) -> Array:
    """Disturbances (4, ...) in the units of their plot, from wrench and drift (3, ...)."""
    return np.array(
        [
            -10.0 * wrench[0] / GRAVITY,
            *(100.0 * drift[:2]),
            np.degrees(drift[2]),
        ]
    )


def _of_plan(message: Any) -> Values:
    return {
        "disturbance/mpc": disturbances(
            np.array(message.wrench), np.array(message.drift)
        ),
        "force/demanded": decode.plan(message)[1].force[0, :, 2],
        "solve_time/mpc": np.array([1e3 * message.solve_time]),
    }


def _angle(source: str) -> Callable[[Any], Values]:
    return lambda message: {
        f"angle/{source}": np.degrees(decode.joint_angles(message)[1])
    }


_VALUES: dict[str, Callable[[Any], Values]] = {
    "/ground_truth/odom": _of_truth,
    "/ground_truth/legs": _of_legs_truth,
    "/mpc_state": lambda message: _of_state(
        "estimated", decode.estimate(message).state
    ),
    "/gait_preview": lambda message: _of_state(
        "reference", decode.preview(message).reference[0]
    ),
    "/tendon_plan": _of_plan,
    "/joint_states": _angle("measured"),
    "/desired_joint_angles": _angle("commanded"),
}
_STATES: dict[str, Callable[[Any], States]] = {
    "/robot_state": lambda message: {
        "supervisor": decode.robot_state(message)[1].name
    },
    "/tendon_plan": lambda message: {"mpc": Status(message.status).name},
    "/gait_preview": lambda message: {"gait": message.gait},
}
TOPICS = tuple({**_VALUES, **_STATES})

"""Text of the page on the robot: state, speed, disturbances in units that a hand knows."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slot_core.arrays import Array
from slot_core.control.policy import Status
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_core.rollout_mpc.settings import read_rollout_mpc
from slot_core.safety.states import RELEASED, Action, State
from slot_lab.play.played_robot import FRAME

SMOOTHING = 0.1  # weight of the newest cost
STYLE = "height:15em;overflow:auto;font-size:0.875em;line-height:1.4em;padding:0.5em"
ALARM = "color:#C00000"  # of a state in which the tendons are slack for a fault or a request
STATES = {
    State.IDLE: "no torque",
    State.READY: "under torque, at rest",
    State.STANDING: "follows the policy",
    State.WALKING: "follows the policy",
    State.HOLD: "the legs keep their angles until the reason is gone",
    State.RELAX: "the tendons slacken",
    State.ESTOP: "no torque until it is reset",
    State.FAULT: "no torque until it is reset",
}
PLANS = {
    Status.SOLVED: "the plan follows its model",
    Status.NOT_SOLVED: "no plan was found, the last one goes on",
    Status.LATE: "the plan came too late, the last one goes on",
    Status.REJECTED: "the input of the plan is refused, the last one goes on",
    Status.STOPPED: "no plan that may be followed",
}
SLOW = 0.95  # share of the wanted speed below which the page says so


@dataclass
class Costs:
    """Mean time of a frame (s) for simulation and controller, and for drawing."""

    robot: float = 0.0
    drawing: float = 0.0

    def add(self, robot: float, drawing: float) -> None:
        """Take the times of a frame, s."""
        self.robot += SMOOTHING * (robot - self.robot)
        self.drawing += SMOOTHING * (drawing - self.drawing)

    def __str__(self) -> str:
        return (
            f"simulation and controller {1e3 * self.robot:.0f} ms, drawing"
            f" {1e3 * self.drawing:.0f} ms of {1e3 * FRAME:.0f} ms"
        )


class StatusText:
    """Lines on a robot, as HTML."""

    def __init__(self) -> None:
        self._mass = read_robot().mass
        # N m/rad
        self._stiffness = np.array(read_rollout_mpc().observer.stiffness[1:])

    def of(
        self,
        newest: Mapping[str, Any],
        position: Array | None,
        remarks: Iterable[str],
    ) -> list[str]:
        """State, place, plan and disturbances by the newest messages; then `remarks`."""
        lines = []
        if (state := newest.get("/robot_state")) is not None:
            _, name, _, reason = decode.robot_state(state)
            style = ALARM if name in RELEASED else ""
            said = f"{STATES[name]}: {reason}".removesuffix(": ")
            lines.append(
                f'<span style="{style}">{strong(name.name)} {escape(said)}</span>'
            )
        if position is not None:
            x, y, z = position
            lines.append(f"x {x:.3f} m, y {y:.3f} m, height {1e3 * z:.1f} mm")
        if (plan := newest.get("/tendon_plan")) is not None and acts(newest):
            said = f"{PLANS[Status(plan.status)]}; {plan.message}"
            lines += [
                escape(said.removesuffix("; ")),
                self.of_disturbances(plan.mass, plan.wrench, plan.drift),
            ]
            remarks = [plan.remark, *remarks]
        return lines + [
            f"<i>{escape(text)}</i>" for text in dict.fromkeys(remarks) if text
        ]

    def of_disturbances(
        self, mass: float, wrench: ArrayLike, drift: ArrayLike
    ) -> str:
        """Disturbances that the policy estimates: payload (kg), tilt (deg), slip (mm/s).

        A note if it estimates none. The tilt follows from the moment and the stiffness of a standing robot.
        """
        if not math.isfinite(mass):
            return "disturbances: none are estimated"
        roll, pitch = np.degrees(np.asarray(wrench)[1:] / self._stiffness)
        x, y = 1e3 * np.asarray(drift)[:2]
        return (
            f"disturbances: payload {mass - self._mass:+.2f} kg,"
            f" tilt {roll:+.1f}, {pitch:+.1f} deg, slip {x:+.0f}, {y:+.0f} mm/s"
        )


def acts(newest: Mapping[str, Any]) -> bool:
    """Whether a policy moves the legs, by the newest state of the supervisor; unknown: no."""
    state = newest.get("/robot_state")
    return state is not None and decode.robot_state(state)[2] is Action.PASS


def block(lines: list[str]) -> str:
    """HTML of lines in a block of constant height, so that the controls below stay in place."""
    return f'<div style="{STYLE}">{"<br>".join(lines)}</div>'


def strong(text: str) -> str:
    """HTML of bold text."""
    return f"<b>{escape(text)}</b>"


def of_speed(factor: float, wanted: float, costs: object) -> str:
    """Line on the speed, over the wall clock's; bold where the machine is too slow."""
    if not math.isfinite(factor):
        return f"speed is being measured; {costs}"
    if factor < SLOW * wanted:
        return strong(
            f"slower than {wanted:.2f} of real time: {factor:.2f}; {costs}"
        )
    return f"{factor:.2f} of real time; {costs}"

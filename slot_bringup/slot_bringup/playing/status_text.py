"""What the page says of the robot: state, speed, disturbances in units of the hand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

import numpy as np

from slot_core.control.policy import PlanReport
from slot_core.predictive.settings import read_predictive
from slot_core.robot import read_robot
from slot_lab.play.played_robot import FRAME, PlayedRobot

SMOOTHING = 0.1  # weight of the newest cost
STYLE = "height:13em;overflow:auto;font-size:0.875em;line-height:1.4em;padding:0.5em"
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
    """Lines on a played robot, as HTML."""

    def __init__(self) -> None:
        self._mass = read_robot().mass
        self._stiffness = np.array(read_predictive().observer.stiffness[1:])  # N m/rad

    def of_robot(self, robot: PlayedRobot, said: str) -> list[str]:
        """State, reason, motion, plan, disturbances, and what is refused or `said`."""
        if robot.ended:
            return [strong(f"{robot.ended}: reset")]
        report, lines = robot.loop.report, list[str]()
        if report is not None:
            lines.append(f"{strong(report.state.name)} {escape(report.reason)}")
        if robot.tick is not None and robot.truth is not None:
            x, y, z = robot.truth.odometry.position
            lines.append(f"t {robot.time:.1f} s, x {x:.3f} m, y {y:.3f} m, height {1e3 * z:.1f} mm")
            plan = robot.tick.plan
            lines.append(escape(f"{plan.status.name} {plan.message}"))
            lines.append(self.of_disturbances(plan.report))
            remarks = robot.tick.preview.remark, robot.loop.refusal, said
            lines += [f"<i>{escape(text)}</i>" for text in dict.fromkeys(remarks) if text]
        return lines

    def of_disturbances(self, found: PlanReport) -> str:
        """What the policy has found: payload in kg, tilt in deg, slip in mm/s; or that it does not.

        The tilt is that by which the moment would turn the robot as it stands.
        """
        if not math.isfinite(found.mass):
            return "disturbances: none are estimated"
        roll, pitch = np.degrees(found.wrench[1:] / self._stiffness)
        x, y = 1e3 * found.drift[:2]
        return (
            f"disturbances: payload {found.mass - self._mass:+.2f} kg,"
            f" tilt {roll:+.1f}, {pitch:+.1f} deg, slip {x:+.0f}, {y:+.0f} mm/s"
        )


def block(lines: list[str]) -> str:
    """HTML of lines in a block of constant height, so that the controls below stay in place."""
    return f'<div style="{STYLE}">{"<br>".join(lines)}</div>'


def strong(text: str) -> str:
    """HTML of bold text."""
    return f"<b>{escape(text)}</b>"


def of_speed(factor: float, wanted: float, costs: Costs) -> str:
    """Line on the speed, over the wall clock's; bold where the machine is too slow."""
    if not math.isfinite(factor):
        return f"speed is being measured; {costs}"
    if factor < SLOW * wanted:
        return strong(f"slower than {wanted:.2f} of real time: {factor:.2f}; {costs}")
    return f"{factor:.2f} of real time; {costs}"

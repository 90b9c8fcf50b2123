"""Diagnostics of supervisor, controller and state estimator, with servos on a bus or without."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from slot_core.clock import SECOND
from slot_core.control.policy import Status
from slot_core.estimation.estimate import Validity
from slot_core.safety.states import RELEASED, State
from slot_msgs.msg import TendonPlan
from slot_nodes import messages, qos, runtime
from slot_nodes.diagnostics import number, status

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.safety.supervisor import Report

PERIOD = 1.0  # s, between two reports without change
INCLINE_SIGMA = math.radians(1.0)  # rad, from which on the incline is not known
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
OF_PLAN = {Status.SOLVED: OK, Status.STOPPED: ERROR}
OF_ESTIMATE = {Validity.VALID: OK, Validity.ODOMETRY_LOST: ERROR}
PLAN_NAMES = {int(found): found.name for found in Status}


class GraphDiagnostics:
    """Publishes a node's diagnostics every PERIOD, and at once when their key changes."""

    def __init__(self, node: Node) -> None:
        self._publisher = runtime.publisher(
            node, DiagnosticArray, "diagnostics", qos.SENSOR
        )
        self._last: tuple[Hashable, int] | None = None  # key, and ns of the message

    def publish(
        self,
        stamp: int,
        make: Callable[[], list[DiagnosticStatus]],
        key: Hashable = None,
    ) -> None:
        """Publish the status of `make` at `stamp` (ns) if it is due."""
        if self._last is not None:
            last, time = self._last
            if key == last and 0 <= stamp - time < PERIOD * SECOND:
                return
        self._last = key, stamp
        found = DiagnosticArray(header=messages.header(stamp, ""), status=make())
        self._publisher.publish(found)


class SupervisorDiagnostics:
    """Diagnostics of the supervisor's reports, and of the newest plan that it has received."""

    def __init__(self, node: Node, mass: float) -> None:
        """mass: of the nominal robot, kg."""
        self._diagnostics, self._mass = GraphDiagnostics(node), mass
        self.plan: TendonPlan | None = None
        self._counted = TendonPlan()  # with the overruns of the last message

    def publish(self, stamp: int, report: Report) -> None:
        """Publish the diagnostics at `stamp` (ns) if they are due; at once in a new state."""
        self._diagnostics.publish(stamp, partial(self._describe, report), report.state)

    def with_remark(self, report: Report) -> Report:
        """The report, whose warnings also name a command that the gait follows in part only."""
        if self.plan is None or not self.plan.remark:
            return report
        return replace(report, warnings=(*report.warnings, self.plan.remark))

    def _describe(self, report: Report) -> list[DiagnosticStatus]:
        if (plan := self.plan) is None:
            return [of_supervisor(report)]
        before, self._counted = self._counted, plan
        passed = plan.overruns - before.overruns, plan.skipped - before.skipped
        controller = of_controller(plan, passed)
        return [of_supervisor(report), controller, of_disturbances(plan, self._mass)]


def of_supervisor(report: Report) -> DiagnosticStatus:
    """State, reason, and the conditions that forbid motion."""
    level = ERROR if report.state in RELEASED else OK
    if report.state is State.HOLD or (report.warnings and level == OK):
        level = WARN
    return status(
        "supervisor",
        level,
        f"{report.state.name}: {report.reason}",
        action=report.action.value,
        conditions="; ".join(report.warnings),
        slack_mm=_numbers(1e3 * report.slack),
    )


def of_controller(plan: TendonPlan, passed: tuple[int, int]) -> DiagnosticStatus:
    """How the newest plan was made; `passed`: overruns and skipped states since the last report."""
    overruns, skipped = passed
    level = OF_PLAN.get(plan.status, WARN)
    name = PLAN_NAMES.get(plan.status, f"status {plan.status}")  # of another version
    message = f"{name} {plan.message}".rstrip()
    if level == OK and any(passed):
        level, message = WARN, f"{overruns} cycles too long, {skipped} states skipped"
    return status(
        "controller",
        level,
        message,
        fallback_cycles=str(plan.fallback_cycles),
        overruns=str(plan.overruns),
        skipped=str(plan.skipped),
        solve_time_ms=number(1e3 * plan.solve_time),
        changed_settings=plan.settings,
    )


def of_disturbances(plan: TendonPlan, mass: float) -> DiagnosticStatus:
    """Disturbances that the policy estimates, payload beyond `mass` (kg); "": not estimated."""
    known = (
        1.0 if math.isfinite(plan.mass) else math.nan
    )  # else the policy plans nothing now
    vertical, *moment = known * np.array(plan.wrench)
    slip, turn = (
        1e3 * known * np.array(plan.drift[:2]),
        known * math.degrees(plan.drift[2]),
    )
    return status(
        "disturbances",
        OK,
        f"payload {number(plan.mass - mass)} kg, slip {number(float(np.hypot(*slip)))} mm/s",
        payload_kg=number(plan.mass - mass),
        slip_mm_s=_numbers(slip),
        turn_deg_s=number(turn),
        force_N=number(vertical),
        moment_N_m=_numbers(moment),
    )


def _numbers(values: Iterable[float]) -> str:
    """Numbers, or "" if none is known."""
    return ", ".join(filter(None, map(number, values)))


def of_estimator(validity: Validity, incline: tuple[float, float]) -> DiagnosticStatus:
    """Validity of the newest estimate, and the incline of the floor where it is known.

    incline: angle and standard deviation, rad.
    """
    angle, sigma = incline
    known = sigma < INCLINE_SIGMA
    return status(
        "state estimator",
        OF_ESTIMATE.get(validity, WARN),
        validity.name,
        incline_deg=number(math.degrees(angle) if known else None),
        incline_sigma_deg=number(math.degrees(sigma) if known else None),
    )

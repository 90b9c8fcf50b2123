"""Reports of a node's state: diagnostics of graph and servos, and the health of the servos."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from slot_core.clock import SECOND
from slot_core.control.policy import Status
from slot_core.elementary import atan2
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.faults import hardware_errors
from slot_core.matrices import norm
from slot_core.safety.states import RELEASED, State
from slot_msgs.msg import ServoHealth, TendonPlan
from slot_nodes import messages, qos, runtime

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.safety.supervisor import Report
    from slot_core.servos.servo_bus import Cycle, ServoStatus
    from slot_core.servos.session import BusPace, ServoSession
    from slot_core.simulation.simulated_servos import DirectServos

PERIOD = 1.0  # s, between two diagnostics without change
HEALTH_PERIOD = 0.05  # s, between two reports of the servos without change
ERROR_RATE_WARNING = 0.05  # share of exchanges that failed
INCLINE_SIGMA = math.radians(1.0)  # rad, from which on the incline is not known
OK, WARN, ERROR = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
)
OF_PLAN = {Status.SOLVED: OK, Status.STOPPED: ERROR}
OF_ESTIMATE = {Validity.VALID: OK, Validity.ODOMETRY_LOST: ERROR}
PLAN_NAMES = {int(found): found.name for found in Status}


class PeriodicReport:
    """Publisher of a report every `period`, and at once when its key changes."""

    def __init__(
        self, node: Node, kind: type, topic: str, period: float
    ) -> None:
        """period: s."""
        self._publisher = runtime.publisher(node, kind, topic, qos.SENSOR)
        self._period = period
        # key, and ns of the message
        self._last: tuple[Hashable, int] | None = None

    def publish(
        self, stamp: int, make: Callable[[], Any], key: Hashable = None
    ) -> None:
        """Publish the message of `make` if it is due at `stamp` (ns), or the clock went back."""
        if self._last is not None:
            last, time = self._last
            if key == last and 0 <= stamp - time < self._period * SECOND:
                return
        self._last = key, stamp
        self._publisher.publish(make())


class DiagnosticReport(PeriodicReport):
    """Report on `/diagnostics`."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, DiagnosticArray, "diagnostics", PERIOD)


class HealthReport(PeriodicReport):
    """Report on `/servo_health`."""

    def __init__(self, node: Node, servos: ServoSession | DirectServos) -> None:
        super().__init__(node, ServoHealth, "servo_health", HEALTH_PERIOD)
        self._servos = servos

    def publish_health(self, stamp: int) -> None:
        """Publish the health of the servos if it is due at `stamp` (ns)."""
        self.publish(stamp, partial(self._make, stamp), self._servos.urgent)

    def _make(self, stamp: int) -> ServoHealth:
        return messages.health_to_msg(stamp, self._servos.health(stamp))


class SupervisorDiagnostics:
    """Diagnostics of the supervisor's reports, and of the newest plan that it has received."""

    def __init__(self, node: Node, mass: float) -> None:
        """mass: of the nominal robot, kg."""
        self._diagnostics, self._mass = DiagnosticReport(node), mass
        self.plan: TendonPlan | None = None
        self._counted = TendonPlan()  # with the overruns of the last message

    def publish(self, stamp: int, report: Report) -> None:
        """Publish the diagnostics at `stamp` (ns) if they are due; at once in a new state."""
        self._diagnostics.publish(
            stamp, partial(self._describe, stamp, report), report.state
        )

    def with_remark(self, report: Report) -> Report:
        """The report, whose warnings also name a command that the gait follows in part only."""
        if self.plan is None or not self.plan.remark:
            return report
        return replace(report, warnings=(*report.warnings, self.plan.remark))

    def _describe(self, stamp: int, report: Report) -> DiagnosticArray:
        if (plan := self.plan) is None:
            return array(stamp, [of_supervisor(report)])
        before, self._counted = self._counted, plan
        passed = plan.overruns - before.overruns, plan.skipped - before.skipped
        return array(
            stamp,
            [
                of_supervisor(report),
                of_controller(plan, passed),
                of_disturbances(plan, self._mass),
            ],
        )


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


def of_controller(
    plan: TendonPlan, passed: tuple[int, int]
) -> DiagnosticStatus:
    """How the newest plan was made; `passed`: overruns and skipped states since the last report."""
    overruns, skipped = passed
    level = OF_PLAN.get(plan.status, WARN)
    # of another version
    name = PLAN_NAMES.get(plan.status, f"status {plan.status}")
    message = f"{name} {plan.message}".rstrip()
    if level == OK and any(passed):
        level, message = (
            WARN,
            f"{overruns} cycles too long, {skipped} states skipped",
        )
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
    # else the policy plans nothing now
    known = 1.0 if math.isfinite(plan.mass) else math.nan
    vertical, *moment = known * np.array(plan.wrench)
    slip = 1e3 * known * np.array(plan.drift[:2])
    turn = known * math.degrees(plan.drift[2])
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


def of_estimator(
    estimate: Estimate, incline: tuple[float, float]
) -> DiagnosticStatus:
    """Validity of the newest estimate, floor and legs, and the incline where it is known.

    incline: angle and standard deviation, rad.
    """
    angle, sigma = incline
    known = sigma < INCLINE_SIGMA
    name = f"{estimate.validity.name} {estimate.message}".strip()
    tilt = atan2(norm(estimate.floor.normal[:2]), estimate.floor.normal[2])
    return status(
        "state estimator",
        OF_ESTIMATE.get(estimate.validity, WARN),
        name,
        floor_height=number(estimate.floor.height),
        floor_tilt_deg=number(math.degrees(tilt)),
        leg_stiffness=number(estimate.leg_stiffness),
        incline_deg=number(math.degrees(angle) if known else None),
        incline_sigma_deg=number(math.degrees(sigma) if known else None),
    )


def of_servos(
    stamp: int, session: ServoSession, pace: BusPace, cycle: Cycle | None
) -> DiagnosticArray:
    """One status for the bus and one for each servo, at `stamp` (ns)."""
    silent, servos = session.silent(), session.bus.health
    readings = cycle.readings if cycle is not None else (None,) * len(servos)
    loads = [None if reading is None else reading.load for reading in readings]
    active = session.bus.active
    found = [
        _servo(s, active, silent.get(s.leg, ""), load)
        for s, load in zip(servos, loads)
    ]
    bus = status(
        "servo bus",
        ERROR if session.watchdog.overdue else OK,
        session.reason or "commands pass",
        action=session.action.value,
        rate_Hz=f"{pace.rate:.1f}",
        cycle_mean_ms=f"{1e3 * pace.mean:.2f}",
        cycle_longest_ms=f"{1e3 * pace.longest:.2f}",
        overruns=str(pace.overruns),
    )
    message = array(stamp, [bus, *found])
    for found_status in message.status:
        found_status.hardware_id = session.bus.facts.brand
    return message


def _servo(
    health: ServoStatus, active: bool, silent: str, load: float | None
) -> DiagnosticStatus:
    faults = [*health.faults(active), *filter(None, [silent])]
    level = ERROR if faults else OK
    if not faults and health.error_rate > ERROR_RATE_WARNING:
        level = WARN
    errors = health.hardware_error
    return status(
        health.name,
        level,
        "; ".join(faults) or "sound",
        temperature_C=number(health.temperature),
        voltage_V=number(health.voltage),
        load_share=number(load),
        torque={None: "", True: "on", False: "off"}[health.torque],
        hardware_errors="" if errors is None else hardware_errors(errors),
        error_rate=f"{health.error_rate:.4f}",
    )


def status(
    name: str, level: bytes, message: str, **values: str
) -> DiagnosticStatus:
    """One status with its values."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(
        level=level, name=name, message=message, values=pairs
    )


def array(stamp: int, statuses: list[DiagnosticStatus]) -> DiagnosticArray:
    """Message of several statuses at `stamp` (ns)."""
    return DiagnosticArray(header=messages.header(stamp, ""), status=statuses)


def number(value: float | None) -> str:
    """Three significant digits; "" if the value is not known."""
    return "" if value is None or math.isnan(value) else f"{value:.3g}"


def _numbers(values: Iterable[float]) -> str:
    """Numbers, or "" if none is known."""
    return ", ".join(filter(None, map(number, values)))

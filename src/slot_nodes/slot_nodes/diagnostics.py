"""Diagnostics of the servos and their bus."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from slot_core.faults import hardware_errors
from slot_nodes import messages

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.servos.servo_bus import Cycle, ServoStatus
    from slot_core.servos.session import BusPace, ServoSession

ERROR_RATE_WARNING = 0.05  # share of exchanges that failed


def to_msg(
    stamp: int, session: ServoSession, pace: BusPace, cycle: Cycle | None
) -> DiagnosticArray:
    """One status for the bus and one for each servo, at `stamp` (ns)."""
    silent, servos = session.silent(), session.bus.health
    readings = cycle.readings if cycle is not None else (None,) * len(servos)
    loads = [None if reading is None else reading.load for reading in readings]
    active = session.bus.active
    found = [
        _servo(s, active, silent.get(s.leg, ""), load) for s, load in zip(servos, loads)
    ]
    array = DiagnosticArray(
        header=messages.header(stamp, ""), status=[_bus(session, pace), *found]
    )
    for found_status in array.status:
        found_status.hardware_id = session.bus.facts.brand
    return array


def _bus(session: ServoSession, pace: BusPace) -> DiagnosticStatus:
    level = DiagnosticStatus.ERROR if session.watchdog.overdue else DiagnosticStatus.OK
    return status(
        "servo bus",
        level,
        session.reason or "commands pass",
        action=session.action.value,
        rate_Hz=f"{pace.rate:.1f}",
        cycle_mean_ms=f"{1e3 * pace.mean:.2f}",
        cycle_longest_ms=f"{1e3 * pace.longest:.2f}",
        overruns=str(pace.overruns),
    )


def _servo(
    health: ServoStatus, active: bool, silent: str, load: float | None
) -> DiagnosticStatus:
    faults = [*health.faults(active), *filter(None, [silent])]
    level = DiagnosticStatus.ERROR if faults else DiagnosticStatus.OK
    if not faults and health.error_rate > ERROR_RATE_WARNING:
        level = DiagnosticStatus.WARN
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


def status(name: str, level: bytes, message: str, **values: str) -> DiagnosticStatus:
    """One status with its values."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=message, values=pairs)


def number(value: float | None) -> str:
    """Three significant digits; "" if the value is not known."""
    return "" if value is None or math.isnan(value) else f"{value:.3g}"

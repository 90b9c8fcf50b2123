"""Diagnostics: conditions, overruns, fallbacks, disturbances and servos; when they are published."""

import math
import types
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.floor_observer import FloorPlane
from slot_core.robot import LEGS
from slot_core.safety.states import Action, State
from slot_core.servos.servo_bus import ServoStatus
from slot_core.servos.session import BusPace
from slot_msgs.msg import TendonPlan
from slot_nodes import diagnostics, runtime

OK, WARN, ERROR = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
)


@pytest.fixture(scope="module")
def rig(simulate):
    return simulate(hardware="sim")


def newest(rig, begin):
    """Newest status of each name since a time, with its values by key."""
    found = [
        status for m in rig.since("/diagnostics", begin) for status in m.status
    ]
    return {
        s.name: (s.level, s.message, {v.key: v.value for v in s.values})
        for s in found
    }


def test_a_walking_robot_is_reported_once_a_second(walking):
    walking.run(1.0)
    begin = walking.now()
    walking.run(5.0)
    reports = walking.since("/diagnostics", begin)
    # of supervisor and state estimator
    assert len(reports) == pytest.approx(2 * 5, abs=2)
    found = newest(walking, begin)
    assert set(found) == {
        "supervisor",
        "controller",
        "disturbances",
        "state estimator",
    }
    assert {level for level, *_ in found.values()} == {OK}
    assert found["supervisor"][1].startswith("WALKING: ")
    assert found["controller"][2]["fallback_cycles"] == "0"
    assert abs(float(found["disturbances"][2]["payload_kg"])) < 0.1
    assert abs(float(found["state estimator"][2]["incline_deg"])) < 1.0


def test_a_lost_estimate_and_a_fault_are_reported_at_once(walking):
    begin = walking.pause("state_estimator")
    held, _ = walking.wait_for_state(State.HOLD, begin)
    level, message, values = newest(walking, held)["supervisor"]
    assert level == WARN
    assert message.startswith("HOLD: ")
    assert "no command for " in values["conditions"]
    relaxed, reason = walking.wait_for_state(State.RELAX, begin)
    assert newest(walking, relaxed)["supervisor"][:2] == (
        ERROR,
        f"RELAX: {reason}",
    )
    walking.resume("state_estimator")


@pytest.mark.parametrize(
    ("changes", "passed", "level", "message"),
    [
        ({}, (0, 0), OK, "SOLVED"),
        ({}, (2, 1), WARN, "2 cycles too long, 1 states skipped"),
        (
            {"status": TendonPlan.LATE, "message": "30 ms"},
            (0, 0),
            WARN,
            "LATE 30 ms",
        ),
        (
            {"status": TendonPlan.STOPPED, "message": "used up"},
            (9, 0),
            ERROR,
            "STOPPED used up",
        ),
        ({"status": 9}, (0, 0), WARN, "status 9"),
    ],
)
def test_overruns_and_fallbacks_of_the_controller_are_reported(
    changes, passed, level, message
):
    status = diagnostics.of_controller(TendonPlan(**changes), passed)
    assert (status.level, status.message) == (level, message)


def test_disturbances_are_in_plain_units_and_empty_where_they_are_unknown():
    plan = TendonPlan(
        mass=2.3, drift=[0.03, -0.04, 0.1], wrench=[-2.94, 0.0, 0.1]
    )
    status = diagnostics.of_disturbances(plan, 2.0)
    assert status.message == "payload 0.3 kg, slip 50 mm/s"
    assert {v.key: v.value for v in status.values}["slip_mm_s"] == "30, -40"
    unknown = diagnostics.of_disturbances(TendonPlan(mass=math.nan), 2.0)
    assert {v.value for v in unknown.values} == {""}


@pytest.mark.parametrize(
    ("validity", "level"),
    [
        (Validity.VALID, OK),
        (Validity.IMU_MISSING, WARN),
        (Validity.ODOMETRY_LOST, ERROR),
    ],
)
def test_the_estimator_reports_floor_and_legs_and_the_incline_where_it_is_known(
    validity, level
):
    estimate = replace(
        Estimate.exact(np.zeros(12)),
        validity=validity,
        leg_stiffness=0.8,
        message="a line",
        floor=FloorPlane(-0.04, np.array([0.6, 0.0, 0.8])),
    )
    known = diagnostics.of_estimator(estimate, (0.1, 0.01))
    assert (known.level, known.message) == (level, f"{validity.name} a line")
    assert [v.value for v in known.values] == [
        "-0.04",
        "36.9",
        "0.8",
        "5.73",
        "0.573",
    ]
    vague = diagnostics.of_estimator(estimate, (0.1, 0.1))
    assert [v.value for v in vague.values][3:] == ["", ""]


@pytest.mark.parametrize("silent", LEGS)
def test_a_silent_servo_is_an_error_of_that_servo_alone(silent):
    health = [ServoStatus(leg, 1) for leg in LEGS]  # all with one id
    session = types.SimpleNamespace(
        bus=types.SimpleNamespace(
            health=health, active=False, facts=types.SimpleNamespace(brand="")
        ),
        watchdog=types.SimpleNamespace(overdue=False),
        silent=lambda: {silent: "the line of its silence"},
        reason="",
        action=Action.PASS,
    )
    message = diagnostics.of_servos(
        0, session, BusPace(100.0, 0.01, 0.01, 0), None
    )
    found = [(status.level, status.message) for status in message.status[1:]]
    sound = (OK, "sound")
    broken = (ERROR, "the line of its silence")
    assert found == [broken if leg == silent else sound for leg in LEGS]


def test_a_report_comes_every_period_at_a_change_and_when_the_clock_went_back(
    monkeypatch,
):
    published = []
    publisher = types.SimpleNamespace(publish=published.append)
    monkeypatch.setattr(runtime, "publisher", lambda *_: publisher)
    report = diagnostics.PeriodicReport(None, None, "", 0.05)
    begin, period = 500_000_000, 50_000_000  # ns
    wanted = {
        begin: "hold",
        begin + period - 2: "pass",
        begin + 2 * period - 2: "pass",
        begin - period: "pass",
    }
    for stamp, key in wanted.items():
        for later in (0, 1):  # the second is not due
            report.publish(stamp + later, lambda stamp=stamp: stamp, key)
    assert published == list(wanted)

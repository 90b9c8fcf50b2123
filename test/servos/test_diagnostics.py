"""Diagnostics of the servos: what is wrong with one servo is said of that servo."""

import types

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from slot_core.robot import LEGS
from slot_core.safety.states import Action
from slot_core.servos.servo_bus import ServoStatus
from slot_core.servos.session import BusPace
from slot_nodes import diagnostics


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
    message = diagnostics.to_msg(0, session, BusPace(100.0, 0.01, 0.01, 0), None)
    found = [(status.level, status.message) for status in message.status[1:]]
    sound = (DiagnosticStatus.OK, "sound")
    broken = (DiagnosticStatus.ERROR, "the line of its silence")
    assert found == [broken if leg == silent else sound for leg in LEGS]

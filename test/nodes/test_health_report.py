"""The health of the servos is published at every change, and every 50 ms."""

import types

import numpy as np

from slot_core.clock import SECOND
from slot_core.safety.states import Action
from slot_core.safety.watchdog import ServoHealth
from slot_nodes import health_publisher, runtime

PERIOD = round(health_publisher.PERIOD * SECOND)  # ns


class Servos:
    """Servos whose reports are counted."""

    def __init__(self):
        self.urgent = (Action.HOLD,)
        self.built = 0

    def health(self, stamp):
        self.built += 1
        return ServoHealth(self.urgent[0], "", np.ones(4, dtype=bool), np.zeros(4))


def test_a_report_is_built_only_when_it_is_published(monkeypatch):
    published = []
    publisher = types.SimpleNamespace(publish=published.append)
    monkeypatch.setattr(runtime, "publisher", lambda *_: publisher)
    report = health_publisher.HealthPublisher(None)
    servos, start = Servos(), 10 * PERIOD
    report.publish(start, servos)
    for later in range(2_000_000, PERIOD, 2_000_000):
        report.publish(start + later, servos)
    assert (servos.built, len(published)) == (1, 1)
    servos.urgent = (Action.PASS,)
    report.publish(start + PERIOD - 1, servos)
    report.publish(start + 2 * PERIOD - 2, servos)
    assert (servos.built, len(published)) == (2, 2)
    report.publish(start + 2 * PERIOD - 1, servos)
    assert (servos.built, len(published)) == (3, 3)
    report.publish(start, servos)  # the clock was set back
    report.publish(start + PERIOD - 1, servos)
    report.publish(start + PERIOD, servos)
    assert (servos.built, len(published)) == (5, 5)

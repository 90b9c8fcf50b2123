"""What the servos are told between the supervisor's word, the commands and their silence."""

import numpy as np
import pytest

from slot_core.robot import read_robot
from slot_core.safety.command_gate import Action
from slot_core.safety.command_watchdog import CommandWatchdog, Word
from slot_core.safety.settings import read_supervisor

SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
TICK = 10_000_000  # ns
START = np.full(4, 1.0)
COMMAND = np.full(4, 1.2)


class Bench:
    """A watchdog that hears a word and a command every 10 ms unless told otherwise."""

    def __init__(self):
        self.watchdog = CommandWatchdog(SETTINGS, read_robot().tendon.angle_max)
        self.watchdog.engage(START)
        self.now = 0

    def run(self, seconds, word=Action.PASS, command=COMMAND, fast=True):
        for _ in range(round(seconds * 1e9 / TICK)):
            self.now += TICK
            if word is not None:
                self.watchdog.permit(Word(self.now, word, fast, "the supervisor's reason"))
            if command is not None:
                self.watchdog.offer(self.now, command)
            self.gated = self.watchdog.step(self.now)
        return self.watchdog.action


@pytest.fixture
def bench():
    return Bench()


def test_without_a_word_nothing_moves_and_nothing_is_let_go(bench):
    assert bench.run(10.0, word=None) is Action.HOLD
    assert bench.watchdog.reason == "no word of the supervisor yet"
    assert (bench.gated.angle == START).all()


def test_without_a_command_nothing_moves_and_nothing_is_let_go(bench):
    assert bench.run(10.0, command=None) is Action.HOLD
    assert bench.watchdog.reason == "no command yet"
    assert bench.gated.torque


@pytest.mark.parametrize("missing", [{"word": None}, {"command": None}])
def test_silence_holds_and_then_relaxes_until_the_word_has_been_off(bench, missing):
    assert bench.run(1.0) is Action.PASS
    assert bench.run(TIMING.command_hold, **missing) is Action.PASS
    assert bench.run(2 * TICK * 1e-9, **missing) is Action.HOLD
    assert bench.run(TIMING.command_lost - TIMING.command_hold, **missing) is Action.RELAX
    assert bench.run(3.0) is Action.RELAX
    assert not bench.gated.torque
    assert bench.run(0.1, Action.OFF) is Action.OFF
    bench.watchdog.engage(START)
    assert bench.run(0.1) is Action.PASS


def test_commands_are_not_missed_under_hold(bench):
    bench.run(0.5)
    assert bench.run(10.0, Action.HOLD, command=None) is Action.HOLD
    assert bench.watchdog.reason == "the supervisor's reason"


def test_a_relaxing_robot_does_not_stop_half_way_for_a_hold(bench):
    bench.run(0.5)
    bench.watchdog.relax("servo FL: overload")
    bench.run(0.1, Action.HOLD)
    assert (bench.watchdog.action, bench.watchdog.reason) == (Action.RELAX, "servo FL: overload")


def test_a_supervisor_that_stops_while_relaxing_does_not_stop_the_relaxing(bench):
    bench.run(0.5)
    bench.run(0.2, Action.RELAX)
    assert bench.run(TIMING.command_hold + 0.02, word=None) is Action.RELAX
    bench.run(SETTINGS.gate.relax_time, word=None)
    assert not bench.gated.torque


def test_standing_is_slow_and_walking_is_fast_but_not_at_once(bench):
    far, gate = np.full(4, 2.0), SETTINGS.gate
    bench.run(0.1, command=START, fast=False)
    bench.run(0.1, command=far, fast=False)
    moved = bench.gated.angle - START
    # ten ticks, of which the first is within what was saved up
    assert moved == pytest.approx(gate.approach_rate * (0.09 + gate.burst), rel=1e-6)
    bench.run(0.02, command=far)
    assert (bench.gated.angle - START - moved < 0.2 * gate.rate_max * 0.02).all()
    bench.run(gate.resume_time, command=far)
    assert bench.gated.angle == pytest.approx(far)
    bench.run(0.02, command=START)  # a budget of burst and two ticks covers the whole step
    assert bench.gated.angle == pytest.approx(START)

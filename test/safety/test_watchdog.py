"""Watchdog: action of the servos from permission, commands and the age of both."""

import numpy as np
import pytest

from slot_core import config
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action
from slot_core.safety.watchdog import Permission, Watchdog

SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
TICK = 10_000_000  # ns
START = np.full(4, 1.0)
COMMAND = np.full(4, 1.2)
STRIDE = np.array([0.3, 2.0, 1.8, 1.2])
LIMITS = SETTINGS.servo_limits


class WatchdogBench:
    """A watchdog with a permission and a command every 10 ms, unless one is None."""

    def __init__(self):
        self.watchdog = Watchdog(read_robot().tendon.angle_max)
        self.watchdog.set_limits(SETTINGS.servo_limits)
        self.watchdog.engage(START)
        self.now = 0

    def run(
        self,
        seconds,
        permission=Action.PASS,
        command=COMMAND,
        fast=True,
        walks=False,
    ):
        for _ in range(round(seconds * 1e9 / TICK)):
            self.now += TICK
            if permission is not None:
                reason = "the supervisor's reason"
                self.watchdog.permit(
                    Permission(self.now, permission, fast, reason, walks=walks)
                )
            if command is not None:
                self.watchdog.offer(self.now, command)
            self.goals = self.watchdog.step(self.now)
        return self.watchdog.action


@pytest.fixture
def bench():
    return WatchdogBench()


@pytest.mark.parametrize(
    ("missing", "reason"),
    [
        ("permission", "no message of the supervisor yet"),
        ("command", "no command yet"),
    ],
)
def test_without_a_permission_or_a_command_nothing_moves_and_torque_stays(
    bench, missing, reason
):
    assert bench.run(10.0, **{missing: None}) is Action.HOLD
    assert bench.watchdog.reason == reason
    assert (bench.goals.angle == START).all()
    assert bench.goals.torque


@pytest.mark.parametrize("missing", [{"permission": None}, {"command": None}])
def test_a_relax_for_want_of_a_message_lasts_until_the_permission_has_been_off(
    bench, missing
):
    assert bench.run(1.0) is Action.PASS
    bench.run(TIMING.command_hold + 2 * TICK * 1e-9, **missing)
    assert bench.watchdog.overdue
    bench.run(TIMING.command_lost - TIMING.command_hold, **missing)
    assert bench.run(3.0) is Action.RELAX
    assert not bench.goals.torque
    assert bench.run(0.1, Action.OFF) is Action.OFF
    bench.watchdog.engage(START)
    assert bench.run(0.1) is Action.PASS


def test_the_age_of_commands_does_not_count_under_hold(bench):
    bench.run(0.5)
    assert bench.run(10.0, Action.HOLD, command=None) is Action.HOLD
    assert bench.watchdog.reason == "the supervisor's reason"


@pytest.mark.parametrize(
    "held",
    [{"permission": Action.HOLD}, {"permission": None}, {"command": None}],
)
def test_in_a_stride_a_hold_moves_all_legs_slowly_to_the_angle_of_standing(
    bench, held
):
    """Also that of the watchdog itself, without the supervisor."""
    bench.run(1.0, command=STRIDE, walks=True)
    while bench.run(TICK * 1e-9, walks=True, **held) is not Action.HOLD:
        pass
    before = bench.goals.angle
    assert bench.run(0.2, walks=True, **held) is Action.HOLD
    moved = LIMITS.gate.approach_rate * 0.2
    assert bench.goals.angle - before == pytest.approx(
        np.clip(LIMITS.standing_angle - before, -moved, moved)
    )


def test_a_hold_keeps_the_angles_of_a_posture_once_it_has_settled(bench):
    for stood, kept in ((0.9, False), (1.1, True)):
        bench.run(1.0, command=STRIDE, walks=True)
        bench.run(stood * LIMITS.settling, command=STRIDE)
        bench.run(1.0, Action.HOLD)
        aim = STRIDE if kept else np.full(4, LIMITS.standing_angle)
        assert bench.goals.angle == pytest.approx(aim)


def test_neither_a_hold_nor_the_supervisors_end_interrupts_a_relax(bench):
    bench.run(0.5)
    bench.watchdog.relax("servo FL: overload")
    assert bench.run(0.1, Action.HOLD) is Action.RELAX
    assert (
        bench.run(TIMING.command_hold + 0.02, permission=None) is Action.RELAX
    )
    assert bench.watchdog.reason == "servo FL: overload"
    bench.run(SETTINGS.gate.relax_time, permission=None)
    assert not bench.goals.torque


def test_goals_move_slowly_while_standing_and_gain_speed_while_walking(bench):
    far, gate = np.full(4, 2.0), SETTINGS.gate
    bench.run(0.1, command=START, fast=False)
    bench.run(0.1, command=far, fast=False)
    moved = bench.goals.angle - START
    # ten ticks, the first of them within the burst
    assert moved == pytest.approx(
        gate.approach_rate * (0.09 + gate.burst), rel=1e-6
    )
    bench.run(0.02, command=far)
    assert (
        bench.goals.angle - START - moved < 0.2 * gate.rate_max * 0.02
    ).all()
    bench.run(gate.resume_time, command=far)
    assert bench.goals.angle == pytest.approx(far)
    # a budget of burst and two ticks covers the whole step
    bench.run(0.02, command=START)
    assert bench.goals.angle == pytest.approx(START)


def test_new_limits_apply_from_the_next_step_without_moving_a_goal(bench):
    bench.run(0.5)
    goal = bench.goals.angle
    slower = config.replace(
        SETTINGS, {"gate.approach_rate": 0.5, "timing.command_hold": 0.05}
    )
    bench.watchdog.set_limits(slower.servo_limits)
    assert bench.run(TICK * 1e-9, Action.HOLD) is Action.HOLD
    assert (bench.goals.angle == goal).all()
    bench.run(0.1, command=START, fast=False)
    moved = goal - bench.goals.angle
    assert moved.max() <= 0.5 * (0.1 + SETTINGS.gate.burst) + 1e-9
    assert bench.run(0.06 + TICK * 1e-9, command=None) is Action.HOLD
    with pytest.raises(config.ConfigError, match=r"gate\.relax_time = 0\.1"):
        bench.watchdog.set_limits(
            config.replace(SETTINGS, {"gate.relax_time": 0.1}).servo_limits
        )
    assert bench.watchdog.limits == slower.servo_limits

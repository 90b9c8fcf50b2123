"""Faults of servos, bus and driver while the whole graph walks on emulated servos."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rig import RAMP, SAG, servo_angle
from std_srvs.srv import SetBool, Trigger

from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_core.safety.states import State


@pytest.fixture(scope="module")
def graph(simulate):
    return simulate(hardware="fake_bus")


@pytest.fixture
def rig(graph):
    """The graph, walking; faults are cleared after the test."""
    graph.walk()
    yield graph
    graph.restore()


LATE = 0.05  # s, from a limit to the reaction: two steps of the supervisor and a bus cycle


def seconds(begin, end):
    return (end - begin) * 1e-9


def errors(rig, since):
    """Lines of /diagnostics with the level ERROR."""
    return [
        f"{status.name}: {status.message}"
        for message in rig.since("/diagnostics", since)
        for status in message.status
        if status.level == DiagnosticStatus.ERROR
    ]


def test_missing_commands_end_in_hold_then_relax_with_an_error_on_diagnostics(rig):
    hold, lost = rig.limit("command_hold"), rig.limit("command_lost")
    stopped = rig.pause("force_mapper")
    held, reason = rig.wait_for_state(State.HOLD, stopped)
    last = decode.stamp(rig.last("/desired_joint_angles"))  # before its arrival
    relaxed, _ = rig.wait_for_state(State.RELAX, stopped)
    off = rig.wait_for_torque_off(relaxed)
    assert reason.startswith("no command for")
    assert hold <= seconds(last, held)
    assert seconds(stopped, held) <= hold + LATE
    assert lost <= seconds(last, relaxed)
    assert seconds(stopped, relaxed) <= lost + LATE
    assert seconds(relaxed, decode.stamp(off)) <= RAMP + LATE
    rig.wait_for_state(State.FAULT, relaxed)
    rig.wait_for(lambda: any("no command for" in line for line in errors(rig, held)))
    rig.resume("force_mapper")


def test_a_silent_servo_ends_in_relax_without_joint_states(rig):
    begin = rig.inject("silent", "RL")
    silent = rig.now()  # at the latest
    relaxed, reason = rig.wait_for_state(State.RELAX, silent)
    rig.wait_for_state(State.FAULT, relaxed)
    limit = rig.limit("servo_silent")
    assert seconds(begin, relaxed) >= limit - 0.1  # its last answer, a cycle before
    assert seconds(silent, relaxed) <= limit + LATE
    # supervisor and driver have the same limit; which of them is first depends on the bus cycle
    assert reason.startswith(("servo RL silent", "servos: servo RL (id 2): no answer for 0.5"))
    assert not rig.since("/joint_states", silent + 10_000_000)
    rig.wait_for(lambda: any(line.startswith("servo RL (id 2): ") for line in errors(rig, silent)))
    while_silent = [m for m in rig.since("/servo_health", silent) if decode.stamp(m) < relaxed]
    # the others answer in every cycle
    assert max(m.silence[k] for m in while_silent for k in (0, 1, 3)) < LATE
    rig.inject("silent", "RL", clear=True)


def test_noise_on_the_bus_causes_at_most_a_hold_and_no_false_angle(rig):
    noisy = rig.inject("corrupt", value=0.1)
    rig.run(2.0)
    rig.inject("corrupt", clear=True)
    assert {state for since, state, _ in rig.transitions if since > noisy} <= {
        State.HOLD,
        State.WALKING,
    }
    assert min(rig.last("/servo_health").error_rate) > 0.01
    joints = rig.since("/joint_states", noisy)
    assert len(joints) > 10
    limit = read_robot().tendon.angle_max
    for message in joints:
        angle = np.array(message.position)
        assert -0.1 < angle.min() <= angle.max() < limit + 0.1
        counts = servo_angle(angle) / RAD_PER_COUNT
        assert counts == pytest.approx(np.round(counts), abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "value", "name"),
    [
        ("overload", 0.0, "overload"),
        ("overheating", 90.0, "overheating"),
        ("undervoltage", 8.0, "input voltage"),
    ],
)
def test_a_hardware_error_relaxes_all_until_reboot_and_reset(rig, kind, value, name):
    begin = rig.inject(kind, "FR", value=value)
    relaxed, reason = rig.wait_for_state(State.RELAX, begin)
    assert f"servo FR: {name}" in reason
    rig.wait_for_torque_off(relaxed)
    rig.wait_for_state(State.FAULT, relaxed)
    rig.inject(kind, "FR", clear=True)
    assert name in rig.request("reset")  # the error lasts until a reboot
    assert rig.state is State.FAULT
    assert rig.call(Trigger, "/dynamixel_driver/reboot_fr").success
    rig.wait_for(lambda: not any(rig.last("/servo_health").hardware_error))
    assert rig.state is State.FAULT
    rig.wait_for(lambda: not rig.request("reset"))


def check_restart(rig, begin):
    """The watchdogs stop the servos; after a new driver and a reset torque is without motion."""
    relaxed, reason = rig.wait_for_state(State.RELAX, begin)
    # stopped in a stride it may tilt too far before the limit of the servos' silence
    assert "silent" in reason or "limit 0.5 rad" in reason
    rig.wait_for_state(State.FAULT, relaxed)
    rig.run(1.0)
    assert rig.registers("bus_watchdog") == [-1] * 4
    restarted = rig.now()
    rig.start("dynamixel_driver")
    rig.wait_for_torque_off(restarted)  # by the driver's start
    rig.wait_for(lambda: not rig.request("reset"))
    before, ready = rig.wait_for_rest(), rig.now()
    rig.wait_for(lambda: not rig.request("ready"))  # once the supervisor has a health report
    rig.wait_for(lambda: all(rig.last("/servo_health").torque))
    rig.wait_for(lambda: len(rig.since("/joint_states", ready)) > 60)
    sag, pull = rig.moved(before, ready)
    assert -SAG < sag <= pull < 1.5  # 1 count of a position between two


def test_an_unplugged_bus_ends_the_driver_and_a_new_one_starts_without_motion(rig):
    begin = rig.inject("unplugged", duration=0.5)
    assert rig.exit_code("dynamixel_driver") == 1
    assert "their bus watchdogs stop the servos" in rig.log("dynamixel_driver")
    check_restart(rig, begin)


def test_after_a_killed_driver_a_new_one_starts_without_motion(rig):
    begin = rig.kill("dynamixel_driver")
    check_restart(rig, begin)


def test_the_estop_switches_torque_off_at_once_until_a_reset(rig):
    begin = rig.now()
    assert rig.request("estop") == ""
    off = rig.wait_for_torque_off(begin)
    assert seconds(begin, decode.stamp(off)) <= LATE
    assert "READY" in rig.request("ready")
    assert rig.state is State.ESTOP
    assert rig.request("reset") == ""


def test_the_torque_service_relaxes_a_walking_robot(rig):
    begin = rig.now()
    off = rig.call(SetBool, "/dynamixel_driver/torque", data=False)
    assert (off.success, off.message) == (True, "slackening, then torque off")
    _, reason = rig.wait_for_state(State.RELAX, begin)
    assert reason.startswith("servos: ")
    assert reason.endswith("torque switched off by the operator")
    rig.wait_for_torque_off(begin)
    rig.wait_for_state(State.FAULT, begin)


def test_relax_ends_in_idle_without_torque(rig):
    begin = rig.now()
    assert rig.request("relax") == ""
    since, _ = rig.wait_for_state(State.IDLE, begin)
    assert seconds(begin, since) <= RAMP + LATE
    rig.wait_for_torque_off(since)


def test_the_driver_ends_with_torque_off_confirmed_by_every_servo(graph):
    graph.walk()
    assert graph.stop("dynamixel_driver") == 0
    assert graph.log("dynamixel_driver").endswith("torque off, confirmed by every servo")
    assert graph.registers("torque_enable") == [0] * 4
    assert graph.stop("sim_robot") == 0
    assert graph.log("sim_robot").endswith("servos left under torque: none")

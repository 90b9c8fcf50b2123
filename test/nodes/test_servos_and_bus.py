"""Faults of servos, bus and driver while the whole graph walks on emulated servos."""

import copy

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rig import SAG, servo_angle
from std_srvs.srv import Trigger

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


LATE = (
    0.05  # s, from a limit to the reaction: two steps of the supervisor and a bus cycle
)


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


def test_a_silent_servo_ends_in_relax_without_joint_states(rig):
    begin = rig.inject("silent", "RL")
    silent = rig.now()  # at the latest
    relaxed, reason = rig.wait_for_state(State.RELAX, silent)
    rig.wait_for_state(State.FAULT, relaxed)
    limit = rig.limit("servo_silent")
    assert seconds(begin, relaxed) >= limit - 0.1  # its last answer, a cycle before
    assert seconds(silent, relaxed) <= limit + LATE
    # supervisor and driver have the same limit; which of them is first depends on the bus cycle
    assert reason.startswith(
        ("servo RL silent", "servos: servo RL (id 2): no answer for 0.5")
    )
    assert not rig.since("/joint_states", silent + 10_000_000)
    rig.wait_for(
        lambda: any(
            line.startswith("servo RL (id 2): ") for line in errors(rig, silent)
        )
    )
    while_silent = [
        m for m in rig.since("/servo_health", silent) if decode.stamp(m) < relaxed
    ]
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


def test_a_hardware_error_relaxes_all_until_reboot_and_reset(rig):
    begin = rig.inject("overheating", "FR", value=90.0)
    relaxed, reason = rig.wait_for_state(State.RELAX, begin)
    assert "servo FR: overheating" in reason
    rig.wait_for_torque_off(relaxed)
    rig.wait_for_state(State.FAULT, relaxed)
    rig.inject("overheating", "FR", clear=True)
    assert "overheating" in rig.request("reset")  # the error lasts until a reboot
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
    rig.wait_for(
        lambda: not rig.request("ready")
    )  # once the supervisor has a health report
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


def test_the_driver_rejects_commands_stamped_by_another_clock(rig):
    """Commands do not pass through the supervisor: the driver checks the stamps itself."""
    foreign = copy.deepcopy(rig.last("/desired_joint_angles"))
    foreign.header.stamp.sec -= 100
    foreign.position = [0.0] * 4
    rig.publishers_of("desired_joint_angles")[0].publish(foreign)
    rig.run(0.01)
    assert "desired_joint_angles refused: stamped -1" in rig.log("dynamixel_driver")


def test_diagnostics_have_a_status_for_the_bus_and_every_servo(rig):
    begin = rig.now()
    bus, *servos = rig.wait_for(lambda: rig.since("/diagnostics", begin))[-1].status
    assert [status.name for status in (bus, *servos)] == [
        "servo bus",
        "servo FL (id 5)",
        "servo FR (id 4)",
        "servo RL (id 2)",
        "servo RR (id 3)",
    ]
    assert {"pass"} == {v.value for v in bus.values if v.key == "action"}
    for status in servos:
        values = {v.key: v.value for v in status.values}
        assert (values["torque"], values["hardware_errors"]) == ("on", "none")
        assert float(values["voltage_V"]) == pytest.approx(11.1, abs=0.05)
        assert 20.0 < float(values["temperature_C"]) < 40.0


def test_the_driver_ends_with_torque_off_confirmed_by_every_servo(rig):
    assert rig.stop("dynamixel_driver") == 0
    assert rig.log("dynamixel_driver").endswith("torque off, confirmed by every servo")
    assert rig.registers("torque_enable") == [0] * 4
    assert rig.stop("sim_robot") == 0
    assert rig.log("sim_robot").endswith("servos left under torque: none")
    rig.start("sim_robot", "dynamixel_driver")

"""Faults of servos, bus and driver while the whole graph walks on emulated servos."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rig import LATE, RAMP, SAG
from std_srvs.srv import SetBool, Trigger

from slot_core.bags import decode
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.robot import read_robot
from slot_core.safety.command_gate import Action
from slot_core.safety.states import State


@pytest.fixture(scope="module")
def graph(make_rig):
    return make_rig()


@pytest.fixture
def rig(graph):
    """The graph, walking: every test begins where the one before it has led back to."""
    graph.walk()
    yield graph
    graph.heal()


def seconds(begin, end):
    return (end - begin) * 1e-9


def errors(rig, since):
    """Lines of /diagnostics at the level of an error."""
    return [
        f"{status.name}: {status.message}"
        for message in rig.since("/diagnostics", since)
        for status in message.status
        if status.level == DiagnosticStatus.ERROR
    ]


def test_commands_that_stop_hold_then_relax_with_an_error_on_diagnostics(rig):
    hold, lost = rig.limit("command_hold"), rig.limit("command_lost")
    stopped = rig.send("force_mapper", signal.SIGSTOP)
    held, why = rig.reached(State.HOLD, stopped)
    last = decode.stamp(rig.last("/desired_joint_angles"))  # older than its coming
    relaxed, _ = rig.reached(State.RELAX, stopped)
    off = rig.slack(relaxed)
    assert why.startswith("no command for")
    assert hold <= seconds(last, held)
    assert seconds(stopped, held) <= hold + LATE
    assert lost <= seconds(last, relaxed)
    assert seconds(stopped, relaxed) <= lost + LATE
    assert seconds(relaxed, decode.stamp(off)) <= RAMP + LATE
    rig.reached(State.FAULT, relaxed)
    rig.wait_for(lambda: any("no command for" in line for line in errors(rig, held)))
    rig.send("force_mapper", signal.SIGCONT)


def test_a_silent_servo_is_named_and_invents_no_joint_states(rig):
    begin = rig.inject("silent", "RL")
    silent = rig.now()  # at the latest
    relaxed, why = rig.reached(State.RELAX, silent)
    rig.reached(State.FAULT, relaxed)
    limit = rig.limit("servo_silent")
    assert seconds(begin, relaxed) >= limit - 0.1  # its last answer, a cycle before
    assert seconds(silent, relaxed) <= limit + LATE
    assert why.startswith("servo RL silent")
    # of a cycle that was under way on a busy machine
    assert not rig.since("/joint_states", silent + 500_000_000)
    rig.wait_for(lambda: any(line.startswith("servo RL (id 2): ") for line in errors(rig, silent)))
    while_silent = [m for m in rig.since("/servo_health", silent) if decode.stamp(m) < relaxed]
    # bounded retries: the others are heard in every cycle of at most four times the bus's timeout
    assert max(m.silence[k] for m in while_silent for k in (0, 1, 3)) < 0.3
    rig.inject("silent", "RL", clear=True)


def test_noise_on_the_bus_is_borne_and_never_believed(rig):
    noisy = rig.inject("corrupt", value=0.1)
    end = rig.now() + 2_000_000_000
    rig.wait_for(lambda: rig.now() > end)
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
        counts = (angle * 1.03199 + np.radians(130.0)) / RAD_PER_COUNT
        assert counts == pytest.approx(np.round(counts), abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "value", "name"),
    [
        ("overload", 0.0, "overload"),
        ("overheating", 90.0, "overheating"),
        ("undervoltage", 8.0, "input voltage"),
    ],
)
def test_a_hardware_error_slackens_all_until_reboot_and_reset(rig, kind, value, name):
    begin = rig.inject(kind, "FR", value=value)
    relaxed, why = rig.reached(State.RELAX, begin)
    assert f"servo FR: {name}" in why
    rig.slack(relaxed)
    rig.reached(State.FAULT, relaxed)
    rig.inject(kind, "FR", clear=True)
    assert name in rig.ask("reset")  # it is not rebooted by itself, so the error stays
    assert rig.state is State.FAULT
    assert rig.call(Trigger, "/dynamixel_driver/reboot_fr").success
    rig.wait_for(lambda: not any(rig.last("/servo_health").hardware_error))
    assert rig.state is State.FAULT
    rig.wait_for(lambda: not rig.ask("reset"))


def stops_and_comes_back(rig, begin):
    """The servos stop by themselves; a new driver, a reset, and no motion as torque comes on."""
    relaxed, reason = rig.reached(State.RELAX, begin)
    # held in the middle of a step it may tilt too far before their silence is noticed
    assert "silent" in reason or "limit 0.5 rad" in reason
    rig.reached(State.FAULT, relaxed)
    watchdog = 1.0  # s, as in PATIENT
    end = begin + round((watchdog + 2 * LATE) * 1e9)
    rig.wait_for(lambda: decode.stamp(rig.last("/ground_truth/odom")) > end)
    rig.wait_for(rig.bus.exists)
    assert rig.registers("bus_watchdog") == [-1] * 4
    restarted = rig.now()
    rig.start("dynamixel_driver")
    assert not any(rig.slack(restarted).torque)  # FAULT: what was left under torque goes slack
    rig.wait_for(lambda: not rig.ask("reset"))
    before, ready = rig.rest(), rig.now()
    rig.wait_for(lambda: not rig.ask("ready"))  # the supervisor may not have heard it yet
    rig.wait_for(lambda: all(rig.last("/servo_health").torque))
    rig.wait_for(lambda: len(rig.since("/joint_states", ready)) > 60)
    sag, pull = rig.moved(before, ready)
    assert -SAG < sag <= pull < 1.5  # one count, where a position lies between two


def test_an_unplugged_bus_ends_the_driver_and_a_new_one_comes_back_without_motion(rig):
    begin = rig.inject("unplugged", duration=0.5)
    assert rig.exit_code("dynamixel_driver") == 1
    assert "their bus watchdogs stop the servos" in rig.log("dynamixel_driver")
    stops_and_comes_back(rig, begin)


def test_after_a_killed_driver_a_new_one_comes_back_without_motion(rig):
    begin = rig.send("dynamixel_driver", signal.SIGKILL)
    stops_and_comes_back(rig, begin)


@pytest.mark.parametrize(
    ("kind", "leg", "value"), [("tendon_slack", "FL", 0.01), ("tendon_broken", "RR", 0.0)]
)
def test_a_spoiled_tendon_stops_the_gait_and_names_the_leg(rig, kind, leg, value):
    begin = rig.inject(kind, leg, value=value)
    held, why = rig.reached(State.HOLD, begin)
    assert why.startswith(f"slack or broken tendon {leg} ")
    told = next(m for m in rig.since("/robot_state", held) if m.state == State.HOLD)
    assert any(line.startswith(f"slack or broken tendon {leg} ") for line in told.warnings)
    rig.wait_for(
        lambda: rig.last("/servo_health").action == decode.ACTION_NUMBERS.index(Action.HOLD)
    )
    rig.inject(kind, leg, clear=True)
    assert rig.ask("relax") == ""
    rig.reached(State.IDLE, held)


def test_estop_is_torque_off_at_once_until_reset(rig):
    begin = rig.now()
    assert rig.ask("estop") == ""
    off = rig.slack(begin)
    assert seconds(begin, decode.stamp(off)) <= LATE
    assert "READY" in rig.ask("ready")
    assert rig.state is State.ESTOP
    assert rig.ask("reset") == ""


def test_the_torque_service_takes_precedence_over_a_supervisor_that_walks(rig):
    begin = rig.now()
    off = rig.call(SetBool, "/dynamixel_driver/torque", data=False)
    assert (off.success, off.message) == (True, "slackening, then torque off")
    _, why = rig.reached(State.RELAX, begin)
    assert why.startswith("servos: ")
    assert why.endswith("torque switched off by the operator")
    rig.slack(begin)
    rig.reached(State.FAULT, begin)


def test_relax_ends_in_idle_without_torque(rig):
    begin = rig.now()
    assert rig.ask("relax") == ""
    since, _ = rig.reached(State.IDLE, begin)
    assert seconds(begin, since) <= RAMP + LATE
    rig.slack(since)


def test_the_nodes_end_with_every_servo_confirmed_slack(graph):
    graph.walk()
    assert set(graph.close().values()) == {0}
    assert "torque off, confirmed by every servo" in graph.log("dynamixel_driver").splitlines()[-1]
    assert "servos left under torque: none" in graph.log("sim_robot")

"""Driver with emulated servos, without the rest of the graph: refusals, services, its end."""

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rig import Rig
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from examples.ideal_servos import IdealServos, make_brand
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.messages import decode
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, State
from slot_core.servos import registry, session
from slot_msgs.msg import RobotState, ServoLimits
from slot_nodes import messages, qos

DRIVER = "dynamixel_driver"
PULLED = 1.5  # rad
CONFIRMED = "torque off, confirmed by every servo"


class StubSupervisor:
    """Sends the limits once, and a permission and a command every 20 ms unless they are None."""

    def __init__(self, rig):
        self.permission, self.angle = None, None
        self._rig = rig
        self._states = rig.publisher(RobotState, "robot_state", qos.STATE)
        self._limits = rig.publisher(ServoLimits, "servo_limits", qos.STATE)
        limits = read_supervisor().servo_limits
        self._limits.publish(messages.limits_to_msg(limits))
        self._commands = rig.publisher(
            JointState, "desired_joint_angles", qos.CONTROL
        )
        self._timer = rig.every(0.02, self._send)

    def _send(self):
        now = self._rig.now()
        if (permission := self.permission) is not None:
            action = decode.ACTION_NUMBERS.index(permission)
            state = RobotState(state=State.WALKING, action=action)
            state.followed = permission is Action.PASS
            state.header.stamp = messages.ns_to_stamp(now)
            self._states.publish(state)
        if (angle := self.angle) is not None:
            self._commands.publish(
                messages.command_to_msg(now, np.full(4, angle), np.zeros(4))
            )

    def close(self):
        self._timer.cancel()
        for made in (self._states, self._limits, self._commands):
            self._rig.node.destroy_publisher(made)

    def power(self):
        """Bring torque on."""
        self.permission, begin = Action.HOLD, self._rig.now()
        powered(self._rig, begin)

    def move_to(self, angle):
        """Move all tendons to an angle, rad, within the servos' droop under load."""
        self.power()
        self.permission, self.angle = Action.PASS, angle
        self._rig.wait_for(
            lambda: np.allclose(
                self._rig.last("/joint_states").position, angle, atol=0.2
            )
        )


@pytest.fixture(scope="module")
def bench(simulate):
    return simulate(hardware="fake_bus", only=["sim_robot"])


@pytest.fixture
def rig(bench):
    """Emulated servos without a driver; a driver that the test starts ends with it."""
    yield bench
    if DRIVER in bench.nodes:
        bench.stop(DRIVER)


@pytest.fixture
def stub(rig):
    """Permissions, limits and commands for a driver."""
    made = StubSupervisor(rig)
    yield made
    made.close()


def start_driver(rig):
    """Start a driver, and wait until it is configured."""
    begin = rig.now()
    rig.start(DRIVER)
    rig.wait_for(lambda: rig.since("/joint_states", begin))


def powered(rig, since):
    """Wait for a health report since a time with every torque on."""
    rig.wait_for(
        lambda: any(all(m.torque) for m in rig.since("/servo_health", since))
    )


def switch(rig, on):
    """Call the torque service; returns success and message."""
    answer = rig.call(SetBool, f"/{DRIVER}/torque", data=on)
    return answer.success, answer.message


@pytest.mark.parametrize(
    ("parameters", "configure", "reason"),
    [
        (
            {"servo.firmware_min": 46},
            session.ServoSession.configure,
            "servo FL (id 5): firmware 45, expected 46 or newer",
        ),
        (
            {"wait_for_port": 0.5, "bus.port": "/nowhere/servos"},
            session.ServoSession.configure,
            "/nowhere/servos: ",
        ),
        ({}, lambda self: self.nothing, "AttributeError("),  # of a brand
    ],
)
def test_unexpected_servos_a_port_that_does_not_appear_and_an_error_are_refused_in_one_line(
    rig, monkeypatch, parameters, configure, reason
):
    monkeypatch.setattr(session.ServoSession, "configure", configure)
    rig.start(DRIVER, parameters=parameters)
    assert rig.wait_for(lambda: rig.exit_codes.get(DRIVER)) == 1
    assert f"servos refused: {reason}" in rig.logs[DRIVER][-1]
    assert rig.registers("torque_enable") == [0] * 4


def test_the_torque_service_switches_torque_off_after_a_ramp_and_on_again(
    rig, stub
):
    start_driver(rig)
    refusal = (False, "torque refused: the supervisor does not permit it")
    rig.wait_for(lambda: switch(rig, True) == refusal)  # once it has the limits
    stub.power()
    assert switch(rig, True) == (False, "torque is on already")
    reboot = rig.call(Trigger, f"/{DRIVER}/reboot_rr")
    assert reboot.message == "needs a configured driver, torque off"
    begin = rig.now()
    assert switch(rig, False) == (True, "slackening, then torque off")
    assert (
        rig.wait_for_torque_off(begin).reason
        == "torque off, after: torque switched off by the operator"
    )
    assert switch(rig, True) == (True, "torque on")


def test_a_measured_zero_applies_at_once_and_after_a_restart(rig):
    start_driver(rig)
    answer = rig.call(Trigger, f"/{DRIVER}/zero_fl")
    assert answer.success, answer.message
    begin = rig.now()
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    assert abs(rig.last("/joint_states").position[0]) < 1.5 * RAD_PER_COUNT
    zero = float(answer.message.split(" at ")[1].split(" deg")[0])
    assert (
        f"zero_deg: [{zero:.2f}, 130.0, "
        in (rig.config / "dynamixel.yaml").read_text()
    )
    rig.stop(DRIVER)
    start_driver(rig)
    assert abs(rig.last("/joint_states").position[0]) < 1.5 * RAD_PER_COUNT


def test_the_driver_reads_torque_off_back_before_it_ends(rig, stub):
    start_driver(rig)
    stub.move_to(PULLED)
    assert all(rig.registers("torque_enable"))
    rig.stop(DRIVER)
    assert CONFIRMED in rig.logs[DRIVER][-1]
    assert rig.registers("torque_enable") == [0] * 4


@pytest.fixture
def change(rig):
    """Request a transition of the driver; returns whether it succeeded."""

    def request(transition):
        goal = Transition(id=transition)
        return rig.call(
            ChangeState, f"/{DRIVER}/change_state", transition=goal
        ).success

    return request


def test_the_driver_follows_lifecycle_transitions_by_service(rig, stub, change):
    rig.start(DRIVER, parameters={"autostart": False})
    begin = rig.now()
    assert not change(Transition.TRANSITION_ACTIVATE)  # it is not configured
    assert change(Transition.TRANSITION_CONFIGURE)
    rig.wait_for(lambda: rig.since("/joint_states", begin))
    assert not change(Transition.TRANSITION_ACTIVATE)  # nothing permits it
    stub.power()
    end = rig.now()
    assert change(Transition.TRANSITION_DEACTIVATE)
    rig.wait_for_torque_off(end)
    assert CONFIRMED in rig.logs[DRIVER][-1]
    on = rig.now()
    assert change(Transition.TRANSITION_ACTIVATE)
    powered(rig, on)
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    assert rig.registers("torque_enable") == [0] * 4
    again = rig.now()
    assert change(Transition.TRANSITION_CONFIGURE)
    rig.wait_for(lambda: rig.since("/joint_states", again))
    assert change(Transition.TRANSITION_ACTIVATE)
    powered(rig, again)
    assert change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert rig.registers("torque_enable") == [0] * 4
    # it is finalized, and still answers
    assert not change(Transition.TRANSITION_CONFIGURE)


def test_the_driver_node_drives_servos_of_another_brand(tmp_path, monkeypatch):
    rig = Rig(
        tmp_path, {"servo_bus": {"brand": "ideal"}}, only=[], hardware="real"
    )
    servos = IdealServos()
    monkeypatch.setitem(
        registry.BRANDS, "ideal", lambda: make_brand(servos, rig.seconds)
    )
    rig.every(0.01, lambda: servos.advance(0.01))
    start_driver(rig)
    stub = StubSupervisor(rig)
    stub.move_to(1.0)
    rig.run(0.5)
    assert rig.last("/joint_states").position == pytest.approx(np.ones(4))
    rig.wait_for(lambda: rig.messages["/diagnostics"])
    assert rig.last("/diagnostics").status[1].hardware_id == "ideal"
    stub.permission, begin = Action.OFF, rig.now()
    rig.wait_for_torque_off(begin)
    answer = rig.call(Trigger, f"/{DRIVER}/zero_fl")
    assert (answer.success, answer.message) == (
        False,
        "servos of ideal have no such service",
    )
    rig.close()

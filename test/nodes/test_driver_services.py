"""Driver with emulated servos, without the rest of the graph: refusals and services."""

import pytest
from std_srvs.srv import SetBool, Trigger
from stub_supervisor import DRIVER, powered, start_driver

from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.safety.states import Action


@pytest.fixture(scope="module")
def bench(simulate):
    return simulate(hardware="fake_bus", only=["sim_robot"])


@pytest.fixture
def rig(bench):
    """Emulated servos without a driver; a driver that the test starts ends with it."""
    yield bench
    if bench.runs(DRIVER):
        bench.stop(DRIVER)


def switch(rig, on):
    """Call the torque service; returns success and message."""
    answer = rig.call(SetBool, f"/{DRIVER}/torque", data=on)
    return answer.success, answer.message


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        (
            {"servo.firmware_min": 46},
            "servo FL (id 5): firmware 45, expected 46 or newer",
        ),
        (
            {"wait_for_port": 0.5, "bus.port": "/nowhere/servos"},
            "/nowhere/servos: ",
        ),
    ],
)
def test_unexpected_servos_and_a_port_that_does_not_appear_are_refused_in_one_line(
    rig, parameters, reason
):
    rig.start(DRIVER, parameters=parameters)
    assert rig.exit_code(DRIVER) == 1
    assert f"servos refused: {reason}" in rig.log_lines(DRIVER)[-1]
    assert rig.registers("torque_enable") == [0] * 4


def test_the_torque_service_switches_torque_off_after_a_ramp_and_on_again(
    rig, stub
):
    start_driver(rig)
    refusal = (False, "torque refused: the supervisor does not permit it")
    rig.wait_for(lambda: switch(rig, True) == refusal)  # once it has the limits
    stub.permission, begin = Action.HOLD, rig.now()
    powered(rig, begin)
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

"""Faults of servos, bus and driver while the whole graph walks on emulated servos."""

import copy

import pytest
from std_srvs.srv import Trigger

from slot_core.safety.states import State

DRIVER = "dynamixel_driver"


def test_in_lockstep_an_unplugged_bus_ends_the_robot_as_its_driver_would(
    simulate,
):
    rig = simulate(hardware="fake_bus", lockstep=True)
    rig.wait_for(lambda: rig.state is State.WALKING)
    rig.inject("unplugged")
    rig.wait_for(lambda: rig.exit_codes == {"sim_robot": 1})
    assert "their bus watchdogs stop the servos" in rig.log("sim_robot")
    rig.close()


@pytest.fixture(scope="module")
def graph(simulate):
    return simulate(hardware="fake_bus")


@pytest.fixture
def rig(graph):
    """The graph, walking."""
    graph.walk()
    return graph


def test_after_a_hardware_error_a_reset_is_refused_until_a_reboot(rig):
    rig.wait_for_state(State.FAULT, rig.inject("overheating", "FR", value=90.0))
    rig.inject("overheating", "FR", clear=True)
    # the error lasts until a reboot
    assert "overheating" in rig.request("reset")
    assert rig.state is State.FAULT
    assert rig.call(Trigger, "/dynamixel_driver/reboot_fr").success
    rig.wait_for(lambda: not any(rig.last("/servo_health").hardware_error))
    assert rig.state is State.FAULT
    rig.wait_for(lambda: not rig.request("reset"))


@pytest.mark.parametrize("fault", ["unplugged", "killed"])
def test_the_robot_is_ready_again_with_a_new_driver(rig, fault):
    if fault == "killed":
        begin = rig.kill(DRIVER)
    else:
        begin = rig.inject("unplugged", duration=0.5)
        assert rig.wait_for(lambda: rig.exit_codes.get(DRIVER)) == 1
        assert "their bus watchdogs stop the servos" in rig.log(DRIVER)
    rig.wait_for_state(State.FAULT, begin)
    rig.run(1.0)
    restarted = rig.now()
    rig.start(DRIVER)
    rig.wait_for_torque_off(restarted)  # by the driver's start
    rig.wait_for(lambda: not rig.request("reset"))
    # once there is a health report
    rig.wait_for(lambda: not rig.request("ready"))
    rig.wait_for(lambda: all(rig.last("/servo_health").torque))


def test_the_driver_rejects_commands_stamped_by_another_clock(rig):
    """Commands do not pass through the supervisor: the driver checks the stamps itself."""
    foreign = copy.deepcopy(rig.last("/desired_joint_angles"))
    foreign.header.stamp.sec -= 100
    foreign.position = [0.0] * 4
    rig.publisher_of("/desired_joint_angles").publish(foreign)
    rig.run(0.01)
    assert "desired_joint_angles refused: stamped -1" in rig.log(DRIVER)

"""The driver's process: torque is off and read back at each of its ends; lifecycle services.

Real time: signals end the process, and rclpy serves the lifecycle.
"""

import signal
import sys

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from stub_supervisor import DRIVER, powered, start_driver

from slot_core.safety.states import Action

pytestmark = pytest.mark.real_time

PULLED = 1.5  # rad
DRIVER_PROGRAM = (
    "from slot_nodes import dynamixel_driver_node, runtime\n"
    "runtime.run(dynamixel_driver_node.DynamixelDriverNode)"
)
# Raises ZeroDivisionError in its first diagnostics under torque.
BROKEN_DRIVER = """
from slot_nodes import diagnostics, dynamixel_driver_node, runtime
original = diagnostics.of_servos
def of_servos(stamp, session, *rest):
    return original(stamp // (not session.bus.active), session, *rest)
diagnostics.of_servos = of_servos
runtime.run(dynamixel_driver_node.DynamixelDriverNode)
"""


@pytest.fixture(scope="module")
def bench(make_rig):
    return make_rig(only=["sim_robot"])


@pytest.fixture
def rig(bench):
    """Emulated servos without a driver; a driver that the test starts ends with it."""
    bench.wait_for(bench.bus.exists)
    yield bench
    if DRIVER in bench.children:
        bench.stop(DRIVER)


@pytest.mark.parametrize(
    "end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, "exception"]
)
def test_the_driver_reads_torque_off_back_before_it_ends(rig, stub, end):
    """SIGHUP comes when the connection to a terminal with `ros2 launch` is lost."""
    before = len(rig.log_lines(DRIVER))
    broken = end == "exception"
    code = BROKEN_DRIVER if broken else DRIVER_PROGRAM
    # a signal that the caller of the tests ignores (nohup) would be ignored here too
    start_driver(
        rig, program=["env", "--default-signal=HUP", sys.executable, "-c", code]
    )
    if broken:
        stub.permission = Action.HOLD
    else:
        stub.move_to(PULLED)
        rig.send_signal(DRIVER, end)
    assert rig.exit_code(DRIVER) == int(broken)
    log = "".join(rig.log_lines(DRIVER)[before:])
    assert "torque on" in log
    assert "torque off, confirmed by every servo" in log
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
    stub.permission = Action.HOLD
    powered(rig, begin)
    end = rig.now()
    assert change(Transition.TRANSITION_DEACTIVATE)
    rig.wait_for_torque_off(end)
    assert "torque off, confirmed by every servo" in rig.log_lines(DRIVER)[-1]
    on = rig.now()
    assert change(Transition.TRANSITION_ACTIVATE)
    powered(rig, on)
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    # the driver has closed the port
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

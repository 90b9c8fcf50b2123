"""Runs at the pace of the wall clock: scripts/run, the real driver, participants that join.

The driver's process: torque is off and read back at each of its ends; lifecycle services.

Real time: signals end the process, and rclpy serves the lifecycle.
"""

import math
import signal
import subprocess
import sys

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rig import TOPICS
from stub_supervisor import DRIVER, powered, start_driver

from slot_bringup.monitor import listener
from slot_core.safety.states import Action, State
from slot_lab.bags.bag import Bag

pytestmark = pytest.mark.real_time

RUN = [sys.executable, "-m", "slot_bringup"]
JOINS = 10
HEARD = {"/odom", "/desired_joint_angles"}  # of two nodes


def run(*arguments, **options):
    """Output of a run; it must succeed."""
    done = subprocess.run(
        [*RUN, *arguments],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_run_in_real_time_keeps_its_pace_and_prints_a_summary(tmp_path):
    output = run("--duration", "4", "--no-bag", cwd=tmp_path)
    figures = dict(
        line.split(maxsplit=1) for line in output.splitlines() if line.strip()
    )
    assert float(figures["real-time"].split()[-1]) == pytest.approx(
        1.0, abs=0.1
    )
    assert list(tmp_path.iterdir()) == []


def test_robot_walks_with_the_real_driver_which_leaves_no_torque(
    environment, tmp_path
):
    """At a pseudo-terminal. Measured: 44 mm/s on average; half of it shows that it walks."""
    bag = tmp_path / "bag"
    run(
        "--hardware",
        "fake_bus",
        "--duration",
        "5",
        "--bag",
        str(bag),
        env=environment,
    )
    place = Bag(bag).series("/ground_truth/odom", "pose.pose.position")
    walked = place["pose.pose.position"][:, 0]
    assert (walked[-1] - walked[0]) / (
        place.stamp[-1] - place.stamp[0]
    ) * 1e9 > 0.02
    assert (
        "torque off, confirmed by every servo"
        in (bag / "log/dynamixel_driver.log").read_text()
    )
    assert (
        "servos left under torque: none"
        in (bag / "log/sim_robot.log").read_text()
    )


def join_and_leave():
    """Take part in the graph until a message of every topic HEARD has come."""
    heard = set()
    with listener("passer_by") as (node, executor):
        for topic in HEARD:
            kind, profile = TOPICS[topic]
            node.create_subscription(
                kind, topic, lambda _, t=topic: heard.add(t), profile
            )
        executor.spin_until(lambda: heard == HEARD, math.inf)


def test_participants_that_join_and_leave_do_not_stop_a_walking_robot(make_rig):
    """As `ros2 topic echo` does; what DDS does in other processes takes real time."""
    rig = make_rig(hardware="sim")
    rig.walk_steadily()
    walking = rig.transitions[-1]
    for _ in range(JOINS):
        join_and_leave()
    assert rig.transitions[-1] == walking, rig.recent_events()
    assert rig.state is State.WALKING
    rig.close()  # its supervisor would be a second one for the driver below


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


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP, "exception"])
def test_the_driver_reads_torque_off_back_before_it_ends(rig, stub, end):
    """SIGINT: the walk above. SIGHUP comes when a terminal with `ros2 launch` is lost."""
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
        rig.children[DRIVER].send_signal(end)
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

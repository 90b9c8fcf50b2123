"""Faults in the process of the simulated robot: of its scene, of its service; divergence."""

import os
import signal
import subprocess
import time
from contextlib import contextmanager

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from slot_bringup.graph import NodeSpec
from slot_bringup.processes import command_line
from slot_core import config
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.messages import decode
from slot_core.robot import TENDON_JOINTS
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import LegStates, RobotState, ServoHealth, ServoLimits
from slot_msgs.srv import InjectFault
from slot_nodes import messages, qos

STANDING = [1.1] * 4  # rad, about the settled tendon angles
LIMIT = 60.0  # s, longest wait on a busy machine


class Robot:
    """A `sim_robot` process, and a node that answers its odometry with constant angles.

    The node also stands in for the supervisor: it permits commands, on each report of the servos.
    """

    def __init__(self, log, **parameters):
        self.log = log
        spec = NodeSpec("sim_robot", "slot_nodes", parameters)
        with log.open("wb") as out:
            self.process = subprocess.Popen(
                command_line(spec), stdout=out, stderr=out, cwd=log.parent, start_new_session=True
            )
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = rclpy.create_node("tester", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.inject_client = self.node.create_client(InjectFault, "/sim_robot/inject")
        self.commands = self.node.create_publisher(JointState, "desired_joint_angles", qos.CONTROL)
        self.node.create_subscription(Odometry, "odom", self._on_odometry, qos.SENSOR)
        self.node.create_subscription(LegStates, "ground_truth/legs", self._on_legs, qos.SENSOR)
        self.states = self.node.create_publisher(RobotState, "robot_state", qos.STATE)
        self.limits = self.node.create_publisher(ServoLimits, "servo_limits", qos.STATE)
        self.limits.publish(messages.limits_to_msg(read_supervisor().servo_limits))
        self.node.create_subscription(ServoHealth, "servo_health", self._on_health, qos.SENSOR)
        self.holding = False
        self.odometry = self.answered = None  # last odometry; the one answered last
        self.tension = {}  # N, by time since the start, s

    def _on_odometry(self, message):
        self.odometry = message
        if self.holding:
            self.answer()

    def answer(self):
        """Answer the last odometry with the standing angles."""
        answer = JointState(name=TENDON_JOINTS, position=STANDING)
        answer.header.stamp = self.odometry.header.stamp
        self.answered = self.odometry
        self.commands.publish(answer)

    def _on_health(self, message):
        state = RobotState(state=State.STANDING, action=RobotState.ACTION_PASS)
        state.header.stamp = message.header.stamp
        self.states.publish(state)

    def _on_legs(self, message):
        self.tension[round(decode.stamp(message) * 1e-9 - 1.0, 6)] = list(message.tension)

    def spin_until(self, condition):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, self.log.read_text()
            self.executor.spin_once(timeout_sec=0.05)

    def hold_while(self, condition):
        """Answer every odometry while a condition holds."""
        self.spin_until(lambda: self.odometry)
        self.holding = True
        self.answer()
        self.spin_until(lambda: not condition())
        self.holding = False

    def hold_until(self, seconds):
        """Answer every odometry until a time since the start of the robot, s."""
        self.hold_while(lambda: max(self.tension, default=0.0) < seconds)

    def inject(self, kind, leg="FL", clear=False, **values):
        """Call the service; return success and message."""
        self.spin_until(self.inject_client.service_is_ready)
        request = InjectFault.Request(kind=kind, leg=leg, clear=clear, **values)
        answer = self.inject_client.call_async(request)
        self.spin_until(answer.done)
        return answer.result().success, answer.result().message

    def close(self):
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(self.process.pid, signal.SIGKILL)
        self.node.destroy_node()
        self.context.try_shutdown()


@contextmanager
def robot(directory, **parameters):
    """A simulated robot, stopped at the end."""
    made = Robot(directory / "sim_robot.log", **parameters)
    try:
        yield made
    finally:
        made.close()


def test_tendon_breaks_at_the_time_of_the_scene(tmp_path):
    with robot(tmp_path, lockstep=True, scene="tendon_breaks") as standing:
        standing.hold_until(5.2)
    times, tensions = map(np.array, zip(*sorted(standing.tension.items())))
    before, after = tensions[times <= 5.0], tensions[times > 5.0]
    assert len(before) > 140
    assert len(after) >= 5
    assert before.min() > 1.0
    assert after[:, 0].tolist() == [0.0] * len(after)
    assert after[:, 1:].min() > 1.0


def test_service_breaks_a_tendon_before_the_start_and_repairs_it_during_motion(tmp_path):
    with robot(tmp_path, lockstep=True) as standing:
        assert standing.inject("tendon_broken", "RR") == (True, "")
        standing.hold_until(0.2)
        assert all(tension[3] == 0.0 for tension in standing.tension.values())
        broken = max(standing.tension)
        assert standing.inject("tendon_broken", "RR", clear=True) == (True, "")
        standing.hold_until(0.5)
    assert all(tension[3] > 1.0 for t, tension in standing.tension.items() if t > broken + 0.1)


def test_service_refuses_a_fault_with_the_reason(tmp_path):
    with robot(tmp_path, lockstep=True) as frozen:
        refused = {
            ("silent", "FL"): "fault 'silent': only the servos of hardware fake_bus can have it",
            ("tired", "FL"): "inject: fault.kind = 'tired': expected one of silent, ",
            ("nan", "tail"): "inject: fault.leg = 'tail': expected one of all, FL, FR, RL, RR",
        }
        for (kind, leg), reason in refused.items():
            success, message = frozen.inject(kind, leg)
            assert not success
            assert message.startswith(reason)
        answer = frozen.inject("tendon_slack", value=0.2)
        assert answer == (False, "inject: fault.value = 0.2: outside [0.0001, 0.1] m")
        answer = frozen.inject("tendon_broken", "RL", clear=True)
        assert answer == (False, "no fault 'tendon_broken' at 'RL'")


def test_service_unplugs_and_plugs_in_the_bus(tmp_path):
    port = tmp_path / "servos"
    with robot(tmp_path, bus=str(port)) as frozen:
        frozen.spin_until(port.exists)
        assert frozen.inject("unplugged", "all") == (True, "")
        frozen.spin_until(lambda: not port.exists())
        assert frozen.inject("unplugged", "all", clear=True) == (True, "")
        frozen.spin_until(port.exists)


def test_diverged_simulation_waits_for_the_driver_to_switch_the_servos_off(tmp_path):
    settings = config.replace(read_settings(), {"bus.timeout": 0.1})  # a busy machine
    link = tmp_path / "servos"
    with robot(tmp_path, bus=str(link)) as sim:
        sim.spin_until(link.exists)
        port = SerialPort(str(link), settings.bus.baud, settings.bus.timeout)
        driver = Driver(port, settings)
        driver.configure()
        driver.activate()
        sim.spin_until(lambda: sim.odometry)
        assert sim.inject("nan", "RL") == (True, "")
        sim.answer()
        sim.spin_until(lambda: "simulation diverged" in sim.log.read_text())
        time.sleep(0.5)  # on a busy machine a driver may send nothing for so long
        assert driver.torque_off().complete
        driver.close()
        sim.spin_until(lambda: sim.process.poll() is not None)
        assert sim.process.returncode == 1
    assert "Traceback" not in sim.log.read_text()
    assert "servos left under torque: none" in sim.log.read_text()


@pytest.mark.parametrize("dump", ["", "kept"])
def test_diverged_simulation_ends_with_one_line_that_names_the_file_of_its_state(tmp_path, dump):
    """Without the parameter `dump` the file is in the working directory."""
    with robot(tmp_path, lockstep=True, dump=dump and str(tmp_path / dump)) as sim:
        sim.hold_until(0.1)
        sim.spin_until(lambda: sim.odometry is not sim.answered)  # then it waits for a command
        assert sim.inject("nan", "FR") == (True, "")
        sim.hold_while(lambda: sim.process.poll() is None)
        assert sim.process.returncode == 1
    line = sim.log.read_text().splitlines()[-1]
    assert "simulation diverged in step" in line
    (file,) = (tmp_path / dump).glob("lost_*.npz")
    assert line.endswith(f"; its state is in {file}")
    state = np.load(file)
    assert str(state["scene"]) == "flat"
    assert np.isnan(state["before_nodes"]).any(axis=(1, 2)).tolist() == [False, True, False, False]

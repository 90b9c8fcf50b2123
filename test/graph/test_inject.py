"""Faults in the process of the simulated robot: by its scene, by its service, and a lost run."""

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
from slot_core.bags import decode
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.robot import TENDON_JOINTS
from slot_msgs.msg import LegStates
from slot_msgs.srv import InjectFault
from slot_nodes import qos

STANDING = [1.1] * 4  # rad, about what the robot settles at
LIMIT = 60.0  # s that anything may take on a busy machine


class Robot:
    """A `sim_robot` in lockstep, and what holds its legs where they stand."""

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
        self.holding = False
        self.waiting = None  # odometry without an answer
        self.tension = {}  # by time since the start, s

    def _on_odometry(self, message):
        self.waiting = message
        if self.holding:
            self.answer()

    def answer(self):
        """Let the robot do one tick more, standing."""
        answer = JointState(name=TENDON_JOINTS, position=STANDING)
        answer.header.stamp = self.waiting.header.stamp
        self.commands.publish(answer)

    def _on_legs(self, message):
        self.tension[round(decode.stamp(message) * 1e-9 - 1.0, 6)] = list(message.tension)

    def spin_until(self, condition):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, self.log.read_text()
            self.executor.spin_once(timeout_sec=0.05)

    def hold_while(self, condition):
        """Let the robot stand tick by tick."""
        self.spin_until(lambda: self.waiting)
        self.holding = True
        self.answer()
        self.spin_until(lambda: not condition())
        self.holding = False

    def hold_until(self, seconds):
        """Let the robot stand until a time of its own clock."""
        self.hold_while(lambda: max(self.tension, default=0.0) < seconds)

    def inject(self, kind, leg="FL", clear=False, **values):
        """Success and message of the service."""
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
    """A simulated robot, ended at last."""
    made = Robot(directory / "sim_robot.log", **parameters)
    try:
        yield made
    finally:
        made.close()


def test_a_tendon_of_the_scene_breaks_at_its_time(tmp_path):
    with robot(tmp_path, lockstep=True, scene="tendon_breaks") as standing:
        standing.hold_until(5.2)
    times, tensions = map(np.array, zip(*sorted(standing.tension.items())))
    before, after = tensions[times <= 5.0], tensions[times > 5.0]
    assert len(before) > 140
    assert len(after) >= 5
    assert before.min() > 1.0
    assert after[:, 0].tolist() == [0.0] * len(after)
    assert after[:, 1:].min() > 1.0


def test_the_service_breaks_a_tendon_of_the_frozen_robot_and_mends_that_of_the_moving(tmp_path):
    with robot(tmp_path, lockstep=True) as standing:
        assert standing.inject("tendon_broken", "RR") == (True, "")
        standing.hold_until(0.2)
        assert all(tension[3] == 0.0 for tension in standing.tension.values())
        broken = max(standing.tension)
        assert standing.inject("tendon_broken", "RR", clear=True) == (True, "")
        standing.hold_until(0.5)
    assert all(tension[3] > 1.0 for t, tension in standing.tension.items() if t > broken + 0.1)


def test_the_service_says_why_not(tmp_path):
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
        told = frozen.inject("tendon_slack", value=0.2)
        assert told == (False, "inject: fault.value = 0.2: outside [0.0001, 0.1] m")
        told = frozen.inject("tendon_broken", "RL", clear=True)
        assert told == (False, "no fault 'tendon_broken' at 'RL'")


def test_the_service_pulls_the_plug_of_the_servos_and_puts_it_back(tmp_path):
    port = tmp_path / "servos"
    with robot(tmp_path, bus=str(port)) as frozen:
        frozen.spin_until(port.exists)
        assert frozen.inject("unplugged", "all") == (True, "")
        frozen.spin_until(lambda: not port.exists())
        assert frozen.inject("unplugged", "all", clear=True) == (True, "")
        frozen.spin_until(port.exists)


def test_a_lost_simulation_lets_the_driver_switch_its_servos_off(tmp_path):
    settings = config.replace(read_settings(), {"bus.timeout": 0.1})  # a busy machine
    link = tmp_path / "servos"
    with robot(tmp_path, bus=str(link)) as lost:
        lost.spin_until(link.exists)
        port = SerialPort(str(link), settings.bus.baud, settings.bus.timeout)
        driver = Driver(port, settings)
        driver.configure()
        driver.activate()
        lost.spin_until(lambda: lost.waiting)
        assert lost.inject("nan", "RL") == (True, "")
        lost.answer()
        lost.spin_until(lambda: driver.cycle() and "simulation stopped" in lost.log.read_text())
        assert driver.torque_off().complete
        driver.close()
        lost.spin_until(lambda: lost.process.poll() is not None)
        assert lost.process.returncode == 1
    assert "Traceback" not in lost.log.read_text()
    assert "servos left under torque: none" in lost.log.read_text()


@pytest.mark.parametrize("dump", ["", "kept"])
def test_a_lost_simulation_ends_in_one_line_that_names_the_file_with_its_state(tmp_path, dump):
    """Without a directory asked for, the file is in the working directory."""
    with robot(tmp_path, lockstep=True, dump=dump and str(tmp_path / dump)) as lost:
        lost.hold_until(0.1)
        assert lost.inject("nan", "FR") == (True, "")
        lost.hold_while(lambda: lost.process.poll() is None)
        assert lost.process.returncode == 1
    line = lost.log.read_text().splitlines()[-1]
    assert "simulation stopped: solution lost in step" in line
    (file,) = (tmp_path / dump).glob("lost_*.npz")
    assert line.endswith(f"; its state is in {file}")
    state = np.load(file)
    assert str(state["scene"]) == "flat"
    assert np.isnan(state["before_nodes"]).any(axis=(1, 2)).tolist() == [False, True, False, False]

"""A controller slower than its period skips to the newest state and counts the skipped ones.

Real time: what is skipped is the queue of DDS during a solve.
"""

import os
import signal
import subprocess
import time

import numpy as np
import pytest
import rclpy
from rclpy.context import Context

from slot_bringup.graph import read_graph
from slot_bringup.processes import command_line
from slot_core import config
from slot_core.control.force_map import read_springs
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.gait.gait import read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_msgs.msg import GaitPreview, MpcState, TendonPlan
from slot_nodes import messages, qos
from slot_nodes.process.executor import DirectExecutor

pytestmark = pytest.mark.real_time

GRAPH = read_graph()
DEFAULTS = {argument.name: argument.default for argument in GRAPH.arguments}
NODES = {spec.name: spec for spec in GRAPH.nodes(DEFAULTS)}
SLOW = ["horizon:=100", "solver.name:=clarabel", "acceptance.condition_max:=1e12"]  # some 10 ms
STAGES = {"stages": 100, "dt": 0.001}  # a period shorter than any solve
BURST = 100  # pairs of state and preview, sent within a few cycles


@pytest.fixture
def slow_controller():
    parameters = [argument for value in SLOW for argument in ("-p", value)]
    command = [*command_line(NODES["mpc_controller"]), *parameters]
    child = subprocess.Popen(command, start_new_session=True)
    yield
    os.killpg(child.pid, signal.SIGKILL)
    child.wait()


class Robot:
    """Publishes states with previews; records the forces with their times of publishing."""

    def __init__(self):
        self.context, self.answers = Context(), []
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("robot", context=self.context)
        self.executor = DirectExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.state = self.node.create_publisher(MpcState, "mpc_state", qos.CONTROL)
        self.preview = self.node.create_publisher(GaitPreview, "gait_preview", qos.CONTROL)
        self.node.create_subscription(TendonPlan, "tendon_plan", self.keep, qos.CONTROL)
        springs = read_springs()
        gaits = config.replace(read_gaits(), STAGES)
        self.scheduler = GaitScheduler(gaits, read_robot(), springs, "stand", None)

    def keep(self, message, info):
        self.answers.append((decode.stamp(message), info["source_timestamp"], message))

    def pair(self, number):
        stamp, state = 1_000_000_000 + number * 1_000_000, np.zeros(12)
        state[5] = 0.06
        estimate = Estimate(stamp, state, np.eye(12), Validity.VALID)
        preview = self.scheduler.step(stamp, state)
        return messages.state_to_msg(estimate), messages.preview_to_msg(preview)

    def send(self, pair):
        self.state.publish(pair[0])
        self.preview.publish(pair[1])

    def wait_for(self, pair):
        """Spin until the forces of that pair have come."""
        for _ in range(600):
            if self.answers and self.answers[-1][0] == decode.stamp(pair[0]):
                return
            self.executor.spin_once(timeout_sec=0.1)
        raise AssertionError(("no answer to a pair", len(self.answers)))


@pytest.fixture
def robot():
    robot = Robot()
    yield robot
    robot.node.destroy_node()
    robot.context.try_shutdown()


def test_a_controller_slower_than_its_period_skips_states_without_a_queue(slow_controller, robot):
    first, *burst = (robot.pair(number) for number in range(BURST + 1))
    robot.send(first)
    robot.wait_for(first)
    for pair in burst:
        robot.send(pair)
    sent = time.time_ns()
    robot.wait_for(burst[-1])
    stamps, times, answers = zip(*robot.answers)
    assert list(stamps) == sorted(set(stamps))
    # one solve was running, one may have begun before the last pair arrived; then the newest
    assert sum(answered > sent for answered in times) <= 3
    assert answers[-1].skipped == BURST + 1 - len(answers) > 0
    assert answers[-1].overruns == sum(answer.solve_time > STAGES["dt"] for answer in answers) > 0

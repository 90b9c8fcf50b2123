"""Bags of `--hardware real` replay to the last bit, whatever came first: sensors are processes.

The robot is simulated, with emulated servos on a pseudo-terminal; its odometry and IMU come from a
process each, best effort, as those of a camera's driver.
"""

import dataclasses
import sys
import time
from pathlib import Path

import pytest
from rig import nodes_of

from slot_bringup.processes import command_line
from slot_core.estimation.estimate import Validity
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag

pytestmark = pytest.mark.real_time

SENSORS = ("odom", "imu")
RELAY = Path(__file__).with_name("relay.py")
OUTPUTS = [
    "/mpc_state",
    "/gait_preview",
    "/tendon_plan",
    "/desired_joint_angles",
]
# ticks that are waited for; at least so many are compared
WAITED, TICKS = (90, 30)
PAUSE = 1.0  # s, between the start of the sensors and of the graph


class Robot:
    """A graph of `--hardware real`, and the processes of the robot and of its sensors."""

    def __init__(self, make_rig):
        rig = make_rig(
            only=[], parameters={"supervisor": {"estop_required": False}}
        )
        simulated = rig.specs["sim_robot"]
        renamed = {topic: f"simulated/{topic}" for topic in SENSORS}
        values = {"port": str(rig.bus), "bag": str(rig.directory / "bag")}
        self.rig, self.bag = rig, Path(values["bag"])
        rig.specs = nodes_of(hardware="real", **values)
        self.graph = [*rig.specs]
        rig.specs["sim_robot"] = dataclasses.replace(
            simulated, remappings=renamed
        )
        rig.start("sim_robot")
        rig.wait_for(rig.bus.exists)

    def start_sensors(self, *topics):
        for topic in topics or SENSORS:
            self.rig.spawn(topic, [sys.executable, str(RELAY), topic])

    def start_graph(self):
        self.rig.start(*self.graph)

    def record_more(self, name):
        """Start a second recorder, in mid-run; returns its bag."""
        spec, bag = self.rig.specs["recorder"], self.rig.directory / name
        spec = dataclasses.replace(
            spec, parameters=spec.parameters | {"bag": str(bag)}
        )
        command = [
            word.replace("__node:=recorder", f"__node:={name}")
            for word in command_line(spec)
        ]
        self.rig.spawn(name, command)
        return bag

    def walk(self):
        self.rig.walk_steadily()
        self.wait_for_commands()

    def wait_for_commands(self):
        """Wait for three seconds of commands; key frames come every second at first."""
        begin = self.rig.now()
        self.rig.wait_for(
            lambda: (
                len(self.rig.since("/desired_joint_angles", begin)) >= WAITED
            )
        )

    def wait_for_odometry(self, subscribers):
        """Wait until the only odometry has as many subscribers as there are to be."""
        node, wanted = self.rig.node, (1, subscribers)

        def count():
            return node.count_publishers("/odom"), node.count_subscribers(
                "/odom"
            )

        self.rig.wait_for(lambda: count() == wanted)

    def close(self):
        """End the recorders first, as their bags are to be whole, then the rest."""
        for name in [
            name for name in self.rig.children if name.startswith("rec")
        ]:
            self.rig.stop(name)
        self.rig.close()


def assert_replays(bag):
    """Every stage of the bag is compared, and equal to the last bit."""
    comparisons = check_bag(Bag(bag), 0.0)
    assert [c.topic for c in comparisons] == OUTPUTS
    for comparison in comparisons:
        line = str(comparison)
        assert not comparison.why, line
        assert comparison.first is None, comparison.first
        assert comparison.largest == 0.0, line
        assert comparison.compared >= TICKS, line


def test_a_bag_of_a_real_robot_replays_if_the_graph_starts_before_the_sensors(
    make_rig,
):
    """Sensors that start first: the next test."""
    robot = Robot(make_rig)
    try:
        robot.start_graph()
        robot.rig.wait_for(lambda: robot.rig.messages["/robot_state"])
        time.sleep(PAUSE)
        robot.start_sensors()
        robot.walk()
    finally:
        robot.close()
    assert_replays(robot.bag)


def test_bags_with_a_lost_odometry_and_begun_in_mid_run_replay(make_rig):
    robot = Robot(make_rig)
    try:
        robot.start_sensors()
        robot.start_graph()
        robot.walk()
        heard = robot.rig.node.count_subscribers("/odom")
        late = robot.record_more("recorder_2")
        robot.wait_for_odometry(heard + 1)
        robot.wait_for_commands()
        robot.rig.stop("odom")
        time.sleep(PAUSE)
        robot.start_sensors("odom")
        robot.wait_for_odometry(heard + 1)
        robot.wait_for_commands()
    finally:
        robot.close()
    for bag in (robot.bag, late):
        validity = Bag(bag).series("/mpc_state", "validity")["validity"]
        assert Validity.ODOMETRY_LOST in validity
        assert_replays(bag)
    (states, *_) = check_bag(Bag(late), 0.0)
    assert ", from " in str(states)

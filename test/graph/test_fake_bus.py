"""The graph on emulated servos: the real driver at a pseudo-terminal."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
import rclpy
from graph_bag import read
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

from slot_bringup.graph import read_graph
from slot_bringup.processes import command_line
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.robot import TENDON_JOINTS, read_robot

RUN = [sys.executable, "-m", "slot_bringup", "--hardware", "fake_bus"]


@pytest.fixture(scope="module")
def walk(environment, tmp_path_factory):
    """Bag of a walk of 5 s on emulated servos."""
    bag = tmp_path_factory.mktemp("fake_bus") / "bag"
    done = subprocess.run(
        [*RUN, "--duration", "5", "--seed", "3", "--bag", str(bag)],
        env=environment, capture_output=True, text=True, timeout=150, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return bag


@pytest.fixture(scope="module")
def messages(walk):
    return read(walk)


@contextmanager
def nodes(environment, tmp_path, *names, **options):
    """Nodes of the graph on a fake bus, ended at last; `options`: more parameters by node."""
    graph = read_graph()
    values = {a.name: a.default for a in graph.arguments} | {"hardware": "fake_bus"}
    values["port"] = str(tmp_path / "bus")
    specs = {spec.name: spec for spec in graph.nodes(values)}
    children = {}
    try:
        for name in names:
            more = [word for option in options.get(name, ()) for word in ("-p", option)]
            with (tmp_path / f"{name}.log").open("wb") as log:
                children[name] = subprocess.Popen(
                    [*command_line(specs[name]), *more],
                    env=environment, stdout=log, stderr=log, start_new_session=True,
                )  # fmt: skip
        yield children
    finally:
        for child in children.values():
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGINT)
            try:
                child.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(child.pid, signal.SIGKILL)


def wait_for(condition, limit=60.0):
    """Wait for a condition, at most `limit` seconds."""
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def test_the_robot_walks_on_the_real_driver(messages):
    """Measured 44 mm/s on average; half of that is walking, standing is none of it."""
    truth = [m.pose.pose.position for _, m in messages["/ground_truth/odom"]]
    assert len(truth) > 120
    assert (truth[-1].x - truth[0].x) / (0.033 * len(truth)) > 0.02


def test_the_driver_alone_reports_the_joints(messages):
    limit = read_robot().tendon.angle_max
    assert len(messages["/joint_states"]) > 200
    for _, message in messages["/joint_states"]:
        assert tuple(message.name) == TENDON_JOINTS
        assert np.isfinite([*message.position, *message.velocity, *message.effort]).all()
        assert -0.1 < min(message.position) <= max(message.position) < limit + 0.1
        # the angles of an encoder: whole counts
        counts = (np.array(message.position) * 1.03199 + np.radians(130.0)) / RAD_PER_COUNT
        assert counts == pytest.approx(np.round(counts), abs=1e-6)


def test_diagnostics_tell_of_the_bus_and_of_every_servo(messages):
    _, last = messages["/diagnostics"][-1]
    assert [status.name for status in last.status] == [
        "servo bus", "servo FL (id 5)", "servo FR (id 4)", "servo RL (id 2)", "servo RR (id 3)",
    ]  # fmt: skip
    bus, *servos = ({v.key: v.value for v in status.values} for status in last.status)
    assert bus["action"] == "pass"
    assert float(bus["rate_Hz"]) > 20.0
    for servo in servos:
        assert servo["torque"] == "on"
        assert servo["hardware_errors"] == "none"
        assert float(servo["voltage_V"]) == pytest.approx(11.1, abs=0.05)
        assert 20.0 < float(servo["temperature_C"]) < 40.0


def test_an_interrupted_run_ends_with_torque_off_at_driver_and_servos(walk):
    assert "torque off, confirmed by every servo" in (walk / "log/dynamixel_driver.log").read_text()
    assert "servos left under torque: none" in (walk / "log/sim_robot.log").read_text()


def test_a_servo_of_another_id_is_refused_in_one_line_that_names_it(environment, tmp_path):
    wrong = ["joints.ids:=[5, 4, 2, 9]"]
    names = ("sim_robot", "dynamixel_driver")
    with nodes(environment, tmp_path, *names, dynamixel_driver=wrong) as children:
        assert children["dynamixel_driver"].wait(60) == 1
    lines = (tmp_path / "dynamixel_driver.log").read_text().splitlines()
    told = [line for line in lines if "waiting for" not in line]
    assert len(told) == 1, lines
    assert "servos refused: servo RR (id 9): ping: " in told[0]
    assert "servos left under torque: none" in (tmp_path / "sim_robot.log").read_text()


def test_a_port_that_does_not_come_is_named(environment, tmp_path):
    impatient = ["wait_for_port:=0.5"]
    with nodes(environment, tmp_path, "dynamixel_driver", dynamixel_driver=impatient) as children:
        assert children["dynamixel_driver"].wait(30) == 1
    last = (tmp_path / "dynamixel_driver.log").read_text().splitlines()[-1]
    assert f"servos refused: {tmp_path}/bus: " in last


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_driver_that_is_asked_to_end_switches_the_servos_off(environment, tmp_path, number):
    log = tmp_path / "dynamixel_driver.log"
    with nodes(environment, tmp_path, "sim_robot", "dynamixel_driver") as children:
        driver = children["dynamixel_driver"]
        wait_for(lambda: "torque on" in log.read_text() or driver.poll() is not None)
        driver.send_signal(number)
        assert driver.wait(20) == 0, log.read_text()
        assert "torque off, confirmed by every servo" in log.read_text()
    assert "servos left under torque: none" in (tmp_path / "sim_robot.log").read_text()


def test_the_torque_service_slackens_and_brings_torque_back(environment, tmp_path):
    log = tmp_path / "dynamixel_driver.log"
    with (
        nodes(environment, tmp_path, "sim_robot", "dynamixel_driver") as children,
        torque_client() as switch,
    ):
        alive = children["dynamixel_driver"].poll
        wait_for(lambda: "torque on" in log.read_text() or alive() is not None)
        assert switch(True) == (False, "activate: torque is on already")
        assert switch(False) == (True, "slackening, then torque off")
        wait_for(lambda: "OFF torque off, after: torque switched off" in log.read_text())
        assert switch(True) == (True, "torque on")


@contextmanager
def torque_client():
    """A function that calls the torque service and returns success and message."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("operator", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(SetBool, "/dynamixel_driver/torque")

    def switch(on):
        assert client.wait_for_service(30.0)
        future = client.call_async(SetBool.Request(data=on))
        executor.spin_until_future_complete(future, 20.0)
        return future.result().success, future.result().message

    try:
        yield switch
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize("hardware", ["fake_bus", "real"])
def test_lockstep_with_servos_is_refused_in_one_line(hardware):
    done = subprocess.run(
        [*RUN, "--hardware", hardware, "--lockstep"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    told = f"scripts/run: --lockstep: servos of --hardware {hardware} move in real time\n"
    assert done.stderr == told

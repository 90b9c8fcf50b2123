"""Messages of the graph from the events of a played robot: to draw it, and to save a bag."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

from slot_bringup.playing.robot_display import Named
from slot_core.clock import LOCKSTEP_START
from slot_core.control.controller import Tick
from slot_core.control.pace import Pace
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.message_types import message_types
from slot_core.recording.origin import origin_here
from slot_core.recording.record_settings import read_record_settings
from slot_core.safety.supervisor import Report
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.readings import (
    ImuReading,
    OdometryReading,
    StampedHealth,
    TrueState,
)
from slot_lab.play.played_robot import Happened, PlayedRobot
from slot_nodes import messages

DRAWN = (TrueState, Tick, JointReading, Report)
PACE = Pace()  # without overruns: the robot's clock waits


def of_frame(happened: Iterable[Happened]) -> Iterator[Named]:
    """Messages for the drawing, from the newest value of each kind in a frame."""
    newest = {type(value): (time, value) for time, value in happened}
    for kind in DRAWN:
        if kind in newest:
            yield from encoded(*newest[kind])


def encoded(stamp: int, value: Any) -> Iterator[Named]:
    """Messages of a reading, tick or report at `stamp` (ns) on the robot's clock."""
    yield from _ENCODE[type(value)](stamp, value)


def _of_truth(_: int, truth: TrueState) -> Iterator[Named]:
    yield "/ground_truth/odom", messages.odometry_to_msg(truth.odometry)
    yield "/ground_truth/legs", messages.legs_to_msg(truth)


def _of_tick(_: int, tick: Tick) -> Iterator[Named]:
    stamp, command = tick.estimate.stamp, tick.command
    yield "/mpc_state", messages.state_to_msg(tick.estimate)
    yield "/gait_preview", messages.preview_to_msg(tick.preview)
    yield "/tendon_plan", messages.plan_to_msg(tick.plan, tick.preview, 0.0, PACE)
    yield (
        "/desired_joint_angles",
        messages.command_to_msg(stamp, command.angle, command.rate),
    )
    yield "/force_map/status", messages.map_status_to_msg(stamp, command)


def _of_health(stamp: int, report: StampedHealth) -> Iterator[Named]:
    if report.health is not None:
        yield "/servo_health", messages.health_to_msg(stamp, report.health)


_ENCODE: dict[type, Callable[[int, Any], Iterable[Named]]] = {
    TrueState: _of_truth,
    Tick: _of_tick,
    StampedHealth: _of_health,
    OdometryReading: lambda _, odom: [("/odom", messages.odometry_to_msg(odom))],
    ImuReading: lambda _, imu: [("/imu", messages.imu_to_msg(imu))],
    JointReading: lambda _, joints: [("/joint_states", messages.joints_to_msg(joints))],
    Report: lambda now, report: [
        ("/robot_state", messages.robot_state_to_msg(now, report))
    ],
}


def save(robot: PlayedRobot, path: Path) -> int:
    """Save the events of the robot as a bag; returns the number of messages.

    Changes of robot and scene are named in the bag. Raises BagError.
    """
    about = {"scene": robot.scene, "policy": robot.policy} | robot.changes
    begin, settings = time.time_ns() - round(1e9 * robot.time), read_record_settings()
    types = message_types()
    with BagWriter(path, settings, origin_here(about)) as bag:
        count = 0
        for stamp, value in robot.history:
            for topic, message in encoded(stamp, value):
                kind = settings.topics[topic].type
                # rclpy adds some bytes to a message with an empty sequence of doubles
                size = 4 + types.get_msgdef(kind).getsize_cdr(0, message, types)
                data = serialize_message(message)[:size]
                bag.write(topic, kind, begin + stamp - LOCKSTEP_START, data)
                count += 1
    return count

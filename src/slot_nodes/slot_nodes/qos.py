"""Quality of service of the graph's topics.

All topics but `/clock` are reliable, because lockstep runs and replays must not lose a message.
Cameras, IMUs and visual SLAMs often publish best effort, which a reliable subscription does not
receive: with real servos the subscriptions to `/odom`, `/imu` and the camera are best effort, by
the parameter `best_effort_sensors`; those to `/cmd_vel` and `/body_pose` declare `qos_overrides`
parameters.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.recording.record_settings import RecordedTopic


def _profile(
    depth: int,
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
) -> QoSProfile:
    return QoSProfile(
        reliability=reliability,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


SENSOR = _profile(200)
"""Measurements and commands from outside; a late subscriber receives only new messages."""

CONTROL = _profile(50, DurabilityPolicy.TRANSIENT_LOCAL)
"""Topics of the controller; a late subscriber also receives the last messages, so that the first
tick of a run reaches every node and the bag in any order of discovery."""

IMAGE = _profile(2)
"""Images of a camera, some megabytes each: a slow subscriber gets the newest."""

STATE = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Values that hold until they are replaced; only the newest counts. With it a slow subscriber to a
topic of the controller drops older messages in place of a queue."""

CLOCK = _profile(1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Profile with which rclpy subscribes to /clock."""


def best_effort(profile: QoSProfile) -> QoSProfile:
    """The profile without reliability: it receives from every publisher and may lose messages."""
    changed = copy(profile)
    changed.reliability = ReliabilityPolicy.BEST_EFFORT
    return changed


def recorded(topic: RecordedTopic, depth: int) -> QoSProfile:
    """Profile of a subscription to a topic of `config/record.yaml`."""
    return _profile(
        depth,
        DurabilityPolicy[topic.durability.upper()],
        ReliabilityPolicy[topic.reliability.upper()],
    )

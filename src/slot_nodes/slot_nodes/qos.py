"""Quality of service of the graph's topics, named once.

All data are reliable: lockstep runs and replays must not lose a message. A sensor that publishes
best effort is matched by the `qos_overrides` parameters that every sensor subscription declares.
"""

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

SENSOR = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
    history=HistoryPolicy.KEEP_LAST,
    depth=200,
)
"""Measurements and commands from outside: a late subscriber gets what comes next."""

CONTROL = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST,
    depth=50,
)
"""What the controller passes on: a late subscriber gets the last values too, so that the first
tick of a run reaches every node and the bag whatever the order of discovery."""

STATE = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
)
"""What holds until it is replaced: only the newest counts. A slow subscriber to what the controller
passes on drops the older with it, instead of a queue."""

CLOCK = QoSProfile(
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
)
"""As rclpy subscribes to /clock."""

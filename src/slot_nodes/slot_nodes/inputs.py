"""Input checks of the nodes: an unusable message is dropped, with one line that says why."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from slot_core.clock import to_seconds
from slot_core.gait.gait import GaitPreview
from slot_core.messages import decode
from slot_core.robot import LEGS
from slot_msgs.msg import RobotState, ServoLimits
from slot_nodes import qos, runtime
from slot_nodes.process import intra_process
from slot_nodes.process.executor import PolledGroup

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.safety.watchdog import Watchdog

UNKNOWN = "UNKNOWN"  # in the name of a node that DDS tells a moment later


def subscribe(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[..., None],
    profile: QoSProfile,
    *,
    overridable: bool = False,
    numbered: bool = False,
    group: PolledGroup | None = None,
) -> Subscription | None:
    """Subscribe; a ValueError of the callback drops the message.

    It is logged once a second. overridable: whether parameters can override the quality of service.
    numbered: whether the callback also gets the number of the message on its topic. group: see
    `PassiveSubscriptions`. Returns None for a topic that a node of the same process publishes: its
    messages come without DDS. Where that node is made later, the subscription that is returned is
    destroyed then.
    """

    def receive(message: Any, number: int = 0) -> None:
        try:
            callback(message, number) if numbered else callback(message)
        except ValueError as error:
            node.get_logger().warning(
                f"{topic} refused: {error}", throttle_duration_sec=1.0
            )

    name = node.resolve_topic_name(topic)
    if intra_process.subscribe(name, receive, profile):
        return None
    overriding = (
        QoSOverridingOptions.with_default_policies() if overridable else None
    )
    take = _with_number(receive) if numbered else receive
    made = node.create_subscription(
        kind,
        topic,
        take,
        profile,
        qos_overriding_options=overriding,
        callback_group=group,
    )
    intra_process.subscribe_later(
        name, receive, profile, lambda: node.destroy_subscription(made)
    )
    return made


def sensor_profile(node: Node, profile: QoSProfile) -> QoSProfile:
    """Declare the parameter `best_effort_sensors`; return the profile, or its best effort."""
    wanted = runtime.declare(
        node,
        "best_effort_sensors",
        False,
        "receive from sensors that publish best effort too",
    )
    return qos.best_effort(profile) if wanted else profile


def _with_number(receive: Callable[[Any, int], None]) -> Any:
    """Callback with two arguments, to which rclpy passes the message's metadata too."""
    return lambda message, info: receive(
        message, info["publication_sequence_number"]
    )


def process_received(subscription: Subscription | None) -> None:
    """Process the messages that a subscription has received now, before the executor would."""
    while subscription and (
        taken := subscription.handle.take_message(
            subscription.msg_type, subscription.raw
        )
    ):
        subscription.callback(taken[0])


class PassiveSubscriptions:
    """Subscriptions whose messages do not wake the node: it processes them when it calls `take`.

    A node that only needs them with another message, or with its next step, leaves the processor to
    those who work for the command meanwhile.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._group = node, PolledGroup()
        self._subscriptions: list[Subscription | None] = []

    def subscribe(
        self,
        kind: type,
        topic: str,
        callback: Callable[..., None],
        profile: QoSProfile,
    ) -> Subscription | None:
        """Subscribe as `inputs.subscribe`; messages of the same process come at once."""
        made = subscribe(
            self._node, kind, topic, callback, profile, group=self._group
        )
        self._subscriptions.append(made)
        return made

    def take(self) -> None:
        """Process the messages received so far."""
        for subscription in self._subscriptions:
            process_received(subscription)

    def wake_on_message(self, awaited: bool) -> None:
        """Let the node wake for the messages while they are `awaited`."""
        self._group.awaited = awaited


def require_finite(name: str, values: Any) -> None:
    """Raise ValueError, which names the first element that is infinite or NaN."""
    array = np.asarray(values, dtype=float)
    finite = np.isfinite(array)
    if not finite.all():
        index = np.argwhere(~finite)[0]
        place = ", ".join(str(int(i)) for i in index)
        raise ValueError(
            f"{name}[{place}] = {array[tuple(index)]}: expected a finite number"
        )


def require_present(stamp: int, now: int, limit: float) -> None:
    """Raise ValueError for a stamp (ns) of another clock, more than `limit` (s) from `now` (ns)."""
    off = to_seconds(stamp - now)
    if abs(off) > limit:
        raise ValueError(f"stamped {off:+.3g} s from now, limit {limit:g} s")


def require_sole_publisher(
    node: Node, topic: str, relax: Callable[[str], None]
) -> None:
    """Raise ValueError, and let the servos relax, if several nodes publish the topic.

    Both get one line that names the nodes.
    """
    if line := second_publisher(node, topic):
        relax(line)
        raise ValueError(line)


def second_publisher(node: Node, topic: str) -> str:
    """One line that names the nodes if several publish the topic, or "".

    DDS lists a killed node for another 20 s.
    """
    name = node.resolve_topic_name(topic)
    if node.count_publishers(name) < 2:
        return ""
    nodes = sorted(map(full_name, node.get_publishers_info_by_topic(name)))
    return f"{name} has {len(nodes)} publishers, limit 1: {', '.join(nodes)}"


def full_name(endpoint: TopicEndpointInfo) -> str:
    """Name of the node of a publisher, with its namespace."""
    if UNKNOWN in endpoint.node_name:
        return "a new node"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def require_supervisor(
    node: Node, message: RobotState, now: int, watchdog: Watchdog
) -> None:
    """Raise ValueError for a HOLD or PASS that may not be of the supervisor that runs.

    Another node publishes the topic too, or the stamp is far from `now` (ns): the latched state of
    a supervisor that is gone. RELAX and OFF are always accepted.
    """
    if message.action in (RobotState.ACTION_HOLD, RobotState.ACTION_PASS):
        require_sole_publisher(node, "robot_state", watchdog.relax)
        require_present(decode.stamp(message), now, watchdog.clock_jump)


def take_limits(node: Node, watchdog: Watchdog, message: ServoLimits) -> None:
    """Take the limits of the servos; raises ValueError as `require_sole_publisher`."""
    require_sole_publisher(node, "servo_limits", watchdog.relax)
    watchdog.set_limits(decode.servo_limits(message))


def require_nominal(preview: GaitPreview) -> None:
    """Raise ValueError unless the preview has stages with finite angles and loads of all legs."""
    if not preview.dt > 0.0:  # NaN is not
        raise ValueError(f"dt = {preview.dt:g}: expected above 0")
    require_finite("reference", preview.reference)
    for name in ("tendon_angle", "normal_force"):
        rows = getattr(preview, name)
        if rows.shape[1] != len(LEGS):
            raise ValueError(
                f"{name}: {rows.shape[1]} a stage, expected {len(LEGS)}"
            )
        require_finite(name, rows)


class TimeSynchronizer:
    """Collects one item per topic and stamp; a set is complete when every topic has an item.

    At most `depth` incomplete sets are kept; the oldest by arrival is dropped first. So a lost
    message costs one tick, and a clock that is set back needs no special treatment.
    """

    def __init__(self, *topics: str, depth: int = 50):
        self._topics, self._depth = topics, depth
        self._sets: dict[int, dict[str, Any]] = {}

    def add(self, topic: str, stamp: int, item: Any) -> tuple[Any, ...] | None:
        """Add an item; return the set of its stamp, in the order of the topics, once complete."""
        items = self._sets.setdefault(stamp, {})
        items[topic] = item
        if len(items) == len(self._topics):
            del self._sets[stamp]
            return tuple(items[t] for t in self._topics)
        if len(self._sets) > self._depth:
            del self._sets[next(iter(self._sets))]
        return None

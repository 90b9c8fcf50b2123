"""Input checks of the nodes: an unusable message is dropped, with one line that says why."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from slot_core.control.gait import GaitPreview
from slot_core.robot import LEGS


def subscribe(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[[Any], None],
    profile: QoSProfile,
    *,
    overridable: bool = False,
) -> Subscription:
    """Subscribe; a ValueError of the callback drops the message and is logged once a second.

    overridable: whether parameters can override the quality of service.
    """

    def receive(message: Any) -> None:
        try:
            callback(message)
        except ValueError as error:
            node.get_logger().warning(f"{topic} refused: {error}", throttle_duration_sec=1.0)

    overriding = QoSOverridingOptions.with_default_policies() if overridable else None
    return node.create_subscription(
        kind, topic, receive, profile, qos_overriding_options=overriding
    )


def take_waiting(subscription: Subscription) -> None:
    """Process now what a subscription has received, before the executor would."""
    while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
        subscription.callback(taken[0])


def require_finite(name: str, values: Any) -> None:
    """Raise ValueError, which names the first element that is infinite or NaN."""
    array = np.asarray(values, dtype=float)
    finite = np.isfinite(array)
    if not finite.all():
        index = np.argwhere(~finite)[0]
        place = ", ".join(str(int(i)) for i in index)
        raise ValueError(f"{name}[{place}] = {array[tuple(index)]}: expected a finite number")


def require_present(stamp: int, now: int, limit: float) -> None:
    """Raise ValueError for a stamp (ns) of another clock, more than `limit` (s) from `now` (ns)."""
    off = (stamp - now) * 1e-9
    if abs(off) > limit:
        raise ValueError(f"stamped {off:+.3g} s from now, limit {limit:g} s")


def require_nominal(preview: GaitPreview) -> None:
    """Raise ValueError unless the preview has finite tendon angles and loads of all legs."""
    require_finite("reference", preview.reference)
    for name in ("tendon_angle", "normal_force"):
        rows = getattr(preview, name)
        if rows.shape[1] != len(LEGS):
            raise ValueError(f"{name}: {rows.shape[1]} a stage, expected {len(LEGS)}")
        require_finite(name, rows)

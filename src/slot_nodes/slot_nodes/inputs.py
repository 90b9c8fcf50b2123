"""What a node takes in: a message that its core cannot use is dropped, with one line on why."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile

from slot_core.control.gait import GaitPreview
from slot_core.robot import LEGS


def subscribe(
    node: Node, kind: type, topic: str, callback: Callable[[Any], None], profile: QoSProfile
) -> None:
    """Subscribe with a callback that raises ValueError for a message it refuses."""

    def take(message: Any) -> None:
        try:
            callback(message)
        except ValueError as error:
            node.get_logger().warning(f"{topic} refused: {error}", throttle_duration_sec=1.0)

    node.create_subscription(kind, topic, take, profile)


def require_finite(name: str, values: Any) -> None:
    """Raise ValueError naming the first element that is infinite or no number."""
    array = np.asarray(values, dtype=float)
    finite = np.isfinite(array)
    if not finite.all():
        lost = np.argwhere(~finite)[0]
        place = ", ".join(str(int(i)) for i in lost)
        raise ValueError(f"{name}[{place}] = {array[tuple(lost)]}: expected a finite number")


def require_present(stamp: int, now: int, limit: float) -> None:
    """Raise ValueError for another clock's stamp: further than `limit` (s) from `now`; both ns."""
    off = (stamp - now) * 1e-9
    if abs(off) > limit:
        raise ValueError(f"stamped {off:+.3g} s from now, limit {limit:g} s")


def require_nominal(preview: GaitPreview) -> None:
    """Raise ValueError unless the preview has finite angles and loads of every leg."""
    for name in ("tendon_angle", "normal_force"):
        rows = getattr(preview, name)
        if rows.shape[1] != len(LEGS):
            raise ValueError(f"{name}: {rows.shape[1]} a stage, expected {len(LEGS)}")
        require_finite(name, rows)

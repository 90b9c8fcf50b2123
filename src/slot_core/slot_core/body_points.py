"""Points of torso and legs that are tracked: their names, and their places along a leg."""

from __future__ import annotations

import numpy as np

from slot_core.robot import LEGS, Array

TORSO = "torso"
LEG_POINTS = {
    "base": 0.0,
    "third": 1 / 3,
    "two_thirds": 2 / 3,
    "tip": 1.0,
}  # share of arc length
BODY_POINTS = (*(f"{leg}_{name}" for leg in LEGS for name in LEG_POINTS), TORSO)
LEAST_NODES = (
    4  # of a leg with points along it; the tabulated robot's have two, clamp and foot
)
COLUMNS = ("time", "point", "x", "y", "z")  # of a CSV file: s, m
FRAME = "frame: "  # begins the comment of a CSV file that names its frame


def arc_length(nodes: Array) -> Array:
    """(N,) m from the first of nodes (N, 3) along the line through them."""
    return np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))]
    )


def at_shares(nodes: Array, values: Array | None = None) -> Array:
    """(4, 3) values (N, 3) at LEG_POINTS of a leg of nodes (N, 3); by default their places."""
    arc = arc_length(nodes)
    shares = np.array(list(LEG_POINTS.values())) * arc[-1]
    columns = (nodes if values is None else values).T
    return np.column_stack([np.interp(shares, arc, column) for column in columns])

"""Predicted places of torso and legs as CSV: `time,point,x,y,z`, as scripts/validate reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slot_core.progress import Tell, untold
from slot_core.robot import LEAST_NODES, LEG_POINTS, LEGS, TORSO, at_shares
from slot_lab.twin.prediction import ModelParts, simulate
from slot_lab.twin.recorded import BagRecording
from slot_lab.twin.settings import TwinSettings
from slot_lab.validation.recording import write_points

PERIOD = 1 / 30  # s, between two rows of a point


def write(
    recorded: BagRecording,
    parts: ModelParts,
    settings: TwinSettings,
    path: Path,
    tell: Tell = untold,
) -> None:
    """Write the predicted places of torso and leg points at 30 Hz; raises OSError.

    Legs of fewer than LEAST_NODES nodes have no points.
    """
    rows: dict[str, list[tuple[float, ...]]] = {}
    due = -np.inf
    for t, sim in simulate(recorded, parts, settings, tell):
        if t < due:
            continue
        due = t + PERIOD - settings.hold / 2
        rows.setdefault(TORSO, []).append((t, *sim.position))
        if sim.nodes.shape[1] < LEAST_NODES:
            continue
        for leg, nodes in zip(LEGS, sim.nodes):
            for name, place in zip(LEG_POINTS, at_shares(nodes)):
                rows.setdefault(f"{leg}_{name}", []).append((t, *place))
    points = {name: np.array(part) for name, part in rows.items()}
    write_points(path, points, ["Predicted by scripts/twin"])

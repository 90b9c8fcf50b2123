"""Gait alone: the policy that passes on the angles and forces of the gait."""

from __future__ import annotations

import numpy as np

from slot_core.arrays import Array
from slot_core.control.policy import Policy, TendonPlan
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview, first_rate
from slot_core.key_frame import StateParts


class GaitAlone(Policy):
    """Tendon angles of the gait: open loop."""

    STATE = StateParts()

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The angles and normal forces of the preview."""
        return gait_plan(preview)


def gait_plan(preview: GaitPreview, change: Array | float = 0.0) -> TendonPlan:
    """The angles of a preview, changed by `change` (n, 4), rad, and its normal forces."""
    angle, force = (
        preview.tendon_angle + change,
        np.zeros((*preview.normal_force.shape, 3)),
    )
    force[..., 2] = preview.normal_force
    return TendonPlan(angle, first_rate(angle, preview.dt), force)

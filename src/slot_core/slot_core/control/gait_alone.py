"""Gait alone: the policy that passes on the angles and forces of the gait."""

from __future__ import annotations

import numpy as np

from slot_core.control.policy import Policy, TendonPlan
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview


class GaitAlone(Policy):
    """Tendon angles of the gait; the gait scheduler still has its feedback once a stride."""

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The angles and normal forces of the preview."""
        force = np.zeros((*preview.normal_force.shape, 3))
        force[..., 2] = preview.normal_force
        return TendonPlan(preview.tendon_angle, preview.rate, force)

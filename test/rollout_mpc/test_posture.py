"""Postures under the rollout MPC: the torso stays at the commanded height."""

import numpy as np
import pytest

from slot_core.simulation.closed_loop import ClosedLoop


@pytest.mark.parametrize("friction", [0.2, 0.4])
def test_a_raised_torso_does_not_sink(friction):
    """Before it sank by 10 mm, since the slopes of feet that stick lead astray."""
    changes = {
        "scene.floor.friction": [friction] * 4,
        "scene.floor.friction_other": [friction] * 4,
    }
    loop = ClosedLoop("flat", "stand", None, 0, changes=changes)
    loop.controller.scheduler.set_pose(np.array([0.05, 0.0, 0.0]))
    heights = [loop.plant.robot.position[2] for _ in loop.run(300)]
    assert heights[180:] == pytest.approx(np.full(120, 0.05), abs=2e-3)

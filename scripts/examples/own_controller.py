"""A user's controller: the angles of the gait, and springs that hold the torso's corners up.

Here it walks in one process under a payload of 0.3 kg; the whole graph walks with it by
`scripts/run --policy scripts/examples/own_controller.py`.
"""

import numpy as np

from slot_core.control.policy import Policy, TendonPlan
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop

ROBOT = read_robot()
GAIN = 20.0  # rad/m: a tendon is wound by so much where its clamp is too low


class HoldsHeight(Policy):
    """Winds the tendons of a corner that is too low."""

    def step(self, estimate, preview):
        """The plan for an estimated state and the preview of the gait."""
        heights = [
            ROBOT.clamp_heights(x[5], x[0], x[1])
            for x in (preview.reference[0], estimate.state)
        ]
        angle = preview.tendon_angle + GAIN * (heights[0] - heights[1])
        return TendonPlan(angle, preview.rate, np.zeros((*angle.shape, 3)))


POLICY = HoldsHeight

if __name__ == "__main__":
    for policy in (__file__, "gait_alone"):
        loop = ClosedLoop(
            "flat",
            "stand",
            None,
            1,
            policy,
            changes={"scene.payload.mass": 0.3},
        )
        height = [loop.plant.robot.position[2] for _ in loop.run(150)]
        print(f"{policy}: {1e3 * height[-1]:.1f} mm high, 40 mm commanded")

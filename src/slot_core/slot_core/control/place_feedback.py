"""Place feedback: the policy that corrects the place by the amplitudes of the stride every tick.

It needs no model of the robot. With the distance e of the reference place from the robot, in the
heading frame and without the gait's own sway, the amplitudes belong to the velocity

    V_k + clip(gain e, +-change_max),

so that the angles differ from the gait's by the difference of its tables. A turn in place stays one,
of at most amplitude one.
"""

from dataclasses import dataclass

import numpy as np

from slot_core import config
from slot_core.config import quantity
from slot_core.control.policy import Policy, TendonPlan, Timer, gait_plan
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview, Vector3, read_gaits
from slot_core.geometry import rotate, wrapped
from slot_core.key_frame import StateParts
from slot_core.robot import RobotParameters


@dataclass(frozen=True)
class PlaceSettings:
    """Settings of `config/place.yaml`."""

    gain: Vector3 = quantity(
        "change of the velocity per error of x, y and yaw", "1/s", 0, 100
    )
    change_max: Vector3 = quantity(
        "largest change of v_x, v_y and yaw rate", "SI", 0, 1
    )


class PlaceFeedback(Policy):
    """Amplitudes from the error of the place."""

    STATE = StateParts()

    def __init__(
        self, robot: RobotParameters, settings: PlaceSettings, timer: Timer
    ):
        """Take the gain; raises ConfigError for gaits that cannot be read."""
        self._settings, self._strides = settings, read_gaits().strides

    @staticmethod
    def read_settings(name: str) -> PlaceSettings:
        """`config/place.yaml`; raises ConfigError."""
        return config.read(PlaceSettings, name)

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The gait's angles, with amplitudes that bring the robot to its place."""
        stride = self._strides.get(preview.gait)
        if (
            stride is None
            or not preview.corrected
            or not np.isfinite(estimate.state).all()
        ):
            return gait_plan(preview)
        phase = preview.phases
        table = stride.stride_table(phase, preview.velocity_ahead)
        state, reference = estimate.state, preview.reference[0]
        gap = rotate(reference[3:5] - state[3:5], -state[2])
        # without the gait's own sway
        error = np.append(
            gap - table[0, 11:13], wrapped(reference[2] - state[2])
        )
        most = np.array(self._settings.change_max)
        change = np.clip(np.array(self._settings.gain) * error, -most, most)
        velocity = preview.velocity_ahead + change
        if preview.in_place:
            # a walk would turn by its steering alone; a larger turn lies on its belly
            velocity = np.clip(
                velocity, (0, 0, -stride.turn.speed), (0, 0, stride.turn.speed)
            )
        turned = stride.stride_table(phase, velocity)
        return gait_plan(preview, turned[:, :4] - table[:, :4])

"""Stride feedback, a rival policy: amplitudes and offsets from the means of the last stride.

At the end of every stride its mean velocity, height, roll and pitch are compared with the commands.
With the errors e (6,) and the effect J (6, 6) of the corrections on them, identified on the
simulated robot, the corrections k change by the solution of

    min |S (J dk - e / 2)|^2 + |r dk / k_max|^2,    |k + dk| <= k_max,    S = 1 / SCALE.

They change the velocity that sets the amplitudes, and offset the angles of all legs, left against
right, and front against rear. Half the distance of the reference place counts as a velocity error.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from slot_core.control.gait_alone import gait_plan
from slot_core.control.place_feedback import place_error
from slot_core.control.policy import Policy, TendonPlan, Timer
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview, Stride, read_gaits
from slot_core.gait.reference import mean_velocity
from slot_core.robot import Array, RobotParameters

# Signs of the offsets common, left-right and front-rear at the legs FL FR RL RR.
OFFSET_SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1]], dtype=float)
COMPLETE = 0.9  # share of the period from which a row of ticks is a stride
GAIN, PLACE_GAIN, REGULAR = 0.5, 0.5, 0.1
OFFSET_MAX = np.radians(25.0)
LIMIT = np.array([0.05, 0.05, 0.1, OFFSET_MAX, OFFSET_MAX, OFFSET_MAX])
SCALE = np.array([0.01, 0.01, 0.03, 0.003, 0.01, 0.01])
# Of the corrections v_x, v_y, yaw rate, common, left-right, front-rear on the means.
EFFECT = np.diag([1.0, 1.0, 1.0, 0.053, 0.44, -0.35])
EFFECT[0, 3], EFFECT[2, 4] = 0.1, -0.41


class StrideFeedback(Policy):
    """The gait's angles with corrections that change once a stride."""

    def __init__(self, robot: RobotParameters, settings: Any, timer: Timer):
        """Start without corrections."""
        gaits = read_gaits()
        self._strides, self._blend = gaits.strides, gaits.transition
        self.reset()

    def reset(self) -> None:
        """Forget the corrections."""
        self.corrections = np.zeros(6)
        self._forget()

    def _forget(self) -> None:
        """Forget the stride so far."""
        self._ticks = 0  # since the stride began
        self._rows: list[Array] = []  # time (s), state (12,), place error (3,) of its ticks
        self._phase = 0.0

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The gait's angles, changed by the corrections."""
        stride = self._strides.get(preview.gait)
        if stride is None or not preview.corrected or not preview.velocity_ahead[0].any():
            self._forget()
            return gait_plan(preview)
        self._ticks += 1
        phase = preview.phases
        table = stride.stride_table(phase, preview.velocity_ahead)
        gap = place_error(estimate.state, preview.reference[0], table[0, 11:13])
        if self._ticks * preview.dt > self._blend:
            self._rows.append(np.concatenate([[1e-9 * estimate.time], estimate.state, gap]))
        if preview.phase < self._phase and self._rows:
            self._finish(stride, preview)
        self._phase = preview.phase
        velocity, offset = self.corrections[:3], self.corrections[3:] @ OFFSET_SIGNS
        corrected = stride.stride_table(phase, preview.velocity_ahead + velocity, offset)
        return gait_plan(preview, corrected[:, :4] - table[:, :4])

    def _finish(self, stride: Stride, preview: GaitPreview) -> None:
        """Correct the corrections by the means of a stride, if it is complete."""
        rows, self._rows = np.array(self._rows), self._rows[-1:]
        if len(rows) < 3 or rows[-1, 0] - rows[0, 0] < COMPLETE * stride.period:
            return
        velocity = preview.velocity_ahead[0]
        wanted = velocity + np.clip(PLACE_GAIN * rows[:, 13:].mean(axis=0), -SCALE[:3], SCALE[:3])
        moved = mean_velocity(rows[:, 0], rows[:, [4, 5, 3]])
        posture = preview.command.pose + stride.mean_posture(velocity)
        posture -= rows[:-1, [6, 1, 2]].mean(axis=0)
        self._correct(np.concatenate([wanted - moved, posture]), stride.walking(velocity))

    def _correct(self, error: Array, walking: float) -> None:
        """Solve for the change of the corrections, in units of their limits."""
        limit = LIMIT * np.maximum([walking, walking, 1, 1, 1, 1], 1e-6)
        matrix = np.vstack([EFFECT * limit / SCALE[:, None], REGULAR * np.eye(6)])
        wanted = np.concatenate([GAIN * error / SCALE, np.zeros(6)])
        now = np.clip(self.corrections / limit, -1.0, 1.0)
        change = lsq_linear(matrix, wanted, (-1.0 - now - 1e-9, 1.0 - now + 1e-9)).x
        self.corrections = (now + change).clip(-1.0, 1.0) * limit


POLICY = StrideFeedback

"""Feedback once a stride: velocity, place, heading and posture by amplitudes and offsets.

The gait's angles alone do not reject disturbances: friction, payload, a slope or a wrong stiffness
change speed, heading and height. At the end of every stride its means are compared with the
commands. With the errors e (6,) and the effect J (6, 6) of the corrections (`FeedbackSettings`),
identified on the simulated robot, the corrections k change by the solution of

    min |S (J dk - gain e)|^2 + regularisation^2 |dk / k_max|^2,    |k + dk| <= k_max,

S = 1 / scale. The increments make it an integral controller; the bounds are part of the problem, so
that it does not wind up. The reference place moves with the commanded velocity, never further than
`lead` from the robot; its distance, times a gain, is added to the commanded velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from slot_core.gait.gait import FeedbackSettings, Stride
from slot_core.gait.reference import mean_velocity
from slot_core.geometry import rotate, wrapped
from slot_core.robot import Array

VELOCITY, OFFSETS = slice(0, 3), slice(3, 6)
# Signs of the offsets common, left-right and front-rear at the legs FL FR RL RR.
OFFSET_SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1]], dtype=float)
WHOLE_STRIDE_SHARE = 0.9  # share of the period from which a row of ticks is a stride


@dataclass(frozen=True)
class Target:
    """Commanded velocity in base_link, and the posture of the torso that a stride is to have."""

    velocity: Array  # (3,) v_x, v_y m/s, yaw rate rad/s
    posture: Array  # (3,) height m, roll, pitch rad, the stride's own means included
    walking: float  # share of the bounds on changes of v_x and v_y; 0: it turns in place


class StrideFeedback:
    """Reference place and corrections of a stride."""

    def __init__(self, stride: Stride):
        """Start without corrections."""
        self._settings: FeedbackSettings = stride.feedback
        self._shortest = WHOLE_STRIDE_SHARE * stride.period  # s
        self._effect = np.array(self._settings.effect, dtype=float)
        self._scale = np.array(self._settings.scale, dtype=float)
        offset = np.radians(self._settings.offset_max_deg)
        self._limit = np.array([*self._settings.velocity_max, offset, offset, offset])
        self.corrections = np.zeros(6)
        self.place: Array | None = None  # (3,) x, y (m), yaw (rad) of the reference, in odom
        self._rows: list[Array] = []  # stamp (s) and state (13,) of the ticks of this stride
        self._gap: list[Array] = []  # (3,) reference place minus the robot's, heading frame

    @property
    def offset(self) -> Array:
        """Offsets (4,) of the tendon angles, rad."""
        return self.corrections[OFFSETS] @ OFFSET_SIGNS

    @property
    def velocity(self) -> Array:
        """Change (3,) of the velocity that sets the amplitudes."""
        return self.corrections[VELOCITY]

    def reset(self) -> None:
        """Forget the stride so far and the reference place; the corrections stay."""
        self.place = None
        self.forget_stride()

    def forget_stride(self) -> None:
        """Forget the stride so far; the reference place stays."""
        self._rows, self._gap = [], []

    def move(self, dt: float, state: Array, velocity: Array) -> None:
        """Move the reference place over dt (s) with a velocity (3,) in its heading frame.

        It starts at the robot.
        """
        if self.place is None:
            self.place = state[[3, 4, 2]].copy()
            return
        step = rotate(velocity[:2], self.place[2])
        self.place = self.place + dt * np.append(step, velocity[2])
        self.limit_lead(state)

    def limit_lead(self, state: Array) -> None:
        """Move the reference place to within `lead` and `heading_lead` of the robot."""
        assert self.place is not None
        gap = self.place[:2] - state[3:5]
        distance = float(np.hypot(*gap))
        if distance > self._settings.lead:
            self.place[:2] = state[3:5] + gap * (self._settings.lead / distance)
        angle = wrapped(self.place[2] - state[2])
        lead = self._settings.heading_lead
        self.place[2] = state[2] + float(np.clip(angle, -lead, lead))

    def add(self, time: float, state: Array) -> None:
        """Add the state (12,) at `time` (s) to this stride."""
        assert self.place is not None
        self._rows.append(np.concatenate([[time], state]))
        gap = rotate(self.place[:2] - state[3:5], -state[2])
        self._gap.append(np.append(gap, wrapped(self.place[2] - state[2])))

    def finish(self, target: Target) -> None:
        """End a stride: correct the corrections by its means, if it has three ticks and is whole.

        The target's posture holds the mean of the motion over a whole stride; a part of one has
        another.
        """
        rows, gaps = np.array(self._rows), np.array(self._gap)
        self._rows, self._gap = self._rows[-1:], self._gap[-1:]  # the next one starts there
        is_complete = len(rows) >= 3 and rows[-1, 0] - rows[0, 0] >= self._shortest
        if not is_complete or self._settings.gain == 0.0:
            return
        error = self._error(rows, gaps.mean(axis=0), target)
        share = np.array([target.walking, target.walking, 1.0, 1.0, 1.0, 1.0])
        self._correct(error, np.maximum(share, 1e-6) * self._limit)

    def _error(self, rows: Array, gap: Array, target: Target) -> Array:
        """Wanted outputs minus those of the stride (6,)."""
        s, reach = self._settings, self._scale[VELOCITY]
        wanted = target.velocity + gap * [s.position_gain, s.position_gain, s.heading_gain]
        wanted = np.clip(wanted, target.velocity - reach, target.velocity + reach)
        velocity = mean_velocity(rows[:, 0], rows[:, [4, 5, 3]])
        posture = rows[:-1, [6, 1, 2]].mean(axis=0)
        return np.concatenate([wanted - velocity, target.posture - posture])

    def _correct(self, error: Array, limit: Array) -> None:
        """Solve for the change of the corrections within limits (6,), in units of their limits."""
        s = self._settings
        matrix = np.vstack(
            [self._effect * limit / self._scale[:, None], s.regularisation * np.eye(6)]
        )
        wanted = np.concatenate([s.gain * error / self._scale, np.zeros(6)])
        now = np.clip(self.corrections / limit, -1.0, 1.0)
        change = lsq_linear(matrix, wanted, (-1.0 - now - 1e-9, 1.0 - now + 1e-9)).x
        self.corrections = (now + change).clip(-1.0, 1.0) * limit

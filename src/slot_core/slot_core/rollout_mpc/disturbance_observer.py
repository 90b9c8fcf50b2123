"""Disturbance observer: drift and wrench from the errors of the nominal robot over a stride.

The nominal robot repeats the motion of the last `window` ticks, a time T, with the commands that
were given, from the torso as it was measured then. The differences e between the measured and the
repeated motion change at every tick

    drift  d += gain ((e_xy, e_yaw) / T - d)    velocity, heading frame, m/s and rad/s
    wrench w += gain K (e_z, e_roll, e_pitch)   F_z, M_x, M_y on the torso, N and N m

The wrench acts in the rollouts; the drift moves their poses on. Hence a payload of m kg is a wrench
F_z = -m g, and a foot that slips more than expected is a drift. The plan takes no more of the drift
than `drift_taken`. After a step of the velocity and in a push, too, the model misses the motion along and
aside for a second, and a plan that takes that for a drift swings about its way.

The misfit is the root mean square, over some 20 ticks, of the errors of height, roll and pitch, in
units of the cost's scales. It is 0.4 to 1.2 in a walk, and 2.6 to 4 where feet stick that slip in
the model: on a floor whose friction is 1 instead of 0.4, a foot that sticks lifts the torso. The
errors of x, y and yaw do not tell: on legs that are softer by a fifth, the yaw's alone reaches 7.
Once the misfit exceeds `misfit_max`, the model has the friction of a floor that grips. It is judged
when a walk has lasted for `misfit_after`: at first the errors are those of wrench and estimator,
which are learned. A turn in place is no part of it: the torso touches the floor.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.geometry import rotate, wrapped
from slot_core.key_frame import StateParts
from slot_core.robot import LEGS
from slot_core.rollout_mpc.nominal_robot import NominalRobot
from slot_core.rollout_mpc.settings import ObserverSettings

PLACE = [3, 4, 2]  # x, y and yaw in a state or a pose
TILTS = [5, 0, 1]  # height, roll and pitch


class _Seen(NamedTuple):
    """The robot at the time of an estimate: predicted start, estimated state, commanded angles."""

    start: Array  # state of the nominal robot
    state: Array  # (12,) of the estimate
    angle: Array  # (4,) rad, commanded
    walked: int  # ticks for which a velocity has been commanded


class DisturbanceObserver:
    """Estimates of drift and wrench."""

    STATE = StateParts(
        "drift",
        "wrench",
        "_misfit",
        "_past",
        values=(_Seen,),
    )

    def __init__(
        self,
        model: NominalRobot,
        settings: ObserverSettings,
        scale: Array,
        dt: float,
    ):
        """scale: (6,) errors of roll, pitch, yaw, x, y, z that cost as much as one another."""
        self._scale = scale[TILTS]
        self._model, self._settings, self._dt = model, settings, dt
        self._stiffness, self._wrench_max = np.array(
            [settings.stiffness, settings.wrench_max]
        )
        self._drift_max, self._drift_taken = np.array(
            [settings.drift_max, settings.drift_taken]
        )
        self.drift = np.zeros(3)  # v_x, v_y m/s, yaw rate rad/s, heading frame
        self.wrench = np.zeros(3)  # F_z N, M_x, M_y N m, heading frame
        self._misfit = np.zeros(3)  # mean squares, in units of the scales
        self._past: deque[_Seen] = deque()

    def forget(self) -> None:
        """Forget the motion so far: a gap or a jump. The estimates stay."""
        self._past.clear()

    def observe(
        self, start: Array, state: Array, angle: Array, walks: bool = True
    ) -> None:
        """Take the estimate of a tick, its state (12,) and the angles (4,) commanded then.

        start: of the nominal robot, with the torso as measured; walks: whether a velocity is
        commanded. Once the ticks reach back over the window, correct drift and wrench. Raises
        ValueError for other shapes.
        """
        state = checked("state", state, (12,))
        angle = checked("angle", angle, (len(LEGS),))
        past, window = self._past, self._settings.window
        walked = walks * (1 + (past[-1].walked if past else 0))
        past.append(_Seen(start, state.copy(), angle.copy(), walked))
        if len(past) <= window:
            return
        while len(past) > window + 1:
            past.popleft()
        plan = np.array([seen.angle for seen in past])
        poses = self._model.roll_out(past[0].start, plan[None]).pose[0]
        if np.isfinite(poses).all():
            self._correct(state, poses[-1], self._dt * window)

    def _correct(self, state: Array, pose: Array, span: float) -> None:
        """Correct the estimates by the state (12,) and the repeated pose (6,) after `span` (s)."""
        s = self._settings
        way = rotate(state[3:5] - pose[3:5], -self._past[0].state[2])
        drift = np.append(way, wrapped(state[2] - pose[2])) / span
        error = state[TILTS] - pose[TILTS]
        if self._past[-1].walked * self._dt > span + s.misfit_after:
            self._judge(error)
        drift = self.drift + s.drift_gain * (drift - self.drift)
        self.drift = _bounded(drift, self._drift_max)
        wrench = self.wrench + s.wrench_gain * self._stiffness * error
        self.wrench = _bounded(wrench, self._wrench_max)

    def _judge(self, error: Array) -> None:
        """Update the misfit by the errors (3,) of height, roll and pitch."""
        s = self._settings
        square = np.square(error / self._scale)
        self._misfit += s.misfit_gain * (square - self._misfit)
        if self.misfit > s.misfit_max:
            self._model.friction = s.friction

    @property
    def taken(self) -> Array:
        """Drift (3,) as the plan takes it."""
        return _bounded(self.drift, self._drift_taken)

    @property
    def misfit(self) -> float:
        """Error of height, roll and pitch in the model, in units of the scales."""
        return float(np.sqrt(self._misfit.mean()))


def _bounded(values: Array, most: Array) -> Array:
    return np.asarray(np.minimum(np.maximum(values, -most), most))

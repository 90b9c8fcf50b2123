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

The friction of the floor shows in the same errors: a foot that sticks where the model's slips lifts
the torso in each stride. The motion is therefore repeated with two frictions, the nominal one and
that of a floor that grips. With each, s is the spread of the errors of height, roll and pitch about
their means, which the wrench explains, in units of the cost's scales and over some 30 ticks:

    s_grip > (1 + friction_margin) s_nominal      the model's floor has the nominal friction
    else s_nominal > friction_misfit              it grips
    or s_nominal^2 - s_grip^2, over some 100 ticks, > friction_benefit      it grips

The better of both is not enough: a fast walk on .5 is explained better by a floor that grips, and
walks worse with it. Measured with the nominal friction in the model, seeds 1 and 2, medians of
s_nominal / s_grip:

    friction    walk         crawl        uphill 5 deg    fast walk
    .5           .74 / .86    .65 / .85    .9 / 1.2        .9 / .8 to 1.0
    .6          1.4 / 1.2                 1.3 / 1.3       1.7 / 1.7
    .8          1.3 / 1.1     .86 / .84   1.5 / 1.3
    1           2.5 / 2.5    1.1 / .86    2.5 / 2.5

Once the model's floor grips, s_grip is 1.2 on friction 1, and 1.1 s_nominal or more on .5. It is
judged once a walk has lasted for `friction_after`. A turn in place is no part of it: the torso
touches the floor.
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
        "_mean",
        "_variance",
        "_benefit",
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
        # of the errors of height, roll and pitch, for the model with each friction
        self._mean, self._variance = np.zeros((2, 2, 3))
        self._variance += 1.0 / 3.0
        self._benefit = 0.0  # of a floor that grips: mean of the variance less
        self._frictions = model.friction, settings.friction
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
        s, past = self._settings, self._past
        window = s.window
        walked = walks * (1 + (past[-1].walked if past else 0))
        past.append(_Seen(start, state.copy(), angle.copy(), walked))
        if len(past) <= window:
            return
        while len(past) > window + 1:
            past.popleft()
        plan = np.array([seen.angle for seen in past])
        known = self._model.friction
        pose = self._repeated(plan, known)
        if not np.isfinite(pose).all():
            return
        self._correct(state, pose)
        if walked > window + s.friction_after / self._dt:
            poses = [
                pose if mu == known else self._repeated(plan, mu)
                for mu in self._frictions
            ]
            self._judge(state[TILTS] - np.array(poses)[:, TILTS])

    def _repeated(self, plan: Array, friction: float) -> Array:
        """Pose (6,) at the end of the motion repeated with a plan (n, 4), rad, and a friction."""
        known = self._model.friction
        self._model.friction = friction
        poses = self._model.roll_out(self._past[0].start, plan[None]).pose[0]
        self._model.friction = known
        return poses[-1]

    def _correct(self, state: Array, pose: Array) -> None:
        """Correct the estimates by the state (12,) and the repeated pose (6,)."""
        s, span = self._settings, self._dt * self._settings.window
        way = rotate(state[3:5] - pose[3:5], -self._past[0].state[2])
        drift = np.append(way, wrapped(state[2] - pose[2])) / span
        error = state[TILTS] - pose[TILTS]
        drift = self.drift + s.drift_gain * (drift - self.drift)
        self.drift = _bounded(drift, self._drift_max)
        wrench = self.wrench + s.wrench_gain * self._stiffness * error
        self.wrench = _bounded(wrench, self._wrench_max)

    def _judge(self, error: Array) -> None:
        """Choose the model's friction by errors (2, 3) of height, roll and pitch with each."""
        s = self._settings
        if not np.isfinite(error).all():
            return
        error = error / self._scale
        self._mean += s.friction_gain * (error - self._mean)
        square = np.square(error - self._mean)
        self._variance += s.friction_gain * (square - self._variance)
        nominal, gripping = self._variance.sum(axis=1)
        self._benefit += s.benefit_gain * (nominal - gripping - self._benefit)
        margin = 1.0 + s.friction_margin
        if gripping > margin * margin * nominal:
            self._model.friction = self._frictions[0]
            self._benefit = min(self._benefit, 0.0)
        elif (
            nominal > s.friction_misfit * s.friction_misfit
            or self._benefit > s.friction_benefit
        ):
            self._model.friction = self._frictions[1]

    @property
    def taken(self) -> Array:
        """Drift (3,) as the plan takes it."""
        return _bounded(self.drift, self._drift_taken)


def _bounded(values: Array, most: Array) -> Array:
    return np.asarray(np.minimum(np.maximum(values, -most), most))

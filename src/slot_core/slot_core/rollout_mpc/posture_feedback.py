"""Feedback of a posture that is kept: the gait's angles and a correction by height, roll and pitch.

Feet that stick hide from a plan what its steps will do, so that a plan chases the torso up and down,
while the angles of the gait alone leave it some millimetres off. With the error e of the torso's
height, roll and pitch, each tick

    f <- f + filter (e - f)                              filtered error, by df
    a <- a - diag(1 / k) B+ K (gain f + df)              correction of the tendon angles, rad

where K is the torso's stiffness, B+ distributes a wrench to the legs, and k is the legs' stiffness,
N/rad. The proportional part is K df, added up. That of the height may not be larger: at first a leg
that is released with its foot stuck lifts the torso. The torso's own stiffness against a tilt is 12
N m/rad; three times as much in K is the gain of a loop whose filter lags by 10 ticks.

The feedback begins with the angles that carry the wrench, and with the differences between the legs
of the last command. What the last command has beyond these decays.
"""

import numpy as np

from slot_core.arrays import Array
from slot_core.key_frame import StateParts
from slot_core.matrices import product
from slot_core.rollout_mpc.settings import LimitSettings, PostureSettings


class PostureFeedback:
    """Tendon angles that keep a posture."""

    STATE = StateParts("_error", "_correction")

    def __init__(
        self, settings: PostureSettings, limits: LimitSettings, shares: Array
    ):
        """shares: B+ (4, 3), forces of the legs for F_z (N), M_x and M_y (N m)."""
        self._settings, self._limits = settings, limits
        self._shares = shares
        self._stiffness = np.array(settings.stiffness)
        self.forget()

    def forget(self) -> None:
        """Begin anew at the next call."""
        self._error = np.zeros(3)
        self._correction: Array | None = None

    def reaches(self, error: Array, rise: float) -> bool:
        """Whether it acts at errors (3,), as in `angle`, of a torso that rises by `rise`, m/s.

        It does not begin while the torso rises: a robot that stands up is left to the plan.
        """
        s, acts = self._settings, self._correction is not None
        near = (np.abs(error) < s.reach).all()
        return bool(near and (acts or abs(rise) < s.rise_max))

    def angle(
        self,
        error: Array,
        gait: Array,
        carried: Array,
        last: Array,
        stiffness: Array,
    ) -> Array:
        """Angles (4,), rad, for the error (3,) of height, roll and pitch, m and rad.

        gait: the gait's angles; carried: these, turned on to carry the wrench; last: the last
        command, all (4,), rad; stiffness: of the legs (4,), N/rad.
        """
        s, limits, before = self._settings, self._limits, self._error
        present = self._correction
        if present is None:
            uneven = last - carried
            present = carried - gait + uneven - uneven.mean()
        self._error = before + s.filter * (error - before)
        wrench = self._stiffness * (s.gain * self._error + self._error - before)
        moved = present - product(self._shares, wrench) / stiffness
        self._correction = np.clip(moved, -limits.deviation, limits.deviation)
        return np.asarray(
            gait + self._correction + limits.decay * (last - gait - present)
        )

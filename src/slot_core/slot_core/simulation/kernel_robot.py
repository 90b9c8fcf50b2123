"""Base class of the robots on the compiled mechanics: pushes, damaged tendons, spools, counters."""

from __future__ import annotations

import numpy as np

from slot_core.arrays import checked
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.model import MechanicalState, Model, Work
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.robot import Array


class KernelRobot(SimulatedRobot):
    """Robot whose kernels operate on a `Model`, a `MechanicalState` and a `Work`."""

    model: Model
    state: MechanicalState
    handle: Handle
    _work: Work

    def push(self, force: Array, moment: Array) -> None:
        """Add an external force (3,), N, and moment (3,), N m, on the torso's centre, in odom.

        They act until their opposites are added. Raises ValueError for another shape or a value
        that is not finite.
        """
        parts = (
            checked("push: force", force, (3,)),
            checked("push: moment", moment, (3,)),
        )
        self.model.push[:] += np.concatenate(parts)

    def damage_tendon(self, leg: int, slack: float = 0.0, broken: bool = False) -> None:
        """Lengthen the tendon of leg 0 .. 3 by `slack` (m), negative: shorten it, or break it.

        Raises ValueError for another leg or a slack that is not finite.
        """
        if leg not in range(4):
            raise ValueError(f"leg {leg} must be 0 to 3")
        self.model.fault[:, leg] = checked(f"slack of leg {leg}", slack, ()), not broken

    @property
    def halvings(self) -> int:
        """Number of times a step was repeated in pieces half as long."""
        return int(self._work.counter[0])

    @property
    def indefinite_steps(self) -> int:
        """Steps in which a pivot was not positive: a sign of a fold or of too large a step."""
        return int(self._work.counter[1])

    @property
    def tendon_angle(self) -> Array:
        """(4,) rad, angle of the spools."""
        return self.state.tendon_angle.copy()

    @property
    def tendon_rate(self) -> Array:
        """(4,) rad/s, over the last step."""
        return self.state.tendon_rate.copy()

    @property
    def tension(self) -> Array:
        """(4,) N, of the tendons, at the stage of the last step."""
        return self.state.tension.copy()

    @property
    def servo_torque(self) -> Array:
        """(4,) N m, load on the servos, with the friction of the guides against the spool's motion.

        A spool that stands still is taken to carry the load without friction.
        """
        rate, friction = self.state.tendon_rate, self.model.servo.friction
        share = np.where(
            rate > 0.0, friction, np.where(rate < 0.0, 1.0 / friction, 1.0)
        )
        return super().servo_torque * share

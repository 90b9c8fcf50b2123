"""Gaits: what the legs are to do over the horizon."""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.robot import Array


@dataclass(frozen=True)
class GaitPreview:
    """Contact schedule, friction and reference at the stages 0 .. n-1 of the horizon.

    Stage k is at `stamp + k dt`. Legs in the order FL FR RL RR, frames odom.
    """

    stamp: int  # ns
    gait: str
    phase: float  # of stage 0, in [0, 1)
    period: float  # s
    dt: float  # s
    contact: Array  # (n, 4) bool, the leg may carry load
    friction: Array  # (n, 4) coefficient the controller may count on
    normal_force: Array  # (n, 4) N, expected by the gait
    tendon_angle: Array  # (n, 4) rad, nominal
    reference: Array  # (n, 12) [roll pitch yaw, p, omega, v]

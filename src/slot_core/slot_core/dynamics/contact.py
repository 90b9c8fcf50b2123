"""Contact of a point with the floor: penalty normal force and regularised Coulomb friction.

    N = max(0, -k gap - d v_n) where gap < 0,      friction = -mu N v_t / sqrt(v_t^2 + eps^2).

In the tangent of a Newton step the coefficient mu N / sqrt(...) is lagged, which leaves the
friction's matrix symmetric and dissipative.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math
from typing import NamedTuple

from slot_core.dynamics.compiled import helper
from slot_core.dynamics.lanes import like, where


class Floor(NamedTuple):
    """Numbers of the contact law."""

    stiffness: float  # N/m for each point
    damping: float  # N s/m for each point
    friction_velocity: float  # m/s, eps


@helper
def touch(floor, friction, gap, vn, vx, vy, vz):
    """Contact of one point: (normal force N, friction coefficient c in N s/m).

    v is the point's velocity, vn its part along the floor's normal (m/s), gap the height (m); the
    friction force is -c (v - vn n). Both are zero without contact.
    """
    normal = -floor.stiffness * gap - floor.damping * vn
    normal = where(gap < 0.0, max(0.0, normal), like(0.0, normal))
    slip = vx * vx + vy * vy + vz * vz - vn * vn
    return normal, friction * normal / math.sqrt(max(0.0, slip) + floor.friction_velocity**2)

"""Hinge of a spatial rod: its moment and the tangent of it.

A hinge with the moment m (in fixed axes) between the segments k - 1 and k, whose rotations in an
iteration are Phi_{k-1} and Phi_k, has the tangent

    dm = (Phi_k + Phi_{k-1}) x m / 2 + K (Phi_k - Phi_{k-1}),      K symmetric.

With the derivative V^T of the rotation vector psi by Phi_k - Phi_{k-1} (`strain.py`), m = V mu and

    K = V B V^T + (m psi^T + psi m^T - 2 (psi.m) 1) / 12 + O(psi^3 m).
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from typing import NamedTuple

from slot_core.compiled import helper
from slot_core.dynamics.lanes import like


class Symmetric(NamedTuple):
    """Upper half of a symmetric 3 x 3 matrix."""

    xx: float
    xy: float
    xz: float
    yy: float
    yz: float
    zz: float


class Hinge(NamedTuple):
    """Moment of a hinge on the segment behind it, its tangent, and two derivatives by Phi_k."""

    moment: tuple[float, float, float]  # N m
    tangent: Symmetric  # K, N m/rad
    tendon: tuple[float, float, float]  # m, of the tendon's length
    bulge: tuple[float, float, float]  # m, of the segment's correction -c


@helper
def bend(rod, s, k, before, viscous, normal, tendon, tension):
    """The hinge at node k behind the frame `before` = (t, d, b).

    viscous: derivative of the moment over the stiffness by the strain in a step, 1 in statics;
    normal: axial force of segment k, N; tendon, tension (N): a tendon along the rod (`tendon.py`).
    """
    t, d, b = before
    x, y, z, c, beta = s.twist[k], s.turn[k], s.side[k], s.curl[k], rod.damping_time
    # V = (t, d, b) (1 + [psi] / 2 + c [psi]^2), whose columns belong to the components of psi.
    vt = _mapped(
        t, d, b, 1.0 - c * (y * y + z * z), c * x * y + 0.5 * z, c * x * z - 0.5 * y
    )
    vd = _mapped(
        t, d, b, c * x * y - 0.5 * z, 1.0 - c * (x * x + z * z), c * y * z + 0.5 * x
    )
    vb = _mapped(
        t, d, b, c * x * z + 0.5 * y, c * y * z - 0.5 * x, 1.0 - c * (x * x + y * y)
    )
    bend, q = y - rod.rest_angle[k], -2.0 * rod.shortening[k]
    around, along, geometric = tendon.around[k], tendon.along[k], q * normal
    twist, inner, outer = rod.torsion[k], rod.bending[k], rod.lateral[k]
    whole, lag = 1.0 + s.firm[0], s.lag[k]
    mt = twist * (whole * x + beta * s.twist_rate[k] + lag[0])
    md = inner * (whole * bend + beta * s.turn_rate[k] + lag[1])
    md += tension * around + geometric * bend
    mb = outer * (whole * z + beta * s.side_rate[k] + lag[2]) + geometric * z
    m = _mapped(vt, vd, vb, mt, md, mb)
    bulge = _mapped(vt, vd, vb, like(0.0, x), q * bend, q * z)
    psi = _mapped(t, d, b, x, y, z)
    level = -(psi[0] * m[0] + psi[1] * m[1] + psi[2] * m[2]) / 6.0
    kt, kd, kb = (
        viscous * twist,
        viscous * inner + geometric,
        viscous * outer + geometric,
    )
    third = (psi[0] / 12.0, psi[1] / 12.0, psi[2] / 12.0)
    et, ed, eb = (
        (kt * vt[0], kt * vt[1], kt * vt[2]),
        (kd * vd[0], kd * vd[1], kd * vd[2]),
        (kb * vb[0], kb * vb[1], kb * vb[2]),
    )
    tangent = Symmetric(
        et[0] * vt[0] + ed[0] * vd[0] + eb[0] * vb[0] + 2.0 * third[0] * m[0] + level,
        et[0] * vt[1]
        + ed[0] * vd[1]
        + eb[0] * vb[1]
        + third[0] * m[1]
        + third[1] * m[0],
        et[0] * vt[2]
        + ed[0] * vd[2]
        + eb[0] * vb[2]
        + third[0] * m[2]
        + third[2] * m[0],
        et[1] * vt[1] + ed[1] * vd[1] + eb[1] * vb[1] + 2.0 * third[1] * m[1] + level,
        et[1] * vt[2]
        + ed[1] * vd[2]
        + eb[1] * vb[2]
        + third[1] * m[2]
        + third[2] * m[1],
        et[2] * vt[2] + ed[2] * vd[2] + eb[2] * vb[2] + 2.0 * third[2] * m[2] + level,
    )
    length = (
        around * vd[0] + along * bulge[0],
        around * vd[1] + along * bulge[1],
        around * vd[2] + along * bulge[2],
    )
    return Hinge(m, tangent, length, bulge)


@helper
def _mapped(a, b, c, x, y, z):
    """x a + y b + z c for vectors a, b, c."""
    return (
        x * a[0] + y * b[0] + z * c[0],
        x * a[1] + y * b[1] + z * c[1],
        x * a[2] + y * b[2] + z * c[2],
    )

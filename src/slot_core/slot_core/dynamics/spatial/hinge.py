"""Hinge of a spatial rod: its moment and the tangent of it.

A hinge with the moment m (in fixed axes) between the segments k - 1 and k, whose rotations in an
iteration are Phi_{k-1} and Phi_k, has the tangent

    dm = (Phi_k + Phi_{k-1}) x m / 2 + K (Phi_k - Phi_{k-1}),      K symmetric.

With the derivative V^T of the rotation vector psi by Phi_k - Phi_{k-1} (`strain.py`), m = V mu and

    K = V B V^T + (m psi^T + psi m^T - 2 (psi.m) 1) / 12 + O(psi^3 m).
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from slot_core.arrays import named
from slot_core.compiled import helper
from slot_core.dynamics.algebra import combined, dot, plus, scaled
from slot_core.dynamics.lanes import like

Symmetric = named("Symmetric", "xx xy xz yy yz zz", __name__)
"""Upper half of a symmetric 3 x 3 matrix."""
Hinge = named(
    "Hinge",
    [
        "moment",  # N m
        "tangent",  # K, N m/rad
        "tendon",  # m, of the tendon's length
        "bulge",  # m, of the segment's correction -c
    ],
    __name__,
)
"""Moment of a hinge on the segment behind it, its tangent, and two derivatives by Phi_k."""


@helper
def rows(a):
    """The three rows of a symmetric matrix."""
    return (a.xx, a.xy, a.xz), (a.xy, a.yy, a.yz), (a.xz, a.yz, a.zz)


@helper
def derivative(before, x, y, z, c):
    """Columns of V = (t, d, b) (1 + [psi] / 2 + c [psi]^2) for psi = (x, y, z) behind a frame."""
    t, d, b = before
    xy = c * x * y
    xz = c * x * z
    yz = c * y * z
    return (
        combined(
            1.0 - c * (y * y + z * z), t, xy + 0.5 * z, d, xz - 0.5 * y, b
        ),
        combined(
            xy - 0.5 * z, t, 1.0 - c * (x * x + z * z), d, yz + 0.5 * x, b
        ),
        combined(
            xz + 0.5 * y, t, yz - 0.5 * x, d, 1.0 - c * (x * x + y * y), b
        ),
    )


@helper
def bend(rod, s, k, before, viscous, normal, tendon, tension):
    """The hinge at node k behind the frame `before` = (t, d, b).

    viscous: derivative of the moment over the stiffness by the strain in a step, 1 in statics;
    normal: axial force of segment k, N; tendon, tension (N): a tendon along the rod (`rod.py`).

    mu = B (e + beta de/dt) with the strains e of `strain.py`, and the material's relaxation. The
    correction c_k of the segment's length adds the axial force to both bending stiffnesses.
    """
    x, y, z = s.twist[k], s.turn[k], s.side[k]
    vt, vd, vb = derivative(before, x, y, z, s.curl[k])
    bent = y - rod.rest_angle[k]
    shorter = -2.0 * rod.shortening[k]
    geometric = shorter * normal
    around, along = tendon.around[k], tendon.along[k]
    # mu, and B with its geometric part
    twist, inner, outer = rod.torsion[k], rod.bending[k], rod.lateral[k]
    whole, beta, lag = 1.0 + s.firm[0], rod.damping_time, s.lag[k]
    mt = twist * (whole * x + beta * s.twist_rate[k] + lag[0])
    md = inner * (whole * bent + beta * s.turn_rate[k] + lag[1])
    md += tension * around + geometric * bent
    mb = outer * (whole * z + beta * s.side_rate[k] + lag[2]) + geometric * z
    moment = combined(mt, vt, md, vd, mb, vb)
    et = scaled(viscous * twist, vt)
    ed = scaled(viscous * inner + geometric, vd)
    eb = scaled(viscous * outer + geometric, vb)
    stiffness = (
        combined(et[0], vt, ed[0], vd, eb[0], vb),
        combined(et[1], vt, ed[1], vd, eb[1], vb),
        combined(et[2], vt, ed[2], vd, eb[2], vb),
    )
    t, d, b = before
    bulge = combined(like(0.0, x), vt, shorter * bent, vd, shorter * z, vb)
    return Hinge(
        moment=moment,
        tangent=turned_tangent(stiffness, combined(x, t, y, d, z, b), moment),
        tendon=plus(scaled(around, vd), along, bulge),
        bulge=bulge,
    )


@helper
def between(k, m):
    """Rows of [m] / 2 - K, the tangent between the segments on both sides of a hinge."""
    x, y, z = 0.5 * m[0], 0.5 * m[1], 0.5 * m[2]
    return (
        (-k.xx, -k.xy - z, -k.xz + y),
        (-k.xy + z, -k.yy, -k.yz - x),
        (-k.xz - y, -k.yz + x, -k.zz),
    )


@helper
def turned_tangent(k, psi, m):
    """K = V B V^T + (m psi^T + psi m^T - 2 (psi.m) 1) / 12; k: the three rows of V B V^T."""
    level = -dot(psi, m) / 6.0
    x, y, z = psi[0] / 12.0, psi[1] / 12.0, psi[2] / 12.0
    return Symmetric(
        xx=k[0][0] + 2.0 * x * m[0] + level,
        xy=k[0][1] + x * m[1] + y * m[0],
        xz=k[0][2] + x * m[2] + z * m[0],
        yy=k[1][1] + 2.0 * y * m[1] + level,
        yz=k[1][2] + y * m[2] + z * m[1],
        zz=k[2][2] + 2.0 * z * m[2] + level,
    )

"""Kernels of the Riccati recursion: a Newton step of the interior-point method, stage by stage.

The MPC's torso is a double integrator driven by the wrench w = W u of twelve forces, and every
constraint is on the three forces of one leg. So a Newton step of the interior-point method
(`interior_point.py`) is a linear-quadratic problem over the horizon (Rao, Wright, Rawlings, JOTA
1998). Two properties reduce its size:

- In the coordinates xi = [E^-1 q, v] of positions q and velocities v, E = a[:6, 6:], the model is

      xi+ = [I I; 0 I] xi + [I/2; I] w,      so that A'PA and B'PB are sums of 6 x 6 blocks.

- The barrier's Hessian R~ = R + G' diag(m/s) G is an arrow matrix for each leg, whose inverse is in
  closed form T diag(d) T'. Eliminating the inputs gives M = W R~^-1 W' (6 x 6). With M = C C' and
  S = B'PB the recursion is

      P- = Q + A'PA - (Y F)'(Y F),   Y = chol(I + C'SC)^-1 C',   F = B'PA,

  without the inverse of M, since a leg in the air has R~^-1 = 0, and in flight M = 0.

Innermost loops run over contiguous entries, and few carry a sum, so that they vectorise. Operations
are neither reordered nor fused, so that every processor gives the same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slot_core.compiled import exact_helper
from slot_core.mpc.model import FEET, INPUTS, STATES
from slot_core.robot import Array

HALF = STATES // 2  # size of positions, velocities and wrench
SIDES = 6  # limits of a leg: mu f_z -+ f_x >= 0, mu f_z -+ f_y >= 0, f_z >= 0, f_max - f_z >= 0
NEGLIGIBLE = 1e-9  # N, or of friction: below it the force is set to zero, without constraints


class QuadraticProgram(NamedTuple):
    """Quadratic programme, stage by stage; states and their costs are those at the stage's end."""

    weight: Array  # (H, 24) diagonal of P: inputs, states
    linear: Array  # (H, 24) c
    drift: Array  # (H, 12) b; that of stage 0 includes a x_0
    step: Array  # (6, 6) E, positions per velocity
    gain: Array  # (12, 6) W', velocities per force
    friction: Array  # (H, 4)
    limit: Array  # (H, 4) N


class Iterate(NamedTuple):
    """Present iterate of the method, its step and its gradients."""

    u: Array  # (H, 4, 3) forces, always within their limits
    slack: Array  # (H, 4, 6) distances of the forces from their limits
    multiplier: Array  # (H, 4, 6)
    u_step: Array
    slack_step: Array
    multiplier_step: Array
    multiplier_target: Array  # (H, 4, 6) of the barrier at the present slacks
    x: Array  # (H, 12) states
    gradient_x: Array  # (H, 12) of the cost by xi
    gradient_u: Array  # (H, 4, 3) of the cost by u
    barrier_gradient: Array  # (H, 4, 3) of cost and barrier by u
    hessian_q: Array  # (H, 6, 6) of the cost by E^-1 q


class Factor(NamedTuple):
    """Factorisation of the Newton step, and work vectors of its solution."""

    p: Array  # (3, 6, 6) P11, P12, P22
    arrow: Array  # (H, 4, 5) R~^-1: two entries of T, then d
    scaled_gain: Array  # (12, 6) W T diag(d)^1/2, transposed
    m: Array  # (6, 6) M, then C
    t: Array  # (6, 6) I + C'SC, then its Cholesky factor
    s: Array  # (H, 6, 6)
    f: Array  # (H, 6, 12)
    y: Array  # (H, 6, 6)
    yf: Array  # (H, 6, 12)
    wrench_gradient: Array  # (H, 6) of the cost to go by the wrench
    wrench: Array  # (H, 6) for xi = 0 at the stage's start
    vector: Array  # (4, 12) work space within one stage


@exact_helper
def clear(out: Array) -> None:
    """out = 0."""
    for j in range(len(out)):
        out[j] = 0.0


@exact_helper
def add_transposed(matrix: Array, vector: Array, sign: float, out: Array) -> None:
    """out += sign matrix' vector."""
    for i in range(len(vector)):
        z = sign * vector[i]
        for j in range(len(out)):
            out[j] += matrix[i, j] * z


@exact_helper
def add_product(matrix: Array, vector: Array, out: Array) -> None:
    """out += matrix vector."""
    for i in range(len(out)):
        z = out[i]
        for j in range(len(vector)):
            z += matrix[i, j] * vector[j]
        out[i] = z


@exact_helper
def cholesky(a: Array) -> None:
    """Replace a by c with a = c c'; for a non-positive pivot the column of c is zero."""
    for k in range(HALF):
        pivot = a[k, k]
        inverse = 1.0 / np.sqrt(pivot) if pivot > 0.0 else 0.0
        for i in range(k, HALF):
            a[i, k] *= inverse
        for i in range(k + 1, HALF):
            for j in range(k + 1, HALF):
                a[i, j] -= a[i, k] * a[j, k]
        for j in range(k + 1, HALF):
            a[k, j] = 0.0


@exact_helper
def bounded(pb: QuadraticProgram, k: int, leg: int, side: int) -> bool:
    """Whether a limit is a constraint: not for a leg in the air, nor without friction."""
    if pb.limit[k, leg] <= NEGLIGIBLE:
        return False
    return side >= 4 or pb.friction[k, leg] > NEGLIGIBLE


@exact_helper
def invert_leg(pb: QuadraticProgram, it: Iterate, k: int, leg: int, arrow: Array) -> None:
    """R~^-1 of a leg: T has the last column (-arrow[0], -arrow[1], 1), d is arrow[2:].

    The pivot of f_z is a sum of positive terms; a difference would suffer cancellation.
    """
    clear(arrow)
    if pb.limit[k, leg] <= NEGLIGIBLE:
        return
    s, m, mu = it.slack[k, leg], it.multiplier[k, leg], pb.friction[k, leg]
    pivot = pb.weight[k, 3 * leg + 2] + m[4] / s[4] + m[5] / s[5]
    if mu > NEGLIGIBLE:
        for axis in range(2):
            r = pb.weight[k, 3 * leg + axis]
            low, high = m[2 * axis] / s[2 * axis], m[2 * axis + 1] / s[2 * axis + 1]
            inverse = 1.0 / (r + low + high)
            arrow[axis] = mu * (high - low) * inverse
            arrow[2 + axis] = inverse
            pivot += mu * mu * (r * (low + high) + 4.0 * low * high) * inverse
    arrow[4] = 1.0 / pivot


@exact_helper
def apply_inverse(arrow: Array, g: Array, out: Array) -> None:
    """out = -R~^-1 g of a leg."""
    z = (g[2] - arrow[0] * g[0] - arrow[1] * g[1]) * arrow[4]
    out[0] = arrow[0] * z - arrow[2] * g[0]
    out[1] = arrow[1] * z - arrow[3] * g[1]
    out[2] = -z


@exact_helper
def sum_legs(arrow: Array, gain: Array, scaled_gain: Array, m: Array) -> None:
    """m = W R~^-1 W' of the four legs; arrow is that of `Factor`."""
    for leg in range(FEET):
        a = arrow[leg]
        x, y, z = np.sqrt(a[2]), np.sqrt(a[3]), np.sqrt(a[4])
        for i in range(HALF):
            wx, wy, wz = gain[3 * leg, i], gain[3 * leg + 1, i], gain[3 * leg + 2, i]
            scaled_gain[3 * leg, i] = wx * x
            scaled_gain[3 * leg + 1, i] = wy * y
            scaled_gain[3 * leg + 2, i] = (wz - a[0] * wx - a[1] * wy) * z
    for i in range(HALF):
        clear(m[i])
    for column in range(INPUTS):
        for i in range(HALF):
            w = scaled_gain[column, i]
            for j in range(HALF):
                m[i, j] += w * scaled_gain[column, j]


@exact_helper
def project(p: Array, s: Array, f: Array) -> None:
    """s = B'PB and f = B'PA."""
    for i in range(HALF):
        for j in range(HALF):
            first = 0.5 * p[0, i, j] + p[1, j, i]
            second = 0.5 * p[1, i, j] + p[2, i, j]
            f[i, j], f[i, HALF + j] = first, first + second
            s[i, j] = 0.5 * first + second


@exact_helper
def factorise_inner(s: Array, c: Array, y: Array, t: Array) -> None:
    """t = chol(I + C'SC); y is work space."""
    for i in range(HALF):
        clear(y[i])
        for k in range(HALF):
            z = s[i, k]
            for j in range(HALF):
                y[i, j] += z * c[k, j]
    for i in range(HALF):
        clear(t[i])
        t[i, i] = 1.0
    for k in range(HALF):
        for i in range(k + 1):
            z = c[k, i]
            for j in range(HALF):
                t[i, j] += z * y[k, j]
    cholesky(t)


@exact_helper
def solve_inner(t: Array, c: Array, y: Array) -> None:
    """y = t^-1 C'."""
    for i in range(HALF):
        for j in range(HALF):
            y[i, j] = c[j, i]
        for k in range(i):
            z = t[i, k]
            for j in range(HALF):
                y[i, j] -= z * y[k, j]
        z = 1.0 / t[i, i]
        for j in range(HALF):
            y[i, j] *= z


@exact_helper
def multiply(y: Array, f: Array, yf: Array) -> None:
    """yf = Y F."""
    for i in range(HALF):
        clear(yf[i])
        for k in range(HALF):
            z = y[i, k]
            for j in range(STATES):
                yf[i, j] += z * f[k, j]


@exact_helper
def previous_cost_to_go(p: Array, yf: Array) -> None:
    """P of the previous stage, without its Q: A'PA - (Y F)'(Y F)."""
    for i in range(HALF):
        for j in range(HALF):
            p[2, i, j] += p[0, i, j] + p[1, i, j] + p[1, j, i]
    for i in range(HALF):
        for j in range(HALF):
            p[1, i, j] += p[0, i, j]
    for k in range(HALF):
        for i in range(HALF):
            z, w = yf[k, i], yf[k, HALF + i]
            for j in range(HALF):
                p[0, i, j] -= z * yf[k, j]
                p[1, i, j] -= z * yf[k, HALF + j]
                p[2, i, j] -= w * yf[k, HALF + j]


@exact_helper
def factorise(pb: QuadraticProgram, it: Iterate, fa: Factor) -> None:
    """Riccati recursion, from the last stage to the first."""
    p = fa.p
    for i in range(HALF):
        clear(p[0, i])
        clear(p[1, i])
        clear(p[2, i])
    for k in range(len(pb.weight) - 1, -1, -1):
        for i in range(HALF):
            for j in range(HALF):
                p[0, i, j] += it.hessian_q[k, i, j]
            p[2, i, i] += pb.weight[k, INPUTS + HALF + i]
        for leg in range(FEET):
            invert_leg(pb, it, k, leg, fa.arrow[k, leg])
        sum_legs(fa.arrow[k], pb.gain, fa.scaled_gain, fa.m)
        project(p, fa.s[k], fa.f[k])
        cholesky(fa.m)
        factorise_inner(fa.s[k], fa.m, fa.y[k], fa.t)
        solve_inner(fa.t, fa.m, fa.y[k])
        multiply(fa.y[k], fa.f[k], fa.yf[k])
        previous_cost_to_go(p, fa.yf[k])


@exact_helper
def backward_pass(pb: QuadraticProgram, it: Iterate, fa: Factor) -> None:
    """Backward pass: gradient of the cost to go, and every stage's wrench for xi = 0."""
    p, b, lead, g = fa.vector[0], fa.vector[1][:HALF], fa.vector[2][:HALF], fa.vector[3]
    clear(p)
    for k in range(len(pb.weight) - 1, -1, -1):
        w, h = fa.wrench[k], fa.wrench_gradient[k]
        for leg in range(FEET):
            apply_inverse(fa.arrow[k, leg], it.barrier_gradient[k, leg], g[3 * leg : 3 * leg + 3])
        clear(w)
        add_transposed(pb.gain, g, 1.0, w)
        for j in range(STATES):
            p[j] += it.gradient_x[k, j]
        for j in range(HALF):
            h[j] = 0.5 * p[j] + p[HALF + j]
            b[j] = h[j]
        add_transposed(fa.s[k], w, 1.0, b)
        clear(lead)
        add_product(fa.y[k], b, lead)
        add_transposed(fa.y[k], lead, -1.0, w)
        for j in range(HALF):
            p[HALF + j] += p[j]
        add_transposed(fa.f[k], w, 1.0, p)


@exact_helper
def forward_pass(pb: QuadraticProgram, it: Iterate, fa: Factor) -> None:
    """Forward pass: the step of the forces of every stage."""
    x, w, gradient, g = fa.vector[0], fa.vector[1][:HALF], fa.vector[2][:HALF], fa.vector[3]
    clear(x)
    for k in range(len(pb.weight)):
        lead = gradient
        clear(lead)
        add_product(fa.yf[k], x, lead)
        for j in range(HALF):
            w[j] = fa.wrench[k, j]
        add_transposed(fa.y[k], lead, -1.0, w)
        for j in range(HALF):
            gradient[j] = fa.wrench_gradient[k, j]
        add_transposed(fa.s[k], w, 1.0, gradient)
        add_product(fa.f[k], x, gradient)
        for leg in range(FEET):
            for axis in range(3):
                g[3 * leg + axis] = it.barrier_gradient[k, leg, axis]
        add_product(pb.gain, gradient, g)
        clear(w)
        for leg in range(FEET):
            change = it.u_step[k, leg]
            apply_inverse(fa.arrow[k, leg], g[3 * leg : 3 * leg + 3], change)
            add_transposed(pb.gain[3 * leg : 3 * leg + 3], change, 1.0, w)
        for j in range(HALF):
            x[j] += x[HALF + j] + 0.5 * w[j]
            x[HALF + j] += w[j]

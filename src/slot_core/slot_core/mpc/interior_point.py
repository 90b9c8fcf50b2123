"""Kernel of the interior-point method: Mehrotra's predictor-corrector on the forces.

The forces are the only unknowns; the states follow from them. The start is in the middle of all
limits, so every iterate satisfies the dynamics and the limits. Newton steps solve the remaining
conditions of optimality

    dJ/du + G'm = 0      and     s m = 0     with slacks s, multipliers m >= 0

(Nocedal and Wright, Numerical Optimization, algorithm 16.4, with one step length for forces and
multipliers). With the gap s'm and the residual r of the first equation, the distance of the forces
from the optimum is bounded by |u - u*|^2 <= 2 (s'm + |r| |u - u*|) / min R.
"""

from __future__ import annotations

from slot_core.compiled import exact_helper, exact_kernel
from slot_core.mpc.model import FEET, INPUTS, STATES
from slot_core.mpc.riccati import (
    HALF,
    NEGLIGIBLE,
    SIDES,
    Factor,
    Iterate,
    QuadraticProgram,
    add_product,
    add_transposed,
    backward_pass,
    bounded,
    clear,
    factorise,
    forward_pass,
)
from slot_core.robot import Array

INITIAL_PRODUCT = 1.0  # s m of every limit at the start; does not affect the result
FRACTION_TO_BOUNDARY = 0.995  # smallest fraction of the way to the nearest limit per step
MARGIN_TO_BOUNDARY = 1e-6  # smallest fraction of that way that a step leaves
RESIDUAL_FACTOR = 0.1  # largest residual, over the root of the allowed gap


@exact_helper
def leg_slacks(u: Array, mu: float, top: float, out: Array) -> None:
    """Slacks of a leg: distances of its force u (3,) N from its six limits."""
    wide = mu * u[2]
    out[0], out[1] = wide - u[0], wide + u[0]
    out[2], out[3] = wide - u[1], wide + u[1]
    out[4], out[5] = u[2], top - u[2]


@exact_helper
def add_multipliers(z: Array, mu: float, out: Array) -> None:
    """out += G'z of a leg."""
    out[0] += z[0] - z[1]
    out[1] += z[2] - z[3]
    out[2] -= mu * (z[0] + z[1] + z[2] + z[3]) + z[4] - z[5]


@exact_helper
def initialise(pb: QuadraticProgram, it: Iterate) -> None:
    """Initialise: Hessians E'QE, and forces in the middle of their limits."""
    for k in range(len(pb.weight)):
        hessian = it.hessian_q[k]
        for i in range(HALF):
            clear(hessian[i])
        for line in range(HALF):
            for i in range(HALF):
                z = pb.weight[k, INPUTS + line] * pb.step[line, i]
                for j in range(HALF):
                    hessian[i, j] += z * pb.step[line, j]
        for leg in range(FEET):
            clear(it.u[k, leg])
            if pb.limit[k, leg] > NEGLIGIBLE:
                it.u[k, leg, 2] = 0.5 * pb.limit[k, leg]


@exact_helper
def initialise_multipliers(pb: QuadraticProgram, it: Iterate) -> None:
    """Initialise the multipliers: equal products with the slacks."""
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            for side in range(SIDES):
                it.multiplier[k, leg, side] = 0.0
                if bounded(pb, k, leg, side):
                    it.multiplier[k, leg, side] = INITIAL_PRODUCT / it.slack[k, leg, side]


@exact_helper
def cost_bound(pb: QuadraticProgram) -> float:
    """Cost with every variable at its target, -c'c / 2P: a lower bound."""
    cost = 0.0
    for k in range(len(pb.weight)):
        for i in range(INPUTS + STATES):
            if pb.weight[k, i] > 0.0:
                cost -= 0.5 * pb.linear[k, i] ** 2 / pb.weight[k, i]
    return cost


@exact_helper
def predict_stage(pb: QuadraticProgram, it: Iterate, k: int, w: Array) -> None:
    """States at the end of stage k; w is the change of the velocities, and is overwritten."""
    x, before = it.x[k], it.x[k - 1]
    for i in range(STATES):
        x[i] = pb.drift[k, i] + (before[i] if k > 0 else 0.0)
    for i in range(HALF):
        x[HALF + i] += w[i]
        w[i] *= 0.5
        if k > 0:
            w[i] += before[HALF + i]
    add_product(pb.step, w, x[:HALF])


@exact_helper
def roll_out(pb: QuadraticProgram, it: Iterate, fa: Factor) -> float:
    """States, slacks and gradients at the forces; returns the cost z'Pz/2 + c'z."""
    w, slope, cost = fa.vector[0][:HALF], fa.vector[1], 0.0
    for k in range(len(pb.weight)):
        clear(w)
        for leg in range(FEET):
            u = it.u[k, leg]
            add_transposed(pb.gain[3 * leg : 3 * leg + 3], u, 1.0, w)
            leg_slacks(u, pb.friction[k, leg], pb.limit[k, leg], it.slack[k, leg])
            for axis in range(3):
                c = pb.linear[k, 3 * leg + axis]
                z = pb.weight[k, 3 * leg + axis] * u[axis] + c
                it.gradient_u[k, leg, axis] = z
                cost += 0.5 * u[axis] * (z + c)
        predict_stage(pb, it, k, w)
        for i in range(STATES):
            c = pb.linear[k, INPUTS + i]
            slope[i] = pb.weight[k, INPUTS + i] * it.x[k, i] + c
            cost += 0.5 * it.x[k, i] * (slope[i] + c)
        clear(it.gradient_x[k])
        add_transposed(pb.step, slope[:HALF], 1.0, it.gradient_x[k])
        for i in range(HALF):
            it.gradient_x[k, HALF + i] = slope[HALF + i]
    return cost


@exact_helper
def gap_after(it: Iterate, step: float) -> float:
    """Gap s'm after a step of the given length."""
    gap = 0.0
    for k in range(len(it.u)):
        for leg in range(FEET):
            for side in range(SIDES):
                s = it.slack[k, leg, side] + step * it.slack_step[k, leg, side]
                m = it.multiplier[k, leg, side] + step * it.multiplier_step[k, leg, side]
                gap += s * m
    return gap


@exact_helper
def residual(pb: QuadraticProgram, it: Iterate, fa: Factor) -> float:
    """Largest entry of dJ/du + G'm, over the constrained forces."""
    p, gradient, g, worst = fa.vector[0], fa.vector[1][:HALF], fa.vector[2], 0.0
    clear(p)
    for k in range(len(pb.weight) - 1, -1, -1):
        for j in range(STATES):
            p[j] += it.gradient_x[k, j]
        for j in range(HALF):
            gradient[j] = 0.5 * p[j] + p[HALF + j]
            p[HALF + j] += p[j]
        for leg in range(FEET):
            mine = g[3 * leg : 3 * leg + 3]
            for axis in range(3):
                mine[axis] = it.gradient_u[k, leg, axis]
            add_multipliers(it.multiplier[k, leg], pb.friction[k, leg], mine)
        add_product(pb.gain, gradient, g)
        for leg in range(FEET):
            for axis in range(3):
                if bounded(pb, k, leg, 2 * axis):
                    worst = max(worst, abs(g[3 * leg + axis]))
    return worst


@exact_helper
def set_target(pb: QuadraticProgram, it: Iterate, product: float, second: float) -> None:
    """Right side of the Newton step for s m = product.

    second: 1 to include the second-order error of the predictor (Mehrotra), else 0.
    """
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            target, gradient = it.multiplier_target[k, leg], it.barrier_gradient[k, leg]
            for side in range(SIDES):
                target[side] = 0.0
                if bounded(pb, k, leg, side):
                    error = it.slack_step[k, leg, side] * it.multiplier_step[k, leg, side]
                    target[side] = (product - second * error) / it.slack[k, leg, side]
            for axis in range(3):
                gradient[axis] = it.gradient_u[k, leg, axis]
            add_multipliers(target, pb.friction[k, leg], gradient)


@exact_helper
def newton_step(pb: QuadraticProgram, it: Iterate, fa: Factor) -> float:
    """Steps of forces, slacks and multipliers; returns the largest feasible length, at most 1."""
    backward_pass(pb, it, fa)
    forward_pass(pb, it, fa)
    length = 1.0
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            ds, dm = it.slack_step[k, leg], it.multiplier_step[k, leg]
            s, m = it.slack[k, leg], it.multiplier[k, leg]
            leg_slacks(it.u_step[k, leg], pb.friction[k, leg], 0.0, ds)
            for side in range(SIDES):
                if not bounded(pb, k, leg, side):
                    ds[side] = dm[side] = 0.0
                    continue
                dm[side] = (
                    it.multiplier_target[k, leg, side] - m[side] - m[side] / s[side] * ds[side]
                )
                if s[side] + length * ds[side] < 0.0:
                    length = -s[side] / ds[side]
                if m[side] + length * dm[side] < 0.0:
                    length = -m[side] / dm[side]
    return length


@exact_helper
def apply_step(it: Iterate, step: float) -> None:
    """Add the step, times its length, to forces and multipliers."""
    for k in range(len(it.u)):
        for leg in range(FEET):
            for axis in range(3):
                it.u[k, leg, axis] += step * it.u_step[k, leg, axis]
            for side in range(SIDES):
                it.multiplier[k, leg, side] += step * it.multiplier_step[k, leg, side]


@exact_helper
def count_limits(pb: QuadraticProgram) -> int:
    """Number of constraints."""
    count = 0
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            for side in range(SIDES):
                if bounded(pb, k, leg, side):
                    count += 1
    return count


@exact_kernel
def minimise(  # noqa: PLR0917
    pb: QuadraticProgram, it: Iterate, fa: Factor, absolute: float, relative: float, most: int
) -> tuple[int, bool]:
    """Minimise; the forces are left in `it.u`, the states in `it.x`. Returns (iterations, solved).

    Solved means gap <= allowed and residual^2 <= RESIDUAL_FACTOR^2 allowed, with allowed =
    absolute + relative (cost - cost with all targets met). With a NaN it runs for `most` iterations
    and is not solved.
    """
    initialise(pb, it)
    cost, bound, count = roll_out(pb, it, fa), cost_bound(pb), max(count_limits(pb), 1)
    initialise_multipliers(pb, it)
    for n in range(most + 1):
        gap, error = gap_after(it, 0.0), residual(pb, it, fa)
        allowed = absolute + relative * (cost - bound)
        if gap <= allowed and error * error <= RESIDUAL_FACTOR * RESIDUAL_FACTOR * allowed:
            return n, True
        if n == most:
            break
        factorise(pb, it, fa)
        set_target(pb, it, 0.0, 0.0)
        left = gap_after(it, newton_step(pb, it, fa)) / gap if gap > 0.0 else 0.0
        set_target(pb, it, left**3 * gap / count, 1.0)
        step = newton_step(pb, it, fa)
        if step < 1.0:
            step *= max(FRACTION_TO_BOUNDARY, 1.0 - max(gap, MARGIN_TO_BOUNDARY))
        apply_step(it, step)
        cost = roll_out(pb, it, fa)
    return most, False

"""Kernel of the interior-point method on the forces: Mehrotra's predictor and corrector.

The forces are the only unknowns, the states follow from them, and the start is in the middle of
all limits: so every iterate keeps the dynamics and the limits, and what is left to reach is

    dJ/du + G'm = 0      and     s m = 0     with slacks s, multipliers m >= 0

by Newton steps (Nocedal and Wright, Numerical Optimization, algorithm 16.4, with one length for
forces and multipliers). With the gap s'm and the residual r of the first equation, the forces are
within |u - u*|^2 <= 2 (s'm + |r| |u - u*|) / min R of the optimum.
"""

from __future__ import annotations

from slot_core.control.mpc.riccati import (
    FEET,
    HALF,
    INPUTS,
    NOTHING,
    SIDES,
    STATES,
    Factor,
    Iterate,
    QuadraticProgram,
    add_product,
    add_transposed,
    bounded,
    clear,
    factorise,
    go_back,
    go_forward,
    helper,
    kernel,
)
from slot_core.robot import Array

START = 1.0  # s m of every limit at the start; of no influence on the result
TO_THE_WALL = 0.995  # least part of the way to the nearest limit that a step takes
SHORT_OF_IT = 1e-6  # least part that it leaves
STEEP = 0.1  # residual over the root of the gap that is allowed


@helper
def measure(u: Array, mu: float, top: float, out: Array) -> None:
    """Distances of a leg's force from its six limits."""
    wide = mu * u[2]
    out[0], out[1] = wide - u[0], wide + u[0]
    out[2], out[3] = wide - u[1], wide + u[1]
    out[4], out[5] = u[2], top - u[2]


@helper
def push(z: Array, mu: float, out: Array) -> None:
    """out += G'z of a leg."""
    out[0] += z[0] - z[1]
    out[1] += z[2] - z[3]
    out[2] -= mu * (z[0] + z[1] + z[2] + z[3]) + z[4] - z[5]


@helper
def begin(pb: QuadraticProgram, it: Iterate) -> None:
    """The curves E'QE, and forces in the middle of their limits."""
    for k in range(len(pb.weight)):
        curve = it.curve[k]
        for i in range(HALF):
            clear(curve[i])
        for line in range(HALF):
            for i in range(HALF):
                z = pb.weight[k, INPUTS + line] * pb.step[line, i]
                for j in range(HALF):
                    curve[i, j] += z * pb.step[line, j]
        for leg in range(FEET):
            clear(it.u[k, leg])
            if pb.limit[k, leg] > NOTHING:
                it.u[k, leg, 2] = 0.5 * pb.limit[k, leg]


@helper
def begin_multipliers(pb: QuadraticProgram, it: Iterate) -> None:
    """Equal products with the slacks."""
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            for side in range(SIDES):
                it.multiplier[k, leg, side] = 0.0
                if bounded(pb, k, leg, side):
                    it.multiplier[k, leg, side] = START / it.slack[k, leg, side]


@helper
def least_cost(pb: QuadraticProgram) -> float:
    """Cost where every variable has its target, -c'c / 2P."""
    cost = 0.0
    for k in range(len(pb.weight)):
        for i in range(INPUTS + STATES):
            if pb.weight[k, i] > 0.0:
                cost -= 0.5 * pb.linear[k, i] ** 2 / pb.weight[k, i]
    return cost


@helper
def advance(pb: QuadraticProgram, it: Iterate, k: int, w: Array) -> None:
    """States at the end of stage k, w its change of the velocities."""
    x, before = it.x[k], it.x[k - 1]
    for i in range(STATES):
        x[i] = pb.drift[k, i] + (before[i] if k > 0 else 0.0)
    for i in range(HALF):
        x[HALF + i] += w[i]
        w[i] *= 0.5
        if k > 0:
            w[i] += before[HALF + i]
    add_product(pb.step, w, x[:HALF])


@helper
def roll_out(pb: QuadraticProgram, it: Iterate, fa: Factor) -> float:
    """States, slacks and slopes at the forces; returns the cost z'Pz/2 + c'z."""
    w, slope, cost = fa.vector[0][:HALF], fa.vector[1], 0.0
    for k in range(len(pb.weight)):
        clear(w)
        for leg in range(FEET):
            u = it.u[k, leg]
            add_transposed(pb.gain[3 * leg : 3 * leg + 3], u, 1.0, w)
            measure(u, pb.friction[k, leg], pb.limit[k, leg], it.slack[k, leg])
            for axis in range(3):
                c = pb.linear[k, 3 * leg + axis]
                z = pb.weight[k, 3 * leg + axis] * u[axis] + c
                it.slope_u[k, leg, axis] = z
                cost += 0.5 * u[axis] * (z + c)
        advance(pb, it, k, w)
        for i in range(STATES):
            c = pb.linear[k, INPUTS + i]
            slope[i] = pb.weight[k, INPUTS + i] * it.x[k, i] + c
            cost += 0.5 * it.x[k, i] * (slope[i] + c)
        clear(it.slope_x[k])
        add_transposed(pb.step, slope[:HALF], 1.0, it.slope_x[k])
        for i in range(HALF):
            it.slope_x[k, HALF + i] = slope[HALF + i]
    return cost


@helper
def gap_after(it: Iterate, step: float) -> float:
    """s'm after a step."""
    gap = 0.0
    for k in range(len(it.u)):
        for leg in range(FEET):
            for side in range(SIDES):
                s = it.slack[k, leg, side] + step * it.slack_step[k, leg, side]
                m = it.multiplier[k, leg, side] + step * it.multiplier_step[k, leg, side]
                gap += s * m
    return gap


@helper
def residual(pb: QuadraticProgram, it: Iterate, fa: Factor) -> float:
    """Largest entry of dJ/du + G'm."""
    p, bent, g, worst = fa.vector[0], fa.vector[1][:HALF], fa.vector[2], 0.0
    clear(p)
    for k in range(len(pb.weight) - 1, -1, -1):
        for j in range(STATES):
            p[j] += it.slope_x[k, j]
        for j in range(HALF):
            bent[j] = 0.5 * p[j] + p[HALF + j]
            p[HALF + j] += p[j]
        for leg in range(FEET):
            mine = g[3 * leg : 3 * leg + 3]
            for axis in range(3):
                mine[axis] = it.slope_u[k, leg, axis]
            push(it.multiplier[k, leg], pb.friction[k, leg], mine)
        add_product(pb.gain, bent, g)
        for leg in range(FEET):
            for axis in range(3):
                if bounded(pb, k, leg, 2 * axis):
                    worst = max(worst, abs(g[3 * leg + axis]))
    return worst


@helper
def aim(pb: QuadraticProgram, it: Iterate, product: float, second: float) -> None:
    """Let the Newton step aim at s m = product, `second` being 1 with the predictor's own error."""
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            wanted, pull = it.wanted[k, leg], it.pull[k, leg]
            for side in range(SIDES):
                wanted[side] = 0.0
                if bounded(pb, k, leg, side):
                    error = it.slack_step[k, leg, side] * it.multiplier_step[k, leg, side]
                    wanted[side] = (product - second * error) / it.slack[k, leg, side]
            for axis in range(3):
                pull[axis] = it.slope_u[k, leg, axis]
            push(wanted, pb.friction[k, leg], pull)


@helper
def newton_step(pb: QuadraticProgram, it: Iterate, fa: Factor) -> float:
    """The changes of forces, slacks and multipliers; returns how far they lead, at most 1."""
    go_back(pb, it, fa)
    go_forward(pb, it, fa)
    way = 1.0
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            ds, dm = it.slack_step[k, leg], it.multiplier_step[k, leg]
            s, m = it.slack[k, leg], it.multiplier[k, leg]
            measure(it.u_step[k, leg], pb.friction[k, leg], 0.0, ds)
            for side in range(SIDES):
                if not bounded(pb, k, leg, side):
                    ds[side] = dm[side] = 0.0
                    continue
                dm[side] = it.wanted[k, leg, side] - m[side] - m[side] / s[side] * ds[side]
                if s[side] + way * ds[side] < 0.0:
                    way = -s[side] / ds[side]
                if m[side] + way * dm[side] < 0.0:
                    way = -m[side] / dm[side]
    return way


@helper
def take(it: Iterate, step: float) -> None:
    """Go there."""
    for k in range(len(it.u)):
        for leg in range(FEET):
            for axis in range(3):
                it.u[k, leg, axis] += step * it.u_step[k, leg, axis]
            for side in range(SIDES):
                it.multiplier[k, leg, side] += step * it.multiplier_step[k, leg, side]


@helper
def count_limits(pb: QuadraticProgram) -> int:
    """How many limits there are."""
    count = 0
    for k in range(len(pb.weight)):
        for leg in range(FEET):
            for side in range(SIDES):
                if bounded(pb, k, leg, side):
                    count += 1
    return count


@kernel
def minimise(  # noqa: PLR0917
    pb: QuadraticProgram, it: Iterate, fa: Factor, absolute: float, relative: float, most: int
) -> tuple[int, bool, float]:
    """Leave forces in `it.u` and states in `it.x`; returns (iterations, solved, residual).

    Solved is gap <= absolute + relative (cost above that of all targets met), residual <= .1 times
    the root of that. A NaN is never that, and ends with the iterations.
    """
    begin(pb, it)
    cost, least, count = roll_out(pb, it, fa), least_cost(pb), max(count_limits(pb), 1)
    begin_multipliers(pb, it)
    slope = 0.0
    for n in range(most + 1):
        gap, slope = gap_after(it, 0.0), residual(pb, it, fa)
        allowed = absolute + relative * (cost - least)
        if gap <= allowed and slope * slope <= STEEP * STEEP * allowed:
            return n, True, slope
        if n == most:
            break
        factorise(pb, it, fa)
        aim(pb, it, 0.0, 0.0)
        left = gap_after(it, newton_step(pb, it, fa)) / gap if gap > 0.0 else 0.0
        aim(pb, it, left**3 * gap / count, 1.0)
        step = newton_step(pb, it, fa)
        if step < 1.0:
            step *= max(TO_THE_WALL, 1.0 - max(gap, SHORT_OF_IT))
        take(it, step)
        cost = roll_out(pb, it, fa)
    return most, False, slope

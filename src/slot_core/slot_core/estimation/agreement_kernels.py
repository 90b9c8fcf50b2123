"""Kernels of `sensor_agreement.py`: turns of gyroscope and odometry, twist and pose.

The turn o of the odometry between two readings is compared with the turn g of the gyroscope between
the same times, for each of SHIFTS between their stamps. Weighted sums of o, g, |o|^2, |g|^2 and
o g^T are kept; about their means a gyroscope turned by R, in a unit k, leaves the residual

    E(R, k) = sum |o - k R g|^2 = S_o + k^2 S_g - 2 k tr(R^T B),   B = sum o g^T
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position
# mypy: disable-error-code="no-untyped-def"

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import times, times_transposed
from slot_core.estimation.filter_kernels import (
    exponential,
    logarithm,
    multiply,
    store_unit,
)
from slot_core.geometry import rotation_matrix
from slot_core.matrices import set_product

MILLISECOND = 1_000_000  # ns
STEP = 5 * MILLISECOND  # between shifts
# ns, IMU stamp minus odometry stamp of one instant; positive ones wait for the IMU
SHIFTS = np.arange(-32, 17) * STEP
KEPT = 160  # attitudes of the gyroscope, 0.64 s at least
APART = 4 * MILLISECOND  # ns, least time between two of them
GAP = 50 * MILLISECOND  # ns, a longer one between samples ends the integral
MEAN, SQUARE = 9, 12  # columns of `TurnSums.pairs` after those of B
SQUARINGS = 10  # of the matrix whose power gives an eigenvector
JUMP = 0.1  # rad between two readings, a longer turn may be a jump
# of a residual over its standard deviation, squared: jumps count no more
LARGEST_RESIDUAL = 1000.0


class TurnSums(NamedTuple):
    """Attitude integrated from the gyroscope, and weighted sums over intervals of odometry."""

    stamps: NDArray[np.int64]  # (KEPT,) ns, a ring
    attitudes: Array  # (KEPT, 4) x y z w
    ring: NDArray[np.int64]  # (2,) first entry and number of entries
    rate: Array  # (3,) rad/s, of the last sample
    force: Array  # (4,) sum of specific force, m/s^2, and number of samples
    pairs: Array  # (len(SHIFTS), 13) of o g^T, g and |g|^2
    odometry: Array  # (5,) of o, |o|^2 and 1
    # (4,) of squared residuals with the twist in base_link, in odom, without twist; of 1
    twist: Array
    up: Array  # (4,) of specific force in odom over time, m/s, and of time, s


class TurnWork(NamedTuple):
    """Work space and results of the kernels."""

    turn: Array  # (3,) rad, of odometry between two readings
    turns: Array  # (len(SHIFTS), 3) rad, of the gyroscope
    table: Array  # (len(SHIFTS), 12), see `turn_table`
    rotation: Array  # (3, 3)
    power: Array  # (4, 4)
    half: Array  # (4, 4)


def turn_sums() -> TurnSums:
    """Sums over nothing."""
    return TurnSums(
        stamps=np.zeros(KEPT, dtype=np.int64),
        attitudes=np.zeros((KEPT, 4)),
        ring=np.zeros(2, dtype=np.int64),
        rate=np.zeros(3),
        force=np.zeros(4),
        pairs=np.zeros((len(SHIFTS), 13)),
        odometry=np.zeros(5),
        twist=np.zeros(4),
        up=np.zeros(4),
    )


def turn_work() -> TurnWork:
    """Work space."""
    return TurnWork(
        turn=np.zeros(3),
        turns=np.zeros((len(SHIFTS), 3)),
        table=np.zeros((len(SHIFTS), 12)),
        rotation=np.zeros((3, 3)),
        power=np.zeros((4, 4)),
        half=np.zeros((4, 4)),
    )


@helper
def square(a):
    """Square of the length of a (3,)."""
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@kernel
def integrate(sums, rotation, stamp, sample):
    """Continue attitude and mean force with a sample (6,) at `stamp` (ns): Q <- Q Exp(w dt).

    The sample is turned by `rotation` (3, 3). Returns the angular velocity, rad/s.
    """
    sample[0], sample[1], sample[2] = times(rotation, sample[:3])
    sample[3], sample[4], sample[5] = times(rotation, sample[3:])
    stamps, ring, rate = sums.stamps, sums.ring, sums.rate
    newest = (ring[0] + ring[1] - 1) % KEPT
    turned = (0.0, 0.0, 0.0, 1.0)
    if ring[1] > 0 and stamp - stamps[newest] > GAP:
        ring[0], ring[1] = (newest + 1) % KEPT, 0
    if ring[1] > 0:
        half = (stamp - stamps[newest]) / SECOND / 2
        turn = exponential(
            half * (rate[0] + sample[0]),
            half * (rate[1] + sample[1]),
            half * (rate[2] + sample[2]),
        )
        turned = multiply(sums.attitudes[newest], turn)
    if ring[1] < 2 or stamps[newest] - stamps[(newest - 1) % KEPT] >= APART:
        newest = (newest + 1) % KEPT
        if ring[1] < KEPT:
            ring[1] += 1
        else:
            ring[0] = (ring[0] + 1) % KEPT
    stamps[newest] = stamp
    store_unit(sums.attitudes[newest], turned)
    for i in range(3):
        rate[i] = sample[i]
        sums.force[i] += sample[3 + i]
    sums.force[3] += 1.0
    return math.sqrt(square(rate))


@kernel
def coverage(sums, before, after):
    """Whether the gyroscope's attitudes reach over all shifts of an interval (ns): 1.

    0: not yet; -1: no more.
    """
    first, count = sums.ring[0], sums.ring[1]
    if (
        count < 2
        or sums.stamps[(first + count - 1) % KEPT] < after + SHIFTS[-1]
    ):
        return 0
    return -1 if sums.stamps[first] > before + SHIFTS[0] else 1


@helper
def attitude_at(sums, entry, stamp):
    """Attitude at `stamp` (ns), linear between an entry of the ring and the next."""
    a = (sums.ring[0] + entry) % KEPT
    b = (a + 1) % KEPT
    low, high = sums.attitudes[a], sums.attitudes[b]
    share = (stamp - sums.stamps[a]) / (sums.stamps[b] - sums.stamps[a])
    return (
        low[0] + share * (high[0] - low[0]),
        low[1] + share * (high[1] - low[1]),
        low[2] + share * (high[2] - low[2]),
        low[3] + share * (high[3] - low[3]),
    )


@helper
def turn_between(p, q):
    """Rotation vector, rad, of the turn from attitude p to attitude q, in the axes of p."""
    return logarithm(*multiply((-p[0], -p[1], -p[2], p[3]), q))


@kernel
def compare_turns(sums, work, before, after, keep):
    """Add odometry's turn work.turn between two stamps (ns), and the gyroscope's of each shift.

    Older intervals count `keep` of before. Returns False, without effect, for a turn longer than
    JUMP and three times the gyroscope's: the odometry has jumped.
    """
    stamps, first, turn = sums.stamps, sums.ring[0], work.turn
    start, end, largest = 0, 0, 0.0
    for row in range(SHIFTS.size):
        a, b = before + SHIFTS[row], after + SHIFTS[row]
        while stamps[(first + start + 1) % KEPT] < a:
            start += 1
        while stamps[(first + end + 1) % KEPT] < b:
            end += 1
        g = work.turns[row]
        g[0], g[1], g[2] = turn_between(
            attitude_at(sums, start, a), attitude_at(sums, end, b)
        )
        largest = max(largest, square(g))
    size = square(turn)
    if size > JUMP * JUMP and size > 9.0 * largest:
        return False
    total = sums.odometry
    for i in range(3):
        total[i] = keep * total[i] + turn[i]
    total[3], total[4] = keep * total[3] + size, keep * total[4] + 1.0
    for row in range(SHIFTS.size):
        pair, g = sums.pairs[row], work.turns[row]
        for i in range(3):
            pair[MEAN + i] = keep * pair[MEAN + i] + g[i]
            for j in range(3):
                pair[3 * i + j] = keep * pair[3 * i + j] + turn[i] * g[j]
        pair[SQUARE] = keep * pair[SQUARE] + square(g)
    return True


@kernel
def turn_table(sums, work):
    """Write E(1, 1), S_o, S_g and B row by row, about the means, of each shift to work.table."""
    total, count = sums.odometry, max(sums.odometry[4], 1.0)
    turned = total[3] - square(total[:3]) / count
    for row in range(SHIFTS.size):
        pair, out = sums.pairs[row], work.table[row]
        out[1] = turned
        out[2] = pair[SQUARE] - square(pair[MEAN:SQUARE]) / count
        for i in range(9):
            out[3 + i] = pair[i] - total[i // 3] * pair[MEAN + i % 3] / count
        out[0] = turned + out[2] - 2.0 * (out[3] + out[7] + out[11])


@kernel
def align(b, prior, work):
    """Write the rotation R that maximises tr(R^T (B + prior 1)) to work.rotation.

    b (9,): B row by row; `prior` decides about axes without motion. Davenport's q-method: its
    quaternion is the eigenvector of a symmetric matrix's largest eigenvalue, here by a high power.
    """
    k, half = work.power, work.half
    trace = b[0] + b[4] + b[8] + 3.0 * prior
    bound = abs(trace)
    for i in range(3):
        for j in range(3):
            k[i, j] = b[3 * i + j] + b[3 * j + i]
            bound += abs(k[i, j])
        k[i, i] += 2.0 * prior - trace
        k[i, 3] = k[3, i] = (
            b[3 * ((i + 2) % 3) + (i + 1) % 3]
            - b[3 * ((i + 1) % 3) + (i + 2) % 3]
        )
    k[3, 3] = trace
    for i in range(4):
        k[i, i] += bound  # no eigenvalue is negative
    for _ in range(SQUARINGS):
        set_product(half, k, k)
        largest = max(half[0, 0], half[1, 1], half[2, 2], half[3, 3])
        for i in range(4):
            for j in range(4):
                k[i, j] = half[i, j] / largest
    column = 0
    for i in range(1, 4):
        column = i if k[i, i] > k[column, column] else column
    store_unit(half[0], k[column])
    rotation_matrix(work.rotation, half[0])


@kernel
def set_turn(work, p, q):
    """Set work.turn to the turn from attitude p to attitude q (4,)."""
    work.turn[0], work.turn[1], work.turn[2] = turn_between(p, q)


@kernel
def compare_steps(sums, work, before, after, dt, variance, keep, keep_force):
    """Add the step between two readings (13,), dt (s) apart, to the sums of twist and force.

    A reading: attitude, position, velocity, angular velocity. Of the displacement and work.turn
    the mean twist, in base_link or odom, or no twist leaves a residual, which is divided by
    `variance` (2,) m^2, rad^2. The mean specific force since the step before is turned into odom.
    """
    moved, turned, rotation = work.half[0], work.half[1], work.rotation
    for kind in range(4):
        sums.twist[kind] *= keep
    sums.twist[3] += 1.0
    for kind in range(3):
        in_base = dt / 2 if kind == 0 else 0.0
        in_odom = dt / 2 if kind == 1 else 0.0
        for i in range(3):
            moved[i], turned[i] = after[4 + i] - before[4 + i], work.turn[i]
        for reading in (before, after):
            rotation_matrix(rotation, reading[:4])
            v = times(rotation, reading[7:10])
            w = times_transposed(rotation, reading[10:13])
            for i in range(3):
                moved[i] -= in_base * v[i] + in_odom * reading[7 + i]
                turned[i] -= in_base * reading[10 + i] + in_odom * w[i]
        sums.twist[kind] += min(
            square(moved) / variance[0], LARGEST_RESIDUAL
        ) + min(square(turned) / variance[1], LARGEST_RESIDUAL)
    up, force = sums.up, sums.force
    for i in range(4):
        up[i] *= keep_force
    if force[3] > 0.0:
        for reading in (before, after):
            rotation_matrix(rotation, reading[:4])
            for i in range(3):
                for j in range(3):
                    up[i] += dt / 2 * rotation[i, j] * force[j] / force[3]
        up[3] += dt
    force[:] = 0.0

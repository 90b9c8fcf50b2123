"""Kernels of the error-state filter: propagation, correction and output (`inertial_filter.py`).

Attitudes are unit quaternions x y z w of base_link in odom. The blocks of the error state
[d_theta, d_p, d_v, d_b_w, d_b_f] (15,) begin at THETA, P, V, GYRO_BIAS and FORCE_BIAS. Operations
are neither reordered nor fused, so that every processor gives the same bits.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slot_core.clock import SECOND
from slot_core.compiled import exact_helper, exact_kernel
from slot_core.robot import GRAVITY, Array

THETA, P, V, GYRO_BIAS, FORCE_BIAS = range(0, 15, 3)
ERROR, MEASURED = 15, 9  # sizes of the error state and of a reading's angle, position, velocity
COS_PITCH_MIN = 1e-3  # keeps the covariance of roll and yaw finite at a pitch of 90 deg
SMALL_ANGLE = 1e-4  # rad, below which the next term of a series is less than a rounding error


class FilterState(NamedTuple):
    """Nominal state and covariance of the error state; the kernels change them in place."""

    attitude: Array  # (4,) unit quaternion x y z w
    position: Array  # (3,) m, in odom
    velocity: Array  # (3,) m/s, in odom
    bias: Array  # (2, 3) gyro rad/s, specific force m/s^2
    cov: Array  # (15, 15)


class FilterWork(NamedTuple):
    """Work space of the kernels."""

    rotation: Array  # (3, 3)
    wide: Array  # (15, 15) jacobian or transition
    product: Array  # (15, 15)
    innovation: Array  # (9, 9) its covariance
    gain: Array  # (15, 9)
    block: Array  # (3, 3)
    residual: Array  # (9,)
    weighted: Array  # (3,)
    error: Array  # (15,)
    sample: Array  # (6,) of the IMU


def work_space() -> FilterWork:
    """Work space of one filter."""
    wide, block = (15, 15), (3, 3)
    shapes = (block, wide, wide, (9, 9), (15, 9), block, (9,), (3,), (15,), (6,))
    return FilterWork(*(np.zeros(shape) for shape in shapes))


@exact_helper
def exponential(x, y, z):
    """Unit quaternion (x y z w) of the rotation vector (x, y, z), rad."""
    angle = math.sqrt(x * x + y * y + z * z)
    small = angle < SMALL_ANGLE
    scale = 0.5 - angle * angle / 48.0 if small else math.sin(angle / 2.0) / angle
    return x * scale, y * scale, z * scale, math.cos(angle / 2.0)


@exact_helper
def logarithm(x, y, z, w):
    """Rotation vector, rad, of at most pi, of the unit quaternion (x y z w)."""
    sine = math.sqrt(x * x + y * y + z * z)
    sign = 1.0 if w >= 0.0 else -1.0  # -q is the same rotation
    if sine < SMALL_ANGLE:
        scale = sign * (2.0 + sine * sine / 3.0)
    else:
        scale = sign * 2.0 * math.atan2(sine, abs(w)) / sine
    return x * scale, y * scale, z * scale


@exact_helper
def multiply(a, b):
    """Product a b of two quaternions: first the rotation b, then a."""
    ax, ay, az, aw = a[0], a[1], a[2], a[3]
    bx, by, bz, bw = b[0], b[1], b[2], b[3]
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


@exact_helper
def store_unit(out, q):
    """Store the quaternion q in out (4,), of unit norm."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        out[i] = q[i] / norm


@exact_helper
def rotation_matrix(out, q):
    """Rotation matrix (3, 3) of the unit quaternion q."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - z * w),
        2 * (x * z + y * w),
    )
    out[1, 0], out[1, 1], out[1, 2] = (
        2 * (x * y + z * w),
        1 - 2 * (x * x + z * z),
        2 * (y * z - x * w),
    )
    out[2, 0], out[2, 1], out[2, 2] = (
        2 * (x * z - y * w),
        2 * (y * z + x * w),
        1 - 2 * (x * x + y * y),
    )


@exact_helper
def rotate(m, a):
    """The rotation matrix m (3, 3) times the vector a (3,)."""
    return (
        m[0, 0] * a[0] + m[0, 1] * a[1] + m[0, 2] * a[2],
        m[1, 0] * a[0] + m[1, 1] * a[1] + m[1, 2] * a[2],
        m[2, 0] * a[0] + m[2, 1] * a[1] + m[2, 2] * a[2],
    )


@exact_helper
def set_cross(out, row, column, a, scale):
    """Set a block (3, 3) of out to scale [a]x, with [a]x b = a x b."""
    x, y, z = scale * a[0], scale * a[1], scale * a[2]
    out[row, column], out[row, column + 1], out[row, column + 2] = 0.0, -z, y
    out[row + 1, column], out[row + 1, column + 1], out[row + 1, column + 2] = z, 0.0, -x
    out[row + 2, column], out[row + 2, column + 1], out[row + 2, column + 2] = -y, x, 0.0


@exact_helper
def set_scaled(out, row, column, m, scale):
    """Set a block (3, 3) of out to scale m."""
    for i in range(3):
        for j in range(3):
            out[row + i, column + j] = scale * m[i, j]


@exact_helper
def set_identity(out):
    """Set out (m, n) to ones on the diagonal and zeros beside it."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = 1.0 if i == j else 0.0


@exact_helper
def product(out, a, b):
    """out = a b."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for k in range(a.shape[1]):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += factor * b[k, j]


@exact_helper
def product_transposed(out, a, b):
    """out = a b^T."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            value = 0.0
            for k in range(a.shape[1]):
                value += a[i, k] * b[j, k]
            out[i, j] = value


@exact_helper
def congruence(p, f, half):
    """p <- f p f^T with a symmetric p; fast where f is sparse. half: work space of p's shape."""
    product(half, f, p)
    for i in range(p.shape[0]):
        for j in range(i):
            half[i, j], half[j, i] = half[j, i], half[i, j]
    product(p, f, half)


@exact_helper
def symmetrise(a):
    """a <- (a + a^T) / 2."""
    for i in range(a.shape[0]):
        for j in range(i):
            a[i, j] = a[j, i] = 0.5 * (a[i, j] + a[j, i])


@exact_helper
def cholesky(a):
    """Replace the lower triangle of a by its Cholesky factor L, a = L L^T; NaN if there is none."""
    for j in range(a.shape[0]):
        for i in range(j, a.shape[0]):
            value = a[i, j]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            a[i, j] = value / a[j, j] if i > j else math.sqrt(value)


@exact_helper
def solve_cholesky(factor, x):
    """Replace x (n,) by the solution of L L^T x = x."""
    n = x.shape[0]
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@exact_kernel
def interpolate(out, stamps, samples, stamp):
    """IMU sample out (6,) at `stamp` (ns), linear between neighbours; its noise variance factor.

    stamps (n,) in ns, rising, and samples (n, 6). Beyond the last sample it is extrapolated over
    one sample interval at most. A held value would be late by half an interval; with the torso's
    angular acceleration that is the larger error.
    """
    after, weight = stamps.shape[0] - 1, 1.0
    while after > 1 and stamps[after - 1] >= stamp:
        after -= 1
    before = max(after - 1, 0)
    if after > before:
        weight = (stamp - stamps[before]) / (stamps[after] - stamps[before])
        weight = min(max(weight, 0.0), 2.0)
    for i in range(6):
        out[i] = samples[before, i] + weight * (samples[after, i] - samples[before, i])
    return weight * weight + (1.0 - weight) * (1.0 - weight)


@exact_kernel
def propagate(state, work, rate, force, dt, noise, from_imu):
    """Propagate by dt (s) with the rate and specific force (3,) of base_link at the midpoint.

    Midpoint rule, with R_m = R Exp(w dt/2) and a = R_m f + g. from_imu: they are raw samples, whose
    biases are subtracted and act; else force is in odom. noise (15,): variance densities Q. With
    A = dt dx'/dx the covariance is P <- F (P + Q dt/2) F^T + Q dt/2, F = I + A + A^2 / 2. Half of
    the noise enters before the step, so that it reaches the position in a long step.
    """
    share = 1.0 if from_imu else 0.0
    w, f = work.weighted, work.error[:3]
    for i in range(3):
        w[i] = dt / 2 * (rate[i] - share * state.bias[0, i])
        f[i] = force[i] - share * state.bias[1, i]
    half = exponential(w[0], w[1], w[2])
    middle = multiply(state.attitude, half)
    rotation = work.rotation
    rotation_matrix(rotation, middle)
    if from_imu:
        f[0], f[1], f[2] = rotate(rotation, f)
    store_unit(state.attitude, multiply(middle, half))
    for i in range(3):
        acceleration = f[i] - (GRAVITY if i == 2 else 0.0)
        state.position[i] += dt * state.velocity[i] + dt * dt / 2 * acceleration
        state.velocity[i] += dt * acceleration
    transition(work.wide, rotation, f, dt, share, work.block)
    for i in range(ERROR):
        state.cov[i, i] += dt / 2 * noise[i]
    congruence(state.cov, work.wide, work.product)
    for i in range(ERROR):
        state.cov[i, i] += dt / 2 * noise[i]


@exact_kernel
def propagate_through(state, work, stamps, samples, begin, end, noise, longest, rate, blind_noise):
    """Propagate from `begin` to `end` (ns) in steps between the IMU samples.

    stamps (n,) in ns, rising, and samples (n, 6) [w, f] in base_link, of which each step takes the
    value at its midpoint. A step longer than `longest` (ns) is made at constant velocities, with
    the angular velocity `rate` (3,) and blind_noise (15,), without the samples.
    """
    start, sample = begin, work.sample
    for i in range(stamps.shape[0] + 1):
        stop = min(stamps[i], end) if i < stamps.shape[0] else end
        if stop <= start:
            continue
        dt = (stop - start) / SECOND
        if stop - start > longest:
            sample[0], sample[1], sample[2] = 0.0, 0.0, GRAVITY
            propagate(state, work, rate, sample[:3], dt, blind_noise, False)
        else:
            interpolate(sample, stamps, samples, (start + stop) // 2)
            propagate(state, work, sample[:3], sample[3:], dt, noise, True)
        start = stop


@exact_helper
def transition(out, rotation, force, dt, share, block):
    """F = I + A + A^2 / 2 (15, 15) of the linear error equations x' dt = A x, which are

        d_theta' = -R d_b_w,   d_p' = d_v,   d_v' = -[f]x d_theta - R d_b_f

    with the force f in odom; share: 1 if it and the rate are the IMU's, 0 if no bias acts.
    """
    set_identity(out)
    for i in range(3):
        out[P + i, V + i] = dt
    set_scaled(out, THETA, GYRO_BIAS, rotation, -share * dt)
    set_scaled(out, V, FORCE_BIAS, rotation, -share * dt)
    set_cross(out, V, THETA, force, -dt)
    set_cross(out, P, THETA, force, -dt * dt / 2)
    set_scaled(out, P, FORCE_BIAS, rotation, -share * dt * dt / 2)
    product(block, out[V : V + 3, THETA : THETA + 3], rotation)
    set_scaled(out, V, GYRO_BIAS, block, -share * dt / 2)


@exact_kernel
def correct(state, work, attitude, position, velocity, variance, gate):
    """Correct with a reading at the state's time, velocity in base_link; False for an outlier.

    variance (9,): of angle and position in odom and of velocity in base_link; gate: largest
    Mahalanobis distance of each of the three. The estimated error (15,) is left in work.error.
    Joseph's form: P <- (I - K H) P (I - K H)^T + K R K^T.
    """
    residual, jacobian = work.residual, work.wide[:MEASURED]
    set_residual(residual, state, work, attitude, position, velocity)
    set_identity(jacobian)
    set_velocity_jacobian(jacobian, state.velocity, work)
    product(work.product[:MEASURED], jacobian, state.cov)
    product_transposed(work.innovation, work.product[:MEASURED], jacobian)
    for i in range(MEASURED):
        work.innovation[i, i] += variance[i]
    for block in (THETA, P, V):
        if not inside(work, block, gate):
            return False
    cholesky(work.innovation)
    for i in range(ERROR):  # K = (S^-1 H P)^T
        for j in range(MEASURED):
            work.gain[i, j] = work.product[j, i]
        solve_cholesky(work.innovation, work.gain[i])
    reduce_covariance(state, work, variance)
    for i in range(ERROR):
        work.error[i] = 0.0
        for j in range(MEASURED):
            work.error[i] += work.gain[i, j] * residual[j]
    add_error(state, work)
    return True


@exact_helper
def set_residual(out, state, work, attitude, position, velocity):
    """Innovation (9,), measured minus predicted: angle, position in odom; velocity in base_link."""
    a, rotation = state.attitude, work.rotation
    inverse = (-a[0], -a[1], -a[2], a[3])
    x, y, z, w = multiply(attitude, inverse)
    out[0], out[1], out[2] = logarithm(x, y, z, w)
    rotation_matrix(rotation, a)
    for i in range(3):
        out[P + i] = position[i] - state.position[i]
        out[V + i] = velocity[i]
        for j in range(3):
            out[V + i] -= rotation[j, i] * state.velocity[j]


@exact_helper
def set_velocity_jacobian(out, velocity, work):
    """Derivative of R^T v by the angle error in odom, R^T [v]x, and by v, R^T; block is used."""
    rotation, block = work.rotation, work.block
    set_cross(block, 0, 0, velocity, 1.0)
    for i in range(3):
        for j in range(3):
            out[V + i, V + j] = rotation[j, i]
            total = 0.0
            for k in range(3):
                total += rotation[k, i] * block[k, j]
            out[V + i, THETA + j] = total


@exact_helper
def inside(work, start, gate):
    """Whether three residuals are within the Mahalanobis distance `gate`; False for NaN."""
    block, weighted, square = work.block, work.weighted, 0.0
    for i in range(3):
        weighted[i] = work.residual[start + i]
        for j in range(3):
            block[i, j] = work.innovation[start + i, start + j]
    cholesky(block)
    solve_cholesky(block, weighted)
    for i in range(3):
        square += weighted[i] * work.residual[start + i]
    return square <= gate * gate


@exact_helper
def reduce_covariance(state, work, variance):
    """P <- (I - K H) P (I - K H)^T + K R K^T; overwrites the jacobian H with I - K H."""
    product(work.product, work.gain, work.wide[:MEASURED])
    set_identity(work.wide)
    for i in range(ERROR):
        for j in range(ERROR):
            work.wide[i, j] -= work.product[i, j]
    congruence(state.cov, work.wide, work.product)
    for i in range(ERROR):
        for j in range(i + 1):
            for k in range(MEASURED):
                state.cov[i, j] += work.gain[i, k] * variance[k] * work.gain[j, k]
            state.cov[j, i] = state.cov[i, j]


@exact_helper
def add_error(state, work):
    """Add the estimated error (15,) to the nominal state and the biases."""
    error = work.error
    turn = exponential(error[0], error[1], error[2])
    store_unit(state.attitude, multiply(turn, state.attitude))
    for i in range(3):
        state.position[i] += error[P + i]
        state.velocity[i] += error[V + i]
        state.bias[0, i] += error[GYRO_BIAS + i]
        state.bias[1, i] += error[FORCE_BIAS + i]


@exact_kernel
def output(state, work, rate, gyro_share, rate_variance, out, cov):
    """State out (12,) and covariance cov (12, 12) of `Estimate`, of first order.

    rate (3,) in base_link with its variance; gyro_share: how much of the gyro bias it contains.
    """
    rotation, jacobian = work.rotation, work.wide[:12]
    rotation_matrix(rotation, state.attitude)
    out[0] = math.atan2(rotation[2, 1], rotation[2, 2])
    out[1] = math.asin(min(max(-rotation[2, 0], -1.0), 1.0))
    out[2] = math.atan2(rotation[1, 0], rotation[0, 0])
    out[6], out[7], out[8] = rotate(rotation, rate)
    for i in range(12):
        for j in range(ERROR):
            jacobian[i, j] = 0.0
    set_angle_jacobian(jacobian, out[1], out[2])
    for i in range(3):
        out[3 + i], out[9 + i] = state.position[i], state.velocity[i]
        jacobian[3 + i, P + i] = jacobian[9 + i, V + i] = 1.0
    set_cross(jacobian, 6, THETA, out[6:9], -1.0)
    set_scaled(jacobian, 6, GYRO_BIAS, rotation, -gyro_share)
    product(work.product[:12], jacobian, state.cov)
    product_transposed(cov, work.product[:12], jacobian)
    for i in range(6, 9):
        cov[i, i] += rate_variance
    symmetrise(cov)


@exact_helper
def set_angle_jacobian(out, pitch, yaw):
    """Set the first block of out to d(roll, pitch, yaw) by a small rotation about odom's axes."""
    s, c = math.sin(yaw), math.cos(yaw)
    cos_pitch = max(math.cos(pitch), COS_PITCH_MIN)
    t = math.sin(pitch) / cos_pitch
    out[0, 0], out[0, 1] = c / cos_pitch, s / cos_pitch
    out[1, 0], out[1, 1] = -s, c
    out[2, 0], out[2, 1], out[2, 2] = c * t, s * t, 1.0

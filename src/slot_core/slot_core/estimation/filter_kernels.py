"""Kernels of the error-state filter: propagation, correction and output (`inertial_filter.py`).

Attitudes are unit quaternions x y z w of base_link in odom. The blocks of the error state
[d_theta, d_p, d_v, d_b_w, d_b_f] (15,) begin at THETA, P, V, GYRO_BIAS and FORCE_BIAS. Operations
are neither reordered nor fused, so that every processor gives the same bits.
"""

# ruff: noqa: PLR0917 - kernels take their arguments by position
# mypy: disable-error-code="no-untyped-def"

import math
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import times, times_transposed
from slot_core.elementary import atan2, cos, sin
from slot_core.geometry import roll_pitch_yaw, rotation_matrix, set_rows
from slot_core.matrices import (
    cholesky,
    set_product,
    set_product_transposed,
    solve_cholesky,
)
from slot_core.robot import GRAVITY

THETA, P, V, GYRO_BIAS, FORCE_BIAS = range(0, 15, 3)
# sizes of the error state and of a reading's angle, position, velocity
ERROR, MEASURED = 15, 9
SMALL_ANGLE = 1e-4  # rad, below which the next term of a series is less than a rounding error
# keeps the covariance of roll and yaw finite at a pitch of 90 deg
COS_PITCH_MIN = 1e-3


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
    return FilterWork(
        rotation=np.zeros((3, 3)),
        wide=np.zeros((15, 15)),
        product=np.zeros((15, 15)),
        innovation=np.zeros((9, 9)),
        gain=np.zeros((15, 9)),
        block=np.zeros((3, 3)),
        residual=np.zeros(9),
        weighted=np.zeros(3),
        error=np.zeros(15),
        sample=np.zeros(6),
    )


@kernel
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
        out[i] = samples[before, i] + weight * (
            samples[after, i] - samples[before, i]
        )
    return weight * weight + (1.0 - weight) * (1.0 - weight)


@kernel
def propagate(state, work, rate, force, dt, noise, from_imu, bias_max):
    """Propagate by dt (s) with the rate and specific force (3,) of base_link at the midpoint.

    Midpoint rule, with R_m = R Exp(w dt/2) and a = R_m f + g. from_imu: they are raw samples, whose
    biases are subtracted and act; else force is in odom. noise (15,): variance densities Q. With
    A = dt dx'/dx the covariance is P <- F (P + Q dt/2) F^T + Q dt/2, F = I + A + A^2 / 2. Half of
    the noise enters before the step, so that it reaches the position in a long step. bias_max: see
    `turn_tilt`.
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
        f[0], f[1], f[2] = times(rotation, f)
    store_unit(state.attitude, multiply(middle, half))
    for i in range(3):
        acceleration = f[i] - (GRAVITY if i == 2 else 0.0)
        state.position[i] += dt * state.velocity[i] + dt * dt / 2 * acceleration
        state.velocity[i] += dt * acceleration
    transition(work.wide, rotation, f, dt, share, work.block)
    if from_imu:
        turn_tilt(state, work, multiply(half, half), dt, bias_max)
    for i in range(ERROR):
        state.cov[i, i] += dt / 2 * noise[i]
    congruence(state.cov, work.wide, work.product)
    for i in range(ERROR):
        state.cov[i, i] += dt / 2 * noise[i]


@kernel
def propagate_through(
    state,
    work,
    stamps,
    samples,
    begin,
    end,
    noise,
    bias_max,
    longest,
    rate,
    blind_noise,
):
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
            propagate(
                state, work, rate, sample[:3], dt, blind_noise, False, bias_max
            )
        else:
            interpolate(sample, stamps, samples, (start + stop) // 2)
            propagate(
                state, work, sample[:3], sample[3:], dt, noise, True, bias_max
            )
        start = stop


@helper
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
    set_product(block, out[V : V + 3, THETA : THETA + 3], rotation)
    set_scaled(out, V, GYRO_BIAS, block, -share * dt / 2)


@helper
def turn_tilt(state, work, turn, dt, largest):
    """Turn a bias of the specific force longer than `largest` (m/s^2) against base_link's `turn`.

    The accelerometer's own bias stays in base_link and is no longer than that, so a longer one is
    the tilt of odom: b_f = R^T t with t constant in odom, so b_f' = -(w - b_w) x b_f. The turn took
    dt (s); the transition in work.wide is extended by it.
    """
    b = state.bias[1]
    if b[0] * b[0] + b[1] * b[1] + b[2] * b[2] <= largest * largest:
        return
    back = work.block
    rotation_matrix(back, (-turn[0], -turn[1], -turn[2], turn[3]))
    b[0], b[1], b[2] = times(back, b)
    set_scaled(work.wide, FORCE_BIAS, FORCE_BIAS, back, 1.0)
    set_cross(work.wide, FORCE_BIAS, GYRO_BIAS, b, -dt)


@kernel
def correct(
    state, work, attitude, position, velocity, variance, gate, bias_max
):
    """Correct with a reading at the state's time, velocity in base_link; False for an outlier.

    variance (9,): of angle and position in odom and of velocity in base_link; gate: largest
    Mahalanobis distance of each of the three; bias_max: see `bound_force_bias`. The estimated error
    (15,) is left in work.error. Joseph's form: P <- (I - K H) P (I - K H)^T + K R K^T.
    """
    residual, jacobian = work.residual, work.wide[:MEASURED]
    set_residual(residual, state, work, attitude, position, velocity)
    set_identity(jacobian)
    set_velocity_jacobian(jacobian, state.velocity, work)
    set_product(work.product[:MEASURED], jacobian, state.cov)
    set_product_transposed(work.innovation, work.product[:MEASURED], jacobian)
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
    bound_force_bias(state, work, bias_max)
    return True


@helper
def set_residual(out, state, work, attitude, position, velocity):
    """Innovation (9,), measured minus predicted: angle, position in odom; velocity in base_link.

    With the innovation t of the angle the velocity's is R^T (exp(t) R v_read - v - t x v). To first
    order it is v_read - R^T v, which lacks the product of both errors: after 0.2 s of a walk
    without IMU, 50 mm/s.
    """
    a, v, rotation = state.attitude, state.velocity, work.rotation
    t = logarithm(*multiply(attitude, (-a[0], -a[1], -a[2], a[3])))
    out[0], out[1], out[2] = t
    rotation_matrix(rotation, attitude)
    read = times(rotation, velocity)
    off = (
        read[0] - v[0] - (t[1] * v[2] - t[2] * v[1]),
        read[1] - v[1] - (t[2] * v[0] - t[0] * v[2]),
        read[2] - v[2] - (t[0] * v[1] - t[1] * v[0]),
    )
    rotation_matrix(rotation, a)
    for i in range(3):
        out[P + i] = position[i] - state.position[i]
    out[V], out[V + 1], out[V + 2] = times_transposed(rotation, off)


@helper
def set_velocity_jacobian(out, velocity, work):
    """Derivative of R^T v by the angle error in odom, R^T [v]x, and by v, R^T; block is used."""
    rotation, block = work.rotation, work.block
    set_cross(block, 0, 0, velocity, 1.0)
    for i in range(3):
        for j in range(3):
            out[V + i, V + j] = rotation[j, i]
            out[V + i, THETA + j] = (
                rotation[0, i] * block[0, j]
                + rotation[1, i] * block[1, j]
                + rotation[2, i] * block[2, j]
            )


@helper
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


@helper
def reduce_covariance(state, work, variance):
    """P <- (I - K H) P (I - K H)^T + K R K^T; overwrites the jacobian H with I - K H."""
    set_product(work.product, work.gain, work.wide[:MEASURED])
    set_identity(work.wide)
    for i in range(ERROR):
        for j in range(ERROR):
            work.wide[i, j] -= work.product[i, j]
    congruence(state.cov, work.wide, work.product)
    for i in range(ERROR):
        for j in range(i + 1):
            for k in range(MEASURED):
                state.cov[i, j] += (
                    work.gain[i, k] * variance[k] * work.gain[j, k]
                )
            state.cov[j, i] = state.cov[i, j]


@helper
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


@helper
def bound_force_bias(state, work, largest):
    """Limit the accelerometer's bias to `largest` (m/s^2), whatever the tilt of odom.

    At rest the accelerometer shows u = (0, 0, g) + R b_f in odom: gravity, which the tilt of odom
    turns but does not change in length, and the sensor's own bias. So | |u| - g | <= `largest`;
    beyond it u is scaled to the limit.
    """
    u, rotation = work.weighted, work.rotation
    rotation_matrix(rotation, state.attitude)
    u[0], u[1], u[2] = times(rotation, state.bias[1])
    u[2] += GRAVITY
    length = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    bounded = min(max(length, GRAVITY - largest), GRAVITY + largest)
    if bounded == length:
        return
    for i in range(3):
        u[i] *= bounded / max(length, 1e-9)
    u[2] -= GRAVITY
    b = state.bias[1]
    b[0], b[1], b[2] = times_transposed(rotation, u)


@kernel
def output(state, work, rate, gyro_share, rate_variance, out, cov):
    """State out (12,) and covariance cov (12, 12) of `Estimate`, of first order.

    rate (3,) in base_link with its variance; gyro_share: how much of the gyro bias it contains.
    """
    rotation, jacobian = work.rotation, work.wide[:12]
    rotation_matrix(rotation, state.attitude)
    out[0], out[1], out[2] = roll_pitch_yaw(rotation)
    out[6], out[7], out[8] = times(rotation, rate)
    for i in range(12):
        for j in range(ERROR):
            jacobian[i, j] = 0.0
    set_angle_jacobian(jacobian, out[1], out[2])
    for i in range(3):
        out[3 + i], out[9 + i] = state.position[i], state.velocity[i]
        jacobian[3 + i, P + i] = jacobian[9 + i, V + i] = 1.0
    set_cross(jacobian, 6, THETA, out[6:9], -1.0)
    set_scaled(jacobian, 6, GYRO_BIAS, rotation, -gyro_share)
    set_product(work.product[:12], jacobian, state.cov)
    set_product_transposed(cov, work.product[:12], jacobian)
    for i in range(6, 9):
        cov[i, i] += rate_variance
    for i in range(12):
        for j in range(i):
            cov[i, j] = cov[j, i] = 0.5 * (cov[i, j] + cov[j, i])


@helper
def set_angle_jacobian(out, pitch, yaw):
    """Set the first block of out to d(roll, pitch, yaw) by a small rotation about odom's axes."""
    s, c = sin(yaw), cos(yaw)
    cos_pitch = max(cos(pitch), COS_PITCH_MIN)
    t = sin(pitch) / cos_pitch
    set_rows(
        out,
        (c / cos_pitch, s / cos_pitch, 0.0),
        (-s, c, 0.0),
        (c * t, s * t, 1.0),
    )


@helper
def exponential(x, y, z):
    """Unit quaternion (x y z w) of the rotation vector (x, y, z), rad."""
    angle = math.sqrt(x * x + y * y + z * z)
    small = angle < SMALL_ANGLE
    scale = 0.5 - angle * angle / 48.0 if small else sin(angle / 2.0) / angle
    return x * scale, y * scale, z * scale, cos(angle / 2.0)


@helper
def logarithm(x, y, z, w):
    """Rotation vector, rad, of at most pi, of the unit quaternion (x y z w)."""
    sine = math.sqrt(x * x + y * y + z * z)
    sign = 1.0 if w >= 0.0 else -1.0  # -q is the same rotation
    if sine < SMALL_ANGLE:
        scale = sign * (2.0 + sine * sine / 3.0)
    else:
        scale = sign * 2.0 * atan2(sine, abs(w)) / sine
    return x * scale, y * scale, z * scale


@helper
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


@helper
def store_unit(out, q):
    """Store the quaternion q in out (4,), of unit norm."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        out[i] = q[i] / norm


@helper
def set_cross(out, row, column, a, scale):
    """Set a block (3, 3) of out to scale [a]x, with [a]x b = a x b."""
    x, y, z = scale * a[0], scale * a[1], scale * a[2]
    set_rows(
        out[row : row + 3, column : column + 3],
        (0.0, -z, y),
        (z, 0.0, -x),
        (-y, x, 0.0),
    )


@helper
def set_scaled(out, row, column, m, scale):
    """Set a block (3, 3) of out to scale m."""
    for i in range(3):
        for j in range(3):
            out[row + i, column + j] = scale * m[i, j]


@helper
def set_identity(out):
    """Set out (m, n) to ones on the diagonal and zeros beside it."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = 1.0 if i == j else 0.0


@helper
def congruence(p, f, half):
    """p <- f p f^T with a symmetric p; fast where f is sparse. half: work space of p's shape."""
    set_product(half, f, p)
    for i in range(p.shape[0]):
        for j in range(i):
            half[i, j], half[j, i] = half[j, i], half[i, j]
    set_product(p, f, half)

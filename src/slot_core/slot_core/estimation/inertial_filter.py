"""Error-state Kalman filter of the torso: the IMU propagates, the odometry corrects.

After Sola, "Quaternion kinematics for the error-state Kalman filter", 2017, with the angle error in
odom:

    R' = R [w - b_w]x
    p' = v
    v' = R (f - b_f) + g

with w, f the angular velocity and specific force of the IMU in base_link and b_w, b_f their biases.
The error state is x = [d_theta, d_p, d_v, d_b_w, d_b_f] (15,), with R_true = Exp(d_theta) R.
The arithmetic is compiled: `filter_kernels.py`.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array, checked
from slot_core.clock import to_ns
from slot_core.config import choice, flag, quantity, text
from slot_core.elementary import atan2
from slot_core.estimation.filter_kernels import (
    FilterState,
    correct,
    interpolate,
    output,
    propagate,
    propagate_through,
    work_space,
)
from slot_core.estimation.floor_observer import (
    LEVEL,
    FloorObserverSettings,
    FloorPlane,
)
from slot_core.geometry import (
    inverse_quaternion,
    matrix_of_quaternion,
    quaternion_product,
)
from slot_core.key_frame import StateParts
from slot_core.matrices import norm, product
from slot_core.robot import GRAVITY

UP = np.array([0.0, 0.0, GRAVITY])  # specific force at rest, in odom
THETA, P, V, GYRO_BIAS, FORCE_BIAS = (slice(i, i + 3) for i in range(0, 15, 3))

NO_ODOMETRY = "none"  # source of the odometry


@dataclass(frozen=True)
class OdometryNoise:
    """Source, noise and admissible range of the odometry."""

    source: str = choice(
        "source; none: of a robot without a camera", "topic", NO_ODOMETRY
    )
    position_noise: float = quantity(
        "standard deviation of the position", "m", 1e-6, 1
    )
    angle_noise: float = quantity(
        "standard deviation of the attitude", "rad", 1e-6, 1
    )
    velocity_noise: float = quantity(
        "standard deviation of the velocity", "m/s", 1e-6, 10
    )
    rate_noise: float = quantity(
        "standard deviation of the angular velocity", "rad/s", 1e-6, 10
    )
    position_max: float = quantity(
        "largest magnitude of a component that is accepted", "m", 1, 1e6
    )
    velocity_max: float = quantity(
        "largest magnitude of a component that is accepted", "m/s", 0.1, 100
    )
    quaternion_tolerance: float = quantity(
        "largest deviation of a quaternion's norm from one", "", 1e-9, 0.1
    )


@dataclass(frozen=True)
class ImuNoise:
    """Noise, biases and admissible range of the IMU."""

    rate: float = quantity("nominal sample rate of the IMU", "Hz", 10, 1e4)
    gyro_noise: float = quantity(
        "noise density of the gyroscope", "rad/s/sqrt(Hz)", 1e-7, 1
    )
    acceleration_noise: float = quantity(
        "noise density of the accelerometer", "m/s^2/sqrt(Hz)", 1e-7, 10
    )
    gyro_bias: float = quantity(
        "initial standard deviation of the gyroscope's bias", "rad/s", 0, 1
    )
    acceleration_bias: float = quantity(
        "initial standard deviation of the accelerometer's bias, tilt of odom included",
        "m/s^2",
        0,
        5,
    )
    acceleration_bias_max: float = quantity(
        "largest bias of the accelerometer, without the tilt of odom",
        "m/s^2",
        0,
        5,
    )
    gyro_drift: float = quantity(
        "random walk of the gyroscope's bias", "rad/s/sqrt(s)", 0, 0.1
    )
    acceleration_drift: float = quantity(
        "random walk of the accelerometer's bias", "m/s^2/sqrt(s)", 0, 1
    )
    angular_acceleration_step: float = quantity(
        "change between two samples, by impacts", "rad/s^2", 0, 1e4
    )
    acceleration_step: float = quantity(
        "change of the acceleration between two samples", "m/s^2", 0, 1e3
    )
    gyro_max: float = quantity(
        "largest magnitude of a component that is accepted", "rad/s", 1, 100
    )
    acceleration_max: float = quantity(
        "largest magnitude of a component that is accepted", "m/s^2", 10, 1e4
    )


@dataclass(frozen=True)
class BlindSettings:
    """Process noise of the constant-velocity model, used without IMU data."""

    gyro_noise: float = quantity(
        "noise density of the angular velocity", "rad/s/sqrt(Hz)", 1e-4, 10
    )
    acceleration_noise: float = quantity(
        "noise density of the acceleration", "m/s^2/sqrt(Hz)", 1e-4, 100
    )


@dataclass(frozen=True)
class OutlierSettings:
    """Outlier gate of the odometry, and when the filter restarts from rejected readings."""

    distance: float = quantity(
        "largest Mahalanobis distance of angle, p, v", "sigma", 3, 1e3
    )
    max_rejections: int = quantity(
        "rejected readings in a row after which the filter restarts if they agree",
        "",
        2,
        100,
    )
    agreement_distance: float = quantity(
        "largest distance of readings that agree, motion subtracted",
        "m",
        1e-4,
        1,
    )
    agreement_angle: float = quantity(
        "largest angle of readings that agree, motion subtracted",
        "rad",
        1e-4,
        1,
    )
    initial_readings: int = quantity(
        "accepted readings in a row until an estimate is valid", "", 1, 1000
    )
    initial_time: float = quantity(
        "time without a rejection until an estimate is valid", "s", 0, 60
    )


@dataclass(frozen=True)
class TimingSettings:
    """Ticks, least rates, and gaps after which the filter degrades or restarts."""

    period: float = quantity("time between two estimates", "s", 1e-3, 0.1)
    rate_min: float = quantity(
        "least rate of the odometry with an IMU", "Hz", 0.1, 1000
    )
    rate_min_blind: float = quantity(
        "least rate of the odometry without an IMU", "Hz", 0.1, 1000
    )
    imu_gap: float = quantity(
        "longest interval between IMU samples that are used", "s", 1e-3, 1
    )
    odometry_gap: float = quantity(
        "longest interval between accepted readings; then the filter restarts",
        "s",
        0.02,
        5,
    )
    odometry_wait: float = quantity(
        "time since an accepted reading from which estimates are not valid",
        "s",
        0.02,
        5,
    )
    imu_lost: float = quantity(
        "time without an IMU sample from which the odometry is the clock",
        "s",
        1e-3,
        1,
    )
    command_delay: float = quantity(
        "time from the newest sample to the effect of its command", "s", 0, 0.2
    )
    clock_jump: float = quantity(
        "a larger step back of the stamps resets the filter", "s", 0.01, 60
    )


@dataclass(frozen=True)
class AgreementSettings:
    """Limits of the agreement of IMU and odometry, see `sensor_agreement.py`."""

    enabled: bool = flag("whether the IMU is compared with the odometry")
    shift_max: float = quantity(
        "largest time between their stamps that is compensated", "s", 0, 0.07
    )
    stamp_ahead: float = quantity(
        "an odometry stamp further ahead of the IMU's is dropped", "s", 0.08, 1
    )
    rate_still: float = quantity(
        "angular velocity below which a time between them makes no difference",
        "rad/s",
        0.01,
        1,
    )
    lean: float = quantity(
        "1 - cosine of the largest angle of the specific force to up of odom",
        "",
        0.01,
        1,
    )


@dataclass(frozen=True)
class BufferSettings:
    """Lengths of the queues."""

    imu: int = quantity("largest number of IMU samples kept", "", 4, 100_000)
    odometry: int = quantity(
        "largest number of readings that wait", "", 1, 1000
    )
    estimates: int = quantity(
        "largest number of estimates not yet polled; the oldest is dropped",
        "",
        1,
        10_000,
    )


@dataclass(frozen=True)
class Mount:
    """Where a sensor sits on the torso; its frame is base_link if it needs no transform."""

    frame: str = text("frame of the sensor")
    position: tuple[float, float, float] = quantity(
        "position of the sensor's origin in base_link", "m", -1, 1
    )
    rpy: tuple[float, float, float] = quantity(
        "roll, pitch, yaw of the sensor in base_link", "rad", -3.15, 3.15
    )


@dataclass(frozen=True)
class MountSettings:
    """Mounts of the sensors; published on `/tf_static`."""

    imu: Mount
    camera: Mount


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of `config/estimator.yaml`."""

    floor: FloorObserverSettings
    odometry: OdometryNoise
    imu: ImuNoise
    blind: BlindSettings
    gate: OutlierSettings
    timing: TimingSettings
    agreement: AgreementSettings
    buffers: BufferSettings
    mounts: MountSettings


@dataclass(frozen=True)
class ImuSamples:
    """IMU samples in the order of their stamps."""

    stamps: NDArray[np.int64]  # (n,) ns, rising
    values: Array  # (n, 6) angular velocity rad/s, specific force m/s^2

    def __post_init__(self) -> None:
        """Raise ValueError for stamps and values of other types or shapes."""
        stamps, values = self.stamps, self.values
        if (
            stamps.dtype != np.int64
            or values.dtype != np.float64
            or stamps.ndim != 1
            or values.shape != (len(stamps), 6)
        ):
            raise ValueError(
                f"IMU samples: stamps {stamps.dtype} {stamps.shape}, values {values.dtype}"
                f" {values.shape}: expected int64 (n,), float64 (n, 6)"
            )

    @classmethod
    def none(cls) -> "ImuSamples":
        """No samples."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 6)))

    def followed(self, stamp: int, value: Array, most: int) -> "ImuSamples":
        """The newest samples, at most `most`: these and another, `stamp` (ns) and value (6,)."""
        return ImuSamples(
            np.concatenate([self.stamps, [stamp]])[-most:],
            np.concatenate([self.values, value[None]])[-most:],
        )

    def __getitem__(self, part: slice) -> "ImuSamples":
        """A part of the samples."""
        return ImuSamples(self.stamps[part], self.values[part])

    def until(self, stamp: int) -> "ImuSamples":
        """The samples up to `stamp`, ns."""
        if len(self.stamps) and self.stamps[-1] <= stamp:
            return self
        return self[: int(self.stamps.searchsorted(stamp, side="right"))]


@dataclass(frozen=True)
class OdometryMotion:
    """A decoded odometry reading: attitude and position in odom, twist in base_link.

    Raises ValueError for other shapes, and values that are not finite.
    """

    stamp: int  # ns
    attitude: Array  # (4,) unit quaternion x y z w
    position: Array  # (3,) m
    velocity: Array  # (3,) m/s
    rate: Array  # (3,) rad/s
    variance: Array  # (12,) of angle, position, velocity and rate; SI

    def __post_init__(self) -> None:
        for name, size in {
            "attitude": 4,
            "position": 3,
            "velocity": 3,
            "rate": 3,
            "variance": 12,
        }.items():
            checked(name, getattr(self, name), (size,))


class Rate(NamedTuple):
    """Angular velocity in base_link."""

    value: Array  # (3,) rad/s
    variance: float
    gyro_share: float  # how much of the gyro bias it contains


class InertialFilter:
    """Error-state filter: nominal state, covariance (15, 15), propagation and correction."""

    STATE = StateParts("_state", "rate", values=(FilterState, Rate))

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        imu, blind = settings.imu, settings.blind
        self._state = FilterState(
            attitude=np.array([0.0, 0.0, 0.0, 1.0]),
            position=np.zeros(3),
            velocity=np.zeros(3),
            bias=np.zeros((2, 3)),
            cov=np.zeros((15, 15)),
        )
        self.forget_biases()
        self._work = work_space()
        drifts = imu.gyro_drift, imu.acceleration_drift
        self.rate = Rate(np.zeros(3), 0.0, 0.0)
        self._bias_max = imu.acceleration_bias_max
        self._noise = _densities(
            imu.gyro_noise, imu.acceleration_noise, *drifts
        )
        self._blind_noise = _densities(
            blind.gyro_noise, blind.acceleration_noise, *drifts
        )

    def forget_biases(self) -> None:
        """Set the biases to zero, as uncertain as at the start."""
        imu, state = self._settings.imu, self._state
        state.bias[:] = 0.0
        state.cov[9:, :] = state.cov[:, 9:] = 0.0
        state.cov[GYRO_BIAS, GYRO_BIAS] = np.square(imu.gyro_bias) * np.eye(3)
        state.cov[FORCE_BIAS, FORCE_BIAS] = np.square(
            imu.acceleration_bias
        ) * np.eye(3)

    def restart(self, motion: OdometryMotion) -> None:
        """Set the state to an odometry reading; the biases and their covariance are kept."""
        state = self._state
        state.attitude[:], state.position[:] = motion.attitude, motion.position
        rotation = matrix_of_quaternion(motion.attitude)
        state.velocity[:] = product(rotation, motion.velocity)
        jacobian = np.eye(9)
        jacobian[V, V] = rotation  # is measured in base_link
        jacobian[V, THETA] = -np.cross(np.eye(3), state.velocity)
        state.cov[:9, :] = state.cov[:, :9] = 0.0
        state.cov[:9, :9] = product(jacobian * motion.variance[:9], jacobian.T)
        self.rate = Rate(motion.rate, float(motion.variance[9:].mean()), 0.0)

    @property
    def state(self) -> FilterState:
        """A copy of nominal state and covariance, for `restore`."""
        return FilterState(*(part.copy() for part in self._state))

    def restore(self, saved: FilterState) -> None:
        """Set nominal state and covariance; valid only without a correction in between."""
        for part, value in zip(self._state, saved, strict=True):
            part[:] = value

    def use_gyro(self, samples: ImuSamples, stamp: int, age: float) -> None:
        """Set the angular velocity from the gyro at `stamp` (ns), `age` (s) after its last sample.

        The variance includes the change by an impact since that sample. Raises ValueError without
        samples.
        """
        _require_some(samples)
        imu, sample = self._settings.imu, self._work.sample
        amplification = interpolate(
            sample, samples.stamps, samples.values, stamp
        )
        variance = float(amplification * np.square(imu.gyro_noise) * imu.rate)
        variance += float(np.square(age * imu.angular_acceleration_step))
        self.rate = Rate(sample[:3] - self._state.bias[0], variance, 1.0)

    def propagate(self, samples: ImuSamples, begin: int, end: int) -> None:
        """Propagate from `begin` to `end` (ns) in steps between the samples; blindly in gaps.

        Raises ValueError without samples.
        """
        _require_some(samples)
        propagate_through(
            self._state,
            self._work,
            samples.stamps,
            samples.values,
            begin,
            end,
            self._noise,
            self._bias_max,
            to_ns(self._settings.timing.imu_gap),
            self.rate.value,
            self._blind_noise,
        )

    def propagate_blind(self, dt: float) -> None:
        """Propagate by dt (s) at constant velocities, without IMU data.

        The angular velocity changes meanwhile: an angular acceleration a turns by a dt^2 / 2.
        """
        blind, steps = self._blind_noise.copy(), self._settings.imu
        turn = 0.5 * dt * dt * steps.angular_acceleration_step
        blind[THETA] += np.square(turn) / dt
        propagate(
            self._state,
            self._work,
            self.rate.value,
            UP,
            dt,
            blind,
            False,
            self._bias_max,
        )
        self.rate = Rate(
            self.rate.value,
            float(np.square(self._settings.blind.gyro_noise)) / dt,
            0.0,
        )

    def extrapolate(self, imu: Array, dt: float) -> None:
        """Propagate by dt (s) with an IMU sample (6,) held, from which the next may differ."""
        imu = checked("IMU sample", imu, (6,))
        held, steps = self._noise.copy(), self._settings.imu
        held[THETA] += np.square(dt * steps.angular_acceleration_step) * dt
        held[V] += np.square(steps.acceleration_step) * dt
        propagate(
            self._state,
            self._work,
            imu[:3],
            imu[3:],
            dt,
            held,
            True,
            self._bias_max,
        )

    def correct(self, motion: OdometryMotion) -> bool:
        """Correct with a reading at the present stamp; False for an outlier, which is ignored."""
        if not correct(
            self._state,
            self._work,
            motion.attitude,
            motion.position,
            motion.velocity,
            motion.variance[:9],
            self._settings.gate.distance,
            self._bias_max,
        ):
            return False
        value, variance, gyro_share = self.rate
        value = value - gyro_share * self._work.error[GYRO_BIAS]
        rate_noise = motion.variance[9:].sum() / 3.0
        share = rate_noise / (rate_noise + variance)
        # by the inverse variances
        fused = share * value + (1.0 - share) * motion.rate
        self.rate = Rate(fused, share * variance, share * gyro_share)
        return True

    @property
    def incline(self) -> tuple[float, float]:
        """Angle between the z axis of odom and gravity, and its standard deviation, rad.

        The deviation is the largest along an axis of base_link.

        It is part of the bias of the specific force; the accelerometer's own is the other part.
        """
        bias = product(
            matrix_of_quaternion(self._state.attitude), self._state.bias[1]
        )
        variance = float(
            self._state.cov[FORCE_BIAS, FORCE_BIAS].diagonal().max()
        )
        share = min(1.0, norm(bias[:2]) / GRAVITY)
        level = math.sqrt((1.0 - share) * (1.0 + share))
        return atan2(share, level), math.sqrt(max(variance, 0.0)) / GRAVITY

    def output(self, floor: FloorPlane = LEVEL) -> tuple[Array, Array]:
        """State (12,) and covariance (12, 12) of `Estimate`; the covariance is of first order.

        With another floor than z = 0 of odom the filter's state is changed, and has to be restored.
        """
        if not floor.is_odom:
            nominal, back = self._state, inverse_quaternion(floor.quaternion)
            turn = matrix_of_quaternion(back)
            nominal.attitude[:] = quaternion_product(back, nominal.attitude)
            nominal.position[2] -= floor.height
            nominal.position[:] = product(turn, nominal.position)
            nominal.velocity[:] = product(turn, nominal.velocity)
            jacobian = np.eye(15)
            for part in (THETA, P, V):
                jacobian[part, part] = turn
            nominal.cov[:] = product(product(jacobian, nominal.cov), jacobian.T)
        state, cov = np.empty(12), np.empty((12, 12))
        rate, variance, gyro_share = self.rate
        output(self._state, self._work, rate, gyro_share, variance, state, cov)
        return state, cov


def _require_some(samples: ImuSamples) -> None:
    if not len(samples.stamps):
        raise ValueError("IMU samples: none")


def load_kernels(settings: EstimatorSettings) -> None:
    """Call every kernel once, which loads or compiles it, so that no reading waits for it."""
    scratch = InertialFilter(settings)
    zero = np.zeros(3)
    still = OdometryMotion(
        0, np.array([0.0, 0.0, 0.0, 1.0]), zero, zero, zero, np.ones(12)
    )
    scratch.restart(still)
    imu = np.concatenate([zero, UP])
    samples = ImuSamples.none().followed(0, imu, 1)
    scratch.use_gyro(samples, 0, 0.0)
    scratch.propagate(samples, 0, 1)
    scratch.extrapolate(imu, 1e-3)
    scratch.correct(still)
    scratch.output()


def _densities(
    gyro: float, force: float, gyro_drift: float, force_drift: float
) -> Array:
    """Variance densities (15,) of the error state from noise densities."""
    return np.square(np.repeat([gyro, 0.0, force, gyro_drift, force_drift], 3))


TIME = 0.5  # s, T: most of a stride, so that errors of the velocity are 2 mg
LEAST = 5.0  # m/s^2, of a mean specific force that is gravity's
DOWN = np.array([0.0, 0.0, -GRAVITY])
DOWN.flags.writeable = False


class GravityFilter:
    """The direction of gravity in odom, from the IMU and the velocity of the torso.

    The specific force R f of a torso with velocity v in odom is v' - g. Over their means m_f and
    m_v with a time constant T (x' + m / T = .. / T),

        g = (v - m_v) / T - m_f,

    whatever the torso's motion, and whatever odom's z axis is. The bias of the accelerometer is
    part of it: 0.1 m/s^2 are 0.6 deg.
    """

    STATE = StateParts("_force", "_velocity")

    def __init__(self) -> None:
        self._force, self._velocity = -DOWN, np.full(3, np.nan)

    def add(self, force: Array, velocity: Array, dt: float) -> None:
        """Take the mean specific force (3,) m/s^2 of the last dt (s), and the velocity (3,) m/s.

        Both in odom.
        """
        share = min(1.0, dt / TIME)
        if np.isnan(self._velocity[0]):
            self._force, self._velocity = force, velocity
        self._force = self._force + share * (force - self._force)
        self._velocity = self._velocity + share * (velocity - self._velocity)

    def value(self, velocity: Array) -> Array:
        """Gravity (3,) m/s^2 in odom, of the length of gravity; straight down while unknown."""
        if np.isnan(self._velocity[0]):
            return DOWN.copy()
        g = (velocity - self._velocity) / TIME - self._force
        length = norm(g)
        return g * (GRAVITY / length) if length > LEAST else DOWN.copy()

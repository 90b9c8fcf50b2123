"""Streams of IMU and odometry readings of closed-form motions, and the estimator run on them."""

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.clock import SECOND
from slot_core.estimation.estimate import Estimate
from slot_core.estimation.state_estimator import StateEstimator, read_estimator
from slot_core.robot import GRAVITY

# without the prediction beyond the newest sample and the agreement of the sensors, which have tests
# of their own
SETTINGS = config.replace(
    read_estimator(),
    {"timing.command_delay": 0.0, "agreement.enabled": False},
)
GYRO_BIAS = np.array([0.02, -0.015, 0.01])
GYRO_NOISE, FORCE_NOISE = 0.01, 0.3  # of one sample at 200 Hz, as in MATCHED
IMU_NOISE = np.repeat([[GYRO_NOISE], [FORCE_NOISE]], 3, axis=1)
ODOMETRY_NOISE = np.repeat(
    [
        [SETTINGS.odometry.angle_noise],
        [SETTINGS.odometry.position_noise],
        [SETTINGS.odometry.velocity_noise],
        [SETTINGS.odometry.rate_noise],
    ],
    3,
    axis=1,
)


class Walk:
    """Sinusoids in roll, pitch, yaw and position, with the walk's amplitudes and frequencies.

    turn: mean yaw rate, rad/s; incline: pitch of odom, rad.
    """

    def __init__(
        self,
        tilt=0.22,
        frequency=1 / 0.7,
        sway=0.01,
        speed=0.05,
        *,
        yaw=0.3,
        turn=0.0,
        incline=0.0,
    ):
        self.amplitude = np.array([tilt, tilt, 0.05, sway, sway, sway])
        self.omega = (
            2 * np.pi * frequency * np.array([1.0, 1.0, 0.5, 1.0, 1.0, 2.0])
        )
        self.phase = np.array([0.0, 1.1, 0.4, 0.2, 1.9, 0.7])
        self.offset = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.06])
        self.drift = np.array([0.0, 0.0, turn, speed, 0.0, 0.0])
        self.up = GRAVITY * np.array([np.sin(incline), 0.0, np.cos(incline)])

    def at(self, t):
        """State (12,), attitude, angular velocity and specific force in base_link at t."""
        angle = self.omega * t + self.phase
        q = self.offset + self.drift * t + self.amplitude * np.sin(angle)
        dq = self.drift + self.amplitude * self.omega * np.cos(angle)
        ddq = -self.amplitude * self.omega**2 * np.sin(angle)
        attitude = Rotation.from_euler("ZYX", q[2::-1])
        # rates of the intrinsic z, y', x'' angles add along their own axes
        axes = [
            attitude.as_matrix()[:, 0],
            Rotation.from_euler("Z", q[2]).as_matrix()[:, 1],
            np.array([0.0, 0.0, 1.0]),
        ]
        omega = dq[0] * axes[0] + dq[1] * axes[1] + dq[2] * axes[2]
        force = attitude.inv().apply(ddq[3:] + self.up)
        state = np.concatenate([q, omega, dq[3:]])
        return state, attitude, attitude.inv().apply(omega), force


def imu_messages(motion, duration, rate=200, rng=None, bias=0.0):
    messages = []
    for k in range(round(duration * rate) + 1):
        w, f = np.array(motion.at(k / rate)[2:]) + drawn(rng, IMU_NOISE)
        messages.append(("imu", k * SECOND // rate, (w + bias, f)))
    return messages


def odometry_messages(motion, duration, rate=30, rng=None, loud=1.0):
    """Messages of odometry, with `loud` times the noise of SETTINGS."""
    messages = []
    for k in range(round(duration * rate)):
        stamp = k * SECOND // rate
        state, attitude, w, _ = motion.at(stamp / SECOND)
        turn, *shift = drawn(rng, loud * ODOMETRY_NOISE)
        p, v, w = (
            np.array([state[3:6], attitude.inv().apply(state[9:]), w]) + shift
        )
        attitude = Rotation.from_rotvec(turn) * attitude
        messages.append(("odometry", stamp, (p, attitude.as_quat(), v, w)))
    return messages


def drawn(rng, noise):
    """Noise of one reading; zero without a generator."""
    return 0.0 * noise if rng is None else rng.normal(0.0, noise)


def arrivals(*streams):
    """The messages of all streams in order of the stamps; at equal stamps the IMU is first."""
    return sorted((m for s in streams for m in s), key=lambda m: (m[1], m[0]))


def run(messages, settings=SETTINGS, estimator=None):
    """Estimates and estimator after all messages; polled after each message."""
    estimator = StateEstimator(settings) if estimator is None else estimator
    estimates: list[Estimate] = []
    for kind, stamp, values in messages:
        (estimator.add_imu if kind == "imu" else estimator.add_odometry)(
            stamp, *values
        )
        estimates += iter(estimator.poll, None)
    return estimates, estimator


def noisy(motion, duration, seed, bias=0.0):
    rng = np.random.default_rng(seed)
    return arrivals(
        imu_messages(motion, duration, rng=rng, bias=bias),
        odometry_messages(motion, duration, rng=rng),
    )


def without(kind, messages, start, end):
    """The messages without those of a kind between two times, s."""
    return [
        m for m in messages if m[0] != kind or not start < m[1] / SECOND < end
    ]


def changed(messages, readings, change):
    """The messages with `change(*values)` in the odometry readings of a slice."""
    stamps = {
        m[1] for m in [m for m in messages if m[0] == "odometry"][readings]
    }
    return [
        (kind, t, change(*v) if kind == "odometry" and t in stamps else v)
        for kind, t, v in messages
    ]


def validities(estimates):
    return [e.validity for e in estimates]


def same(*streams):
    """Whether estimates are equal to the last bit."""
    first, second = (
        [
            (
                e.stamp,
                e.lead,
                e.validity,
                e.state.tobytes(),
                e.covariance.tobytes(),
            )
            for e in stream
        ]
        for stream in streams
    )
    return first == second


def arriving(messages, delay):
    """The messages in the order of their arrival, the odometry `delay()` s after its stamp."""
    at = [
        m[1] + (delay() * SECOND if m[0] == "odometry" else 0) for m in messages
    ]
    return [messages[i] for i in np.argsort(at, kind="stable")]

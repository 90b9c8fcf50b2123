"""State estimator: the MPC's twelve states and their covariance, from odometry and IMU.

The IMU is the clock of the controller: once the filter has started, the first sample at or after a
tick gives an estimate, and the ticks are `period` apart. So odometry of any rate and delay serves
alike. Each reading, stamped t, corrects the filter at t; it waits until the IMU has reached t, so
the filter depends only on data stamped up to t, not on the order in which the streams arrive. An
estimate is predicted with all IMU samples that have arrived, and by `command_delay` beyond the
newest, to the time at which its command takes effect: the delay of the odometry costs no more than
the drift of the IMU over it. The filter itself is in `inertial_filter.py`.

    reading                        effect
    newer than the last one:       corrects when the IMU has reached it, or is lost
    not newer:                     dropped: repeated, or out of order
    none accepted for `odometry_wait`: estimates are ODOMETRY_LOST or ODOMETRY_REJECTED
    none accepted for `odometry_gap`:  the state stands still; the next reading restarts the filter
    rejected, but in agreement:    after `max_rejections` of them the filter restarts, and the
                                   estimates go on if the velocities agree too: odom has jumped

Without an IMU sample for `imu_lost` the odometry is the clock, and the estimates rest on it alone.

A restart keeps the biases, unless readings were rejected before it with other velocities too: the
biases may be what was wrong. An IMU slower than 1.25 `imu_gap` does not serve, as if there were none.
"""

from collections import deque
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.clock import SECOND, to_ns, to_seconds
from slot_core.elementary import atan2
from slot_core.estimation import sensor_agreement
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.filter_kernels import FilterState
from slot_core.estimation.floor_observer import LEVEL, FloorObserver, FloorPlane
from slot_core.estimation.inertial_filter import (
    DOWN,
    EstimatorSettings,
    GravityFilter,
    ImuSamples,
    InertialFilter,
    OdometryMotion,
    load_kernels,
)
from slot_core.estimation.sensor_agreement import STRAYS, SensorAgreement
from slot_core.geometry import (
    Transform,
    inverse_quaternion,
    matrix_of_quaternion,
    matrix_of_rpy,
    quaternion_of_vector,
    quaternion_product,
)
from slot_core.key_frame import StateParts
from slot_core.matrices import norm, product
from slot_core.robot import LEGS

BEFORE_ALL_TIMES = -(2**62)  # ns
# intervals of odometry after which an IMU that is withheld no more counts as missing
WITHHELD = 3.0
# SI, to which the variances of a message are clipped
VARIANCE_MIN, VARIANCE_MAX = 1e-12, 1e6
ANGLE_MAX = 100.0  # rad, of a tendon angle that is used
EARLY = 0.25  # of a period, see `_earliness`
INTERVAL_GAIN = 0.2  # of the mean time between readings
IMU_GAIN = 0.05  # the same of the IMU
IMU_INTERVAL = 0.1  # s, longest time between its samples that counts
SLOW_IMU = 1.25  # times `imu_gap`, mean time between samples of an IMU that serves no more
JUMPED = "odom has started anew: place and heading count from here"
JUMP_SAID = 3 * SECOND  # ns, for which it is said
SAME_SPEED, SAME_RATE = 0.1, 0.5  # m/s, rad/s, of one motion in two frames


def read_estimator() -> EstimatorSettings:
    """The settings of `config/estimator.yaml`; raises ConfigError."""
    return config.read(EstimatorSettings, "estimator")


class StateEstimator:
    """Orders the odometry and IMU streams, filters them, and rates the validity of each estimate.

    Every tick gives one estimate, from the first usable reading on. Bad data raises nothing: IMU
    samples are dropped, odometry readings are rejected.
    """

    STATE = StateParts(
        "_filter",
        "_agreement",
        "_newest",
        "_begun",
        "_behind",
        "_imu",
        "_received",
        "_waiting",
        "_rejected",
        "_stamp",
        "_corrected",
        "_reached",
        "_tick",
        "_accepted_stamp",
        "_accepted",
        "_initial",
        "_interval",
        "_sampled",
        "_imu_interval",
        "_imu_complete",
        "_restarted",
        "_jumped",
        "_floor",
        "_gravity",
        "_weighed",
        values=(FilterState, OdometryMotion, ImuSamples),
    )

    def __init__(
        self, settings: EstimatorSettings, floor: FloorObserver | None = None
    ) -> None:
        """Without a floor observer the floor is z = 0 of odom."""
        load_kernels(settings)
        sensor_agreement.load_kernels()
        self._settings, self._floor = settings, floor
        o = settings.odometry
        noise = [
            o.angle_noise,
            o.position_noise,
            o.velocity_noise,
            o.rate_noise,
        ]
        self._variance = np.square(np.repeat(noise, 3))
        imu = settings.mounts.imu
        is_moved = any((*imu.position, *imu.rpy))
        # from the IMU's frame to base_link; None: it is base_link
        self._mount = Transform.of(imu.position, imu.rpy) if is_moved else None
        # s, mean time between the samples of an IMU that serves, at most
        self._longest_imu_interval = SLOW_IMU * settings.timing.imu_gap
        self._ready: deque[Estimate] = deque(maxlen=settings.buffers.estimates)
        self._reset()

    def _reset(self) -> None:
        """Return to the state after construction; estimates not yet polled are kept."""
        self._filter = InertialFilter(self._settings)
        if self._floor is not None:
            self._floor.reset()
        self._agreement = SensorAgreement(
            self._settings, matrix_of_rpy(self._settings.mounts.imu.rpy)
        )
        self._newest: dict[str, int] = {}
        self._begun = 0  # ns, stamp of the first message
        # by stream: stamps in a row that are far from the newest
        self._behind: dict[str, int] = {}
        self._imu = ImuSamples.none()
        # readings that wait for the tick, as they came
        self._received: deque[tuple[Any, ...]] = deque()
        self._waiting: deque[tuple[int, OdometryMotion | None]] = deque()
        self._rejected: deque[OdometryMotion | None] = deque(
            maxlen=self._settings.gate.max_rejections
        )
        # ns, of the filter's state; None: not started
        self._stamp: int | None = None
        self._corrected = self._filter.state  # at `_stamp`
        # ns, of the filter: at or after `_stamp`
        self._reached = BEFORE_ALL_TIMES
        self._tick = BEFORE_ALL_TIMES  # ns, stamp of the next estimate
        self._accepted_stamp = 0  # ns, of the last accepted reading
        # accepted readings since `_initial`, ns; in a row until valid
        self._accepted, self._initial = 0, 0
        self._interval = 0.0  # s, mean of the last accepted readings
        # ns, stamp of the last IMU sample; s, mean time between them
        self._sampled, self._imu_interval = 0, 0.0
        # whether the IMU had samples up to the last reading
        self._imu_complete = True
        self._restarted = False  # whether odometry has started anew
        self._jumped = BEFORE_ALL_TIMES  # ns, when odom jumped in motion
        self._gravity = GravityFilter()
        self._weighed = BEFORE_ALL_TIMES  # ns, of its last sample

    @property
    def gyro_bias(self) -> Array:
        """Estimated gyro bias (3,) rad/s, in base_link."""
        return self._filter.state.bias[0]

    @property
    def incline(self) -> tuple[float, float]:
        """Angle of the floor of odom and its standard deviation, rad, see `InertialFilter`."""
        return self._filter.incline

    def add_imu(
        self, stamp: int, angular_velocity: Array, specific_force: Array
    ) -> None:
        """Add an IMU sample: stamp (ns), (3,) rad/s and (3,) m/s^2 in the frame of the IMU."""
        limits, (turn_unit, force_unit) = (
            self._settings.imu,
            self._agreement.units,
        )
        reach = limits.gyro_max * self._agreement.reach
        rate = vector(angular_velocity, 3, reach / turn_unit)
        force = vector(specific_force, 3, limits.acceleration_max / force_unit)
        if (
            rate is None
            or force is None
            or self._is_slow(stamp)
            or not self._advances("imu", stamp)
        ):
            return
        rate, force = turn_unit * rate, force_unit * force
        if self._mount is not None:
            # f = R f_imu - w x (w x r); no IMU measures the angular acceleration's share
            rate = product(self._mount.rotation, rate)
            force = product(self._mount.rotation, force) - np.cross(
                rate, np.cross(rate, self._mount.position)
            )
        sample = self._agreement.sample(stamp, rate, force)
        if sample is not None:
            self._imu = self._imu.followed(
                stamp, sample, self._settings.buffers.imu
            )
        if self._stamp is None or stamp >= self._tick:
            self._take_received()
        self._process_due()
        self._propagate_to_newest()
        self._publish_due(stamp, stamp)

    def add_odometry(  # noqa: PLR0917 - in the order of the message
        self,
        stamp: int,
        position: Array,
        quaternion_xyzw: Array,
        velocity: Array,
        angular_velocity: Array,
        variance: Array | None = None,
    ) -> None:
        """Add an odometry reading: stamp (ns), pose in odom (m), twist in base_link (SI).

        variance: (12,) of angle, position, velocity and rate, from the message; where it is not
        positive, or without it, the settings' noise counts.

        Readings wait for the tick, so that estimates depend on what has arrived by then, but not
        on the order in which IMU and odometry came.
        """
        if self._agreement.is_stray(stamp, self._newest.get("imu")):
            return
        self._received.append(
            (
                stamp,
                position,
                quaternion_xyzw,
                velocity,
                angular_velocity,
                variance,
            )
        )
        newest = self._newest.get("imu", BEFORE_ALL_TIMES)
        starts = self._stamp is None and newest > BEFORE_ALL_TIMES
        is_lost = self._imu_is_lost(stamp + self._agreement.shift)
        if (
            starts
            or is_lost
            or len(self._received) > self._settings.buffers.odometry
        ):
            self._take_received()
            self._process_due()
            self._propagate_to_newest()
        if is_lost:
            self._publish_due(stamp, stamp + self._earliness)
        elif starts:
            self._publish_due(newest, newest)

    @property
    def _earliness(self) -> int:
        """Time before a tick from which on odometry in place of the IMU gives it, ns.

        The tick takes the reading nearest to it.
        """
        period = self._settings.timing.period
        return to_ns(min(EARLY * period, self._interval / 2.0))

    def _take_received(self) -> None:
        """Take the readings that have arrived, in their order."""
        received, self._received = self._received, deque()
        for stamp, *parts in received:
            agreement, shift = self._agreement, self._agreement.shift
            if not self._advances("odometry", stamp + shift):
                continue
            motion, variance = self._decode(stamp, *parts), parts[-1]
            if motion is not None:
                is_given = variance is None or not np.any(
                    np.asarray(variance)[6:] < 0.0
                )
                newest = self._newest.get("imu", 0)
                motion = agreement.compared(motion, is_given, newest)
                self._shift_odometry(agreement.shift - shift)
                if agreement.recalibrated:
                    self._forget_biases()
            self._waiting.append((stamp + agreement.shift, motion))

    def add_joints(self, stamp: int, angle: Array, torque: Array) -> None:
        """Add tendon angles (4,) rad and torques (4,) N m at `stamp` (ns).

        At rest they tell where the floor is. Torques that are not finite are unknown.
        """
        known = vector(angle, len(LEGS), ANGLE_MAX)
        if known is not None and self._floor is not None:
            self._floor.add_joints(
                stamp,
                known,
                torque if np.isfinite(torque).all() else np.nan_to_num(torque),
            )

    def _shift_odometry(self, step: int) -> None:
        """Move the stamps of the odometry so far by `step` (ns), and those of the filter."""
        if not step or self._stamp is None:
            return
        self._newest["odometry"] += step
        self._waiting = deque(
            (
                stamp + step,
                motion and replace(motion, stamp=motion.stamp + step),
            )
            for stamp, motion in self._waiting
        )
        self._filter.restore(self._corrected)
        self._stamp += step
        self._accepted_stamp += step
        self._reached = self._stamp

    def _forget_biases(self) -> None:
        """Learn the biases anew, because axes or units of the IMU have changed."""
        self._agreement.recalibrated = False
        self._filter.restore(self._corrected)
        self._filter.forget_biases()
        self._corrected, self._imu = self._filter.state, ImuSamples.none()
        if self._stamp is not None:
            self._reached = self._stamp

    def poll(self) -> Estimate | None:
        """The next estimate, in order of the stamps; None if none is ready."""
        return self._ready.popleft() if self._ready else None

    def present(self) -> Estimate | None:
        """The state in odom at the newest IMU sample; None if the filter has not reached one."""
        newest = self._newest.get("imu", BEFORE_ALL_TIMES)
        if (
            self._stamp is None
            or newest <= self._stamp
            or newest != self._reached
        ):
            return None
        return self._predicted(newest, 0.0, LEVEL)

    def _decode(  # noqa: PLR0917
        self,
        stamp: int,
        position: Array,
        quaternion: Array,
        velocity: Array,
        rate: Array,
        variance: Array | None,
    ) -> OdometryMotion | None:
        """The decoded reading; None if it is not finite, of a wrong shape, or out of range."""
        limits = self._settings.odometry
        p = vector(position, 3, limits.position_max)
        q = vector(quaternion, 4, 2.0)
        v = vector(velocity, 3, limits.velocity_max)
        w = vector(rate, 3, self._settings.imu.gyro_max)
        if (
            p is None
            or q is None
            or v is None
            or w is None
            or abs((length := norm(q)) - 1.0) > limits.quaternion_tolerance
        ):
            return None
        nominal = self._variance
        given = np.asarray(
            nominal if variance is None else variance, dtype=np.float64
        )
        if given.shape != nominal.shape:
            given = nominal
        known = np.where(given > 0.0, given, nominal)  # NaN is not
        known = np.clip(known, VARIANCE_MIN, VARIANCE_MAX)
        return OdometryMotion(stamp, q / length, p, v, w, known)

    def _advances(self, stream: str, stamp: int) -> bool:
        """Whether `stamp` is the newest of its stream; a clock set back resets the estimator.

        A single stamp far behind, or of the IMU far ahead, is a stray one: the ticks follow it.
        """
        newest, timing = (
            self._newest.get(stream, stamp - 1),
            self._settings.timing,
        )
        behind = newest - stamp > timing.clock_jump * SECOND
        lost = stamp - newest > timing.imu_lost * SECOND
        if behind or (lost and stream == "imu"):
            self._behind[stream] = self._behind.get(stream, 0) + 1
            if self._behind[stream] < (STRAYS if behind else 2):
                return False
        self._behind[stream] = 0
        if behind:
            self._reset()
        elif stamp <= newest:
            return False
        if not self._newest:
            self._begun = stamp
        self._newest[stream] = stamp
        return True

    def _is_slow(self, stamp: int) -> bool:
        """Whether the mean time between IMU samples, the one at `stamp` (ns) too, is too long."""
        if stamp > self._sampled:
            elapsed = to_seconds(stamp - (self._sampled or stamp))
            self._imu_interval = _mean(
                self._imu_interval, min(elapsed, IMU_INTERVAL), IMU_GAIN
            )
            self._sampled = stamp
        return self._imu_interval > self._longest_imu_interval

    def _process_due(self) -> None:
        """Process waiting readings that the IMU has reached, or all if it is lost.

        In a full queue the oldest ones are due too.
        """
        newest, most = self._newest, self._settings.buffers.odometry
        while self._waiting and (
            newest.get("imu", BEFORE_ALL_TIMES) >= self._waiting[0][0]
            or len(self._waiting) > most
            or self._imu_is_lost(self._waiting[-1][0])
        ):
            self._process(*self._waiting.popleft())

    def _imu_is_lost(self, stamp: int) -> bool:
        """Whether the newest IMU sample is older than `stamp` (ns) by more than `imu_lost`."""
        newest = self._newest.get("imu", self._begun)
        return stamp - newest > self._settings.timing.imu_lost * SECOND

    def _propagate_to_newest(self) -> None:
        """Propagate to the newest IMU sample within `odometry_gap`; blindly in gaps of the IMU."""
        if self._stamp is None:
            return
        end = self._stamp + to_ns(self._settings.timing.odometry_gap)
        samples = self._imu.until(end)
        if len(samples.stamps) and samples.stamps[-1] > self._reached:
            newest = int(samples.stamps[-1])
            self._filter.propagate(samples, self._reached, newest)
            self._reached = newest
        newest = min(self._newest.get("imu", self._reached), end)
        if newest > self._reached:  # samples that must not serve
            self._filter.propagate_blind(to_seconds(newest - self._reached))
            self._reached = newest

    def _publish_due(self, now: int, latest: int) -> None:
        """Make the estimate of the newest tick up to `latest` (ns), if one is due at `now`.

        The ticks follow the time of the IMU. A later `latest` is that of odometry in its place:
        the tick is then at the reading, and the next one a period later.
        """
        if self._stamp is None or latest < self._tick:
            return
        timing, state = self._settings.timing, self._filter.state
        period = to_ns(timing.period)
        is_known = now - self._accepted_stamp <= to_ns(timing.odometry_wait)
        if self._floor is not None and is_known:
            samples, rate = self._imu.values, self._filter.rate.value
            force = samples[-1, 3:] if len(samples) else np.zeros(3)
            self._floor.observe(now, state, rate, force)
        self._weigh(state)
        tick = now if latest > now else now - (now - self._tick) % period
        floor = LEVEL if self._floor is None else self._floor.floor
        self._ready.append(self._predicted(tick, timing.command_delay, floor))
        self._tick = tick + period

    def _weigh(self, state: FilterState) -> None:
        """Let the gravity filter take the samples since the last tick."""
        stamps = self._imu.stamps
        first = int(stamps.searchsorted(self._weighed, side="right"))
        if first == len(stamps):
            return
        force = self._imu.values[first:, 3:].sum(axis=0) / (len(stamps) - first)
        self._gravity.add(
            product(matrix_of_quaternion(state.attitude), force),
            state.velocity,
            min(
                to_seconds(int(stamps[-1]) - self._weighed),
                self._settings.timing.period,
            ),
        )
        self._weighed = int(stamps[-1])

    def _process(self, stamp: int, motion: OdometryMotion | None) -> None:
        """Predict to a reading (None: unusable), and correct with it."""
        gap = self._settings.timing.odometry_gap * SECOND
        if self._stamp is None or stamp - self._accepted_stamp > gap:
            if motion is not None:
                self._start(motion)
            return
        self._imu_complete = self._predict(self._stamp, stamp)
        if motion is not None and self._filter.correct(motion):
            self._accept(stamp)
        else:
            self._rejected.append(motion)
            if self._is_initialising(stamp):
                if motion is not None:
                    self._start(motion)
                    return
                # not valid yet: the readings are counted anew
                self._accepted, self._initial = 0, stamp
        readings = [usable for usable in self._rejected if usable is not None]
        has_relocalised = len(
            readings
        ) >= self._settings.gate.max_rejections and all(
            self._agree(a, b) for a, b in pairwise(readings)
        )
        if motion is not None and has_relocalised:
            self._start(motion, self._moves_alike(motion))
            return
        self._corrected, self._reached = self._filter.state, stamp

    def _start(self, motion: OdometryMotion, alike: bool = False) -> None:
        """Start the filter from a reading; after rejections without the biases it has learned.

        alike: odom has jumped, but the torso moves as the filter knows: the estimates go on.
        """
        if self._contradicted and not alike:
            self._filter.forget_biases()
        if self._stamp is not None and self._floor is not None:
            old = self._filter.state
            before = self._floor.floor.above(old.attitude, old.position)
            self._floor.start_anew(before, motion.attitude, motion.position)
        if alike:
            self._jumped = motion.stamp
        else:
            self._restarted = self._stamp is not None
            self._initial, self._accepted = motion.stamp, 0
        self._filter.restart(motion)
        self._stamp = self._accepted_stamp = motion.stamp
        self._corrected, self._reached = self._filter.state, motion.stamp
        self._tick = max(self._tick, motion.stamp)
        self._accept(motion.stamp)

    def _predict(self, start: int, stamp: int) -> bool:
        """Propagate the filter from `start` to `stamp` (ns); False if IMU data was missing."""
        self._stamp = stamp
        self._filter.restore(self._corrected)
        samples = self._imu.until(stamp)
        first = max(
            int(np.searchsorted(samples.stamps, start, side="right")) - 1, 0
        )
        knots = [*samples.stamps[first:].tolist(), stamp]
        knots = knots if knots[0] <= start else [start, *knots]
        longest = max(b - a for a, b in pairwise(knots))
        if (
            not len(samples.stamps)
            or longest > self._settings.timing.imu_gap * SECOND
        ):
            self._filter.propagate_blind(to_seconds(stamp - start))
            return False
        self._filter.propagate(samples, start, stamp)
        self._filter.use_gyro(samples, stamp, to_seconds(stamp - knots[-2]))
        # two stay, to extrapolate
        self._imu = self._imu[max(len(samples.stamps) - 2, 0) :]
        return True

    def _accept(self, stamp: int) -> None:
        elapsed = to_seconds(stamp - self._accepted_stamp)
        if elapsed > 0.0:  # else the filter has started
            self._interval = _mean(self._interval, elapsed, INTERVAL_GAIN)
        self._accepted_stamp = stamp
        self._accepted += 1
        self._rejected.clear()

    @property
    def _contradicted(self) -> bool:
        """Whether a usable reading was rejected since the last accepted one."""
        return any(motion is not None for motion in self._rejected)

    def _moves_alike(self, motion: OdometryMotion) -> bool:
        """Whether the velocities of a reading are those of the filter at its stamp."""
        state = self._filter.state
        back = matrix_of_quaternion(state.attitude).T
        off = product(back, state.velocity) - motion.velocity
        return bool(
            norm(off) < SAME_SPEED
            and norm(self._filter.rate.value - motion.rate) < SAME_RATE
        )

    def _agree(self, a: OdometryMotion, b: OdometryMotion) -> bool:
        """Whether a, moved at the mean velocity of a and b, gives b within the gate."""
        half = to_seconds(b.stamp - a.stamp) / 2
        before, after = matrix_of_quaternion([a.attitude, b.attitude])
        travel = half * (
            product(before, a.velocity) + product(after, b.velocity)
        )
        turned = quaternion_product(
            a.attitude, quaternion_of_vector(half * (a.rate + b.rate))
        )
        distance = norm(b.position - a.position - travel)
        apart = quaternion_product(inverse_quaternion(turned), b.attitude)
        angle = 2.0 * atan2(norm(apart[:3]), abs(apart[3]))
        gate = self._settings.gate
        return bool(
            distance <= gate.agreement_distance
            and angle <= gate.agreement_angle
        )

    def _is_initialising(self, stamp: int) -> bool:
        """Whether estimates at `stamp` (ns) are not valid yet."""
        gate = self._settings.gate
        return (
            self._accepted < gate.initial_readings
            or to_seconds(stamp - self._initial) < gate.initial_time
        )

    def _judged(self, stamp: int) -> tuple[Validity, str]:
        """Validity of an estimate at `stamp` (ns), and its message."""
        timing = self._settings.timing
        withheld = to_seconds(stamp - self._agreement.withheld)
        is_open = withheld < WITHHELD * self._interval
        without_imu = self._imu_is_lost(stamp) or not (
            self._imu_complete or is_open
        )
        least = timing.rate_min_blind if without_imu else timing.rate_min
        rate = 1.0 / max(self._interval, 1e-3)
        if stamp - self._accepted_stamp > timing.odometry_wait * SECOND:
            age = to_seconds(stamp - self._accepted_stamp)
            fault, line = Validity.ODOMETRY_LOST, "no usable odom"
            if self._contradicted:
                fault, line = (
                    Validity.ODOMETRY_REJECTED,
                    "odom contradicts the IMU",
                )
            return fault, (
                f"{line} for {age:.2g} s, limit {timing.odometry_wait:g} s"
            )
        if self._is_initialising(stamp):
            anew = "odom has started anew" if self._restarted else ""
            return Validity.INITIALISING, anew
        if self._floor is not None and not self._floor.is_known:
            return (
                Validity.INITIALISING,
                "the floor is not known before the torso rests on it",
            )
        with_it = "without an IMU" if without_imu else "with an IMU"
        if rate < least:
            return (
                Validity.ODOMETRY_SLOW,
                f"odom at {rate:.1f} Hz, limit {least:g} Hz {with_it}",
            )
        found = Validity.IMU_MISSING if without_imu else Validity.VALID
        if self._imu_interval > self._longest_imu_interval:
            return found, (
                f"imu at {1.0 / self._imu_interval:.0f} Hz, limit"
                f" {1.0 / self._longest_imu_interval:.0f} Hz: it is not used"
            )
        jumped = JUMPED if 0 < stamp - self._jumped < JUMP_SAID else ""
        return found, self._agreement.message or jumped

    def _predicted(
        self, stamp: int, delay: float, floor: FloorPlane
    ) -> Estimate:
        """Estimate of the tick `stamp`, predicted by `delay` (s) from where the filter is."""
        assert self._stamp is not None
        saved, rate, samples = self._filter.state, self._filter.rate, self._imu
        gravity = DOWN
        if not self._imu_is_lost(stamp):
            gravity = product(
                matrix_of_quaternion(floor.quaternion).T,
                self._gravity.value(saved.velocity),
            )
        newest = (
            int(samples.stamps[-1]) if len(samples.stamps) else BEFORE_ALL_TIMES
        )
        if newest >= self._reached > self._stamp:
            self._filter.use_gyro(samples, newest, delay)
        if delay > 0.0 and newest >= self._reached:
            self._filter.extrapolate(samples.values[-1], delay)
        elif delay > 0.0:
            self._filter.propagate_blind(delay)
        state, covariance = self._filter.output(floor)
        self._filter.restore(saved)
        self._filter.rate = rate
        validity, message = self._judged(stamp)
        if self._agreement.forbids_motion:
            validity, message = Validity.INITIALISING, self._agreement.message
        below = self._floor
        return Estimate(
            stamp,
            state,
            covariance,
            validity,
            lead=self._reached + to_ns(delay) - stamp,
            leg_stiffness=1.0 if below is None else below.ratio,
            legs_are_known=below is None or below.legs_are_known,
            message=message,
            floor=floor,
            gravity=gravity,
        )


def _mean(known: float, value: float, gain: float) -> float:
    """Running mean that has `known`, or nothing yet, and takes a value with the share `gain`."""
    known = known or value
    return known + gain * (value - known)


def vector(values: Array, size: int, limit: float) -> Array | None:
    """A copy of `values` (size,); None for another shape or an element beyond +-limit."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    within = all(abs(x) <= limit for x in array.ravel().tolist())  # NaN is not
    return array if array.shape == (size,) and within else None

"""Agreement of IMU and odometry: time shift, axes and units, from what both have measured.

    compared                                finding                          effect
    turns, for shifts of the stamps         shift                            compensated
    turns, about the means                  R, k of `agreement_kernels`      compensated
    specific force, turned into odom, at    g for m/s^2                      compensated
    rest [0 0 g]                            absent, too short, not upward    no usable estimate
    twist and change of pose                twist in odom                    turned
                                            absent, or not of this motion    from the pose
    stamps of odometry and IMU              one far ahead                    dropped
                                            all far ahead                    no usable estimate

Until motion has shown the shift the IMU serves at rest alone, where a shift makes no difference;
the filter goes on with the odometry, unless that is so rare or late that a shift is the smaller
error. So it does where no finding explains the difference, with a line. Turns and twists need
motion, the specific force does not.
"""

from collections import deque
from dataclasses import replace

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import SECOND, to_ns, to_seconds
from slot_core.estimation.agreement_kernels import (
    MILLISECOND,
    SHIFTS,
    SQUARE,
    STEP,
    TurnSums,
    align,
    compare_steps,
    compare_turns,
    coverage,
    integrate,
    set_turn,
    turn_sums,
    turn_table,
    turn_work,
)
from slot_core.estimation.inertial_filter import (
    EstimatorSettings,
    OdometryMotion,
)
from slot_core.geometry import OPTICAL, matrix_of_quaternion, rpy_of
from slot_core.key_frame import StateParts
from slot_core.matrices import norm, product
from slot_core.robot import GRAVITY

STANDARD_GRAVITY = 9.80665  # m/s^2, the unit g
DEGREE = np.pi / 180.0
# ns between readings that are compared
INTERVAL, LONGEST_INTERVAL = 25 * MILLISECOND, SECOND // 2
MEMORY, FORCE_MEMORY = 2.0, 0.5  # s, time constants of the sums
LINGER = to_ns(0.15)  # ns, motion lasts after a sample that shows it
FORCE_TIME = 0.15  # s, from which the mean specific force counts
FORCE_RANGE = 2.5  # m/s^2, of its length about gravity's
UNEXPLAINED = 0.4  # largest share of the squared turns of odometry that is left
WELL = 0.2  # the same for an IMU that is turned, noise subtracted
SHARP = 4 * MILLISECOND  # ns, standard deviation of a shift that counts
FOLLOWED = 2 * MILLISECOND  # ns, least change of the shift, if it is certain
# rad^2, sums of squared turns from which a shift counts, and all must be explained
LEAST_MOTION, MOTION = 0.002, 0.02
NOISIEST = 16.0  # largest variance at rest over that of the settings
NOISY = 2.5  # noise over that of the settings, from which a line says so
LATE = 2.5  # times the largest shift, age of odometry that is worse than an IMU so shifted
MOVES = 16.0  # squared turn of odometry over its variance that shows motion
DISTINCT = 6.0  # standard deviations of a unit that is no noise
TURNED = 0.087  # rad, least angle of an IMU that counts as turned
# standard deviations of an angle that is no noise; rad, so many of them at most
TURN_ERROR, DOUBT = 5.0, 0.2
LONG = 0.8  # s of turns from which axes count
SQUARE_ANGLE = 0.15  # deviation of elements of a turn by multiples of 90 deg
APART = 50.0  # between sums of twist of which one is right
# squared distance, in six standard deviations, of a twist like the pose's
NEAR = 14.0
STRAYS = 5  # stamps ahead in a row, which are no stray ones
# m/s^2, rad/s^2 between readings
ACCELERATION, ANGULAR_ACCELERATION = 2.0, 15.0
# s between readings with which the robot walks without IMU, and a mean twist is the pose's
SLOWEST = 0.06
UNKNOWN_TWIST = np.array([0.25] * 3 + [4.0] * 3)  # variance (6,), SI


class SensorAgreement:
    """Compares the readings of IMU and odometry, and mends what it can tell."""

    STATE = StateParts(
        "_sums",
        "_last",
        "_intervals",
        "_interval",
        "_span",
        "_variance",
        "shift",
        "_proven",
        "_weighed",
        "withheld",
        "_moving",
        "_imu",
        "_seen",
        "_ahead",
        "_rotation",
        "units",
        "_frame",
        "_faults",
        "_notes",
        values=(TurnSums, OdometryMotion),
    )

    def __init__(self, settings: EstimatorSettings, mount: Array) -> None:
        """`mount`: rotation (3, 3) from the IMU's axes to base_link, as configured."""
        self._settings, self._mount = settings.agreement, mount
        noise = settings.odometry
        # of displacement and turn between two readings; m^2, rad^2
        self._least_variance = 2.0 * np.square(
            [noise.position_noise, noise.angle_noise]
        )
        self._variance = self._least_variance.copy()
        self._work, self._sums = turn_work(), turn_sums()
        self._last: OdometryMotion | None = None  # last reading compared
        # that wait for the IMU: two stamps, ns, and a turn (3,), rad
        self._intervals: deque[tuple[int, int, Array]] = deque(maxlen=32)
        self._interval = 0.0  # s, mean between readings
        self._span = 0.0  # s, mean age of a reading when the next one comes
        self.shift = 0  # ns, from the odometry's stamps to the IMU's
        off = not self._settings.enabled
        self._proven = off  # whether turns agree
        self._weighed = off  # whether the specific force is gravity's
        self.withheld = 0  # ns, last sample of which motion will tell more
        self._moving = 0  # ns, IMU stamp until which the torso moves
        self._imu = 0  # ns, newest IMU stamp when the last reading is compared
        self._seen = 0  # ns, that when a stamp of odometry was judged last
        self._ahead = 0  # readings in a row with stamps far ahead
        self._rotation = np.eye(3)  # to base_link, after the mount
        # whether samples before are to be forgotten
        self.recalibrated = False
        self.units = (1.0, 1.0)  # of the IMU, rad/s and m/s^2
        # of the twist; "pose" if that gives it, "" until motion has shown it
        self._frame = "base_link" if off else ""
        self._faults: dict[str, str] = {}
        self._notes: dict[str, str] = {}

    @property
    def message(self) -> str:
        """One line: contradictions, or else compensations; empty without any."""
        return "; ".join((self._faults or self._notes).values())

    @property
    def forbids_motion(self) -> bool:
        """Whether the robot must not move; it may where the IMU alone does not serve."""
        return bool(self._faults.keys() - {"turns"})

    @property
    def reach(self) -> float:
        """Factor on the range of the gyroscope, which may be in deg/s until turns agree."""
        return 1.0 if self._proven else 1.0 / DEGREE

    def sample(self, stamp: int, rate: Array, force: Array) -> Array | None:
        """(6,) [w, f] of a sample of the IMU as mounted, in base_link; None if it must not serve."""
        sample = np.concatenate([rate, force])
        if not self._settings.enabled:
            return sample
        size = integrate(self._sums, self._rotation, stamp, sample)
        if size > self._settings.rate_still or size == 0.0:
            self._moving = stamp + LINGER
        serves = self._weighed and (
            self._proven
            or self._span > LATE * self._settings.shift_max
            or stamp > self._moving
        )
        if not self._faults and not serves:
            self.withheld = stamp
        return sample if serves and not self._faults else None

    def is_stray(self, stamp: int, newest: int | None) -> bool:
        """Whether an odometry stamp is ahead of the IMU's newest one (ns) beyond the limit.

        From STRAYS of them in a row it is a clock's fault. A silent IMU shows nothing.
        """
        if newest is None or newest == self._seen:
            return False
        self._seen = newest
        ahead = to_seconds(stamp + self.shift - newest)
        limit = self._settings.stamp_ahead
        self._ahead = self._ahead + 1 if ahead > limit else 0
        if self._ahead >= STRAYS:
            self._faults.setdefault(
                "stamps",
                f"odom: stamps {ahead:.2f} s ahead of the imu's, limit"
                f" {limit:g} s: do their clocks differ?",
            )
        elif not self._ahead:
            self._faults.pop("stamps", None)
        return 0 < self._ahead < STRAYS or bool(self._ahead and self._last)

    def compared(
        self, motion: OdometryMotion, is_given: bool, newest: int
    ) -> OdometryMotion:
        """The reading at its time on the IMU's clock, with the twist in base_link.

        is_given: whether the message states a twist; zeros are none. newest: IMU stamp, ns.
        """
        self._imu = newest
        last, stamp = self._last, motion.stamp
        is_given &= bool(motion.velocity.any() or motion.rate.any())
        if not is_given:
            self._notes["twist"] = "odom: no twist: velocities from the pose"
        apart, turn = LONGEST_INTERVAL + 1, np.zeros(3)
        if last is not None:
            apart = stamp - last.stamp
            set_turn(self._work, last.attitude, motion.attitude)
            turn = self._work.turn.copy()
        if apart >= INTERVAL:
            self._last = motion
        if (
            last is not None
            and INTERVAL <= apart <= LONGEST_INTERVAL
            and self._settings.enabled
        ):
            self._compare(last, motion, turn, is_given)
        if not is_given or self._frame in {"", "pose"}:
            velocity, rate, variance = self._twist_of_pose(motion, last, turn)
            if is_given and not self._frame:
                difference = np.concatenate(
                    [motion.velocity - velocity, motion.rate - rate]
                )
                square = (difference * difference / variance[6:]).sum()
                is_given = bool(square < NEAR)
            if not is_given or self._frame == "pose":
                motion = replace(
                    motion, velocity=velocity, rate=rate, variance=variance
                )
        elif self._frame == "odom":
            back = matrix_of_quaternion(motion.attitude).T
            motion = replace(
                motion,
                velocity=product(back, motion.velocity),
                rate=product(back, motion.rate),
            )
        if self.shift:
            motion = replace(motion, stamp=stamp + self.shift)
        return motion

    def _twist_of_pose(
        self, motion: OdometryMotion, last: OdometryMotion | None, turn: Array
    ) -> tuple[Array, Array, Array]:
        """Mean twist since the reading `last`, as uncertain as it is now; variance (12,)."""
        variance = motion.variance.copy()
        variance[6:] = UNKNOWN_TWIST
        dt = to_seconds(motion.stamp - last.stamp) if last is not None else 0.0
        if last is None or dt * SECOND > LONGEST_INTERVAL:
            return np.zeros(3), np.zeros(3), variance
        back = matrix_of_quaternion(motion.attitude).T
        change = np.square(
            [0.5 * dt * ACCELERATION, 0.5 * dt * ANGULAR_ACCELERATION]
        )
        variance[6:] = np.repeat(self._variance / (dt * dt) + change, 3)
        velocity = product(back, (motion.position - last.position) / dt)
        return velocity, turn / dt, variance

    def _compare(
        self,
        last: OdometryMotion,
        motion: OdometryMotion,
        turn: Array,
        is_given: bool,
    ) -> None:
        """Add the step between two readings to the sums, and judge what they show."""
        dt = to_seconds(motion.stamp - last.stamp)
        moved = motion.position - last.position
        steps = np.array([(moved * moved).sum(), (turn * turn).sum()])
        if steps[1] > MOVES * 3.0 * self._variance[1]:
            self._moving = max(self._moving, self._imu + LINGER)
        if self._imu > self._moving:  # at rest a step is noise
            least = self._least_variance
            learned = (steps / 3.0 - self._variance) * dt / FORCE_MEMORY
            self._variance = np.clip(
                self._variance + learned, least, NOISIEST * least
            )
            noise = float(np.sqrt((self._variance / least).max()))
            self._notes.pop("noise", None)
            if noise > NOISY:
                self._notes["noise"] = (
                    f"odom: noise {noise:.0f} times that of estimator.yaml"
                )
        self._interval += 0.1 * (dt - self._interval)
        age = max(to_seconds(self._imu - last.stamp), 0.0)
        self._span += 0.1 * (age - self._span)
        before, after = (
            np.concatenate([m.attitude, m.position, m.velocity, m.rate])
            for m in (last, motion)
        )
        compare_steps(
            self._sums,
            self._work,
            before,
            after,
            dt,
            self._variance,
            1.0 - dt / MEMORY,
            1.0 - dt / FORCE_MEMORY,
        )
        if is_given:
            self._judge_twist()
        self._judge_force(motion)
        self._intervals.append((last.stamp, motion.stamp, turn))
        added = False
        while self._intervals:
            start, end, turn = self._intervals[0]
            covered = coverage(self._sums, start, end)
            if covered == 0:
                break
            self._intervals.popleft()
            if covered > 0:
                self._work.turn[:] = turn
                keep = 1.0 - (end - start) / SECOND / MEMORY
                added |= compare_turns(self._sums, self._work, start, end, keep)
        if added:
            self._judge_turns()

    def _judge_twist(self) -> None:
        """Find the frame of the twist, as soon as frames differ enough."""
        *sums, count = self._sums.twist.tolist()
        base, odom, none = (max(each - 6.0 * count, 0.0) for each in sums)
        if none < APART:
            return
        if odom < 0.5 * base and base - odom > APART:
            self._frame = "odom"
            self._notes["twist"] = (
                "odom: twist in the axes of odom, expected in base_link: turned"
            )
        elif base < 0.5 * none and (base < odom or not self._frame):
            self._frame = "base_link"
            self._notes.pop("twist", None)
        elif base > none + APART and self._interval < SLOWEST:
            self._frame = "pose"
            self._notes["twist"] = (
                "odom: twist is none of the pose's motion: velocities from the pose"
            )

    def _judge_force(self, motion: OdometryMotion) -> None:
        """Compare the mean specific force, in odom, with [0 0 g]."""
        time = float(self._sums.up[3])
        if time < FORCE_TIME or (
            self._weighed
            and self._imu <= self._moving
            and "force" not in self._faults
        ):
            return
        up = self._sums.up[:3] / time
        size = norm(up)
        found = f"imu: specific force {size:.1f} m/s2"
        fault = ""
        upright = size - up[2] <= self._settings.lean * size
        if abs(size - 1.0) < 0.15 and upright and not self._weighed:
            self.units = (self.units[0], STANDARD_GRAVITY)
            self._sums.up[:] = 0.0
            self._notes["force"] = f"{found} at rest, expected 9.8: taken as g"
            return
        if size == 0.0:
            fault = f"{found}, expected 9.8: is its accelerometer off?"
        elif size < 0.4 * GRAVITY:
            fault = f"{found}, expected 9.8: has its driver removed gravity?"
        elif abs(size - GRAVITY) > FORCE_RANGE:
            fault = f"{found}, expected 9.8: is it calibrated?"
        elif not upright:
            fault = self._describe_axes(motion, up / size)
        self._weighed = True
        if fault:
            self._faults.setdefault("force", fault)
        else:
            self._faults.pop("force", None)

    def _describe_axes(self, motion: OdometryMotion, up: Array) -> str:
        """One line about an IMU whose up, of odom (3,), is none: a mount that would mend it."""
        rotation = matrix_of_quaternion(motion.attitude)
        seen = product(rotation.T, up)  # in base_link, as mounted
        sensor = product(self._mount.T, seen)
        axis = int(np.argmax(np.abs(sensor)))
        name = "-+"[int(sensor[axis] > 0.0)] + "xyz"[axis]
        if name == "-y":
            mount, cause = OPTICAL, "is it in optical axes?"
        else:
            mount = product(_shortest_turn(seen, rotation[2]), self._mount)
            cause = "is it turned?"
        return (
            f"imu: up is its {name} axis against odometry's attitude: {cause}"
            f" mounts.imu.rpy: {_angles(mount)}"
        )

    def _judge_turns(self) -> None:
        """Compare the turns of gyroscope and odometry: shift, axes, unit."""
        work, total = self._work, self._sums.odometry
        turn_table(self._sums, work)
        table = work.table
        left, turned, gyro = table[:, :3].T
        best = 1 + int(np.argmin(left[1:-1]))
        count, variance = float(total[4]), float(self._variance[1])
        moved = float(turned[best]) - 3.0 * count * variance
        before, here, after = left[best - 1 : best + 2].tolist()
        bend = before - 2.0 * here + after
        each = max(here / (3.0 * count), variance)
        if (
            bend > 0.0
            and moved > LEAST_MOTION
            and here < UNEXPLAINED * turned[best]
            and 2.0 * each * (STEP * STEP) < (SHARP * SHARP) * bend
        ):
            align(table[best, 3:], np.sqrt(each * gyro[best]), work)
            noise = TURN_ERROR * TURN_ERROR * each / gyro[best]
            angle = 3.0 - work.rotation.trace()  # squared, of a small turn
            straight = noise < DOUBT * DOUBT and angle < max(
                TURNED * TURNED, noise
            )
            if (
                straight
                or abs(SHIFTS[best]) > self._settings.shift_max * SECOND
            ):
                half = 0.5 * STEP * (before - after) / bend
                self._take_shift(
                    int(SHIFTS[best]) + round(half),
                    STEP * float(np.sqrt(2.0 * each / bend)),
                )
                return
        square = float(self._sums.pairs[best, SQUARE])
        rate = float(np.sqrt(square / count)) / self._interval
        if (
            square > 3.0 * total[3]
            and rate > self._settings.rate_still
            and not self._proven
        ):
            self._notes["rest"] = (
                f"imu: turns at {rate:.2g} rad/s where odometry is at rest:"
                " not used until motion tells more; is it in deg/s?"
            )
        is_long = moved > MOTION and count * self._interval > LONG
        if is_long or gyro[best] > 100.0 * turned[best]:
            self._explain(table, moved, is_long)

    def _take_shift(self, shift: int, error: float) -> None:
        """Follow a shift of the stamps, as certain as `error`, ns, or find it beyond the limit."""
        found, limit = to_seconds(shift), self._settings.shift_max
        follows = abs(shift - self.shift) > FOLLOWED + 1.5 * error
        self.shift = shift if follows else self.shift
        self._notes.pop("rest", None)
        if abs(found) > limit:
            self._faults["turns"] = (
                f"imu: stamps {5 * round(200 * found):+d} ms against odometry's, limit"
                f" {1e3 * limit:.0f} ms: it is not used; mend its stamps"
            )
            return
        self._accept_turns()
        self._proven = True
        if follows:
            self._notes["shift"] = (
                f"imu: stamps {1e3 * found:+.0f} ms against odometry's:"
                " compensated"
            )

    def _accept_turns(self) -> None:
        """Take back that the turns differ."""
        self._faults.pop("turns", None)
        self._faults.pop("clock", None)

    def _explain(self, table: Array, moved: float, is_long: bool) -> None:
        """Find axes and unit with which the gyroscope turns as the odometry does.

        table: see `turn_table`; moved: sum of squared turns of odometry without noise, rad^2; is_long: enough for axes.
        """
        work, variance = self._work, float(self._variance[1])
        best = int(
            np.argmax(
                np.square(table[:, 3:]).sum(axis=1)
                / np.maximum(table[:, 2], variance)
            )
        )
        turned, gyro = float(table[best, 1]), float(table[best, 2])
        b = table[best, 3:]
        align(b, np.sqrt(variance * gyro), work)
        shared = float((work.rotation.ravel() * b).sum())
        unit = shared / max(gyro, variance)
        clear = unit * unit * gyro > (DISTINCT * DISTINCT) * variance
        straight = max(
            TURNED * TURNED,
            TURN_ERROR * TURN_ERROR * variance / max(gyro, variance),
        )
        # without noise
        explained = turned - unit * shared - (turned - moved) < WELL * moved
        upright = work.rotation[2, 2] > 1.0 - 2.0 * self._settings.lean
        if clear and abs(unit / DEGREE - 1.0) < 0.3 and self.units[0] == 1.0:
            self.units = (DEGREE, self.units[1])
            self._notes["unit"] = (
                f"imu: turns {1 / unit:.0f} times as fast as odometry: taken"
                " as deg/s"
            )
        elif explained and 3.0 - work.rotation.trace() < straight:
            self._accept_turns()
            return
        elif explained and upright and 0.7 < unit < 1.4 and is_long:
            self._rotation = product(_squared(work.rotation), self._rotation)
            mount = product(self._rotation, self._mount)
            self._notes["axes"] = (
                "imu: turned against odometry: compensated; mounts.imu.rpy:"
                f" {_angles(mount)}"
            )
        elif is_long:
            self._proven = False
            ratio = np.sqrt(max(gyro, 0.0) / turned)
            found = "clock" if 0.8 < ratio < 1.25 else "turns"
            self._faults.pop("clock" if found == "turns" else "turns", None)
            self._faults[found] = _mismatch(ratio)
            return
        else:
            return
        self._proven, self.recalibrated = False, True
        self._faults.pop("turns", None)
        self._notes.pop("rest", None)
        sums = self._sums
        for part in (sums.pairs, sums.odometry, sums.ring, sums.up, sums.force):
            part[:] = 0
        self._intervals.clear()


def _mismatch(ratio: float) -> str:
    """One line about a gyroscope whose turns, `ratio` of odometry's, are not those."""
    if ratio < 0.1:
        return (
            "imu: no turn where odometry turns: it is not used; is its"
            " gyroscope off?"
        )
    if 0.8 < ratio < 1.25:
        return (
            "imu: turns as much as odometry, but at no shift of its stamps from"
            f" {SHIFTS[0] // MILLISECOND} to {SHIFTS[-1] // MILLISECOND} ms with"
            " it: do their clocks differ?"
        )
    return (
        f"imu: turns {ratio:.1g} times as much as odometry, not with it: it is"
        " not used; in which unit, and is it on the torso?"
    )


def _angles(mount: Array) -> str:
    """Roll, pitch and yaw of a rotation (3, 3) as in a configuration, rad."""
    angles = rpy_of(_squared(mount)).tolist()
    return f"[{', '.join(f'{angle + 0.0:.4g}' for angle in angles)}]"


def load_kernels() -> None:
    """Call every kernel once, which loads or compiles it, so that no reading waits for it."""
    sums, work = turn_sums(), turn_work()
    for k in range(-40, 40):
        integrate(sums, np.eye(3), k * STEP, np.zeros(6))
    reading, steps = np.array([0.0, 0.0, 0.0, 1.0, *[0.0] * 9]), np.ones(2)
    set_turn(work, reading[:4], reading[:4])
    compare_steps(sums, work, reading, reading, 0.0, steps, 1.0, 1.0)
    if coverage(sums, 0, STEP) > 0:
        compare_turns(sums, work, 0, STEP, 1.0)
    turn_table(sums, work)
    align(work.table[0, 3:], 1.0, work)


def _squared(rotation: Array) -> Array:
    """A rotation (3, 3), by multiples of 90 deg if it is close to one."""
    near = np.round(rotation) + 0.0
    is_close = np.abs(rotation - near).max() < SQUARE_ANGLE
    return near if is_close and near.trace() < 3.0 else rotation


def _shortest_turn(a: Array, b: Array) -> Array:
    """The rotation (3, 3) of a unit vector to another about their normal; about x if opposite."""
    axis, c = np.cross(a, b), float((a * b).sum())
    if norm(axis) < 0.1 and c < 0.0:
        return np.diag([1.0, -1.0, -1.0])
    x = np.cross(np.eye(3), axis)  # [axis]x
    return np.eye(3) + x + product(x, x) / (1.0 + c)

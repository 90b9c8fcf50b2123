"""State estimator without odometry, for a robot that has no camera yet, and the choice of the estimator.

At every tick it corrects the filter with a reading of its own, whose variances say what is known:

    known                       from                                   variance
    roll and pitch, with IMU    gravity, over the mean motion          of the filter
    roll and pitch, without     the legs at rest (`rest_pose`)         1 rad^2
    yaw                         the gyro; without an IMU it stays      none
    height                      the legs at rest                       (20 mm)^2
    velocity                    0                                      (0.1 m/s)^2
    place                       it stays                               none

So the state moves as the IMU says within a stride, and stays over many. The supervisor sees by the
covariance what is not known. A bias of the accelerometer is taken for a tilt: 0.1 m/s^2 are 0.6 deg.
"""

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.estimation.estimate import USABLE, Validity
from slot_core.estimation.filter_kernels import FilterState
from slot_core.estimation.floor_observer import FloorObserver
from slot_core.estimation.inertial_filter import (
    NO_ODOMETRY,
    EstimatorSettings,
    ImuSamples,
    OdometryMotion,
)
from slot_core.estimation.state_estimator import (
    ANGLE_MAX,
    VARIANCE_MAX,
    StateEstimator,
    vector,
)
from slot_core.geometry import (
    matrix_of_quaternion,
    matrix_of_rpy,
    quaternion_of,
    rpy_of,
)
from slot_core.key_frame import StateParts
from slot_core.legs.leg_table import LegSprings, rest_pose
from slot_core.matrices import norm
from slot_core.robot import GRAVITY, LEGS, RobotParameters

CHANGES = {
    # rad/s, m/s^2, standard deviations: more of the biases counts as turn and tilt
    "imu.gyro_bias": 0.005,
    "imu.acceleration_bias": 0.1,
    "agreement.enabled": False,  # there is nothing to compare the IMU with
}
FORCE_ERROR = (
    3.0  # m/s^2, of the specific force from gravity, beyond which it is named
)
# (12,) standard deviations of angle, position, velocity and rate at the start; unknown: VARIANCE_MAX
START = np.repeat([0.1, 0.02, 0.1, 0.1], 3)
HEIGHT_ERROR, SPEED, TILT = 0.02, 0.1, 1.0  # m, m/s, rad
PLACE, HEIGHT, VELOCITY, RATE = slice(3, 5), 5, slice(6, 9), slice(9, 12)


class UnaidedEstimator(StateEstimator):
    """State estimator that ignores odometry; its clock is the IMU, or without one the joints."""

    STATE = StateParts(
        *StateEstimator.STATE.names,
        "_angle",
        values=(FilterState, OdometryMotion, ImuSamples),
    )

    def __init__(
        self,
        settings: EstimatorSettings,
        robot: RobotParameters,
        springs: LegSprings,
    ) -> None:
        self._robot, self._springs = robot, springs
        rest_pose(robot, springs, np.zeros(4))  # compiles its kernels
        super().__init__(config.replace(settings, CHANGES))

    def _reset(self) -> None:
        super()._reset()
        self._angle = np.zeros(len(LEGS))  # rad, of the tendons

    def add_odometry(self, *_: object) -> None:
        """Ignore odometry."""

    def add_joints(self, stamp: int, angle: Array, torque: Array) -> None:
        """Add tendon angles (4,) rad at `stamp` (ns); without an IMU they may lead to a tick."""
        known = vector(angle, len(LEGS), ANGLE_MAX)
        if known is None or not self._advances("joints", stamp):
            return
        self._angle = known
        if self._imu_is_lost(stamp):
            latest = stamp + self._earliness
            self._correct(stamp, latest, with_imu=False)
            self._publish_due(stamp, latest)

    def _process_due(self) -> None:
        stamp = self._newest["imu"]
        self._correct(stamp, stamp, with_imu=True)

    def _correct(self, stamp: int, latest: int, *, with_imu: bool) -> None:
        """Correct at `stamp` (ns) with a reading of its own, if a tick is due up to `latest`."""
        if latest >= self._tick:
            self._process(stamp, self._reading(stamp, with_imu))

    def _reading(self, stamp: int, with_imu: bool) -> OdometryMotion:
        """A reading that changes nothing of what is not known."""
        state, zero = self._filter.state, np.zeros(3)
        height, roll, pitch = rest_pose(self._robot, self._springs, self._angle)
        yaw = rpy_of(matrix_of_quaternion(state.attitude))[2]
        level = quaternion_of(matrix_of_rpy([roll, pitch, yaw]))
        place = np.array([*state.position[:2], height])
        attitude, variance = level, np.square(START)
        variance[PLACE] = VARIANCE_MAX
        if self._stamp is not None:
            variance[:] = VARIANCE_MAX
            variance[HEIGHT] = np.square(HEIGHT_ERROR)
            variance[VELOCITY] = np.square(SPEED)
            if with_imu:
                attitude = state.attitude
            else:
                variance[:2] = np.square(TILT)
                variance[RATE] = np.square(SPEED)
        return OdometryMotion(stamp, attitude, place, zero, zero, variance)

    def _judged(self, stamp: int) -> tuple[Validity, str]:
        validity, message = super()._judged(stamp)
        samples = self._imu.values
        force = norm(samples[-1, 3:]) if len(samples) else GRAVITY
        if validity not in USABLE and abs(force - GRAVITY) > FORCE_ERROR:
            message = (
                f"imu: specific force {force:.1f} m/s2 of a robot in its place:"
                " in g, or gravity removed?"
            )
        return validity, message


def make_estimator(
    settings: EstimatorSettings, robot: RobotParameters, springs: LegSprings
) -> StateEstimator:
    """The state estimator for the source of the odometry; raises ConfigError without a leg table."""
    if settings.odometry.source == NO_ODOMETRY:
        return UnaidedEstimator(settings, robot, springs)
    return StateEstimator(
        settings,
        FloorObserver(robot, springs, settings.floor, settings.timing.period),
    )

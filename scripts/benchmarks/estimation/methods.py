"""Ways to the state that the MPC uses: the authors', the filter without prediction, and with it.

Each yields (time of use in ns, state (12,)) for the arrivals of a `Slam`. A state is used when its
odometry has arrived, or at a tick of the controller.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.estimation.measured_streams import Arrival
from slot_core import config
from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.inertial_filter import EstimatorSettings
from slot_core.estimation.state_estimator import StateEstimator
from slot_core.geometry import rpy_of
from slot_core.simulation.readings import ImuReading, OdometryReading

Use = tuple[int, Array]
Way = Callable[[Sequence[Arrival], EstimatorSettings], Iterator[Use]]
USABLE = (Validity.VALID, Validity.ODOMETRY_LOST, Validity.ODOMETRY_REJECTED)


def finite_differences(
    arrivals: Sequence[Arrival], _: EstimatorSettings
) -> Iterator[Use]:
    """The authors' way: pose of the odometry, velocity by its differences, angular rate zero."""
    last: OdometryReading | None = None
    for arrival, r in arrivals:
        if isinstance(r, ImuReading) or (last and r.stamp <= last.stamp):
            continue
        if last is not None:
            velocity = (r.position - last.position) / to_seconds(
                r.stamp - last.stamp
            )
            yield (
                arrival,
                np.concatenate(
                    [
                        rpy_of(Rotation.from_quat(r.quaternion).as_matrix()),
                        r.position,
                        np.zeros(3),
                        velocity,
                    ]
                ),
            )
        last = r


def without_prediction(
    arrivals: Sequence[Arrival], settings: EstimatorSettings
) -> Iterator[Use]:
    """The filter's state at the stamp of the odometry, used when that has arrived.

    The ticks have the stamps of the simulated odometry. In order of the stamps the estimator's states
    are newer than that by `lead`; as long after the arrival they are as old as they should be.
    """
    arrival_of = {
        r.stamp: time for time, r in arrivals if isinstance(r, OdometryReading)
    }
    in_order = sorted(arrivals, key=lambda item: item[1].stamp)
    prompt = config.replace(settings, {"timing.command_delay": 0.0})
    for _, estimate in estimates(in_order, prompt):
        if estimate.stamp in arrival_of:
            yield arrival_of[estimate.stamp] + estimate.lead, estimate.state


def predicted(
    arrivals: Sequence[Arrival], settings: EstimatorSettings
) -> Iterator[Use]:
    """The state of the estimator, predicted to the newest IMU sample."""
    for time, estimate in estimates(arrivals, settings):
        yield time, estimate.state


def estimates(
    arrivals: Sequence[Arrival], settings: EstimatorSettings
) -> Iterator[tuple[int, Estimate]]:
    """(time of arrival in ns, estimate) of the estimates after the initial readings."""
    estimator = StateEstimator(settings)
    for time, r in arrivals:
        for estimate in taken(estimator, r):
            if estimate.validity in USABLE:
                yield time, estimate


def taken(
    estimator: StateEstimator, r: ImuReading | OdometryReading
) -> list[Estimate]:
    """Estimates that follow from a reading, once the estimator has taken it."""
    if isinstance(r, ImuReading):
        estimator.add_imu(r.stamp, r.angular_velocity, r.specific_force)
    else:
        estimator.add_odometry(
            r.stamp, r.position, r.quaternion, r.velocity, r.angular_velocity
        )
    return list(iter(estimator.poll, None))


def plain_step() -> tuple[Rotation, Array]:
    """One step of the error-state filter in NumPy and SciPy: attitude and covariance (15, 15).

    The equations of `filter_kernels.propagate` with some values, to compare the time.
    """
    dt, rate, noise = 0.005, np.array([0.3, -0.2, 0.5]), 1e-6 * np.eye(15)
    half = Rotation.from_rotvec(dt / 2 * rate)
    middle = Rotation.identity() * half
    turn, (x, y, z) = middle.as_matrix(), middle.apply([0.1, -0.3, 9.81])
    change = np.zeros((15, 15))
    change[0:3, 9:12] = change[6:9, 12:15] = -dt * turn
    change[3:6, 6:9] = dt * np.eye(3)
    change[6:9, 0:3] = -dt * np.array(
        [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    )
    transition = np.eye(15) + change + change @ change / 2
    return middle * half, transition @ (
        np.eye(15) + noise
    ) @ transition.T + noise

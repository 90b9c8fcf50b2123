"""Alignment of a measurement with a run, in time and space.

Frame: the rotation R and shift d minimise sum |R m_i + d - r_i|^2 over the samples of all points
(W. Kabsch, Acta Cryst. A 34, 1978, 827; det R = 1). What is free:

    rigid   R and d: the measurement has another frame, as of a camera
    level   turn about z, and d: both have z upwards
    none    nothing: both are in one frame

The alignment removes errors in what it fits: with `rigid` place, heading and inclination.

Clock: t_run = offset + (1 + drift) t_measurement

1. Cross-correlation of the points' velocities over all shifts of a grid. The frames may differ: of
   the cross-covariance H of a shift (3 x 3, summed over the points, by FFT) the score is the
   largest trace(R H) over the rotations that the frame leaves free, over the energy of both.
2. Least squares on offset and drift about the best shift: sum |R m_i - r(t_i)|^2, r a cubic spline,
   R as above, of the differences without their moving mean. So a place or heading that the run gets
   wrong by and by is not taken for a drift of the clock.

The intervals take the differences of every `SLOW` as one group (as the fit of the calibration
does): where the run differs from the measurement in shape, noise alone would promise too
narrow ones.

Periodic motion fits nearly as well a period later: the shifts of the highest peaks are all refined,
and the one with the least rest is taken. `rival_rest` is the rest of the next best one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import correlate, correlation_lags, find_peaks
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from slot_core.arrays import Array
from slot_core.geometry import rpy_of
from slot_lab.validation.recording import PointTrack, RecordingError

GRID = 0.01  # s
SMOOTH = 0.04  # s, of the velocities
PEAK = 0.85  # height of a peak that is refined, of the highest
PEAKS = 6  # that are refined
SLOW = 2.0  # s, width of the moving mean of the differences
LEAST_SAMPLES = 20  # in the time of the run
OVERLAP = 0.5  # least overlap, of the shorter recording
APART = 0.15  # s, from the best shift to its rivals
DRIFT_MAX = 5e-3  # of a clock; a quartz has 1e-4
LEAST_FOR_DRIFT = 5.0  # s, of a recording whose drift is fitted
LEVEL = 0.95  # of the intervals
Pair = tuple[PointTrack, PointTrack]  # of the measurement and of the run


@dataclass(frozen=True)
class FrameAlignment:
    """x_run = rotation x_measurement + shift."""

    rotation: Array  # (3, 3)
    shift: Array  # (3,) m

    def apply(self, points: Array) -> Array:
        """Points (n, 3) of the measurement in the frame of the run."""
        return np.asarray(points @ self.rotation.T + self.shift)

    def attitude(self, rpy: Array) -> Array:
        """Attitudes (n, 3) of the measurement in the frame of the run, yaw unwrapped."""
        turned = Rotation.from_matrix(self.rotation) * Rotation.from_euler(
            "xyz", rpy
        )
        return np.unwrap(rpy_of(turned.as_matrix()), axis=0)


def align_frames(measured: Array, run: Array, frame: str) -> FrameAlignment:
    """Alignment of points (n, 3) with points (n, 3) of the run."""
    if frame == "none":
        return FrameAlignment(np.eye(3), np.zeros(3))
    centre, target = measured.mean(axis=0), run.mean(axis=0)
    rotation = best_rotation((measured - centre).T @ (run - target), frame)
    return FrameAlignment(rotation, target - rotation @ centre)


def best_rotation(covariance: Array, frame: str) -> Array:
    """(3, 3) rotation R with the largest trace(R H) of a cross-covariance H = sum m r^T (3, 3)."""
    if frame == "none":
        return np.eye(3)
    if frame == "level":
        (a, b, _), (c, d, _), _ = covariance
        angle = np.arctan2(b - c, a + d)
        return np.asarray(Rotation.from_euler("z", angle).as_matrix())
    left, _, right = np.linalg.svd(covariance)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((left * sign @ right).T)


@dataclass(frozen=True)
class TimeAlignment:
    """t_run = offset + (1 + drift) t_measurement, with half widths of the 95 % intervals."""

    offset: float  # s
    drift: float
    offset_width: float = 0.0  # s; NaN: too few groups to tell
    drift_width: float = 0.0  # 0: not fitted
    rest: float = 0.0  # m, RMS per coordinate of the differences without their moving mean
    # m, of the next best shift; infinite: there is none
    rival_rest: float = np.inf
    rival_offset: float = np.nan  # s

    def apply(self, t: Array) -> Array:
        """Times of the measurement on the clock of the run."""
        return self.offset + (1.0 + self.drift) * t


def align_times(
    pairs: Sequence[Pair], frame: str, offset: float | None = None
) -> TimeAlignment:
    """Alignment of points measured and run; offset: known to 0.1 s or so, else searched.

    Raises RecordingError for motion that is not enough to align.
    """
    starts = (
        candidates(*cross_correlation(pairs, frame))
        if offset is None
        else [offset]
    )
    found, refusals = [], []
    for start in starts:
        try:
            found.append(_refine(pairs, frame, start))
        except RecordingError as error:  # a candidate that overlaps too little
            refusals.append(error)
    if not found:
        raise refusals[0]
    found.sort(key=lambda each: each.rest)
    best, *others = found
    for rival in others:
        if abs(rival.offset - best.offset) > APART:
            return replace(
                best, rival_rest=rival.rest, rival_offset=rival.offset
            )
    return best


def candidates(shifts: Array, score: Array) -> list[float]:
    """Shifts (s) of the highest peaks of the cross-correlation.

    At most PEAKS of them, each higher than PEAK times the highest; the highest value
    counts as a peak also at an end.
    """
    peaks = np.append(find_peaks(score)[0], np.argmax(score))
    peaks = peaks[score[peaks] > PEAK * score.max()]
    best = peaks[np.argsort(-score[peaks])][:PEAKS]
    return [float(shift) for shift in dict.fromkeys(shifts[best].tolist())]


def cross_correlation(pairs: Sequence[Pair], frame: str) -> tuple[Array, Array]:
    """Shifts (n,) in s, and their normalised cross-correlation (n,).

    score(k) = max_R trace(R H_k) / sqrt(E_m(k) E_r(k)) with the cross-covariance H_k of the
    velocities at the shift k, and the energies E of measurement and run where they
    overlap. Shifts whose overlap is below OVERLAP of the shorter recording are left out.
    Raises RecordingError for a recording shorter than 1 s or without motion.
    """
    first = [min(pair[k].t[0] for pair in pairs) for k in (0, 1)]
    last = [max(pair[k].t[-1] for pair in pairs) for k in (0, 1)]
    grids = [np.arange(a, b, GRID) for a, b in zip(first, last)]
    sizes = [len(grid) for grid in grids]
    if min(sizes) < 1.0 / GRID:
        raise RecordingError(
            f"a recording of {min(sizes) * GRID:.2f} s is shorter than 1 s"
        )
    total = np.zeros((sum(sizes) - 1, 3, 3))
    ones = [np.ones(size) for size in sizes]
    energy = [np.zeros(size) for size in sizes]
    for pair in pairs:
        moved = [_velocity(track, grid) for track, grid in zip(pair, grids)]
        for i, mine in enumerate(moved[0].T):
            for j, run in enumerate(moved[1].T):
                total[:, i, j] += correlate(run, mine, method="fft")
        energy = [e + np.square(m).sum(axis=1) for e, m in zip(energy, moved)]
    lags = correlation_lags(sizes[1], sizes[0])  # of the measurement in the run
    overlap = np.rint(correlate(ones[1], ones[0], method="fft"))
    power = correlate(energy[1], ones[0], method="fft")  # in the overlap
    power *= correlate(ones[1], energy[0], method="fft")
    good = overlap >= OVERLAP * min(sizes)
    score = np.array(
        [np.trace(best_rotation(h, frame) @ h) for h in total[good]]
    )
    most = power[good].max()
    if not most > 0:
        raise RecordingError(
            "nothing moves in one of the recordings: no alignment in time"
        )
    score /= np.sqrt(np.maximum(power[good], 1e-6 * most))
    return first[1] - first[0] + lags[good] * GRID, score


def _velocity(track: PointTrack, grid: Array) -> Array:
    """(n, 3) m/s, smoothed; zero where the point is not recorded, mean zero."""
    place = np.column_stack(
        [np.interp(grid, track.t, column) for column in track.position.T]
    )
    speed = gaussian_filter1d(
        np.gradient(place, GRID, axis=0), SMOOTH / GRID, axis=0
    )
    return np.asarray(speed - speed.mean(axis=0))


def _refine(pairs: Sequence[Pair], frame: str, start: float) -> TimeAlignment:
    """Alignment by least squares about a start, s.

    Residuals are the differences of the places in the run's axes, from their mean and
    without their moving mean. Covariance of the estimate from the scores of the groups, as
    in slot_lab/calibration/fit.py. Raises RecordingError for too few samples.
    """
    parts = [
        part for pair in pairs if len((part := _inside(pair, start))[0]) > 1
    ]
    count = sum(len(t) for t, _, _ in parts)
    if count < LEAST_SAMPLES:
        raise RecordingError(
            f"only {count} samples of the measurement are in the time of the run, less than"
            f" {LEAST_SAMPLES}"
        )
    times = np.concatenate([t for t, _, _ in parts])
    middle, duration = float(times.mean()), float(np.ptp(times))
    size = 2 if duration >= LEAST_FOR_DRIFT else 1
    measured = np.vstack([place - place.mean(axis=0) for _, place, _ in parts])

    ends = np.cumsum([len(t) for t, _, _ in parts])[:-1]
    late = (times - middle) / duration

    def residuals(u: Array) -> Array:
        """u: shift at the middle of the measurement, and drift times its duration, s."""
        drifted = u[1] * late if size == 2 else np.zeros(len(late))
        shift = np.split(u[0] + drifted, ends)
        places = [
            spline(start + t + moved)
            for (t, _, spline), moved in zip(parts, shift)
        ]
        run = np.vstack([place - place.mean(axis=0) for place in places])
        off = measured @ best_rotation(measured.T @ run, frame).T - run
        return np.concatenate(
            [
                _fast(t, part).ravel()
                for (t, _, _), part in zip(parts, np.split(off, ends))
            ]
        )

    limit = np.array([APART, DRIFT_MAX * duration])[:size]
    found = least_squares(
        residuals,
        np.zeros(size),
        bounds=(-limit, limit),
        x_scale=0.01,
        xtol=1e-10,
        ftol=1e-10,
    )
    jacobian = np.asarray(found.jac)
    block = np.repeat(np.floor((times - times.min()) / SLOW), 3)
    scores = np.array(
        [
            jacobian[block == k].T @ found.fun[block == k]
            for k in np.unique(block)
        ]
    )
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    freedom = len(scores) - size
    covariance = (
        inverse @ scores.T @ scores @ inverse * (len(scores) / max(freedom, 1))
    )
    to_result = np.array([[1.0, -middle / duration], [0.0, 1.0 / duration]])[
        :, :size
    ]
    offset, drift = to_result @ found.x
    factor = student.ppf((1 + LEVEL) / 2, freedom) if freedom > 0 else np.nan
    widths = factor * np.sqrt(np.diag(to_result @ covariance @ to_result.T))
    offset_width, drift_width = widths.tolist()
    return TimeAlignment(
        start + float(offset),
        float(drift),
        offset_width,
        drift_width,
        rest=float(np.sqrt(np.mean(found.fun**2))),
    )


def _inside(pair: Pair, start: float) -> tuple[Array, Array, CubicSpline]:
    """Times and places of the measurement that stay in the run's time, and the run's spline."""
    measured, run = pair
    at = start + measured.t
    keep = (at >= run.t[0] + APART) & (at <= run.t[-1] - APART)
    return (
        measured.t[keep],
        measured.position[keep],
        CubicSpline(run.t, run.position),
    )


def _fast(t: Array, off: Array) -> Array:
    """Differences (n, 3) at times t without their moving mean over SLOW."""
    samples = max(1, round(SLOW / float(np.median(np.diff(t)))))
    return np.asarray(
        off
        - uniform_filter1d(off, min(samples, len(t)), axis=0, mode="nearest")
    )

"""Weighted nonlinear least squares with bounds, confidence intervals and correlation.

    min sum r_i^2,   r_i = (predicted_i - measured_i) / sigma_i

over the coordinates u of the parameters: u = log(value) where the bounds are positive, else value
over the width of its bounds. With the Jacobian J = dr/du, residual variance s^2 = r.r / (n - rank)
and covariance C = s^2 (J^T J)^-1, the interval of a coordinate is u +- t sqrt(C_kk), with t of
Student's distribution at n - rank degrees of freedom (Seber and Wild, Nonlinear Regression, 1989,
ch. 5). It linearises the model and neglects the bounds: at a bound it is a rough estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from slot_core.calibration.experiments import PredictionError
from slot_core.config import ConfigError, leaves
from slot_core.robot import Array, Robot

LEVEL = 0.95  # of the intervals
STEP = 0.01  # of a coordinate in central differences; wide, because predictions have kinks
# A singular value of the scaled Jacobian below this part of the largest is taken as zero:
# differences of simulated values have about four digits.
RANK = 1e-4
NULL_SHARE = 1e-3  # share of a parameter in a null direction above which it is undetermined
FAILED_RESIDUAL = 1e6  # residual of a trial whose prediction fails, so that it is rejected
TOLERANCE = 1e-5  # of the last step of the coordinates and the last decrease of the sum of squares
EDGE = 1e-6  # of a coordinate; the search stays off the bounds, a result this close is at its bound
TRIALS = 60  # evaluations of a start, at most
SCATTER = 1.0  # of the coordinates of further starts: a factor e, or the width of the bounds

Predict = Callable[[Array], Array]  # values of the parameters (p,) to predictions (n,)


class FitError(RuntimeError):
    """The fit failed; the message names the cause."""


@dataclass(frozen=True)
class Parameter:
    """A free parameter: start value and bounds."""

    name: str
    start: float
    low: float
    high: float

    def coordinate(self, value: float) -> float:
        """Coordinate u of a value: log(value) for positive bounds, else value over their width."""
        return math.log(value) if self.low > 0.0 else value / (self.high - self.low)

    def value(self, coordinate: float) -> float:
        """Inverse of `coordinate`."""
        if self.low > 0.0:
            return float(np.exp(coordinate))
        return coordinate * (self.high - self.low)


@dataclass(frozen=True)
class FitProblem:
    """Free parameters, predictions and measurements."""

    parameters: tuple[Parameter, ...]
    predict: Predict
    measured: Array  # (n,)
    sigma: Array  # (n,)

    def coordinates(self, values: Sequence[float] | Array) -> Array:
        """(p,) coordinates of values (p,)."""
        return np.array([p.coordinate(v) for p, v in zip(self.parameters, values)])

    def values(self, u: Array) -> Array:
        """(p,) values at coordinates u (p,)."""
        return np.array([p.value(c) for p, c in zip(self.parameters, u)])

    def residuals(self, u: Array) -> Array:
        """(n,) residuals (predicted - measured) / sigma at u (p,); raises PredictionError."""
        return (self.predict(self.values(u)) - self.measured) / self.sigma

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (p,) of the coordinates."""
        low = self.coordinates([p.low for p in self.parameters])
        return low, self.coordinates([p.high for p in self.parameters])

    def jacobian(self, u: Array) -> Array:
        """(n, p) dr/du by central differences, one-sided at a bound; raises FitError."""
        low, high = self.bounds()
        columns = []
        for k, name in enumerate(p.name for p in self.parameters):
            up, down = u.copy(), u.copy()
            up[k], down[k] = min(u[k] + STEP, high[k]), max(u[k] - STEP, low[k])
            try:
                change = self.residuals(up) - self.residuals(down)
            except PredictionError as error:
                raise FitError(f"no derivative by {name}: {error}") from None
            columns.append(change / (up[k] - down[k]))
        return np.column_stack(columns)


@dataclass(frozen=True)
class FitResult:
    """Result of a fit; without convergence, the best point of its trials."""

    values: Array  # (p,)
    chi_square: float  # sum of squares r.r
    converged: bool


@dataclass(frozen=True)
class ParameterEstimate:
    """Parameters with intervals and correlation; those of undetermined parameters are NaN.

    A parameter is undetermined if the data do not depend on it, or if its interval contains both
    of its bounds.
    """

    values: Array  # (p,)
    predicted: Array  # (n,)
    chi_square: float  # r.r
    freedom: int  # n - rank
    interval: Array  # (p, 2), 95 % interval: least and largest value
    correlation: Array  # (p, p), of the coordinates
    condition: float  # of the Jacobian with columns of length one
    at_limit: NDArray[np.bool_]  # (p,) within STEP of a bound


def parameters_of(robot: Robot, names: Sequence[str]) -> tuple[Parameter, ...]:
    """Free parameters by dotted name, with start and bounds of their settings.

    Raises ConfigError for a name that is no number of the robot or is given twice.
    """
    known = {name: (v, meta) for name, v, meta in leaves(robot) if isinstance(v, float)}
    for name in names:
        if name not in known:
            raise ConfigError(f"{name} is not a number of the robot (known: {', '.join(known)})")
    if len(set(names)) < len(names):
        raise ConfigError(f"a parameter is named twice: {', '.join(names)}")
    return tuple(
        Parameter(name, known[name][0], known[name][1]["low"], known[name][1]["high"])
        for name in names
    )


def fit(problem: FitProblem, starts: int = 1, progress: Callable[[str], None] = print) -> FitResult:
    """Best of the fits from the parameters' start values and from `starts` - 1 further starts.

    The further starts scatter about the first, with a random generator of fixed seed. progress
    takes a line of text per start. Raises FitError where every start fails.
    """
    rng = np.random.default_rng(0)
    first = problem.coordinates([p.start for p in problem.parameters])
    low, high = problem.bounds()
    best, reason = None, ""
    for k in range(starts):
        shift = SCATTER * rng.uniform(-1.0, 1.0, len(first)) if k else 0.0
        try:
            found = _fit_from(problem, np.clip(first + shift, low, high))
        except FitError as error:
            reason = str(error)
            progress(f"start {k + 1} of {starts}: {error}")
            continue
        end = "" if found.converged else f", stopped after {TRIALS} trials"
        progress(f"start {k + 1} of {starts}: sum of squares {found.chi_square:.6g}{end}")
        if best is None or found.chi_square < best.chi_square:
            best = found
    if best is None:
        raise FitError(reason)
    return best


def _fit_from(problem: FitProblem, start: Array) -> FitResult:
    """Fit from coordinates `start`; raises FitError where prediction or derivative fails."""
    try:
        problem.residuals(start)
    except PredictionError as error:
        raise FitError(f"no prediction at the start: {error}") from None

    def residuals(u: Array) -> Array:
        try:
            return problem.residuals(u)
        except PredictionError:
            return np.full(len(problem.measured), FAILED_RESIDUAL)

    low, high = problem.bounds()
    end = least_squares(
        residuals,
        start,
        jac=problem.jacobian,
        bounds=(low, high),
        x_scale="jac",
        xtol=TOLERANCE,
        ftol=TOLERANCE,
        max_nfev=TRIALS,
    )
    u = np.where(end.x - low < EDGE, low, np.where(high - end.x < EDGE, high, end.x))
    return FitResult(problem.values(u), float(2 * end.cost), bool(end.status))


def estimate(problem: FitProblem, values: Sequence[float] | Array) -> ParameterEstimate:
    """Intervals and correlation at given values (p,); raises PredictionError, FitError."""
    u, (low, high) = problem.coordinates(values), problem.bounds()
    residual, jacobian = problem.residuals(u), problem.jacobian(u)
    length = np.linalg.norm(jacobian, axis=0)
    length[length == 0.0] = 1.0
    _, singular, directions = np.linalg.svd(jacobian / length)
    singular = np.append(singular, np.zeros(len(u) - len(singular)))
    significant = singular > RANK * singular[0]
    freedom = len(residual) - int(significant.sum())
    chi_square = float(residual @ residual)
    scaled = directions[significant].T / singular[significant]
    covariance = scaled @ scaled.T / np.outer(length, length)
    determined = np.all(np.abs(directions[~significant]) < NULL_SHARE, axis=0)
    width = np.full(len(u), np.nan)
    if freedom:
        deviation = np.sqrt(chi_square / freedom * np.diag(covariance))
        width = np.where(determined, student.ppf((1 + LEVEL) / 2, freedom) * deviation, np.nan)
    return ParameterEstimate(
        values=problem.values(u),
        predicted=problem.measured + residual * problem.sigma,
        chi_square=chi_square,
        freedom=freedom,
        interval=_intervals(problem, u, width),
        correlation=_correlation(covariance, determined),
        condition=float(singular[0] / singular[-1]) if significant.all() else math.inf,
        at_limit=(u - low < STEP) | (high - u < STEP),
    )


def _intervals(problem: FitProblem, u: Array, width: Array) -> Array:
    """(p, 2) intervals; NaN where one contains both bounds: the data say nothing there."""
    low, high = problem.bounds()
    width = np.where((u - width <= low) & (u + width >= high), np.nan, width)
    with np.errstate(over="ignore"):  # overflow gives infinity
        return np.column_stack([problem.values(u - width), problem.values(u + width)])


def _correlation(covariance: Array, determined: NDArray[np.bool_]) -> Array:
    deviation = np.where(determined, np.sqrt(np.diag(covariance)), np.nan)
    return covariance / np.outer(deviation, deviation)

"""Weighted nonlinear least squares with bounds, confidence intervals and correlation.

    min sum r_i^2,   r_i = (predicted_i - measured_i) / sigma_i

over the coordinates u of the parameters: u = log(value) where the bounds are positive, else value
over the width of its bounds. With the Jacobian J = dr/du, residual variance s^2 = r.r / (n - rank)
and covariance C = s^2 (J^T J)^-1, the interval of a coordinate is u +- t sqrt(C_kk), with t of
Student's distribution at n - rank degrees of freedom (Seber and Wild, Nonlinear Regression, 1989,
ch. 5). It linearises the model and neglects the bounds: at a bound it is a rough estimate.

Residuals that belong together, as a stride's, form one of K groups. With g_k = J_k^T r_k,

    C = K / (K - rank) (J^T J)^-1 (sum_k g_k g_k^T) (J^T J)^-1

at K - rank degrees of freedom (Cameron and Miller, A Practitioner's Guide to Cluster-Robust
Inference, 2015, sec. II).
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from slot_core.arrays import Array
from slot_core.command_line import untold
from slot_core.config import ConfigError, leaves
from slot_core.refusal import InputError
from slot_core.robot import RobotParameters
from slot_lab.workers import serially

LEVEL = 0.95  # of the intervals
# of a coordinate in central differences; wide: predictions have kinks
STEP = 0.01
# A singular value of the scaled Jacobian below this part of the largest is taken as zero:
# differences of simulated values have about four digits.
RANK = 1e-4
# share of a parameter in a null direction that makes it undetermined
NULL_SHARE = 1e-3
# of a trial whose prediction fails, so that it is rejected
FAILED_RESIDUAL = 1e6
# of the last step of the coordinates and the last decrease of the sum
TOLERANCE = 1e-5
EDGE = 1e-6  # of a coordinate; a result this close to a bound is at its bound
TRIALS = 60  # evaluations of a start, at most
BEST_CONVERGED = "well: the best start converged; a start that was stopped found nothing better"
BEST_STOPPED = (
    "not well: the best start was stopped while its sum of squares still fell; give more"
    " --starts, or continue the fit from the parameters that it found"
)
SCATTER = 1.0  # of further starts: a factor e, or the width of the bounds

# values of the parameters (p,) to predictions (n,)
Predict = Callable[[Array], Array]
# of several points
RunAll = Callable[[Predict, Sequence[Array]], Sequence[Array]]


class FitError(InputError):
    """The fit failed; the message names the cause."""


class PredictionError(InputError):
    """The simulation of a measurement failed; the message names the test and the cause."""


@dataclass(frozen=True)
class Parameter:
    """A free parameter: start value and bounds."""

    name: str
    start: float
    low: float
    high: float

    def coordinate(self, value: float) -> float:
        """Coordinate u of a value: log(value) for positive bounds, else value over their width."""
        return (
            math.log(value)
            if self.low > 0.0
            else value / (self.high - self.low)
        )

    def value(self, coordinate: float) -> float:
        """Inverse of `coordinate`."""
        return (
            float(np.exp(coordinate))
            if self.low > 0.0
            else coordinate * (self.high - self.low)
        )


@dataclass(frozen=True)
class FitProblem:
    """Free parameters, predictions and measurements."""

    parameters: tuple[Parameter, ...]
    predict: Predict
    measured: Array  # (n,)
    sigma: Array  # (n,)
    run_all: RunAll = serially

    def coordinates(self, values: Sequence[float] | Array) -> Array:
        """(p,) coordinates of values (p,)."""
        return np.array(
            [p.coordinate(v) for p, v in zip(self.parameters, values)]
        )

    def values(self, u: Array) -> Array:
        """(p,) values at coordinates u (p,)."""
        return np.array([p.value(c) for p, c in zip(self.parameters, u)])

    def allowed(self, u: Array) -> Array:
        """(p,) values at u (p,) within the bounds, which exp(log(bound)) may leave by rounding."""
        low, high = np.array([(p.low, p.high) for p in self.parameters]).T
        return np.clip(self.values(u), low, high)

    def residuals(self, u: Array) -> Array:
        """(n,) residuals (predicted - measured) / sigma at u (p,); raises PredictionError."""
        (predicted,) = self.run_all(self.predict, [self.allowed(u)])
        return (predicted - self.measured) / self.sigma

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (p,) of the coordinates."""
        return self.coordinates(
            [p.low for p in self.parameters]
        ), self.coordinates([p.high for p in self.parameters])

    def jacobian(self, u: Array) -> Array:
        """(n, p) dr/du by central differences, one-sided at a bound; raises FitError."""
        low, high = self.bounds()
        up, down = (np.tile(u, (len(u), 1)) for _ in range(2))
        np.fill_diagonal(up, np.minimum(u + STEP, high))
        np.fill_diagonal(down, np.maximum(u - STEP, low))
        try:
            found = self.run_all(
                self.predict, [self.allowed(point) for point in (*up, *down)]
            )
        except PredictionError as error:
            raise FitError(f"no derivative: {error}") from None
        change = np.array(found[: len(u)]) - np.array(found[len(u) :])
        return np.asarray((change / self.sigma / np.diag(up - down)[:, None]).T)


@dataclass(frozen=True)
class FitResult:
    """Result of a fit; without convergence, the best point of its trials."""

    values: Array  # (p,)
    chi_square: float  # sum of squares r.r
    converged: bool


@dataclass(frozen=True)
class ParameterEstimate:
    """Parameters with intervals and correlation; NaN for undetermined parameters.

    A parameter is undetermined if the data do not depend on it, or if its interval contains both
    of its bounds.
    """

    values: Array  # (p,)
    predicted: Array  # (n,)
    chi_square: float  # r.r
    freedom: int  # n - rank, or of groups K - rank
    interval: Array  # (p, 2), 95 % interval: least and largest value
    correlation: Array  # (p, p), of the coordinates
    condition: float  # of the Jacobian with columns of length one
    at_limit: NDArray[np.bool_]  # (p,) within STEP of a bound

    def at_bound(self, names: Sequence[str]) -> list[str]:
        """Names of the determined parameters at a bound."""
        return [
            name
            for name, at, low in zip(names, self.at_limit, self.interval[:, 0])
            if at and not math.isnan(low)
        ]


def parameters_of(
    robot: RobotParameters, names: Sequence[str]
) -> tuple[Parameter, ...]:
    """Free parameters by dotted name, with start and bounds of their settings.

    Raises ConfigError for a name that is no number of the robot or is given twice.
    """
    known = {
        name: Parameter(name, v, meta["low"], meta["high"])
        for name, v, meta in leaves(robot)
        if isinstance(v, float)
    }
    for name in names:
        if name not in known:
            raise ConfigError(
                f"{name} is not a number of the robot (known: {', '.join(known)})"
            )
    if len(set(names)) < len(names):
        raise ConfigError(f"a parameter is named twice: {', '.join(names)}")
    return tuple(known[name] for name in names)


def fit(
    problem: FitProblem,
    starts: int = 1,
    say: Callable[[str], None] = print,
    tell: Callable[[str], object] = untold,
) -> FitResult:
    """Best of the fits from the parameters' start values and from `starts` - 1 further starts.

    The further starts scatter about the first, with a random generator of fixed seed. `say` takes
    a line on each start, and on the best if any was stopped, `tell` one on each trial. Raises
    FitError where every start fails.
    """
    rng = np.random.default_rng(0)
    first = problem.coordinates([p.start for p in problem.parameters])
    best, reason, stopped = None, "", 0
    for k in range(starts):
        name = f"start {k + 1} of {starts}"
        shift = SCATTER * rng.uniform(-1.0, 1.0, len(first)) if k else 0.0
        start = np.clip(first + shift, *problem.bounds())
        try:
            found = _fit_from(problem, start, name, tell)
        except FitError as error:
            reason = str(error)
            say(f"{name}: {error}")
            continue
        end = (
            "converged" if found.converged else f"stopped after {TRIALS} trials"
        )
        say(f"{name}: sum of squares {found.chi_square:.6g}, {end}")
        stopped += not found.converged
        if best is None or found.chi_square < best.chi_square:
            best = found
    if best is None:
        raise FitError(reason)
    if stopped:
        say(BEST_CONVERGED if best.converged else BEST_STOPPED)
    return best


def _fit_from(
    problem: FitProblem, start: Array, name: str, tell: Callable[[str], object]
) -> FitResult:
    """Fit from coordinates `start`; raises FitError where prediction or derivative fails.

    name: of the start, for `tell`, which takes a line on each trial.
    """
    numbers = itertools.count(1)
    try:
        problem.residuals(start)
    except PredictionError as error:
        raise FitError(f"no prediction at the start: {error}") from None

    def residuals(u: Array) -> Array:
        tell(f"{name}, trial {next(numbers)} of at most {TRIALS}")
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
    u = np.where(
        end.x - low < EDGE, low, np.where(high - end.x < EDGE, high, end.x)
    )
    return FitResult(problem.allowed(u), float(2 * end.cost), bool(end.status))


def estimate(
    problem: FitProblem,
    values: Sequence[float] | Array,
    groups: NDArray[np.intp] | None = None,
) -> ParameterEstimate:
    """Intervals and correlation at given values (p,); raises PredictionError, FitError.

    groups: (n,) number of the group of each residual; by default each is a group.
    """
    u, (low, high) = problem.coordinates(values), problem.bounds()
    residual, jacobian = problem.residuals(u), problem.jacobian(u)
    length = np.linalg.norm(jacobian, axis=0)
    length[length == 0.0] = 1.0
    scaled = jacobian / length
    left, singular, directions = np.linalg.svd(
        scaled, full_matrices=len(residual) < len(u)
    )
    singular = np.append(singular, np.zeros(len(u) - len(singular)))
    significant = singular > RANK * singular[0]
    chi_square, rank = float(residual @ residual), int(significant.sum())
    determined = np.all(np.abs(directions[~significant]) < NULL_SHARE, axis=0)
    inverse = (
        directions[significant].T / singular[significant] / length[:, None]
    )
    if groups is None:
        freedom = len(residual) - rank
        covariance = inverse @ inverse.T * (chi_square / max(freedom, 1))
    else:
        # (p, n), by each residual
        moved = inverse @ (left[:, : len(u)].T[significant] * residual)
        sums = np.array(
            [moved[:, groups == k].sum(axis=1) for k in np.unique(groups)]
        )
        freedom = max(len(sums) - rank, 0)
        covariance = sums.T @ sums * (len(sums) / max(freedom, 1))
    deviation = np.where(determined, np.sqrt(np.diag(covariance)), np.nan)
    width = deviation * (
        student.ppf((1 + LEVEL) / 2, freedom) if freedom else np.nan
    )
    # NaN where an interval contains both bounds: the data say nothing there
    width[(u - width <= low) & (u + width >= high)] = np.nan
    with np.errstate(over="ignore"):  # overflow gives infinity
        ends = [problem.values(u - width), problem.values(u + width)]
    return ParameterEstimate(
        values=problem.allowed(u),
        predicted=problem.measured + residual * problem.sigma,
        chi_square=chi_square,
        freedom=freedom,
        interval=np.column_stack(ends),
        correlation=covariance / np.outer(deviation, deviation),
        condition=float(singular[0] / singular[-1])
        if significant.all()
        else math.inf,
        at_limit=(u - low < STEP) | (high - u < STEP),
    )

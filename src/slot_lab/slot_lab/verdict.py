"""Verdict of a comparison: whether its residuals are as large as the uncertainty of the data.

With the residuals r_i over their standard uncertainty and f degrees of freedom, chi^2 = sum r_i^2
is about f if the model explains the data. It counts as explained where

    chi^2 / f <= max(LARGEST, q / f),   q the CONFIDENCE quantile of the chi-square distribution,

so that errors of a model that are smaller than the uncertainty are no objection where there are
many data, nor chance where there are few. A parameter at its bound is never explained.
"""

from collections.abc import Sequence
from dataclasses import dataclass

LARGEST = 2.0  # residuals 1.4 times as large as the uncertainty
CONFIDENCE = 0.99
EXPLAINED, NOT_EXPLAINED = 0, 1  # exit codes
EXIT_CODES = """\
The last line is the verdict: explained, or not explained, by the sum of squares of the residuals
over their uncertainty, per degree of freedom. Exit code: 0 explained, 1 not explained, 2 unusable
input.
"""


@dataclass(frozen=True)
class Verdict:
    """Sum of squares of the residuals over their uncertainty, and parameters at a bound."""

    chi_square: float
    freedom: int
    at_bound: Sequence[str] = ()
    largest: str = ""  # which residuals are the largest

    @property
    def limit(self) -> float:
        """Largest sum of squares per degree of freedom that counts as explained."""
        from scipy.stats import chi2  # noqa: PLC0415 - half a second

        return max(
            LARGEST, float(chi2.ppf(CONFIDENCE, self.freedom)) / self.freedom
        )

    @property
    def code(self) -> int:
        """Exit code."""
        fits = self.freedom > 0 and self.chi_square <= self.limit * self.freedom
        return EXPLAINED if fits and not self.at_bound else NOT_EXPLAINED

    @property
    def line(self) -> str:
        """The verdict in a line."""
        word = "explained" if self.code == EXPLAINED else "not explained"
        if self.freedom <= 0:
            return f"verdict: {word}: no more data than free parameters"
        ratio = self.chi_square / self.freedom
        parts = [
            f"verdict: {word}: chi-square {self.chi_square:.3g} on {self.freedom} degrees of"
            f" freedom, {ratio:.3g} each, limit {self.limit:.3g}",
            self.largest,
            f"at its bound: {', '.join(self.at_bound)}"
            if self.at_bound
            else "",
        ]
        return "; ".join(filter(None, parts))

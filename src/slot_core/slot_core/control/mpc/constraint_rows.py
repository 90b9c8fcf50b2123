"""The constraints of a `HorizonQp` as one matrix, for solvers that want them so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.control.mpc.model import HorizonQp
from slot_core.robot import Array


class ConstraintRows:
    """C of [A; G; one row per variable with a bound], refreshed in place.

    A variable has a bound if it has one when this is made.
    """

    def __init__(self, qp: HorizonQp, signs: tuple[int, ...] = (1,)):
        """signs: one row per bounded side and sign; (1,) for two-sided rows, (-1, 1) for z <= b."""
        self._qp = qp
        lower, upper = np.isfinite(qp.lower.ravel()), np.isfinite(qp.upper.ravel())
        sides = (lower, upper) if len(signs) == 2 else (lower | upper,)
        self.bounded = tuple(np.flatnonzero(side) for side in sides)
        unit = sparse.eye(len(lower), format="csr")
        bounds = [sign * unit[rows] for sign, rows in zip(signs, self.bounded)]
        self.matrix = sparse.vstack([qp.A, qp.G, *bounds], format="csc")
        self._slots = _slots(self.matrix, qp)

    def refresh(self) -> Array:
        """The entries of `matrix`, with those of A and G as they stand."""
        to_a, to_g = self._slots
        self.matrix.data[to_a] = self._qp.A.data
        self.matrix.data[to_g] = self._qp.G.data
        return self.matrix.data


def _slots(matrix: sparse.csc_matrix, qp: HorizonQp) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where the entries of A and of G stand in `matrix`, column by column in order."""
    equalities, inequalities = qp.A.shape[0], qp.A.shape[0] + qp.G.shape[0]
    rows = matrix.indices
    to_a = np.flatnonzero(rows < equalities)
    to_g = np.flatnonzero((rows >= equalities) & (rows < inequalities))
    assert len(to_a) == qp.A.nnz
    assert len(to_g) == qp.G.nnz
    return to_a, to_g

"""Constraints of a `HorizonQp` as one matrix, for solvers with a single constraint matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from slot_core.mpc.model import HorizonQp
from slot_core.robot import Array


class ConstraintRows:
    """Constraint matrix C = [A; G; one row per bounded variable], updated in place.

    The set of bounded variables is that at construction.
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
        """Update `matrix` to the present A and G; returns its entries."""
        a_entries, g_entries = self._slots
        self.matrix.data[a_entries] = self._qp.A.data
        self.matrix.data[g_entries] = self._qp.G.data
        return self.matrix.data


def _slots(matrix: sparse.csc_matrix, qp: HorizonQp) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the entries of A and of G in `matrix.data`, in column order."""
    equalities, inequalities = qp.A.shape[0], qp.A.shape[0] + qp.G.shape[0]
    rows = matrix.indices
    a_entries = np.flatnonzero(rows < equalities)
    g_entries = np.flatnonzero((rows >= equalities) & (rows < inequalities))
    assert len(a_entries) == qp.A.nnz
    assert len(g_entries) == qp.G.nnz
    return a_entries, g_entries

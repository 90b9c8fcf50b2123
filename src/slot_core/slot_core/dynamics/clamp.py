"""The clamp of a leg: the remainder of the leg's equations there, and its part of the torso's.

F (7 x 8) is the quadratic form over the six displacements of the clamp, the change lambda of the
tendon's tension, and the gradient. A taut tendon adds
lambda dl - lambda^2 / (2 kappa), with kappa = k + c / (theta h), in place of its full matrix
kappa grad l grad l^T.
"""

# mypy: disable-error-code="no-untyped-def"

from slot_core.compiled import helper
from slot_core.dynamics.lanes import like, total, where


@helper
def couple(tendon, leg, inv):
    """Eliminate lambda; writes leg.reduced, the form over the displacements of the clamp."""
    F, release, reduced = leg.form, leg.release, leg.reduced
    taut = tendon.stiffness + tendon.damping * inv
    stiffness = where(leg.pull[0] > 0.0, like(taut, F[6, 6]), like(0.0, F[6, 6]))
    factor = stiffness / (1.0 - stiffness * F[6, 6])
    for c in range(6):
        release[c] = factor * F[6, c]
    release[6] = factor * F[6, 7]
    for r in range(6):
        for c in range(6):
            reduced[r, c] = F[r, c] + F[r, 6] * release[c]
        reduced[r, 6] = F[r, 7] + F[r, 6] * release[6]


@helper
def add_to_torso(leg, matrix, vector):
    """Add a leg's form, mapped by leg.clamp, to the torso's system; in lanes, of all legs."""
    reduced, half, L = leg.reduced, leg.product, leg.clamp
    for r in range(6):
        for c in range(6):
            value = reduced[r, 0] * L[0, c]
            for k in range(1, 6):
                value += reduced[r, k] * L[k, c]
            half[r, c] = value
    for r in range(6):
        value = L[0, r] * reduced[0, 6]
        for k in range(1, 6):
            value += L[k, r] * reduced[k, 6]
        vector[r] += total(value)
        for c in range(r + 1):
            value = L[0, r] * half[0, c]
            for k in range(1, 6):
                value += L[k, r] * half[k, c]
            value = total(value)
            matrix[r, c] += value
            if c < r:
                matrix[c, r] += value

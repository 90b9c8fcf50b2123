"""Time integration scheme, state and energies of a rod in motion."""

from dataclasses import dataclass

from slot_core.arrays import Array
from slot_core.rod.model import RodError


@dataclass(frozen=True)
class Scheme:
    """Theta time integration: forces are evaluated at t + theta h.

    theta = 1/2 is the implicit midpoint rule. It is of second order and conserves linear and
    angular momentum up to `tolerance`. It does not conserve energy: where the step resolves the
    motion, the energy oscillates about its initial value. Above 1/2 the scheme is of first order
    and damps motion that the step does not resolve.

    Raises RodError for theta outside of 0.5 .. 1, fewer than one iteration, a tolerance below 0.
    """

    theta: float = 0.5
    iterations: int = 20  # of Newton's method, at most
    tolerance: float = 1e-9  # of Newton's last increment, in rad and rod lengths

    def __post_init__(self) -> None:
        if not 0.5 <= self.theta <= 1.0:
            raise RodError(f"theta {self.theta} must be within 0.5 .. 1")
        if self.iterations < 1:
            raise RodError(f"iterations {self.iterations} must be at least 1")
        if not self.tolerance >= 0.0:
            raise RodError(f"tolerance {self.tolerance} must not be below 0")


MIDPOINT = Scheme()


@dataclass(frozen=True)
class RodState:
    """State of a rod of N nodes.

    The directors are unit vectors normal to their segments, against the width. The swirl is the
    angular momentum of each segment about itself over its polar moment of inertia: its spin times
    its direction. The columns of an end's axes are its section's tangent, width and normal.
    """

    position: Array  # (N, 3) m
    director: Array  # (N-1, 3)
    velocity: Array  # (N, 3) m/s
    swirl: Array  # (N-1, 3) rad/s
    ends: Array  # (2, 3, 3) axes of the sections at base and tip


@dataclass(frozen=True)
class Energy:
    """Energies, J. The potential of gravity and dead forces is zero at the origin."""

    kinetic: float
    elastic: float
    potential: float

    @property
    def total(self) -> float:
        """Sum of the three, J."""
        return self.kinetic + self.elastic + self.potential

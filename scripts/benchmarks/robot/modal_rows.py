"""Accuracy and cost of the modal leg, against exact equilibria of the same rod.

The exact rod is integrated from the clamp. Newton's method finds the moment at the clamp, the
cable's extension, and the clamp's height or the force on it.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numba
import numpy as np
from scipy.linalg import eigh

from benchmarks.harness import cpu_time
from benchmarks.rod import exact
from slot_core.dynamics.rod import discretise
from slot_core.legs.leg_map import StaticLeg
from slot_core.legs.modal import ModalLeg
from slot_core.legs.modal_basis import Contact, Modes, tip_contact
from slot_core.robot import GRAVITY, Array, Robot, read_robot

STEPS = 300  # of the integration along the whole leg, at least
NEWTON = 30  # iterations, at most
PROBE = 1e-7  # step of the finite differences, over the scale of an unknown
SCALE = np.array([1.0, 1e-3, 1.0])  # N m, m, and m or N
CONVERGED = 1e-10  # change over scale

TABLE = (  # for each number of unknowns the best split, with contact at the tip
    Modes((2, 3), (1, 0)),
    Modes((3, 3), (2, 0)),
    Modes((3, 4), (1, 2)),
    Modes((4, 4), (2, 2)),
    Modes((5, 5), (3, 3)),
    Modes((6, 6), (4, 4)),
)
FINE = Modes((14, 14), (8, 8))
CHAIN_NODES = 22
ANGLES_DEG = {"tip": np.arange(0.0, 106.0, 7.5), "nodes": np.arange(30.0, 106.0, 7.5)}
FREQUENCIES = exact.FREQUENCIES["leg"]  # Hz, of `straight`
APPROACH = 40  # load steps of the chain, to the height and to the tendon angle


@dataclass(frozen=True)
class Exact:
    """Equilibria of the rod's differential equations by shooting, for n angles at once.

    With the force (0, V) and the moment M that the part beyond s, tendon included, exerts:

        r' = (1 + eps) t,     M' = -(1 + eps) V t_x,     V' = g dm/ds,
        EA eps = V t_z - T,   phi' = phi_0' + (M - T d) / EI    (T up to the anchor alone),

    by fourth-order Runge-Kutta. V drops by the floor's force at each contact point; V and M are
    zero at the tip. Raises RuntimeError if Newton's method does not converge.
    """

    robot: Robot
    contact: Contact

    @cached_property
    def _length(self) -> float:
        return self.robot.leg.arc_length()

    @cached_property
    def _shape(self) -> tuple[Array, Array]:
        """Coefficients of the natural shape's first and second derivative, highest power first."""
        shape = self.robot.leg.shape
        first, second = (shape.deriv(k).convert().coef[::-1] for k in (1, 2))
        return first, second

    def stand(self, angle: Array, load: float, guess: Array) -> Array:
        """(n,) m, heights of the clamp for angles (n,) rad, from guesses (n, 3) of the unknowns.

        The unknowns: moment at the clamp, N m; extension of the cable, m; height, m.
        """
        return self._newton(lambda u: self._ends(angle, u, u[2], np.full(len(angle), load)), guess)

    def solve(self, angle: Array, height: Array, guess: Array) -> Array:
        """(n,) N, forces of the floor for angles (n,) rad and heights (n,) m.

        The third unknown is that force, N.
        """
        return self._newton(lambda u: self._ends(angle, u, height, u[2]), guess)

    def _newton(self, residual: Callable[[Array], Array], guess: Array) -> Array:
        u = guess.T.copy()
        for _ in range(NEWTON):
            at = residual(u)
            columns = []
            for k in range(3):
                moved = u.copy()
                moved[k] += PROBE * SCALE[k]
                columns.append((residual(moved) - at) / (PROBE * SCALE[k]))
            jacobian = np.stack(columns).transpose(2, 1, 0)
            change = np.linalg.solve(jacobian, at.T[..., None])[..., 0].T
            u -= change
            if np.abs(change / SCALE[:, None]).max() < CONVERGED:
                return u[2]
        raise RuntimeError(f"shooting: the unknowns still move by {np.abs(change).max():.1e}")

    def _ends(self, angle: Array, u: Array, height: Array, force: Array) -> Array:
        """(3, n) residuals of V and M at the tip and of the cable's law."""
        tendon, leg = self.robot.tendon, self.robot.leg
        length = self._length
        anchor = tendon.end_fraction * length
        places = sorted({anchor, length, *(f * length for f in self.contact.fraction)})
        points = {f * length: k for f, k in zip(self.contact.fraction, self.contact.stiffness)}
        tension = tendon.cable_stiffness * np.maximum(0.0, u[1])
        zero = np.zeros(len(angle))
        y = np.array([zero, zero, zero, u[0], force - leg.mass * GRAVITY, zero, zero])
        y[2] = np.arctan(leg.shape.deriv()(0.0))
        begin, short = 0.0, zero
        for end in places:
            pull = tension if end <= anchor else zero
            y = self._integrate(y, begin, end, pull)
            if end in points:
                y[4] = y[4] - points[end] * np.maximum(0.0, -height - y[1])
            if end == anchor:
                natural = np.arctan(leg.shape.deriv()(y[6]))
                short = y[5] + tendon.offset * (y[2] - natural)
            begin = end
        law = u[1] - (short - tendon.slack + tendon.spool_radius * angle)
        return np.array([y[4], y[3], law])

    def _integrate(self, y: Array, begin: float, end: float, pull: Array) -> Array:
        steps = math.ceil(STEPS * (end - begin) / self._length)
        h = (end - begin) / steps
        for i in range(steps):
            s = begin + i * h
            a = self._slope(s, y, pull)
            b = self._slope(s + h / 2, y + h / 2 * a, pull)
            c = self._slope(s + h / 2, y + h / 2 * b, pull)
            d = self._slope(s + h, y + h * c, pull)
            y = y + h / 6 * (a + 2 * b + 2 * c + d)
        return y

    def _slope(self, s: float, y: Array, pull: Array) -> Array:
        """(7, n) dy/ds of y = (x, z, phi, M, V, extension so far, x of the natural shape)."""
        leg = self.robot.leg
        thickness = leg.thickness_clamp + (leg.thickness_tip - leg.thickness_clamp) * (
            s / self._length
        )
        axial = leg.young_modulus * leg.width * thickness
        first, second = self._shape
        ds = np.hypot(1.0, np.polyval(first, y[6]))
        natural = np.polyval(second, y[6]) / ds**3
        cos, sin = np.cos(y[2]), np.sin(y[2])
        eps = (y[4] * sin - pull) / axial
        turn = natural + (y[3] - pull * self.robot.tendon.offset) / (axial * thickness**2 / 12)
        weight = leg.density * leg.width * thickness * GRAVITY
        x, z = (1 + eps) * cos, (1 + eps) * sin
        return np.array([x, z, turn, -y[4] * x, np.full(len(x), weight), eps, 1 / ds])


def guess(leg: ModalLeg, third: float) -> list[float]:
    """Unknowns of `Exact` at a modal leg's last equilibrium; `third`: height (m) or force (N)."""
    moment, extension = leg.clamp_moment(), leg.cable_extension()
    return [moment, extension, third]


def contacts() -> dict[str, Contact]:
    """Contact at the tip alone, and at the simulator's nodes; stiffness of the scene."""
    model = StaticLeg(read_robot(), CHAIN_NODES).model
    points, stiffness = model.rod.arc[1:] / model.rod.arc[-1], model.floor.stiffness[1:]
    nodes = Contact(tuple(points), tuple(stiffness))
    return {"tip": tip_contact(stiffness[-1]), "nodes": nodes}


def exact_heights(robot: Robot, contact: Contact, angles: Array) -> Array:
    """(n,) m, clamp heights at which the leg carries a quarter of the robot's weight.

    The initial guess is the modal leg with FINE modes.
    """
    leg, load = ModalLeg(robot, contact, FINE), robot.weight / 4
    start = [guess(leg, leg.stand(angle, load).height) for angle in angles]
    return Exact(robot, contact).stand(angles, load, np.array(start))


def modal_rows(repeats: int = 5) -> Iterator[dict[str, Any]]:
    """Largest error of the standing leg's height over the tendon angles, mm, and CPU time.

    The CPU time is the mean over all angles, including the load steps to the first one.
    """
    robot = read_robot()
    for name, contact in contacts().items():
        angles = np.radians(ANGLES_DEG[name])
        heights = exact_heights(robot, contact, angles)
        for modes in TABLE:
            leg = ModalLeg(robot, contact, modes)
            error = np.abs(_heights(leg, robot, angles) - heights)
            cpu = cpu_time(partial(_heights, leg, robot, angles), repeats).median
            yield {
                "kind": "modal",
                "contact": name,
                "modes": [*modes.moment, *modes.axial],
                "unknowns": modes.unknowns,
                "error_mm": 1e3 * error.max(),
                "cpu_ms": 1e3 * cpu / len(angles),
            }
        if name == "nodes":
            yield chain_row(robot, angles, heights)


def _heights(leg: ModalLeg, robot: Robot, angles: Array) -> Array:
    leg.reset()
    return np.array([leg.stand(angle, robot.weight / 4).height for angle in angles])


def chain_row(robot: Robot, angles: Array, heights: Array) -> dict[str, Any]:
    """The simulator's chain at the exact heights: error of its force over its stiffness."""
    errors = []
    for angle, height in zip(angles, heights):
        leg = StaticLeg(robot, CHAIN_NODES)
        for z in np.linspace(2 * robot.leg.reach, height, APPROACH):
            leg.solve(0.0, z)
        for part in np.linspace(0.0, angle, APPROACH):
            end = leg.solve(part, height)
        errors.append((end.force - robot.weight / 4) / end.stiffness)
    return {
        "kind": "modal",
        "contact": "nodes",
        "chain": CHAIN_NODES,
        "unknowns": 2 * (CHAIN_NODES - 1),
        "error_mm": 1e3 * np.abs(errors).max(),
    }


def straight(robot: Robot) -> Robot:
    """The robot with a straight leg of 10 MPa, whose frequencies are `FREQUENCIES`."""
    leg = dataclasses.replace(robot.leg, natural_shape=(0.0, 0.0, 0.0, 0.0), young_modulus=1e7)
    return dataclasses.replace(robot, leg=leg)


def dynamics_rows(repeats: int = 9) -> Iterator[dict[str, Any]]:
    """Frequencies of modes and chain, and the cost of the modes' dense algebra in each step."""
    robot = straight(read_robot())
    for modes in TABLE:
        leg = ModalLeg(robot, contacts()["tip"], modes)
        yield _frequency_row({"unknowns": modes.unknowns}, leg.frequencies())
    for nodes in (CHAIN_NODES, 31, 61):
        yield _frequency_row({"chain": nodes, "unknowns": 2 * (nodes - 1)}, chain(robot, nodes))
    leg = ModalLeg(robot, contacts()["tip"])
    n, points = leg.modes.unknowns, len(leg.basis.arc)
    moves, added = np.random.default_rng(0).random((2 * points, n)), np.eye(n)
    matrix = np.empty((n, n))
    seconds = cpu_time(lambda: dense(1000, moves, added, matrix), repeats).median / 1000
    yield {"kind": "modal step", "unknowns": n, "us_four_legs_two_iterations": 8e6 * seconds}


def _frequency_row(what: dict[str, Any], hertz: Array) -> dict[str, Any]:
    percent = 100 * np.abs(hertz[:3] / FREQUENCIES - 1)
    return {"kind": "modal frequency", **what, "percent": percent, "highest_Hz": hertz[-1]}


def chain(robot: Robot, nodes: int) -> Array:
    """(2 N - 2,) natural frequencies of the simulator's clamped chain, Hz."""
    rod, n = discretise(robot.leg, nodes, robot.tendon.end_fraction), nodes - 1
    along, turned = np.zeros((n, nodes, 2)), np.zeros((n + 1, nodes, 2))
    for i, chord in enumerate(np.diff(rod.node, axis=0)):
        tangent = chord / np.hypot(*chord)
        normal = np.array([-tangent[1], tangent[0]]) / np.hypot(*chord)
        along[i, i], along[i, i + 1] = -tangent, tangent
        turned[i + 1, i], turned[i + 1, i + 1] = -normal, normal
    strain = np.concatenate([along, np.diff(turned, axis=0)])[:, 1:].reshape(2 * n, 2 * n)
    stiffness = (np.concatenate([rod.axial, rod.bending]) * strain.T) @ strain
    mass = np.diag(np.repeat(rod.mass[1:], 2))
    hertz: Array = np.sqrt(eigh(stiffness, mass, eigvals_only=True)) / (2 * math.pi)
    return hertz


@numba.njit(fastmath={"contract", "reassoc", "nsz"})  # type: ignore[misc]
def dense(repeats: int, moves: Array, added: Array, matrix: Array) -> None:
    """J^T J and its Cholesky factor: the minimum work of one iteration of one leg."""
    n = matrix.shape[0]
    for _ in range(repeats):
        matrix[:] = added + np.dot(moves.T, moves)
        for j in range(n):
            for k in range(j):
                for i in range(j, n):
                    matrix[i, j] -= matrix[i, k] * matrix[j, k]
            scale = 1.0 / math.sqrt(matrix[j, j])
            for i in range(j, n):
                matrix[i, j] *= scale

"""PyElastica's rod as a peer: staggered nodes and elements, shear, explicit steps, no damping.

Stiffness, mass and inertia are the tapered leg's, with the shear coefficient 5/6.

The clamp as documented fixes the first node and the directors of the first element. The directors
are half an element further along, so the rod is held at the middle of its first element. With the
clamp moved, the rod begins half an element behind it, so that it is held at the clamp.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import elastica
import numpy as np
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from benchmarks.harness import timed
from benchmarks.rod.release import (
    DURATION,
    LEG,
    PUSH,
    SAMPLES,
    TPU,
    UNDAMPED,
    percent,
    release_row,
)
from slot_core.arrays import Array
from slot_core.rod.model import Scheme

# elements, for its own converged motion, by `quick`
FINE = {True: (30, 60), False: (60, 120)}
SHEAR_FACTOR = 5 / 6

FIRST_STEP = 6e-5  # s; unstable with every number of elements
STEP_RATIO = 0.93  # from one step tried to the next
SAMPLE = DURATION / SAMPLES  # s
FIRST_NODE, FIRST_ELEMENT = (0,), (0,)


class Simulator(elastica.BaseSystemCollection, elastica.Constraints):  # type: ignore[misc]
    """PyElastica's system of a rod and its clamp."""


@dataclass(frozen=True)
class Cells:
    """Arc lengths of the leg's elements; s = 0 is the clamp."""

    elements: int
    moved: bool

    @property
    def size(self) -> float:
        """Length of an element, m."""
        return LEG.length / (self.elements - 0.5 * self.moved)

    @property
    def edges(self) -> Array:
        """(elements + 1,) arc length of the nodes, m."""
        return LEG.length - self.size * np.arange(self.elements, -1, -1.0)

    @property
    def middles(self) -> Array:
        """(elements,) arc length of the elements' middles, m."""
        return (self.edges[1:] + self.edges[:-1]) / 2


def rows(quick: bool, elements: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """The release test at the largest stable step, over the number of elements and both clamps."""
    few, many = (release(Cells(count, moved=True))[0] for count in FINE[quick])
    exact = (4 * many - few) / 3  # second order
    for count, moved in itertools.product(elements, (False, True)):
        tip, start, h, cost = release(Cells(count, moved))
        yield release_row(
            f"PyElastica, clamp {'moved' if moved else 'as documented'}",
            UNDAMPED,
            count + 1,
            h=h,
            percent=percent(tip, exact, start),
            cpu_s=cost,
            version=version("pyelastica"),
        )


def release(cells: Cells) -> tuple[Array, Array, float, float]:
    """Tip (SAMPLES, 3), m; its start (3,), m; largest stable step, s; CPU s per simulated s."""
    run(cells, FIRST_STEP, 1)  # compiles
    h = FIRST_STEP
    while True:
        substeps = math.ceil(SAMPLE / h)
        (tip, start), seconds = timed(run, cells, SAMPLE / substeps, SAMPLES)
        if np.isfinite(tip).all():
            return tip, start, SAMPLE / substeps, seconds / DURATION
        h *= STEP_RATIO


def run(cells: Cells, h: float, samples: int) -> tuple[Array, Array]:
    """Tip (samples, 3) of the released rod, NaN once it diverges, and its start (3,); m."""
    rod = bent_rod(cells)
    start = rod.position_collection[:, -1].copy()
    simulator, stepper, now = Simulator(), elastica.PositionVerlet(), 0.0
    simulator.append(rod)
    simulator.constrain(rod).using(
        elastica.OneEndFixedBC,
        constrained_position_idx=FIRST_NODE,
        constrained_director_idx=FIRST_ELEMENT,
    )
    simulator.finalize()
    tip = np.full((samples, 3), math.nan)
    for sample in tip:
        for _ in range(round(SAMPLE / h)):
            now = stepper.step(simulator, now, h)
        here = rod.position_collection[:, -1]
        if not np.abs(here).max() < 2 * LEG.length:
            break
        sample[:] = here
    return tip, start


def bent_rod(cells: Cells) -> Any:
    """The rod in its equilibrium under PUSH; CosseratRod's equilibrium is the initial guess."""
    rod, n = straight_rod(cells), cells.elements
    place, axes = guess(cells)

    def assign(unknowns: Array) -> None:
        rod.position_collection[:, 1:] = unknowns[: 3 * n].reshape(3, n)
        turned = (
            axes
            @ Rotation.from_rotvec(
                unknowns[3 * n :].reshape(n - 1, 3)
            ).as_matrix()
        )
        rod.director_collection[..., 1:] = np.moveaxis(
            turned[:, :, [1, 2, 0]], (0, 2), (2, 0)
        )

    def imbalance(unknowns: Array) -> Array:
        assign(unknowns)
        rod.compute_internal_forces_and_torques(0.0)
        force = rod.internal_forces[:, 1:].copy()
        force[:, -1] += PUSH.force
        return np.concatenate(
            [force.ravel(), rod.internal_torques[:, 1:].ravel() / cells.size]
        )

    start = np.concatenate([place.ravel(), np.zeros(3 * (n - 1))])
    unknowns, _, status, message = fsolve(
        imbalance, start, xtol=1e-10, full_output=True
    )
    if status != 1:
        raise ArithmeticError(f"no equilibrium of PyElastica's rod: {message}")
    assign(unknowns)
    return rod


def guess(cells: Cells) -> tuple[Array, Array]:
    """Nodes (3, n), m, and axes (n - 1, 3, 3), tangent, width, normal, of the free elements."""
    _, ours = UNDAMPED.leg(2 * cells.elements + 1, Scheme())
    s = np.linspace(0.0, LEG.length, len(ours.position))
    place = np.array(
        [np.interp(cells.edges[1:], s, part) for part in ours.position.T]
    )
    tangent = np.diff(ours.position, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    axes = np.stack(
        [tangent, -ours.director, np.cross(tangent, -ours.director)], axis=2
    )
    of_element = np.searchsorted(s, cells.middles[1:]) - 1
    return place, axes[of_element]


def straight_rod(cells: Cells) -> Any:
    """The straight leg; stiffness and mass are set here, as the constructor has circular sections.

    The axes of a section are y (width), z (thickness) and the tangent.
    """
    size, section = cells.size, LEG.section
    rod = elastica.CosseratRod.straight_rod(
        cells.elements,
        np.array([cells.edges[0], 0.0, 0.0]),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 1.0, 0.0]),
        base_length=cells.elements * size,
        base_radius=section.width / 2,
        density=TPU.density,
        youngs_modulus=TPU.young_modulus,
        shear_modulus=TPU.shear_modulus,
    )
    area, inner, outer, _ = sections(cells.middles)
    lateral = SHEAR_FACTOR * TPU.shear_modulus * area
    fill(rod.shear_matrix, lateral, lateral, TPU.young_modulus * area)
    _, bend, aside, torsion = sections(cells.edges[1:-1])
    fill(
        rod.bend_matrix,
        TPU.young_modulus * bend,
        TPU.young_modulus * aside,
        TPU.shear_modulus * torsion,
    )
    half = TPU.density * area * size / 2
    rod.mass[:] = np.append(half, 0.0) + np.append(0.0, half)
    inertia = [
        TPU.density * size * part for part in (inner, outer, inner + outer)
    ]
    fill(rod.mass_second_moment_of_inertia, *inertia)
    fill(rod.inv_mass_second_moment_of_inertia, *(1 / part for part in inertia))
    return rod


def sections(s: Array) -> tuple[Array, Array, Array, Array]:
    """Area, second moments and torsion constant at arc lengths s (m); constant behind the clamp."""
    return LEG.section.constants(np.clip(s / LEG.length, 0.0, 1.0))


def fill(matrices: Array, *diagonal: Array) -> None:
    """Set matrices (3, 3, m) to the given diagonals, each (m,)."""
    matrices[:] = 0.0
    for i, values in enumerate(diagonal):
        matrices[i, i] = values

"""Numbers of a discretised rod: the chain of the robot's legs, with a hinge at both ends.

Node 0 carries the hinge between the base's section and the first segment, node N - 1 that between
the last segment and the tip's section. Weights of the hinges and error are as
in `dynamics/rod.py`, of fourth order. An end's section has no mass.

The tip's section takes the place of a segment N - 1 of unit length, without axial stiffness, so
that the kernels of strains and hinges treat all hinges alike.
"""

from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array
from slot_core.dynamics.rod import Sections, links, weights
from slot_core.dynamics.spatial.refine import Refinement, tilts
from slot_core.rod.model import Geometry, Material, Support, need, numbers


class NoTendon(NamedTuple):
    """Derivatives of a tendon's length, zero at all hinges and segments: a rod has no tendon."""

    around: Array  # (N,)
    along: Array  # (N,)


class Mesh(NamedTuple):
    """A chain of N nodes and N - 1 segments.

    Arrays (N,) belong to the hinges, or to the segments and the tip's section; fields and units as
    in `dynamics.rod.Rod`.
    """

    natural: Array  # (N, 3) m, from the base's pose
    turn: float  # rad, natural angle of the tip
    mass: Array
    coupling: Array
    spin: Array
    rest_length: Array
    rest_angle: Array
    shortening: Array
    axial: Array
    bending: Array
    lateral: Array
    torsion: Array
    metric: Array  # (4 N + 7,) norm of the unknowns: masses, and of turns mass L^2 / 12
    held: Array  # (2, 6) bool, held components of position and rotation at base and tip
    none: NoTendon
    refinement: Refinement
    length: float  # m
    damping_time: float  # s


def build_mesh(  # noqa: PLR0917
    material: Material,
    geometry: Geometry,
    nodes: int,
    base: Support,
    tip: Support,
    refined: bool,
) -> Mesh:
    """Divide a rod into nodes - 1 segments of equal arc length; raises RodError below one.

    refined: with the correction of `dynamics/spatial/refine.py`.
    """
    need(nodes >= 2, f"nodes {nodes} must be at least 2")
    length, shape = geometry.length, geometry.natural_shape(nodes)
    arc = np.linspace(0.0, length, nodes)
    hinge = sections(material, geometry, arc)
    middle = sections(material, geometry, (arc[1:] + arc[:-1]) / 2)
    chain = links(shape[:, :2], arc, weights(np.diff(arc)), hinge, middle)
    last = shape[-1, 2] - np.sum(chain["rest_angle"])
    turning = chain["mass"] * length**2 / 12
    of_nodes = np.column_stack(
        [chain["mass"], chain["mass"], chain["mass"], turning]
    )
    return Mesh(
        natural=np.column_stack([shape[:, 0], np.zeros(nodes), shape[:, 1]]),
        turn=float(shape[-1, 2]),
        mass=chain["mass"],
        coupling=np.append(chain["coupling"], 0.0),
        spin=np.append(chain["spin"], 0.0),
        rest_length=np.append(chain["rest_length"], 1.0),
        rest_angle=np.append(chain["rest_angle"], last),
        shortening=np.append(chain["shortening"], 0.0),
        axial=np.append(chain["axial"], 0.0),
        bending=chain["bending"],
        lateral=chain["lateral"],
        torsion=chain["torsion"],
        # norm of the unknowns in the order of `assembly.py`
        metric=np.concatenate(
            [np.full(4, turning[0]), of_nodes.ravel(), np.full(3, turning[-1])]
        ),
        held=np.array([[*end.position, *end.rotation] for end in (base, tip)]),
        refinement=_refinement(geometry, arc, refined),
        none=NoTendon(np.zeros(nodes), np.zeros(nodes)),
        length=length,
        damping_time=material.damping_time,
    )


def sections(material: Material, geometry: Geometry, s: Array) -> Sections:
    """Sections at arc lengths s, m; raises RodError for values that are not above 0."""
    fraction, section = s / geometry.length, geometry.section

    def over(name: str) -> Array:
        values = numbers(name, getattr(section, name)(fraction), s.shape)
        need(
            bool((values > 0.0).all()), f"{name} of the section must be above 0"
        )
        return values

    area, inner, outer = map(over, ("area", "second_moment", "lateral_moment"))
    return Sections(
        axial=material.young_modulus * area,
        bending=material.young_modulus * inner,
        lateral=material.young_modulus * outer,
        torsion=material.shear_modulus * over("torsion_constant"),
        mass=material.density * area,
        spin=material.density * (inner + outer),
    )


def _refinement(geometry: Geometry, arc: Array, active: bool) -> Refinement:
    """Correction of the hinges at arc lengths (N,), m."""
    step, n = np.diff(arc), len(arc)
    curvature = np.array(geometry.curvature_at(arc))
    return Refinement(
        extent=weights(step),
        curvature=curvature,
        slope=np.gradient(curvature, arc),
        tilt=tilts(n) * step[0],
        step=float(step[0]),
        strain=np.zeros((n, 3)),
        moment=np.zeros((n, 3)),
        shift=np.zeros((n, 3)),
        delta=np.zeros((n, 3)),
        active=active,
    )

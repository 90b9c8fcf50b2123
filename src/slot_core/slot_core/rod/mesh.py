"""Numbers of a discretised rod: the chain of the robot's legs, with a hinge at both ends.

Node 0 carries the hinge between the base's section and the first segment, node N - 1 that between
the last segment and the tip's section. Weights of the hinges and error are as
in `dynamics/rod.py`, of fourth order. An end's section has no mass.

The tip's section takes the place of a segment N - 1 of unit length, without axial stiffness, so
that the kernels of strains and hinges treat all hinges alike.

State and scratch arrays of a rod, allocated once.

The frame of a segment has the rows t, d, b: its direction, its director across the width, and
t x d. That of an end's section has the same rows; t is its tangent, -d its width and -b its normal.
Row N of the nodes and row N - 1 of the segments stand for the tip's section (above).
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import (
    Array,
    Arrays,
    Shapes,
    named,
    one_buffer,
    zeros,
)
from slot_core.dynamics.rod import (
    Rod,
    Sections,
    TendonModel,
    links,
    lumped,
    weights,
)
from slot_core.dynamics.spatial.strain import (
    Refinement,
    segments,
    tilts,
)
from slot_core.rod.model import (
    Geometry,
    Material,
    Plane,
    RodTendon,
    Support,
    need,
    numbers,
)


class Cables(NamedTuple):
    """The m tendons of a rod at its hinges; components along d and b of a section's frame."""

    offset: Array  # (m, N, 2) m
    rise: Array  # (m, N, 2) m, slope of the offset along the rod times the hinge's weight
    along: Array  # (m, N) of a segment's extension that lengthens the tendon
    stiffness: Array  # (m,) N/m


class Walls(NamedTuple):
    """The planes that a rod can touch."""

    normal: Array  # (q, 3)
    level: Array  # (q,) m, normal component of the centre line's place where it touches
    stiffness: Array  # (q, N) N/m of the nodes
    damping: Array  # (q, N) N s/m
    friction: Array  # (q,)
    creep: Array  # (q,) m/s


class Mesh(NamedTuple):
    """A chain of N nodes and N - 1 segments."""

    rod: Rod  # its arrays (N-1,) with an entry for the tip's section, hinges at all nodes
    turn: float  # rad, natural angle of the tip
    metric: Array  # (4 N + 7,) norm of the unknowns: masses, and of turns mass L^2 / 12
    held: Array  # (2, 6) bool, held components of position and rotation at base and tip
    free: Array  # (4 N + 7,) 1 for the unknowns that exist and that no support holds, else 0
    fixed: NDArray[np.intp]  # the others
    none: TendonModel  # a leg's tendon that does nothing: a rod's tendons are `Cables`
    cables: Cables
    walls: Walls
    refinement: Refinement
    length: float  # m


def build_mesh(  # noqa: PLR0917
    material: Material,
    geometry: Geometry,
    nodes: int,
    base: Support,
    tip: Support,
    refined: bool,
    tendons: Sequence[RodTendon],
    planes: Sequence[Plane],
) -> Mesh:
    """Divide a rod into nodes - 1 segments of equal arc length; raises RodError below one.

    refined: with the correction of `dynamics/spatial/strain.py`.
    """
    need(nodes >= 2, f"nodes {nodes} must be at least 2")
    length, shape = geometry.length, geometry.natural_shape(nodes)
    arc = np.linspace(0.0, length, nodes)
    hinge = sections(material, geometry, arc)
    middle = sections(material, geometry, (arc[1:] + arc[:-1]) / 2)
    chain = links(shape[:, :2], arc, weights(np.diff(arc)), hinge, middle)
    ends = dict.fromkeys(("coupling", "spin", "shortening", "axial"), 0.0)
    ends["rest_length"] = 1.0
    ends["rest_angle"] = shape[-1, 2] - np.sum(chain["rest_angle"])
    chain |= {name: np.append(chain[name], end) for name, end in ends.items()}
    turning = chain["mass"] * length**2 / 12
    of_nodes = np.column_stack(
        [chain["mass"], chain["mass"], chain["mass"], turning]
    )
    held = np.array([[*end.position, *end.rotation] for end in (base, tip)])
    free = np.ones(4 * nodes + 7)
    free[[3, -4]] = 0.0
    free[[4, 5, 6, 0, 1, 2]], free[[-7, -6, -5, -3, -2, -1]] = 1.0 - held
    return Mesh(
        rod=Rod(
            node=shape[:, :2],
            arc=arc,
            **chain,
            anchor=nodes - 1,
            anchor_share=1.0,
            damping_time=material.damping_time,
            relaxation=np.zeros((2, 2)),
        ),
        turn=float(shape[-1, 2]),
        # norm of the unknowns in the order of `elimination.py`
        metric=np.concatenate(
            [np.full(4, turning[0]), of_nodes.ravel(), np.full(3, turning[-1])]
        ),
        held=held,
        free=free,
        fixed=np.flatnonzero(free == 0.0),
        none=TendonModel(np.zeros(nodes), np.zeros(nodes), 0.0, 0.0, 0.0, 0.0),
        cables=_cables(tendons, arc),
        walls=_walls(planes, arc),
        refinement=_refinement(geometry, arc, refined),
        length=length,
    )


def sections(material: Material, geometry: Geometry, s: Array) -> Sections:
    """Sections at arc lengths s, m; raises RodError for values that are not above 0."""
    parts = geometry.section.constants(s / geometry.length)
    area, inner, outer, torsion = (
        numbers("section", part, s.shape) for part in parts
    )
    above = min(area.min(), inner.min(), outer.min(), torsion.min()) > 0.0
    need(above, "area and moments of the section must be above 0")
    return Sections(
        axial=material.young_modulus * area,
        bending=material.young_modulus * inner,
        lateral=material.young_modulus * outer,
        torsion=material.shear_modulus * torsion,
        mass=material.density * area,
        spin=material.density * (inner + outer),
    )


def _cables(tendons: Sequence[RodTendon], arc: Array) -> Cables:
    """Tendons at hinges at arc lengths (N,), m; raises RodError for an offset of another shape."""
    n, step = len(arc), np.diff(arc)
    offset = np.zeros((len(tendons), n, 2))
    for own, tendon in zip(offset, tendons):
        given = np.shape(tendon.offset)
        need(
            given in {(2,), (n, 2)},
            f"offset of shape {given} must be of shape (2,) or ({n}, 2)",
        )
        own[:] = -numbers("offset", tendon.offset, (n, 2))
    order: Literal[1, 2] = 2 if n > 2 else 1
    rate: Any = np.gradient(offset, arc, axis=1, edge_order=order)
    rise = rate * weights(step)[:, None]
    slope = np.diff(offset, axis=1, append=0.0) / step[0]
    along = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=2))
    along[:, -1] = 0.0  # of the tip's section
    stiffness = np.array([tendon.stiffness for tendon in tendons], dtype=float)
    return Cables(offset, rise, along, stiffness)


def _walls(planes: Sequence[Plane], arc: Array) -> Walls:
    """Planes beside nodes at arc lengths (N,), m."""

    def each(name: str) -> Array:
        return np.array([getattr(plane, name) for plane in planes], dtype=float)

    normal = each("normal").reshape(-1, 3)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    extent = lumped(np.ones(len(arc)), np.diff(arc))
    point = each("point").reshape(-1, 3)
    return Walls(
        normal=normal,
        level=(normal * point).sum(axis=1) + each("radius"),
        stiffness=np.outer(each("stiffness"), extent),
        damping=np.outer(each("damping"), extent),
        friction=each("friction"),
        creep=each("creep"),
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


def posture_shapes(n: int) -> Shapes:
    """The iterate of statics, and the stage of a step, of a rod of n nodes."""
    return {
        "stage": (n + 1, 3),  # m
        # directions from which the directors `from_director` are carried on
        "begin": (n, 3),
        "from_director": (n, 3),
        "stage_frame": (2, 3, 3),
        "tension": (n,),  # N, independent axial force of the tangent
    }


def work_shapes(n: int, m: int) -> Shapes:
    """State, iterate and factorised tangent of a rod of n nodes and m tendons."""
    return {
        "node": (n + 1, 3),  # m
        "velocity": (n + 1, 3),  # m/s
        "director": (n, 3),
        # rad/s, angular momentum about the segments over their polar inertia
        "swirl": (n, 3),
        "frame": (2, 3, 3),  # of the base's and the tip's section
        "turning": (2, 3),  # rad/s, their angular velocity in the last stage
        "driven": (2, 3),  # m/s, their nodes' velocity in the last stage
        "speed": (n + 1, 3),  # m/s, V
        "before": (n + 1, 3),  # m/s, velocity at the start of the step
        "spin": (n,),  # rad/s, Omega
        # rad/s, angular velocity of the ends' sections at the stage
        "rate": (2, 3),
        # of the first and the last segment at the stage
        "stage_director": (2, 3),
        # N m, of the hinges, with the independent axial force
        "moment": (n, 3),
        "residual": (n, 3),  # N m, the same with the axial force of the strains
        "normal": (n,),  # N, axial force of the strains
        "stretch": (n, 8),  # derivative of l - c over (s, w) before, behind
        # tangent | -gradient of a hinge over (s, w) before, behind
        "along": (11,),  # the same over the unknowns of a hinge, scratch
        "form": (8, 9),
        "factor": (
            4 * n + 7,
            11,
        ),  # rows of the tangent from its diagonal on, factorised in place
        "last": (7, 7),  # the same of the last node and the tip's section
        "gap": (4 * n + 7,),  # increments of the held unknowns
        "change": (4 * n + 7,),  # Newton increment
        # of the tendons: pull (N), stiffness (N/m), 0 where the pull does not depend on the
        # length (m), the last
        "pull": (m, 3),
        "yielding": (m,),  # m/N, of a tendon and the rod
        "carried": (n,),  # N, axial force of the segments by the tendons' pull
        # derivative of a tendon's length over (s, w) before, behind, by bending
        "reach": (m, n, 8),
        "gradient": (m, 4 * n + 7),  # derivative of a tendon's length
        "response": (m, 4 * n + 7),  # displacement by a unit force along it
        "rotation": (3, 3),  # scratch
        # steps whose last increment was above the tolerance
        "unconverged": (1,),
    }


RodWork = named(
    "RodWork",
    ["posture", *posture_shapes(2), *work_shapes(2, 0), "segments"],
    __name__,
)
"""Arrays of a rod: `posture` holds the variables of `posture_shapes`, which are views of it."""


def work_space(mesh: Mesh) -> Arrays:
    """Work arrays of a rod; `place` moves it to a pose."""
    n, m = len(mesh.rod.mass), len(mesh.cables.stiffness)
    posture, views = one_buffer(posture_shapes(n))
    arrays = zeros(work_shapes(n, m)) | views
    return RodWork(posture=posture, segments=segments(n + 1), **arrays)


def place(mesh: Mesh, work: Arrays, position: Array, axes: Array) -> None:
    """Put the rod at rest in its natural shape; axes (3, 3): columns x, y, z of the base."""
    natural = mesh.rod.node
    work.node[: len(natural)] = position + natural @ axes[:, [0, 2]].T
    c, s = np.cos(mesh.turn), np.sin(mesh.turn)
    work.frame[0] = frame_rows(axes)
    work.frame[1] = frame_rows(
        axes @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    )
    work.director[:] = work.frame[0, 1]


def frame_rows(axes: Array) -> Array:
    """(3, 3) rows t, d, b of a section with the axes tangent, width, normal as columns.

    Transposed before and after, the axes of a frame.
    """
    return np.array([axes[:, 0], -axes[:, 1], -axes[:, 2]])

"""State and scratch arrays of a rod, allocated once.

The frame of a segment has the rows t, d, b: its direction, its director across the width, and
t x d. That of an end's section has the same rows; t is its tangent, -d its width and -b its normal.
Row N of the nodes and row N - 1 of the segments stand for the tip's section (`mesh.py`).
"""

from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, one_buffer
from slot_core.dynamics.spatial.strain import Segments, segments
from slot_core.rod.mesh import Mesh


class RodWork(NamedTuple):
    """State, iterate and factorised tangent of a rod of N nodes."""

    node: Array  # (N + 1, 3) m
    velocity: Array  # (N + 1, 3) m/s
    director: Array  # (N, 3)
    swirl: Array  # (N, 3) rad/s, angular momentum about the segments over their polar inertia
    frame: Array  # (2, 3, 3) of the base's and the tip's section
    turning: Array  # (2, 3) rad/s, their angular velocity in the last stage
    driven: Array  # (2, 3) m/s, their nodes' velocity in the last stage
    posture: Array  # the iterate of statics, and the stage of a step, in these views:
    stage: Array  # (N + 1, 3) m
    begin: Array  # (N, 3) directions from which the directors `from_director` are carried on
    from_director: Array  # (N, 3)
    stage_frame: Array  # (2, 3, 3)
    tension: Array  # (N,) N, independent axial force of the tangent
    speed: Array  # (N + 1, 3) m/s, V
    before: Array  # (N + 1, 3) m/s, velocity at the start of the step
    spin: Array  # (N,) rad/s, Omega
    rate: Array  # (2, 3) rad/s, angular velocity of the ends' sections at the stage
    # (2, 3) of the first and the last segment at the stage
    stage_director: Array
    segments: Segments
    moment: Array  # (N, 3) N m, of the hinges, with the independent axial force
    residual: Array  # (N, 3) N m, the same with the axial force of the strains
    normal: Array  # (N,) N, axial force of the strains
    stretch: Array  # (N, 8) derivative of l - c over (s, w) before, behind
    form: Array  # (8, 9) tangent | -gradient of a hinge over (s, w) before, behind
    factor: Array  # (N, 11, 12) tangent | -gradient of the hinges, factorised in place
    last: Array  # (6, 7) the same of the last node and the tip's section
    gap: Array  # (2, 6) increments of the held unknowns
    change: Array  # (4 N + 7,) Newton increment
    rotation: Array  # (3, 3) scratch
    # (1,) steps whose last increment was above the tolerance
    unconverged: Array


def work_space(mesh: Mesh) -> RodWork:
    """Work arrays of a rod; `place` moves it to a pose."""
    n = len(mesh.mass)
    posture, views = one_buffer(
        {
            "stage": (n + 1, 3),
            "begin": (n, 3),
            "from_director": (n, 3),
            "stage_frame": (2, 3, 3),
            "tension": (n,),
        }
    )
    return RodWork(
        node=np.zeros((n + 1, 3)),
        velocity=np.zeros((n + 1, 3)),
        director=np.zeros((n, 3)),
        swirl=np.zeros((n, 3)),
        frame=np.zeros((2, 3, 3)),
        turning=np.zeros((2, 3)),
        driven=np.zeros((2, 3)),
        posture=posture,
        **views,
        speed=np.zeros((n + 1, 3)),
        before=np.zeros((n + 1, 3)),
        spin=np.zeros(n),
        rate=np.zeros((2, 3)),
        stage_director=np.zeros((2, 3)),
        segments=segments(n + 1),
        moment=np.zeros((n, 3)),
        residual=np.zeros((n, 3)),
        normal=np.zeros(n),
        stretch=np.zeros((n, 8)),
        form=np.zeros((8, 9)),
        factor=np.zeros((n, 11, 12)),
        last=np.zeros((6, 7)),
        gap=np.zeros((2, 6)),
        change=np.zeros(4 * n + 7),
        rotation=np.zeros((3, 3)),
        unconverged=np.zeros(1, dtype=np.int64),
    )


def place(mesh: Mesh, work: RodWork, position: Array, axes: Array) -> None:
    """Put the rod at rest in its natural shape; axes (3, 3): columns x, y, z of the base."""
    n = len(mesh.mass)
    work.node[:n] = position + mesh.natural @ axes.T
    c, s = np.cos(mesh.turn), np.sin(mesh.turn)
    work.frame[0] = frame_rows(axes)
    work.frame[1] = frame_rows(
        axes @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    )
    work.director[:] = work.frame[0, 1]


def frame_rows(axes: Array) -> Array:
    """(3, 3) rows t, d, b of a section with the axes tangent, width, normal as columns."""
    return np.array([axes[:, 0], -axes[:, 1], -axes[:, 2]])

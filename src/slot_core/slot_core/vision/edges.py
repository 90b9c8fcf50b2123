"""Corners of markers to a few hundredths of a pixel: lines through the edges, then their crossings.

Along the normal of an edge the grey level rises from black to white. The centroid of its slope is
the edge, whatever symmetric blur the lens and the motion have; a corner detector would be drawn
into the marker by the blur. The points are freed of the distortion before lines are fitted.
"""

import cv2
import numpy as np

from slot_core.arrays import Array
from slot_core.vision.board import GreyImage
from slot_core.vision.camera import Camera

ALONG = np.linspace(0.1, 0.9, 24)
"""Places on an edge: the corners are rounded by the blur."""
ROUGHLY = ALONG[::4]
ACROSS = np.linspace(-1.0, 1.0, 15)  # samples over the half width
HALF_WIDTH = (2.0, 5.0)  # px, its limits
SHARE = 0.75  # of a cell: the half width within these
STRONG = 0.1  # of the largest slope in the profile: below is noise
OUTLIER = 3.0  # times the median distance


def refined_rays(
    image: GreyImage, corners: Array, camera: Camera, cells: int
) -> tuple[Array, Array]:
    """Corners (m, 4, 2) as undistorted x', y', from corners (m, 4, 2) in px found roughly.

    cells: of a marker along an edge, its black border included. Also the RMS distance (m,) of the
    edges' points from their lines, px; infinite where an edge is no edge.
    """
    points, strength = edge_points(image, corners, ROUGHLY, cells)
    corners, _ = crossings(points, strength)
    points, strength = edge_points(image, corners, ALONG, cells)
    rays, distance = crossings(camera.rays(points), strength)
    return rays, distance * camera.focal


def edge_points(
    image: GreyImage, corners: Array, along: Array, cells: int
) -> tuple[Array, Array]:
    """Points (m, 4, n, 2) px on the edges of markers and their slopes (m, 4, n), zero: none.

    along: (n,) places on an edge as shares of its length.
    """
    edge = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(edge, axis=-1)
    normal = (
        np.stack([edge[..., 1], -edge[..., 0]], axis=-1) / length[..., None]
    )
    half = np.clip(SHARE * length.min(axis=1) / cells, *HALF_WIDTH)
    middle = corners[:, :, None] + along[:, None] * edge[:, :, None]

    # grey levels along the outward normals, at offsets of -half to half
    offset = half[:, None, None, None] * ACROSS  # (m, 1, 1, p)
    outward = normal[:, :, None]  # (m, 4, 1, 2)
    places = middle[..., None, :] + offset[..., None] * outward[..., None, :]
    sampled = cv2.remap(
        image,
        places.reshape(-1, places.shape[-2], 2).astype(np.float32),
        np.empty(0),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    grey = sampled.reshape(places.shape[:-1]).astype(np.float64)

    # centroid of their slope
    slope = np.diff(grey, axis=-1)
    strongest = slope.max(axis=-1, keepdims=True)
    slope = np.where(slope > STRONG * strongest, slope, 0.0)
    total = slope.sum(axis=-1)
    between = (offset[..., 1:] + offset[..., :-1]) / 2
    moment = (slope * between).sum(axis=-1)
    shift = np.divide(moment, total, where=total > 0, out=np.zeros_like(total))
    return middle + shift[..., None] * outward, np.maximum(total, 0.0)


def crossings(points: Array, weight: Array) -> tuple[Array, Array]:
    """Crossings (m, 4, 2) of neighbouring edges through points (m, 4, n, 2), and RMS distances."""
    typical = np.median(weight, axis=-1, keepdims=True)
    weight = np.where(weight > 0.5 * typical, 1.0, 0.0)
    _, _, distance = _lines(points, weight)
    typical = np.median(distance, axis=-1, keepdims=True)
    weight = weight * (distance <= OUTLIER * typical + 1e-12)
    centre, normal, distance = _lines(points, weight)

    used = weight.sum(axis=-1)
    mean = (weight * distance**2).sum(axis=-1) / np.maximum(used, 1.0)
    rms = np.sqrt(mean.mean(axis=-1))
    rms[(used < 3).any(axis=-1)] = np.inf

    # a crossing x is on the edge (n, c) and on the one before it: n x = n c
    value = (normal * centre).sum(axis=-1)
    matrix = np.stack([np.roll(normal, 1, axis=1), normal], axis=-2)
    right = np.stack([np.roll(value, 1, axis=1), value], axis=-1)
    parallel = np.abs(np.linalg.det(matrix)) < 1e-3
    matrix[parallel] = np.eye(2)
    rms[parallel.any(axis=1)] = np.inf
    return np.linalg.solve(matrix, right[..., None])[..., 0], rms


def _lines(points: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Centre and normal (m, 4, 2) of the lines of least squares, distances (m, 4, n) from them."""
    total = np.maximum(weight.sum(axis=-1), 1.0)
    centre = (weight[..., None] * points).sum(axis=-2) / total[..., None]
    x, y = np.moveaxis(points - centre[..., None, :], -1, 0)
    xx, xy, yy = (
        (weight * a * b).sum(axis=-1) for a, b in ((x, x), (x, y), (y, y))
    )
    angle = np.arctan2(2 * xy, xx - yy) / 2  # of the principal axis
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    return centre, normal, np.abs(x * normal[..., :1] + y * normal[..., 1:])

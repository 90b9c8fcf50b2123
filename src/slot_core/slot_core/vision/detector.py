"""Finds markers in an image with cv2.aruco; looks first where they were in the last one.

Corners of markers to a few hundredths of a pixel: lines through the edges, then their crossings.

Along the normal of an edge the grey level rises from black to white. The centroid of its slope is
the edge, whatever symmetric blur the lens and the motion have; a corner detector would be drawn
into the marker by the blur. The points are freed of the distortion before lines are fitted.
"""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.refusal import quoted
from slot_core.vision.board import GreyImage
from slot_core.vision.camera import Camera, CameraError

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


FAMILIES = (  # to tell which dictionary the markers are of, if not of the one expected
    "DICT_4X4_1000",
    "DICT_5X5_1000",
    "DICT_6X6_1000",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
)
Ids = NDArray[np.int64]
SMALLEST = 40.0  # px, smallest perimeter of a marker
MARGIN = 40  # px, around where the markers were
WHOLE_EVERY = 15  # images between two searches of the whole image
LARGE = 60.0  # px, edge of markers that are found at half the resolution


@dataclass(frozen=True)
class Detection:
    """Markers of an image, each id once."""

    ids: tuple[int, ...]
    pixels: Array  # (m, 4, 2) px, clockwise from the marker's top left
    rays: Array  # (m, 4, 2) x', y' without distortion
    duplicates: tuple[
        int, ...
    ] = ()  # ids seen more than once: none of them is used
    size: float = 0.0  # px, shortest edge


class MarkerDetector:
    """Markers of a dictionary in images of a camera; call it with one image after the other."""

    def __init__(self, dictionary: int, camera: Camera) -> None:
        self._camera = camera
        self._dictionary = cv2.aruco.getPredefinedDictionary(dictionary)
        self._last = Detection((), np.zeros((0, 4, 2)), np.zeros((0, 4, 2)))
        self._doubled: frozenset[int] = frozenset()  # in the last whole image
        self._since_whole = 0

    def find(self, image: GreyImage) -> Detection:
        """The markers of a grey image (h, w); raises CameraError for another size or type."""
        if image.ndim != 2 or image.dtype != np.uint8:
            raise CameraError(
                f"image of {image.dtype}, {image.shape}: expected grey of 8 bits"
            )
        height, width = image.shape
        if (width, height) != (self._camera.width, self._camera.height):
            raise CameraError(
                f"image of {width} x {height} px: the camera is calibrated at"
                f" {self._camera.width} x {self._camera.height} px"
            )
        last, self._since_whole = self._last, self._since_whole + 1
        near = last.ids and self._since_whole < WHOLE_EVERY
        found = self._near(image, last) if near else None
        if found is None or not set(last.ids) <= set(found.ids):
            self._since_whole, self._doubled = 0, frozenset()
            found = self._refined(image, *self._raw(image, 1.0))
            self._doubled = frozenset(found.duplicates)
        self._last = found
        return found

    def _near(self, image: GreyImage, last: Detection) -> Detection:
        """The markers near the places of the last image's."""
        low = np.maximum(last.pixels.min(axis=(0, 1)) - MARGIN, 0).astype(int)
        high = np.ceil(last.pixels.max(axis=(0, 1)) + MARGIN).astype(int)
        ids, corners = self._raw(
            image[low[1] : high[1], low[0] : high[0]],
            0.5 if last.size > LARGE else 1.0,
        )
        return self._refined(image, ids, corners + low)

    def _raw(self, image: GreyImage, scale: float) -> tuple[Ids, Array]:
        """Ids (m,) and corners (m, 4, 2), px, as cv2.aruco finds them at a scale."""
        small = (
            image
            if scale == 1.0
            else cv2.resize(
                image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
            )
        )
        parameters = cv2.aruco.DetectorParameters()
        parameters.minMarkerPerimeterRate = scale * SMALLEST / max(small.shape)
        corners, ids, _ = cv2.aruco.ArucoDetector(
            self._dictionary, parameters
        ).detectMarkers(np.ascontiguousarray(small))
        if ids is None:
            return np.zeros(0, np.int64), np.zeros((0, 4, 2))
        found = np.array(corners, np.float64).reshape(-1, 4, 2)
        return np.array(ids, np.int64).ravel(), (found + 0.5) / scale - 0.5

    def _refined(self, image: GreyImage, ids: Ids, corners: Array) -> Detection:
        """The markers with exact corners; drops those without clear edges and doubled ids.

        Of an id that was doubled in the whole image, a part of it may show one marker only.
        """
        if not len(ids):
            return Detection((), np.zeros((0, 4, 2)), np.zeros((0, 4, 2)))
        rays, noise = refined_rays(
            image, corners, self._camera, self._dictionary.markerSize + 2
        )
        doubled = {
            i
            for i, n in Counter(ids.tolist()).items()
            if n > 1 or i in self._doubled
        }
        keep = np.isfinite(noise) & np.array(
            [i not in doubled for i in ids.tolist()]
        )
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
        return Detection(
            tuple(ids[keep].tolist()),
            corners[keep],
            rays[keep],
            tuple(sorted(doubled)),
            float(edges[keep].min()) if keep.any() else 0.0,
        )


def other_dictionary(image: GreyImage) -> str:
    """The dictionary of which most markers are found, with their number; empty: of none."""
    counts = {}
    for name in FAMILIES:
        _, ids, _ = cv2.aruco.ArucoDetector(
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        ).detectMarkers(image)
        counts[name] = 0 if ids is None else len(ids)
    best = max(counts, key=lambda name: counts[name])
    return f"{counts[best]} of {best}" if counts[best] else ""


CHANNELS = {
    "mono8": 1,
    "8UC1": 1,
    "bgr8": 3,
    "rgb8": 3,
    "8UC3": 3,
    "bgra8": 4,
    "rgba8": 4,
}
TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "8UC3": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
}


def grey_image(message: Any) -> GreyImage:
    """Grey image (h, w) of an Image; raises ValueError for other encodings, missing bytes."""
    if message.encoding not in CHANNELS:
        raise ValueError(
            f"encoding {quoted(message.encoding)}: expected one of {', '.join(CHANNELS)}"
        )
    pixels = _pixels(message, CHANNELS[message.encoding])
    code = TO_GREY.get(message.encoding)
    return (
        np.ascontiguousarray(pixels[..., 0])
        if code is None
        else np.asarray(cv2.cvtColor(pixels, code), np.uint8)
    )


def _pixels(message: Any, channels: int) -> NDArray[np.uint8]:
    """Pixels (h, w, channels), without the bytes at the end of the rows."""
    height, width, step = message.height, message.width, message.step
    data, row = np.frombuffer(message.data, np.uint8), width * channels
    if step < row or len(data) != height * step or not height or not width:
        raise ValueError(
            f"{len(data)} bytes in rows of {step}: {width} x {height} px of"
            f" {message.encoding} have {height} rows of {row} bytes at least"
        )
    pixels = data.reshape(height, step)[:, :row]
    return np.ascontiguousarray(pixels).reshape(height, width, channels)

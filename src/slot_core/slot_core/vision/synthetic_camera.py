"""Synthetic camera: images of flat printed surfaces, with distortion, blur and noise.

A pixel looks along its undistorted ray; where that meets a surface gives the grey level. Each pixel
is the mean of SAMPLES x SAMPLES rays. Surfaces cast no shadows; a later one hides those before it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from slot_core.arrays import Array
from slot_core.vision.board import GreyImage
from slot_core.vision.camera import Camera

SAMPLES = 2  # rays per pixel and axis
GRID = 16  # samples between two rays that are computed; those between are interpolated
NEAREST = 0.02  # m, of a surface
GREY, BLACK, WHITE = 120, 25, 225  # of the background, of ink and paper
PAD = 3  # samples around a surface


@dataclass(frozen=True)
class Surface:
    """A printed sheet: its image and its corners, clockwise from the image's top left."""

    print: GreyImage  # (h, w), black 0 to white 255
    corners: Array  # (4, 3) m in the optical frame
    velocity: Array | None = None  # (4, 3) m/s of the corners

    @property
    def faces_camera(self) -> bool:
        """Whether its front is before the camera."""
        a, b, _, d = self.corners
        in_front = (self.corners[:, 2] > NEAREST).all()
        return bool(in_front and np.linalg.det(np.array([a, b - a, d - a])) > 0)


@dataclass(frozen=True)
class Imperfections:
    """Noise, blur and exposure of an image."""

    noise: float = 2.0  # standard deviation, grey levels of 255
    blur: float = 0.6  # px, standard deviation of the lens' blur
    exposure: float = 0.004  # s


class SyntheticCamera:
    """Renders images of a camera."""

    def __init__(
        self,
        camera: Camera,
        imperfections: Imperfections,
        rng: np.random.Generator,
    ) -> None:
        self.camera, self._made = camera, imperfections
        self._rng = rng
        self._rays = _rays(camera)
        noise = imperfections.noise * rng.standard_normal(
            (camera.height + 64, camera.width + 64), np.float32
        )
        self._noise = noise.round().astype(np.int16)

    def image(self, surfaces: list[Surface]) -> GreyImage:
        """The image (h, w) at mid exposure."""
        canvas = np.full(self._rays.shape[:2], GREY, np.uint8)
        for surface in surfaces:
            if surface.faces_camera:
                self._paint(canvas, surface)
        size = (self.camera.width, self.camera.height)
        image = cv2.resize(canvas, size, interpolation=cv2.INTER_AREA)
        if self._made.blur > 0:
            image = cv2.GaussianBlur(image, (0, 0), self._made.blur)
        y, x = self._rng.integers(0, 64, 2)
        noise = self._noise[y : y + size[1], x : x + size[0]]
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U), np.uint8)

    def _paint(self, canvas: GreyImage, surface: Surface) -> None:
        """Paint a surface on the canvas of samples, and blur it by its motion."""
        edge = np.linspace(0, 1, 9)[:-1, None]
        outline = np.concatenate(
            [
                a + edge * (b - a)
                for a, b in zip(
                    surface.corners, np.roll(surface.corners, -1, axis=0)
                )
            ]
        )
        pixels = SAMPLES * (self.camera.project(outline) + 0.5)
        blur = self._motion(surface)
        pad = PAD + int(np.ceil(np.abs(blur).max()))
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - pad, 0)
        high = np.minimum(
            np.ceil(pixels.max(axis=0)).astype(int) + pad, canvas.shape[::-1]
        )
        if (high <= low).any():
            return
        place = (slice(low[1], high[1]), slice(low[0], high[0]))
        height, width = surface.print.shape
        sheet = (
            np.array(
                [[0, 0], [width, 0], [width, height], [0, height]], np.float32
            )
            - 0.5
        )
        rays = (surface.corners[:, :2] / surface.corners[:, 2:]).astype(
            np.float32
        )
        places = cv2.perspectiveTransform(
            np.ascontiguousarray(self._rays[place]),
            cv2.getPerspectiveTransform(rays, sheet.astype(np.float32)),
        )
        ink = BLACK + (WHITE - BLACK) / 255 * surface.print
        part = np.ascontiguousarray(canvas[place])
        cv2.remap(
            ink.astype(np.uint8),
            places,
            np.empty(0),
            cv2.INTER_LINEAR,
            part,
            cv2.BORDER_TRANSPARENT,
        )
        canvas[place] = _moved(part, blur)

    def _motion(self, surface: Surface) -> Array:
        """(2,) samples, way of a surface in the image during the exposure."""
        if surface.velocity is None:
            return np.zeros(2)
        way = self._made.exposure / 2 * surface.velocity
        ends = [
            self.camera.project(surface.corners + sign * way)
            for sign in (-1, 1)
        ]
        return np.asarray(SAMPLES * (ends[1] - ends[0]).mean(axis=0), float)


def _moved(image: GreyImage, way: Array) -> GreyImage:
    """The mean of an image moved along a straight way (2,), centred, px."""
    length = float(np.linalg.norm(way))
    if length < 0.5:
        return image
    half = int(np.ceil(length / 2)) + 1
    steps = np.linspace(-0.5, 0.5, 4 * half + 1)[:, None] * way + half
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for x, y in steps:  # bilinear
        i, j = int(x), int(y)
        u, v = x - i, y - j
        kernel[j : j + 2, i : i + 2] += np.outer([1 - v, v], [1 - u, u])[
            : kernel.shape[0] - j, : kernel.shape[1] - i
        ]
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)


def _rays(camera: Camera) -> np.ndarray:
    """Undistorted rays (h, w, 2) of all samples, float32; linear between points of a grid."""
    height, width = SAMPLES * camera.height, SAMPLES * camera.width
    grid = np.meshgrid(
        np.arange(0, width + GRID, GRID), np.arange(0, height + GRID, GRID)
    )
    pixels = (np.stack(grid, axis=-1) + 0.5) / SAMPLES - 0.5
    coarse = camera.rays(pixels.astype(float))
    fine_x, fine_y = np.meshgrid(
        np.arange(width) / GRID, np.arange(height) / GRID
    )
    return np.asarray(
        cv2.remap(
            coarse.astype(np.float32),
            fine_x.astype(np.float32),
            fine_y.astype(np.float32),
            cv2.INTER_LINEAR,
        )
    )

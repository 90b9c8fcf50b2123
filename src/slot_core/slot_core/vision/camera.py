"""Camera model: pinhole with OpenCV's distortion, and its calibration file in the format of ROS.

    x' = X / Z,  y' = Y / Z;  (u, v) = K distort(x', y')

with X, Y, Z in the optical frame (z forward, y down). The file has the keys of `camera_info` in the
YAML of ROS (camera_calibration_parsers), so that camera drivers read it too, and beside them the
covariance of the calibration, which `camera_info` has no field for.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from slot_core import config
from slot_core.arrays import Array
from slot_core.refusal import InputError, quoted, read_text
from slot_core.vision.settings import Intrinsics

# coefficients by name in ROS
MODELS = {"plumb_bob": 5, "rational_polynomial": 8}
SIZE_MAX = 100_000  # bytes of a calibration file
NO_MODEL = ("", "none", "pinhole")  # names beside those, without coefficients
PIXELS_MAX, LARGEST = 2**15, 1e6  # of an image's side; of K and D
FIELDS = (2.0, 170.0)  # deg, of view along an image's side
ACCURATE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)


class CameraError(InputError):
    """An unusable camera or calibration; the message is one line."""


@dataclass(frozen=True)
class Camera:
    """Intrinsic parameters of a camera."""

    width: int  # px
    height: int  # px
    matrix: Array  # (3, 3) K
    distortion: Array  # (5,) or (8,)
    # of f_x f_y c_x c_y and the distortion, (9, 9) or (12, 12); None: not known
    covariance: Array | None = None

    @property
    def model(self) -> str:
        """Name of the distortion model in ROS."""
        return next(
            name
            for name, size in MODELS.items()
            if size == self.distortion.size
        )

    @property
    def focal(self) -> float:
        """Mean focal length, px."""
        return float(self.matrix[0, 0] + self.matrix[1, 1]) / 2

    @property
    def projection(self) -> Array:
        """(3, 4) P = [K 0], of a single camera without rectification."""
        return np.hstack([self.matrix, np.zeros((3, 1))])

    def equals(self, other: Camera) -> bool:
        """Whether all values are equal."""
        mine, its = (
            [c.width, c.height, *c.matrix.ravel(), *c.distortion]
            for c in (self, other)
        )
        return mine == its

    def rays(self, pixels: Array) -> Array:
        """Undistorted x', y' (..., 2) of pixels (..., 2); raises ValueError for another shape."""
        _require_last("pixels", pixels, 2)
        flat = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        if not len(flat):
            return np.zeros(pixels.shape)
        rays = cv2.undistortPointsIter(
            flat, self.matrix, self.distortion, np.eye(3), np.eye(3), ACCURATE
        )
        return np.asarray(rays, np.float64).reshape(pixels.shape)

    def ray_slopes(self, rays: Array) -> Array:
        """Derivatives (2n, 4 + 5 or 8) of the rays (n, 2) of given pixels by the parameters.

        With (u, v) = P(x', y', parameters) at given pixels: d ray = -(dP/d ray)^-1 dP/d parameters.
        """
        _, slopes = cv2.projectPoints(
            np.column_stack([rays, np.ones(len(rays))])[:, None],
            np.zeros(3),
            np.zeros(3),
            self.matrix,
            self.distortion,
        )
        # of a shift along x and y at distance one
        by_ray = slopes[:, 3:5].reshape(-1, 2, 2)
        by_parameter = slopes[:, 6:].reshape(len(rays), 2, -1)
        return np.asarray(
            -np.linalg.solve(by_ray, by_parameter).reshape(2 * len(rays), -1)
        )

    def project(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in front of the camera, m in the optical frame.

        Raises ValueError for another shape.
        """
        _require_last("points", points, 3)
        pixels, _ = cv2.projectPoints(
            np.ascontiguousarray(points, np.float64).reshape(-1, 1, 3),
            np.zeros(3),
            np.zeros(3),
            self.matrix,
            self.distortion,
        )
        return np.asarray(pixels, np.float64).reshape(*points.shape[:-1], 2)


def _require_last(name: str, values: Array, size: int) -> None:
    if values.shape[-1:] != (size,):
        raise ValueError(
            f"{name}: shape {values.shape}, expected (..., {size})"
        )


def nominal(settings: Intrinsics) -> Camera:
    """The camera of `config/vision.yaml`; raises CameraError."""
    (f_x, f_y), (c_x, c_y) = settings.focal, settings.centre
    return from_camera_info(
        settings.width,
        settings.height,
        "plumb_bob",
        settings.distortion,
        [f_x, 0.0, c_x, 0.0, f_y, c_y, 0.0, 0.0, 1.0],
    )


def from_camera_info(  # noqa: PLR0917
    width: int, height: int, model: str, d: Any, k: Any, covariance: Any = None
) -> Camera:
    """The camera of a sensor_msgs/CameraInfo: its size, distortion model, D and K.

    covariance: of the calibration, if it is known. Raises CameraError if it is not calibrated
    (K = 0), for an unknown model, for values that are not finite, and for a K that is not that of
    an image of this size, such as one with skew.
    """
    for name, size in (("image_width", width), ("image_height", height)):
        if type(size) is not int or not 1 <= size <= PIXELS_MAX:
            raise CameraError(
                f"{name} = {quoted(size)}: expected an integer in [1, {PIXELS_MAX}]"
            )
    matrix, distortion = _numbers("K", k), _numbers("D", d)
    if matrix.size != 9:
        raise CameraError(f"K has {matrix.size} values, expected 9")
    if matrix[0] == 0.0:
        raise CameraError(
            "K[0] = 0: the camera is not calibrated, see scripts/calibrate --camera"
        )
    if not distortion.size and model in (*NO_MODEL, *MODELS):
        distortion, model = np.zeros(5), "plumb_bob"
    if not isinstance(model, str) or model not in MODELS:
        raise CameraError(
            f"distortion_model {quoted(model)}: expected one of {', '.join(MODELS)}; rectify the"
            " images of a fisheye first"
        )
    if distortion.size != MODELS[model]:
        raise CameraError(
            f"D has {distortion.size} values, {model} has {MODELS[model]}"
        )
    matrix = matrix.reshape(3, 3)
    _require_pinhole(matrix, width, height)
    return Camera(
        width,
        height,
        matrix,
        distortion,
        None
        if covariance is None
        else _checked(covariance, 4 + distortion.size),
    )


def _require_pinhole(matrix: Array, width: int, height: int) -> None:
    """Raise CameraError unless K = [f_x 0 c_x; 0 f_y c_y; 0 0 1] px suits an image of this size."""
    (f_x, skew, c_x), (below, f_y, c_y), last = matrix.tolist()
    turned = ": transposed?" if c_x == c_y == 0.0 else ""
    sides = ("x", f_x, c_x, width), ("y", f_y, c_y, height)
    field = [2 * np.degrees(np.arctan2(n / 2, f)) for _, f, _, n in sides]
    normalised = ": normalised? K is in px" if f_x < 10.0 else ""
    for unsuitable, fault in (
        (
            last != [0.0, 0.0, 1.0],
            f"K[6:9] = {', '.join(f'{v:g}' for v in last)}{turned}, expected 0, 0, 1",
        ),
        (
            skew or below,
            f"K[1] = {skew:g}, K[3] = {below:g}: expected 0, a camera without skew; calibrate it"
            " by scripts/calibrate --camera",
        ),
        (min(f_x, f_y) <= 0, f"f = {f_x:g}, {f_y:g} px: expected > 0"),
        *(
            (
                not FIELDS[0] <= angle <= FIELDS[1],
                f"f_{axis} = {f:g} px, a field of view of {angle:.3g} deg on {size} px, expected"
                f" {FIELDS[0]:g} to {FIELDS[1]:g}{normalised}",
            )
            for (axis, f, _, size), angle in zip(sides, field)
        ),
        *(
            (
                not 0.0 <= c <= size,
                f"c_{axis} = {c:g} px: outside of the image, [0, {size}]; K of another size?",
            )
            for axis, _, c, size in sides
        ),
    ):
        if unsuitable:
            raise CameraError(fault)


def _numbers(name: str, values: Any) -> Array:
    """(n,) of a camera's values; raises CameraError unless they are numbers up to LARGEST."""
    try:
        found = np.array(values, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise CameraError(
            f"{name} = {quoted(values)}: expected numbers"
        ) from None
    if not (np.abs(found) <= LARGEST).all():  # NaN is not
        raise CameraError(
            f"{name} has a value that is not finite, or above {LARGEST:g}"
        )
    return found


def _checked(covariance: Any, size: int) -> Array:
    """A covariance (size, size) from its values; raises CameraError."""
    values = _numbers("intrinsics_covariance", covariance)
    if values.size != size**2:
        raise CameraError(
            f"intrinsics_covariance has {values.size} values, expected {size**2}"
        )
    square = values.reshape(size, size)
    if (
        not np.allclose(square, square.T)
        or np.linalg.eigvalsh(square).min() < -1e-9 * np.abs(square).max()
    ):
        raise CameraError(
            "intrinsics_covariance is no covariance: not symmetric and positive"
        )
    return square


def read_camera(path: Path) -> Camera:
    """The camera of a calibration file; raises CameraError with the path and the cause."""
    try:
        content = config.parse(read_text(path, SIZE_MAX))
        return from_camera_info(
            content["image_width"],
            content["image_height"],
            content["distortion_model"],
            content["distortion_coefficients"]["data"],
            content["camera_matrix"]["data"],
            content.get("intrinsics_covariance", {}).get("data"),
        )
    except KeyError as error:
        raise CameraError(f"{path}: {error.args[0]} is missing") from None
    except OSError as error:
        raise CameraError(f"{path}: {error.strerror}") from None
    except (TypeError, ValueError) as error:
        raise CameraError(f"{path}: {error}") from None


def camera_text(camera: Camera, name: str = "camera") -> str:
    """Content of the calibration file of a camera."""
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(camera.matrix),
        "distortion_model": camera.model,
        "distortion_coefficients": _matrix(camera.distortion[None]),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(camera.projection),
    }
    if camera.covariance is not None:
        content["intrinsics_covariance"] = _matrix(camera.covariance)
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


def _matrix(values: Array) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.ravel().tolist()}

"""Grey images from sensor_msgs/Image messages, received or read from a bag."""

from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from slot_core.refusal import quoted
from slot_core.vision.board import GreyImage

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
DEPTHS = ("16UC1", "mono16")


def grey(message: Any) -> GreyImage:
    """Grey image (h, w) of an Image; raises ValueError for other encodings, missing bytes."""
    if message.encoding not in CHANNELS:
        raise ValueError(
            f"encoding {quoted(message.encoding)}: expected one of {', '.join(CHANNELS)}"
        )
    pixels = _pixels(message, CHANNELS[message.encoding], np.dtype(np.uint8))
    if message.encoding in TO_GREY:
        return np.asarray(
            cv2.cvtColor(pixels, TO_GREY[message.encoding]), np.uint8
        )
    return np.ascontiguousarray(pixels[..., 0])


def depth(message: Any) -> NDArray[np.uint16]:
    """Depth (h, w), mm, of an Image; raises ValueError for other encodings, missing bytes."""
    if message.encoding not in DEPTHS:
        raise ValueError(
            f"encoding {quoted(message.encoding)}: expected one of {', '.join(DEPTHS)}"
        )
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    return _pixels(message, 1, np.dtype(np.uint16).newbyteorder(order))[
        ..., 0
    ].astype(np.uint16)


def _pixels(message: Any, channels: int, kind: np.dtype[Any]) -> NDArray[Any]:
    """Pixels (h, w, channels), without the bytes at the end of the rows."""
    height, width, step = message.height, message.width, message.step
    data = np.frombuffer(message.data, np.uint8)
    row = width * channels * kind.itemsize
    if step < row or len(data) != height * step or not height or not width:
        raise ValueError(
            f"{len(data)} bytes in rows of {step}: {width} x {height} px of"
            f" {message.encoding} have {height} rows of {row} bytes at least"
        )
    return (
        np.ascontiguousarray(data.reshape(height, step)[:, :row])
        .view(kind)
        .reshape(height, width, channels)
    )

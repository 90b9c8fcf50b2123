"""Grey images from sensor_msgs/Image messages, received or read from a bag."""

from typing import Any

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


def grey(message: Any) -> GreyImage:
    """Grey image (h, w) of an Image; raises ValueError for other encodings, missing bytes."""
    if message.encoding not in CHANNELS:
        raise ValueError(
            f"encoding {quoted(message.encoding)}: expected one of {', '.join(CHANNELS)}"
        )
    pixels = _pixels(message, CHANNELS[message.encoding])
    if message.encoding in TO_GREY:
        return np.asarray(
            cv2.cvtColor(pixels, TO_GREY[message.encoding]), np.uint8
        )
    return np.ascontiguousarray(pixels[..., 0])


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

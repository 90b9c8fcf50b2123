"""Images of a film one after the other: from a video, a folder of images, or a bag."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slot_core.clock import to_seconds
from slot_core.messages.decode import stamp
from slot_core.refusal import InputError, require_regular
from slot_core.vision.board import GreyImage
from slot_core.vision.camera import Camera, CameraError, from_camera_info
from slot_core.vision.detector import grey_image
from slot_lab.bags.bag import STORAGES, Bag, BagError
from slot_lab.bags.topics import IMAGES

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class FilmError(InputError):
    """A film that cannot be read; the message is one line with its path and the cause."""


@dataclass(frozen=True)
class Frame:
    """An image of a film."""

    time: float  # s
    grey: GreyImage  # (h, w)


def read_film(
    path: Path, rate: float | None = None, topic: str = IMAGES
) -> Iterator[Frame]:
    """Frames of a video, a folder or a bag; raises FilmError.

    rate: images per s of a video (default: its own) or a folder (default: 30). topic: of the
    bag's images.
    """
    if is_bag(path):
        return _of_bag(path, topic)
    if not path.exists():
        raise FilmError(f"{path}: does not exist")
    folder = path.is_dir()
    return _of_folder(path, rate or 30.0) if folder else _of_video(path, rate)


def silence_opencv() -> None:
    """Keep OpenCV from printing what our messages say."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def claimed_length(path: Path) -> int:
    """Number of images that a video says it has; zero if it says none, and for other films."""
    if path.is_dir() or is_bag(path):
        return 0
    return max(0, int(_opened(path).get(cv2.CAP_PROP_FRAME_COUNT)))


def is_bag(path: Path) -> bool:
    """Whether a path is a bag."""
    files = [path, *path.glob("*")]
    return any(
        file.suffix in STORAGES or file.name == "metadata.yaml"
        for file in files
    )


def bag_camera(path: Path, topic: str) -> Camera:
    """The camera of a bag's images, from `camera_info` beside their topic; raises FilmError."""
    beside = f"{topic.rpartition('/')[0]}/camera_info"
    try:
        for _, m in Bag(path).messages(beside):
            return from_camera_info(
                m.width, m.height, m.distortion_model, m.d, m.k
            )
    except (BagError, CameraError) as error:
        raise FilmError(f"{path}: {beside}: {error}") from None
    raise FilmError(f"{path}: {beside} has no message")


def _of_video(path: Path, rate: float | None) -> Iterator[Frame]:
    video = _opened(path)
    own = video.get(cv2.CAP_PROP_FPS)
    if not video.isOpened():
        raise FilmError(f"{path}: no video that OpenCV can read")
    if rate is None and not 0 < own < 1e4:
        raise FilmError(f"{path}: says {own:g} images per s; give --rate")
    number, time, step = 0, 0.0, 1.0 / (rate or own)
    while (image := video.read()[1]) is not None:
        # its own times, since films of telephones vary in their rate
        if rate is None:
            own_time = video.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            time = own_time if own_time > time or not number else time + step
        else:
            time = number * step
        yield Frame(time, _grey(image))
        number += 1
    if not number:
        raise FilmError(f"{path}: has no image that can be read")


def _opened(path: Path) -> cv2.VideoCapture:
    """A video; raises FilmError for a device or a pipe, for which OpenCV would wait."""
    try:
        require_regular(path)
    except (OSError, ValueError) as error:
        raise FilmError(f"{path}: {error}") from None
    return cv2.VideoCapture(str(path))


def _of_folder(path: Path, rate: float) -> Iterator[Frame]:
    """The images of a folder in the order of their names."""
    files = sorted(
        f
        for f in path.glob("*")
        if f.suffix.lower() in SUFFIXES and f.is_file()
    )
    if not files:
        raise FilmError(
            f"{path}: a folder without images ({', '.join(SUFFIXES)})"
        )
    for number, file in enumerate(files):
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise FilmError(f"{file}: no image that OpenCV can read")
        yield Frame(number / rate, _grey(image))


def _of_bag(path: Path, topic: str) -> Iterator[Frame]:
    try:
        for _, message in Bag(path).messages(topic):
            time = to_seconds(stamp(message))
            yield Frame(time, grey_image(message))
    except (BagError, ValueError, AttributeError) as error:
        raise FilmError(f"{path}: {topic}: {error}") from None


def _grey(image: Any) -> GreyImage:
    coloured = image.ndim > 2
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if coloured else image
    return np.asarray(grey, np.uint8)

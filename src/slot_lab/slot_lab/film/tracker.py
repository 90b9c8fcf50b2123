"""Marker tracker: 3-D tracks of the markers on torso and legs, seen by a camera at rest.

A point is the middle of its marker, by the marker's pose. Where a board of `config/vision.yaml` that
is fixed in odom is seen, the tracks are in odom; the pose of the camera then comes from the board's
median corners over all images. Else they are in camera_link, z up if the camera is level.
"""

import argparse
import itertools
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from slot_core.arrays import Array
from slot_core.command_line import ProgressLine, Tell, untold
from slot_core.geometry import OPTICAL, Transform
from slot_core.robot import ODOM_FRAME, POINT_FRAME, TORSO
from slot_core.vision.board import (
    GreyImage,
    board_poses,
    make_board,
    single_marker,
)
from slot_core.vision.camera import Camera, CameraError, nominal, read_camera
from slot_core.vision.detector import (
    Detection,
    MarkerDetector,
    other_dictionary,
)
from slot_core.vision.localizer import unusual
from slot_core.vision.settings import VisionSettings, read_vision
from slot_lab.bags.topics import IMAGES
from slot_lab.csv_table import write_points
from slot_lab.desk_command import Outcome
from slot_lab.film.images import (
    FilmError,
    bag_camera,
    claimed_length,
    is_bag,
    read_film,
    silence_opencv,
)

FEWEST = 2  # markers of a board that place the camera
CAMERA = "camera_link"
MOVED = 1.0  # px, of the board before a camera that stands still
# images that a video says over those read: some estimate their length
COMPLETE = 1.02


class MarkerSample(NamedTuple):
    """A point at one time."""

    time: float  # s
    point: str
    position: Array  # (3,) m


@dataclass
class Tracks:
    """Result of a film."""

    frame: str  # odom, or camera_link
    samples: list[MarkerSample]
    images: int
    camera_motion: float  # px, largest motion of a marker of the boards
    notes: list[str] = field(default_factory=list)

    @property
    def warnings(self) -> list[str]:
        """Limits to the use of the tracks, one line each."""
        line = (
            f"the camera moved: the board by {self.camera_motion:.1f} px,"
            f" limit {MOVED:g} px"
        )
        return [*([line] if self.camera_motion > MOVED else []), *self.notes]


class Tracker:
    """Tracks the markers through the images of a film, given in order."""

    def __init__(self, settings: VisionSettings, camera: Camera) -> None:
        self._settings, self._camera = settings.detection, camera
        self._names = settings.points.names
        self._marker = single_marker(0, settings.points.size).corners[0]
        self._boards = [
            make_board(board)
            for board in settings.boards_in(ODOM_FRAME).values()
        ]
        self._detector = MarkerDetector(settings.dictionary_number, camera)
        self._noise = settings.detection.corner_noise / camera.focal
        self._seen: list[MarkerSample] = []  # in the optical frame
        self._rays: dict[
            int, list[Array]
        ] = {}  # (4, 2) of the boards' markers, which stand still
        self._images = 0
        self._duplicates: set[int] = set()
        self._unusual = ""  # warning about the board's reprojection error

    def add(self, time: float, image: GreyImage) -> list[MarkerSample]:
        """Add the grey image (h, w) of a time (s); its points in the optical frame.

        Raises CameraError for another size.
        """
        found = self._detector.find(image)
        self._images += 1
        self._duplicates |= set(found.duplicates)
        new = []
        for index, number in enumerate(found.ids):
            if any(number in board.corners for board in self._boards):
                self._rays.setdefault(number, []).append(found.rays[index])
            if number not in self._names:
                continue
            if (place := self._locate(found, index)) is not None:
                new.append(MarkerSample(time, self._names[number], place))
        self._seen += new
        return new

    def tracks(self) -> Tracks:
        """All tracks so far; raises CameraError if the board is not as it is configured."""
        frame, to_frame = ODOM_FRAME, self._camera_in_odom()
        if to_frame is None:
            frame, to_frame = CAMERA, Transform(OPTICAL, np.zeros(3))
        off = [
            np.abs(seen - np.median(seen, axis=0)).mean(axis=(1, 2))
            for seen in map(np.array, self._rays.values())
        ]
        motion = self._camera.focal * max(
            (float(o.max()) for o in off), default=0.0
        )
        samples = [
            MarkerSample(s.time, s.point, to_frame.apply(s.position))
            for s in self._seen
        ]
        notes = [f"board: {self._unusual}"] if self._unusual else []
        if self._duplicates:
            notes.append(
                f"ids {', '.join(map(str, sorted(self._duplicates)))} were seen more than"
                " once in an image and left out there"
            )
        return Tracks(frame, samples, self._images, motion, notes)

    def _locate(self, found: Detection, index: int) -> Array | None:
        """Middle of a marker (3,) m in the optical frame; None without a pose."""
        pose = board_poses(
            self._marker, found.rays[index], self._noise, self._camera
        )
        if (
            pose is None
            or pose.error * self._camera.focal > self._settings.error_max
        ):
            return None
        return pose.transform.position

    def _camera_in_odom(self) -> Transform | None:
        """Optical frame in odom, from the median rays of the board with most markers; or None."""
        if not self._boards:
            return None
        rays = {
            number: np.median(seen, axis=0)
            for number, seen in self._rays.items()
        }
        board = max(
            self._boards,
            key=lambda board: len(rays.keys() & board.corners.keys()),
        )
        ids = sorted(rays.keys() & board.corners.keys())
        if len(ids) < FEWEST:
            return None
        pose = board_poses(
            np.concatenate([board.corners[number] for number in ids]),
            np.concatenate([rays[n] for n in ids]),
            self._noise,
        )
        if pose is None or pose.ratio < self._settings.ambiguity:
            return None
        if (
            error := pose.error * self._camera.focal
        ) > self._settings.error_max:
            raise CameraError(
                f"reprojection error of the board {error:.2f} px, limit"
                f" {self._settings.error_max:g} px: wrong calibration, a moving camera, or a"
                " board other than in vision.yaml"
            )
        self._unusual = unusual(error, self._settings)
        return board.pose @ pose.transform.inverse


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Track a film and write the tracks; returns lines on them.

    Raises FilmError, CameraError, ConfigError, OSError.
    """
    cv2.setNumThreads(1)
    silence_opencv()
    settings = read_vision()
    tracks = track_film(
        options.film,
        _camera(options, settings, progress),
        settings,
        rate=options.rate,
        topic=options.topic,
        tell=partial(progress, f"tracking {options.film}"),
    )
    samples = (
        of_leg(tracks.samples, options.leg) if options.leg else tracks.samples
    )
    if not samples:
        raise FilmError(f"{options.film}: no marker of leg {options.leg}")
    write_points(options.out, samples, [f"{POINT_FRAME}{tracks.frame}"])
    counts = Counter(s.point for s in samples)
    width = max(map(len, counts))
    return [
        f"{tracks.images} images, tracks in {tracks.frame}",
        *tracks.warnings,
        *(
            f"{point:<{width}}  in {100 * count / tracks.images:5.1f} % of the images"
            for point, count in counts.items()
        ),
    ], 0


def of_leg(samples: list[MarkerSample], leg: str) -> list[MarkerSample]:
    """The samples of the torso and of one leg, its points without its name."""
    return [
        s._replace(point=s.point.removeprefix(f"{leg}_"))
        for s in samples
        if s.point == TORSO or s.point.startswith(f"{leg}_")
    ]


def track_film(
    film: Path,
    camera: Camera,
    settings: VisionSettings,
    *,
    rate: float | None = None,
    topic: str = IMAGES,
    tell: Tell = untold,
) -> Tracks:
    """Tracks of the markers of a film, as for `read_film`; raises FilmError, CameraError."""
    frames = read_film(film, rate, topic)
    first = next(frames, None)
    if first is None:
        raise FilmError(f"{film}: no image on {topic}")
    tracker, claimed = Tracker(settings, camera), claimed_length(film)
    for number, frame in enumerate(itertools.chain([first], frames)):
        tracker.add(frame.time, frame.grey)
        tell(min(1.0, number / claimed) if claimed else 0.0)
    tracks = tracker.tracks()
    if claimed > COMPLETE * tracks.images:
        tracks.notes.append(
            f"the video says that it has {claimed} images: it is damaged"
        )
    if not tracks.samples:
        ids, other = settings.points.names, other_dictionary(first.grey)
        raise FilmError(
            f"{film}: no tracked marker in {tracks.images} images (ids {min(ids)} to"
            f" {max(ids)} of {settings.dictionary}; the first shows {other or 'no marker'})"
        )
    return tracks


def _camera(
    options: argparse.Namespace,
    settings: VisionSettings,
    progress: ProgressLine,
) -> Camera:
    if options.camera:
        return read_camera(options.camera)
    if is_bag(options.film):
        return bag_camera(options.film, options.topic)
    progress.say(
        "without --camera FILE: the nominal camera of config/vision.yaml is used"
    )
    return nominal(settings.camera)

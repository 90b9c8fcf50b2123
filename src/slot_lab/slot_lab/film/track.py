"""Tracks of the markers of a film, and their file."""

from __future__ import annotations

import argparse
import csv
import itertools
from collections import Counter
from functools import partial
from pathlib import Path

import cv2

from slot_core.progress import ProgressLine, Tell, untold
from slot_core.robot import POINT_COLUMNS, POINT_FRAME, TORSO
from slot_core.vision.camera import Camera, nominal, read_camera
from slot_core.vision.detector import other_dictionary
from slot_core.vision.settings import VisionSettings, read_vision
from slot_lab.bags.topics import IMAGES
from slot_lab.film.images import (
    FilmError,
    Frame,
    bag_camera,
    claimed_length,
    is_bag,
    read_film,
)
from slot_lab.film.tracker import MarkerSample, Tracker, Tracks

COMPLETE = 1.02  # images that a video says over those read: some estimate their length


def track(options: argparse.Namespace, progress: ProgressLine) -> list[str]:
    """Track a film and write the tracks; returns lines on them.

    Raises FilmError, CameraError, ConfigError, OSError.
    """
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # it repeats our messages
    settings = read_vision()
    tracks = track_film(
        options.film,
        _camera(options, settings, progress),
        settings,
        rate=options.rate,
        depth=options.depth,
        topic=options.topic,
        tell=partial(progress, f"tracking {options.film}"),
    )
    samples = of_leg(tracks.samples, options.leg)
    if not samples:
        raise FilmError(f"{options.film}: no marker of leg {options.leg}")
    write_tracks(options.out, samples, tracks.frame)
    return _summary(tracks, samples)


def of_leg(samples: list[MarkerSample], leg: str | None) -> list[MarkerSample]:
    """The samples of the torso and of one leg, its points without its name; all without a leg."""
    if leg is None:
        return samples
    mine = [s for s in samples if s.point == TORSO or s.point.startswith(f"{leg}_")]
    return [
        MarkerSample(s.time, s.point.removeprefix(f"{leg}_"), s.position) for s in mine
    ]


def write_tracks(path: Path, samples: list[MarkerSample], frame: str) -> None:
    """Write samples as CSV, time, point, x, y, z (s, m), after a comment that names the frame."""
    with path.open("w", newline="") as file:
        file.write(f"# {POINT_FRAME}{frame}\n")
        writer = csv.writer(file)
        writer.writerow(POINT_COLUMNS)
        for s in samples:
            writer.writerow(
                [f"{s.time:.6f}", s.point, *(f"{value:.6f}" for value in s.position)]
            )


def track_film(
    film: Path,
    camera: Camera,
    settings: VisionSettings,
    *,
    rate: float | None = None,
    depth: str = "",
    topic: str = IMAGES,
    tell: Tell = untold,
) -> Tracks:
    """Tracks of the markers of a film, as for `read_film`; raises FilmError, CameraError."""
    frames = read_film(film, rate, depth, topic)
    first = next(frames, None)
    if first is None:
        raise FilmError(f"{film}: no image on {topic}")
    tracker, claimed = Tracker(settings, camera), claimed_length(film)
    for number, frame in enumerate(itertools.chain([first], frames)):
        tracker.add(frame.time, frame.grey, frame.depth)
        tell(min(1.0, number / claimed) if claimed else 0.0)
    tracks = tracker.tracks()
    if claimed > COMPLETE * tracks.images:
        tracks.notes.append(
            f"the video says that it has {claimed} images: it is damaged"
        )
    if not tracks.samples:
        raise FilmError(
            f"{film}: no tracked marker in {_absence(tracks, settings, first)}"
        )
    return tracks


def _absence(tracks: Tracks, settings: VisionSettings, first: Frame) -> str:
    ids = settings.points.names
    text = (
        f"{tracks.images} images (ids {min(ids)} to {max(ids)} of {settings.dictionary}"
    )
    other = other_dictionary(first.grey)
    return text + (
        f"; the first shows {other})" if other else "; the first shows no marker)"
    )


def _camera(
    options: argparse.Namespace, settings: VisionSettings, progress: ProgressLine
) -> Camera:
    if options.camera:
        return read_camera(options.camera)
    if is_bag(options.film):
        return bag_camera(options.film, options.topic)
    progress.say(
        "without --camera FILE: the nominal camera of config/vision.yaml is used"
    )
    return nominal(settings.camera)


def _summary(tracks: Tracks, samples: list[MarkerSample]) -> list[str]:
    """Lines: the frame, and of each point how many images show it."""
    lines = [f"{tracks.images} images, tracks in {tracks.frame}"]
    lines += tracks.warnings
    counts = Counter(s.point for s in samples)
    width = max(map(len, counts))
    for point, count in counts.items():
        lines.append(
            f"{point:<{width}}  in {100 * count / tracks.images:5.1f} % of the images"
        )
    return lines

"""Vision on rendered images: error and CPU time of the marker tracker, a walk through images.

The film is rendered: the leg FR and the torso from 0.8 m, 1280 x 720 px, with
distortion, blur, motion and noise. Errors are taken over all its points, across and along the line of
sight of the camera. The tracker's CPU time is compared with cv2.aruco.detectMarkers on the
same images.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.estimation.filmed_robot import Stage
from benchmarks.estimation.measured_streams import WARM_UP, RecordingPlant
from benchmarks.harness import Check, Progress, Row, at_most, timed
from slot_core.arrays import Array
from slot_core.dynamics.scene import read_scene
from slot_core.geometry import Transform
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.vision.camera import nominal
from slot_core.vision.settings import VisionSettings, read_vision
from slot_core.vision.synthetic_camera import Imperfections, SyntheticCamera
from slot_lab.film.tracker import Tracker
from slot_lab.report.robot_drawing import Snapshot, snapshot

PERIOD = read_scene("marker_camera").sensors.camera.period  # s, of the images
# px, rows and columns that show robot and board
FILMED = (slice(60, 500), slice(160, 920))


def rows(quick: bool, progress: Progress) -> list[Row]:
    """Rows of the kinds `tracker` and `images`."""
    cv2.setNumThreads(1)
    progress("film of a walk")
    result = tracker_rows(read_vision(), shots(40 if quick else 150))
    duration = 4.0 if quick else 10.0
    for scene in ("flat", "marker_camera"):
        progress(f"walk of {duration:g} s in the scene {scene}")
        result.append(walk_row(scene, duration))
    return result


def shots(count: int) -> list[Snapshot]:
    """The walking robot at `count` images."""
    loop = ClosedLoop("flat", "walk", None, 0)
    return [snapshot(loop.plant.robot) for _ in loop.run(count)]


def draw_film(path: Path) -> None:
    """Write the part of an image of the film that shows robot and board."""
    settings = read_vision()
    surfaces = Stage(settings, read_robot()).surfaces(shots(1)[0])
    camera = SyntheticCamera(
        nominal(settings.camera), Imperfections(), np.random.default_rng(0)
    )
    cv2.imwrite(str(path), camera.image(surfaces)[FILMED])


def tracker_rows(
    settings: VisionSettings, walk: list[Snapshot]
) -> list[dict[str, Any]]:
    """Errors and CPU time of the tracker.

    Errors are across and along the camera's line of sight.
    """
    stage, camera = Stage(settings, read_robot()), nominal(settings.camera)
    synthetic = SyntheticCamera(
        camera, Imperfections(), np.random.default_rng(0)
    )
    tracker = Tracker(settings, camera)
    plain, truth, times = (
        cv2.aruco.ArucoDetector(
            cv2.aruco.getPredefinedDictionary(settings.dictionary_number)
        ),
        [],
        [],
    )
    for number, (now, soon) in enumerate(pairwise(walk)):
        surfaces = stage.surfaces(now, (soon, PERIOD))
        image = synthetic.image(surfaces)
        truth.append(stage.plates(now))
        plain_time = timed(plain.detectMarkers, image)[1]
        times.append((timed(tracker.add, float(number), image)[1], plain_time))
    look = Transform.of((0, 0, 0), settings.film_camera.rpy).rotation[:, 0]
    samples = tracker.tracks().samples
    off = np.array(
        [s.position - truth[round(s.time)][s.point].position for s in samples]
    )
    along = off @ look
    across = np.linalg.norm(off - along[:, None] * look, axis=1)
    cpu, stock = np.median(times, axis=0)
    return [
        {
            "kind": "tracker",
            "images": len(truth),
            "samples": len(along),
            "depth_mm": 1e3 * np.sqrt(np.mean(along**2)),
            "image_plane_mm": 1e3 * np.sqrt(np.mean(across**2)),
            "cpu_ms": 1e3 * cpu,
            "plain_ms": 1e3 * stock,
            "images_per_s": 1 / cpu,
            "ratio": np.median([own / other for own, other in times]),
        }
    ]


def walk_row(scene: str, duration: float) -> Row:
    """Velocity, drift to the side and error of the estimate of a walk."""
    loop, off = (
        ClosedLoop(scene, "walk", None, 0, make=RecordingPlant),
        list[Array](),
    )
    sim = loop.plant.robot
    for tick in loop.run(round(duration / PERIOD)):
        state = tick.estimate.state
        off.append(
            np.concatenate(
                [state[3:6] - sim.position, state[9:12] - sim.velocity]
            )
        )
    assert isinstance(loop.plant, RecordingPlant)
    rms = 1e3 * np.sqrt(
        np.mean(np.square(off[round(WARM_UP / PERIOD) :]), axis=0)
    )
    place, speed = np.sqrt(np.mean(rms.reshape(2, 3) ** 2, axis=1))
    return {
        "kind": "images",
        "scene": scene,
        **loop.plant.motion()[1],
        "position_mm": place,
        "velocity_mm_s": speed,
    }


def checks(rows: list[Row]) -> list[Check]:
    """Figures of these rows that have a goal."""
    image = next(r for r in rows if r["kind"] == "tracker")
    stock, seen = (r for r in rows if r["kind"] == "images")
    return [
        at_most(
            "tracker, image plane at 0.8 m", image["image_plane_mm"], 1.0, "mm"
        ),
        at_most("tracker, depth at 0.8 m", image["depth_mm"], 3.0, "mm"),
        at_most("tracker, CPU over that of detectMarkers", image["ratio"], 3.0),
        at_most(
            "v_x through images",
            abs(seen["v_x_mm_s"] / stock["v_x_mm_s"] - 1.0),
            0.05,
        ),
        at_most(
            "lateral error through images, beyond that of stock odometry",
            seen["lateral_mm"] - stock["lateral_mm"],
            2.0,
            "mm",
        ),
    ]

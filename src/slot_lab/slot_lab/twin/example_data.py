"""Makes the shipped example, slot_bringup/example, from a simulated walk. All of it is synthetic.

The robot of the scene `synthetic` stands for a real one: other friction, stiffness and tendons than
those of robot.yaml, in a finer simulation. RECORDED is a bag of that robot with its ground truth.
DIRECTORY gets

    walk/                    tendon angles, commands and noisy odometry, as of a real robot
    walk_markers.csv         torso and leg FL as a camera measures them: noise, own frame, own clock
    single_leg_run.csv       the paper's test of the leg, simulated with robot.yaml
    single_leg_markers.csv   the same test of the synthetic robot, as a camera measures it
"""

from __future__ import annotations

import math
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.body_points import LEG_POINTS, TORSO, at_shares
from slot_core.command_line import command_parser
from slot_core.config import ConfigError
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import Array
from slot_core.simulation.plant import make_robot
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.topics import COMMANDED, MEASURED, ODOMETRY
from slot_lab.csv_table import TableError
from slot_lab.twin.prediction import ModelParts, read_parts
from slot_lab.validation.recording import PointTrack, RecordingError, read_recording, write_points

SCENE = "synthetic"
TOPICS = (MEASURED, COMMANDED, ODOMETRY)
RATE = 30.0  # Hz, of the camera
NOISE = 1e-3  # m, of each coordinate of a marker
DRIFT = 2e-4  # of the camera's clock
TURN_DEG, SHIFT = 25.0, (0.4, -0.3, 0.02)  # of the camera's frame, which is level; m
LATE = 1.3  # s, from the start of the recording to that of the film
SEED = 13
# Angles of the single-leg test: rest, sine to the full angle, hold, cosine back (paper's scripts).
REST, PULL, HOLD, RELEASE = 1.024, 2.4, 0.2, 2.0  # s


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; ends with exit code 2 and one line on a bad input."""
    parser = command_parser("example_data", __doc__)
    parser.add_argument("recorded", type=Path, metavar="BAG", help="bag of the scene")
    parser.add_argument("directory", type=Path, metavar="DIR")
    options = parser.parse_args(arguments)
    try:
        write(options.recorded, options.directory)
    except (BagError, RecordingError, TableError, ConfigError, OSError) as error:
        parser.error(str(error))
    return 0


def write(recorded: Path, directory: Path) -> None:
    """Write the files of the example; raises what `read_recording` raises, and OSError."""
    rng = np.random.default_rng(SEED)
    directory.mkdir(parents=True, exist_ok=True)
    _copy(recorded, directory / "walk")
    truth = read_recording(recorded).points
    shown = {name: truth[name] for name in (TORSO, *(f"FL_{point}" for point in LEG_POINTS))}
    said = f"Synthetic: a simulated robot (scene {SCENE}), {1e3 * NOISE:g} mm of noise; see --help"
    write_points(directory / "walk_markers.csv", _filmed(shown, rng), [said])
    run = _single_leg(read_parts("flat"))
    model = ["Simulated: the test of the single leg with the robot of robot.yaml, on scene flat"]
    write_points(directory / "single_leg_run.csv", _rows(run), model)
    level = {"tendons.slack": [0.0] * 4}  # so that the torso does not tilt
    other = read_parts(SCENE)
    leg = _single_leg(ModelParts(other.robot, config.replace(other.scene, level), other.servo))
    write_points(directory / "single_leg_markers.csv", _filmed(leg, rng), [said])


def _copy(recorded: Path, out: Path) -> None:
    """Copy what a real robot records into a bag of its own."""
    bag = Bag(recorded)
    with tempfile.TemporaryDirectory(dir=out.parent) as scratch:
        fresh = Path(scratch, out.name)
        with BagWriter(fresh, read_record_settings()) as writer:
            for topic, time, data in bag.raw(*TOPICS):
                writer.write(topic, bag.topics[topic], time, data)
        shutil.rmtree(out, ignore_errors=True)
        fresh.rename(out)


def _filmed(points: Mapping[str, PointTrack], rng: np.random.Generator) -> dict[str, Array]:
    """Rows time, x, y, z of points as a camera measures them."""
    turn = Rotation.from_euler("z", TURN_DEG, degrees=True)
    rows = {}
    for name, track in points.items():
        t = np.arange(track.t[0] + LATE, track.t[-1], 1 / RATE)
        place = CubicSpline(track.t, track.position)(t)
        noisy = turn.apply(place) + SHIFT + rng.normal(scale=NOISE, size=place.shape)
        rows[name] = np.column_stack([(t - LATE) * (1 + DRIFT), noisy])
    return rows


def _single_leg(parts: ModelParts) -> dict[str, PointTrack]:
    """Points of a leg in the single-leg test: all four lift the torso, which stays level."""
    sim = make_robot(parts.robot, config.replace(parts.scene, {"start.tendon_angle_deg": 0.0}),
                     parts.servo)  # fmt: skip
    step = parts.scene.solver.step
    steps, limit = round(0.01 / step), parts.robot.tendon.angle_max
    t, places = [], []
    while sim.time < REST + PULL + HOLD + RELEASE:
        t.append(sim.time)
        places.append(at_shares(sim.nodes[0]))
        sim.advance(steps, np.full(4, limit * _share(sim.time)))
    table = np.array(places)
    return {name: PointTrack(np.array(t), table[:, k]) for k, name in enumerate(LEG_POINTS)}


def _share(t: float) -> float:
    """Tendon angle of the single-leg test over the largest, at t (s)."""
    if t < REST + PULL:
        return math.sin(math.pi / 2 * max(0.0, (t - REST) / PULL))
    return math.cos(math.pi / 2 * min(1.0, max(0.0, (t - REST - PULL - HOLD) / RELEASE)))


def _rows(points: Mapping[str, PointTrack]) -> dict[str, Array]:
    """Rows time, x, y, z of points, at the camera's rate."""
    every = round(1 / RATE / 0.01)
    return {k: np.column_stack([v.t, v.position])[::every] for k, v in points.items()}


if __name__ == "__main__":
    sys.exit(main())

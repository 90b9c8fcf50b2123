"""Monte Carlo samples of mass, friction, lag, pushes and noise, and the limits that each exceeds.

A sample starts at the reference with a payload that the controller's model does not contain. It is
pushed after 1 s and has the rest of its time to recover. Its parameters are uniform within `RANGES`
and depend only on the seed and the sample's index, so any sample can be run again on any machine.
Two plants: the rigid torso with lag, which follows height and speed, and the Cosserat robot under
the whole controller with the policy `forces`, which stands, on servos of the model `torque_speed`:
the default's pid has no lag of its own.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from benchmarks.perturbations.cases import DT, HEIGHT, P_Z, SPEED, tilt
from benchmarks.perturbations.rigid_torso import Body, TorsoLoop
from slot_core import config
from slot_core.control.policy import Status
from slot_core.divergence import DivergenceError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.mpc.settings import read_mpc
from slot_core.robot import Array, read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.plant import RobotSimulator

RANGES = {
    "payload": (0.0, 0.6),  # kg at the torso's centre, not in the controller's model
    "friction": (0.1, 0.8),  # of the floor; the controller assumes 0.4
    "lag": (0.01, 0.1),  # s, of the forces, or of the servos of the Cosserat robot
    "push": (0.0, 12.0),  # N on the torso's centre, horizontal
    "direction": (-math.pi, math.pi),  # rad, of the push
    "noise": (0.0, 4.0),  # factor on the sensors' noise of the scene `flat`
}
NOISES = {
    "odometry": ("position_noise", "orientation_noise", "velocity_noise", "rate_noise"),
    "imu": ("rate_noise", "acceleration_noise"),
}
DURATION, PUSH_AT, PUSH_TIME, END = 5.0, 1.0, 0.2, 1.0  # s; END: length of the final interval
LIMITS = {
    "tilt_max": 0.35,  # rad, at any time
    "sink_max": 0.022,  # m below the reference at any time: the torso reaches the floor
    "height_error": 0.010,  # m, mean over the final interval
    "tilt_end": 0.05,  # rad, mean over the final interval
    "speed_error": 0.05,  # m/s, of the mean velocity over the final interval
    "unsolved": 0.0,  # MPC cycles without a solution
    "lost": 0.0,  # 1: the simulation diverged
}
CONFIDENCE = 0.95
FIELDS = ("revision", "seed", "plant", "observer", "index", *RANGES, *LIMITS, "failed")


@dataclass(frozen=True)
class RandomSample:
    """Parameters of one sample; units as in `RANGES`."""

    plant: str
    seed: int
    observer: float  # s, time constant of the MPC's observer of mass and bias; 0: none
    index: int
    payload: float
    friction: float
    lag: float
    push: float
    direction: float
    noise: float


def draw(plant: str, seed: int, observer: float, index: int) -> RandomSample:
    """Draw the sample of an index."""
    rng = np.random.default_rng([seed, index])
    values = {name: float(rng.uniform(*limits)) for name, limits in RANGES.items()}
    return RandomSample(plant, seed, observer, index, **values)


def run_sample(sample: RandomSample) -> dict[str, Any]:
    """Run a sample: its parameters, measurements, and the limits exceeded, joined by `+`."""
    try:
        states, unsolved = RUNNERS[sample.plant](sample)
        speed = np.array([SPEED if sample.plant == "torso" else 0.0, 0.0])
        found = measure(states, speed) | {"unsolved": float(unsolved), "lost": 0.0}
    except DivergenceError:
        found = dict.fromkeys(LIMITS, math.nan) | {"lost": 1.0}
    over = [name for name, limit in LIMITS.items() if found[name] > limit]
    return asdict(sample) | found | {"failed": "+".join(over)}


def measure(states: Array, speed: Array) -> dict[str, float]:
    """The quantities in `LIMITS` of states (n, 12); `speed` (2,): reference velocity, m/s."""
    leaning, height = tilt(states[:, :3]), states[:, P_Z]
    end = states[-round(END / DT) :]
    return {
        "tilt_max": float(leaning.max()),
        "sink_max": float(HEIGHT - height.min()),
        "height_error": float(abs(end[:, P_Z].mean() - HEIGHT)),
        "tilt_end": float(leaning[-len(end) :].mean()),
        "speed_error": float(np.linalg.norm(end[:, 9:11].mean(axis=0) - speed)),
    }


def torso_states(sample: RandomSample) -> tuple[Array, int]:
    """(n, 12) states of the rigid torso, and the number of MPC cycles without a solution."""
    robot, rng = read_robot(), np.random.default_rng([sample.seed, sample.index, 1])
    mass = robot.mass + sample.payload
    torso = Body(mass, robot.inertia, robot.feet, sample.friction, sample.lag)
    state = np.zeros(12)
    state[[P_Z, 9]] = HEIGHT, SPEED
    settings = config.replace(read_mpc("forces"), {"disturbance.time": sample.observer})
    loop = TorsoLoop(robot, settings, torso, state)
    noise, push = sample.noise * _sensor_noise(), _push(sample)
    rows, unsolved = [], 0
    for k in range(round(DURATION / DT)):
        pushed = PUSH_AT <= k * DT < PUSH_AT + PUSH_TIME
        loop.torso.external[:3] = push if pushed else 0.0
        rows.append(loop.torso.state)
        measured = rows[-1] + noise * rng.normal(size=12)
        unsolved += loop.tick(lambda _, x=measured: x).status != Status.SOLVED
    return np.array(rows), unsolved


def robot_states(sample: RandomSample) -> tuple[Array, int]:
    """(n, 12) states of the Cosserat robot, and the number of MPC cycles without a solution."""
    flat = read_scene("flat")
    servo = config.replace(read_servo(), {"model": "torque_speed", "lag": sample.lag})
    sensors = {
        f"sensors.{sensor}.{name}": sample.noise * getattr(getattr(flat.sensors, sensor), name)
        for sensor, names in NOISES.items()
        for name in names
    }
    changes = {"payload.mass": sample.payload, "floor.friction": [sample.friction] * 4}
    scene = config.replace(flat, sensors | changes | {"floor.torso_friction": sample.friction})
    observer = {"policy.disturbance.time": sample.observer}
    loop = ClosedLoop("flat", "stand", np.zeros(3), sample.seed, "forces", changes=observer)
    rng = np.random.default_rng([sample.seed, sample.index, 1])
    loop.plant = RobotSimulator(read_robot(), scene, servo, rng)
    sim, push, rows, unsolved = loop.plant.robot, _push(sample), [], 0
    begin, end = round(PUSH_AT / DT), round((PUSH_AT + PUSH_TIME) / DT)
    for k, tick in enumerate(loop.run(round(DURATION / DT))):
        if k in {begin, end}:
            sim.push(push if k == begin else -push, np.zeros(3))
        rows.append(np.concatenate([sim.rpy, sim.position, sim.angular_velocity, sim.velocity]))
        unsolved += tick.plan.status != Status.SOLVED
    return np.array(rows), unsolved


RUNNERS = {"torso": torso_states, "robot": robot_states}


def _push(sample: RandomSample) -> Array:
    return sample.push * np.array([math.cos(sample.direction), math.sin(sample.direction), 0.0])


def _sensor_noise() -> Array:
    """(12,) standard deviations of the odometry of the scene `flat`, in the order of the states."""
    o = read_scene("flat").sensors.odometry
    return np.repeat([o.orientation_noise, o.position_noise, o.rate_noise, o.velocity_noise], 3)


class SampleRecord:
    """Samples of one revision, seed, plant and observer in a CSV file; results are added to it."""

    def __init__(self, path: Path, revision: str, like: RandomSample):
        """Ignore, but keep, the file's rows of other revisions, seeds, plants and observers."""
        self._path = path
        if path.exists():  # an interrupted run may have left an incomplete line
            text = path.read_text()
            path.write_text(text[: text.rfind("\n") + 1])
        names = ("seed", "plant", "observer")
        self._head = {"revision": revision} | {name: getattr(like, name) for name in names}
        ours = {name: str(value) for name, value in self._head.items()}
        self.rows = [row for row in _read(path) if ours.items() <= row.items()]

    def missing(self, count: int) -> list[int]:
        """Indices of 0 .. count-1 that are not recorded."""
        return sorted({*range(count)} - {int(row["index"]) for row in self.rows})

    def add(self, result: Mapping[str, Any]) -> None:
        """Append one result to the file at once, so that an interruption loses none."""
        row = self._head | dict(result)
        with self._path.open("a", newline="") as file:
            writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
            if file.tell() == 0:
                writer.writeheader()
            writer.writerow(row)
        self.rows.append(row)


def _read(path: Path) -> Iterator[dict[str, Any]]:
    """The rows of a file, parameters and measurements as numbers."""
    if not path.exists():
        return
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            yield {k: float(v) if k in RANGES or k in LIMITS else v for k, v in row.items()}


def interval(failures: int, count: int) -> tuple[float, float]:
    """Confidence interval of a rate by Clopper and Pearson (Biometrika 26, 1934)."""
    found = binomtest(failures, count).proportion_ci(CONFIDENCE)
    return float(found.low), float(found.high)


def summary(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rate of failure; for each limit how often it was exceeded, and at which parameters."""
    rows = list(rows)
    failed = [row for row in rows if row["failed"]]
    low, high = interval(len(failed), len(rows))
    total = {"kind": "failures", "samples": len(rows), "failed": len(failed)}
    rate = {"rate": len(failed) / len(rows), "rate_low": low, "rate_high": high}
    out = [total | rate | {"confidence": CONFIDENCE}]
    for name, limit in LIMITS.items():
        over = [row for row in rows if name in row["failed"].split("+")]
        spans = {key: _span(over, key) for key in RANGES}
        out.append({"kind": "limit", "limit": name, "at": limit, "failed": len(over)} | spans)
    return out


def _span(rows: list[Mapping[str, Any]], key: str) -> list[float]:
    """Least, median and largest value of a parameter; empty without rows."""
    return np.quantile([row[key] for row in rows], [0.0, 0.5, 1.0]).tolist() if rows else []

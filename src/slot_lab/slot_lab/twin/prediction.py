"""Prediction: recorded tendon angles on the simulated robot, from the recorded start.

Measured angles are imposed: the spool follows a cubic spline through them, whatever the
load. Each value is held for h and reached with the lag h / 2, which makes up for giving it
h / 2 too early. Commands are extrapolated at their rate until the next one and pass through
the model of the servo.

The robot settles under the first angles and is moved to the recorded place and heading. The
shapes of the legs are not measured; the run-in forgets the shapes of another start.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.arrays import Array
from slot_core.command_line import Tell, untold
from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import ServoSettings, read_servo
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.robot import (
    LEAST_NODES,
    LEG_POINTS,
    LEGS,
    TORSO,
    RobotParameters,
    at_shares,
    read_parameters,
    read_robot,
)
from slot_core.safety.rate_limiter import extrapolated
from slot_core.simulation.make_robot import make_robot
from slot_lab.bags.recorded_walk import TendonAngles, TorsoTrack
from slot_lab.csv_table import PointRow, write_points
from slot_lab.twin.strides import BagRecording, TwinSettings

LEAST_SETTLING = 1.0  # s
LONGEST_GAP = 0.06  # s, between two angles, across which a spline is drawn
# rad, by which a measured angle may exceed the range of the tendons
BEYOND = 0.1
POINT_PERIOD = 1 / 30  # s, between two written rows of a point
FREE_RPM = 1000.0  # of a spool whose angle is imposed


@dataclass(frozen=True)
class ModelParts:
    """Robot, scene and servo of a prediction."""

    robot: RobotParameters
    scene: Scene
    servo: ServoSettings


def read_parts(scene: str, parameters: str = "") -> ModelParts:
    """Robot, scene and servo of a scene, or of another set of `config/parameters` in it.

    Raises ConfigError.
    """
    floor = read_scene(scene)
    named = parameters or floor.parameters
    if parameters:
        floor = config.replace(
            floor,
            {**read_parameters(parameters, "scene"), "parameters": parameters},
            f"parameters/{parameters}.yaml: scene",
        )
    return ModelParts(read_robot(named), floor, read_servo(named))


def simulate(
    recorded: BagRecording,
    parts: ModelParts,
    settings: TwinSettings,
    tell: Tell = untold,
) -> Iterator[tuple[float, SimulatedRobot]]:
    """Yield (graph time, robot) at the start and after each hold; the robot is advanced in place.

    Raises DivergenceError, and ConfigError if it cannot be simulated with these settings.
    """
    tell(0.0)
    begin, end = recorded.span
    scene, servo = parts.scene, parts.servo
    step = scene.solver.step
    if recorded.angles.measured:
        # its spool follows the given angles
        follows = {"model": "ideal", "ideal_rpm": FREE_RPM, "backlash_deg": 0.0}
        servo = config.replace(servo, follows | {"lag": settings.hold / 2})
    commands = _commands(recorded, parts, settings, begin, end)
    sim = make_robot(
        parts.robot, config.replace(scene, {"start.settle": 0.0}), servo
    )
    sim.advance(
        round(max(scene.start.settle, LEAST_SETTLING) / step), commands[0][1]
    )
    _place(sim, recorded.motion, begin)
    yield begin, sim
    now = 0
    for until, command in commands:
        if until > now:
            sim.advance(until - now, command)
            now = until
            tell(now / commands[-1][0])
            yield begin + now * step, sim


def predict(
    recorded: BagRecording,
    parts: ModelParts,
    settings: TwinSettings,
    tell: Tell = untold,
) -> TorsoTrack:
    """The predicted motion after each hold; raises as `simulate`."""
    rows = [
        (t, *sim.position, *sim.velocity, *sim.rotation.ravel())
        for t, sim in simulate(recorded, parts, settings, tell)
    ]
    t, position, velocity, turn = np.split(np.array(rows), [1, 4, 7], axis=1)
    return TorsoTrack(
        "prediction",
        t[:, 0],
        position,
        Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat(),
        velocity,
    )


def write_predicted_points(
    recorded: BagRecording,
    parts: ModelParts,
    settings: TwinSettings,
    path: Path,
    tell: Tell = untold,
) -> None:
    """Write the predicted places of torso and leg points at 30 Hz; raises OSError.

    The CSV file has the columns time,point,x,y,z, as scripts/validate reads it. Legs of
    fewer than LEAST_NODES nodes have no points.
    """
    rows: list[PointRow] = []
    due = -np.inf
    for t, sim in simulate(recorded, parts, settings, tell):
        if t < due:
            continue
        due = t + POINT_PERIOD - settings.hold / 2
        rows.append((t, TORSO, sim.position))
        if sim.nodes.shape[1] >= LEAST_NODES:
            rows += [
                (t, f"{leg}_{name}", place)
                for leg, nodes in zip(LEGS, sim.nodes)
                for name, place in zip(LEG_POINTS, at_shares(nodes))
            ]
    write_points(path, rows, ["Predicted by scripts/twin"])


def _commands(
    recorded: BagRecording,
    parts: ModelParts,
    settings: TwinSettings,
    begin: float,
    end: float,
) -> list[tuple[int, Array]]:
    """(last step, angles (4,)) of each hold, ordered by time; the first is for settling."""
    step, limit = parts.scene.solver.step, parts.robot.tendon.angle_max
    hold, angles = max(1, round(settings.hold / step)), recorded.angles
    least, largest = angles.angle.min(), angles.angle.max()
    if least < -BEYOND or largest > limit + BEYOND:
        raise ConfigError(
            f"{recorded.name}: {angles.source} holds angles of {least:.4g} to {largest:.4g} rad,"
            f" outside [0, {limit:.4g}]"
        )
    edges = np.arange(0, int((end - begin) / step) + 1, hold)
    if angles.measured:
        rows = _spline(angles)(begin + edges * step)
    else:
        effect = np.rint(
            (angles.t + settings.command_delay - begin) / step
        ).astype(int)
        edges = np.unique(
            np.concatenate([edges, effect[(effect > 0) & (effect < edges[-1])]])
        )
        # in effect before each edge
        newest = (np.searchsorted(effect, edges, side="left") - 1).clip(min=0)
        rows = angles.angle[newest]
        if angles.rate is not None:
            age = step * (edges - hold / 2 - effect[newest])
            rows = extrapolated(rows, angles.rate[newest], age)
    return list(zip(edges.tolist(), np.clip(rows, 0.0, limit)))


def _spline(angles: TendonAngles) -> CubicSpline:
    """Angles (rad) over time (s); straight across gaps, where a spline would overshoot."""
    gaps = np.flatnonzero(np.diff(angles.t) > LONGEST_GAP)
    added = [
        np.arange(angles.t[k] + LONGEST_GAP / 2, angles.t[k + 1], LONGEST_GAP)
        for k in gaps
    ]
    t = np.union1d(angles.t, np.concatenate([angles.t[:0], *added]))
    return CubicSpline(
        t,
        np.column_stack(
            [np.interp(t, angles.t, column) for column in angles.angle.T]
        ),
    )


def _place(sim: SimulatedRobot, motion: TorsoTrack, begin: float) -> None:
    """Move the robot to the recorded place and heading, at the height of the scene's floor."""
    k = int(np.searchsorted(motion.t, begin))
    turn = Rotation.from_euler("z", motion.rpy[k, 2] - sim.rpy[2])
    sim.state.rotation[:] = turn.as_matrix() @ sim.state.rotation
    sim.state.velocity[:] = turn.apply(sim.state.velocity)
    sim.state.position[:2] = motion.position[k, :2]

"""The perturbations on the Cosserat robot under the whole controller, as far as they are possible.

The robot stands (`stand`), because the sway of a walk is larger than the perturbations. The torso's
state cannot be changed alone: if it were turned by 0.1 rad about its centre, its feet would be
18 mm below the floor. Instead

    roll, pitch    a moment pulse of three ticks, such that the peak of the torso's angle is the
                   perturbation
    p_z            a smaller tendon angle while it settles, down to the lowest height possible: the
                   torso's underside, 17 mm below its centre, rests on the floor before 10 mm
    v_x            the whole robot gets the difference from the reference, which is 0 here, not 0.08
    noise          of the odometry, on every state; nothing else is noisy
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from benchmarks.perturbations.cases import (
    DT,
    HEIGHT,
    P_Z,
    PITCH,
    ROLL,
    SPEED,
    V_X,
    PerturbedRun,
)
from slot_core import config
from slot_core.arrays import Array
from slot_core.control.policy import Status
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.plant import RobotSimulator

SEED = 0  # of the sensors' noise
PULSE_TICKS = 3
TRIAL = 0.5  # s, within which the torso's angle reaches its peak after a pulse
MOST_MOMENT = 3.0  # N m; 3.7 N m would lift two feet of four
ANGLE_TOLERANCE = 1e-3  # of a moment, N m
NOISE_FIELDS = ("position_noise", "orientation_noise", "velocity_noise", "rate_noise")


@dataclass(frozen=True)
class RealisedCase:
    """A case as inputs of the simulated robot."""

    start_angle_deg: float  # tendon angle while it settles
    moment: tuple[float, float]  # N m about x and y, over the pulse
    speed: float  # m/s added to v_x


def realise(change: Mapping[int, float], start_angle_deg: float) -> RealisedCase:
    """Inputs of a case; `start_angle_deg` is the tendon angle at the reference height."""
    angle = lowest_angle(change[P_Z]) if P_Z in change else start_angle_deg
    moment = (pulse(ROLL, change.get(ROLL, 0.0)), pulse(PITCH, change.get(PITCH, 0.0)))
    speed = change[V_X] - SPEED if V_X in change else 0.0
    return RealisedCase(angle, moment, speed)


@functools.cache
def lowest_angle(height: float) -> float:
    """Tendon angle, deg, at which the robot stands at `height` (m); 0 if it cannot be that low."""

    def above(angle_deg: float) -> float:
        scene = config.replace(
            read_scene("flat"), {"start.tendon_angle_deg": angle_deg}
        )
        plant = RobotSimulator(
            read_robot(), scene, read_servo(), np.random.default_rng(0)
        )
        return float(plant.robot.position[2]) - height

    if above(0.0) >= 0.0:
        return 0.0
    return float(
        brentq(above, 0.0, read_scene("flat").start.tendon_angle_deg, xtol=0.1)
    )


@functools.cache
def pulse(axis: int, angle: float) -> float:
    """Moment, N m, of a pulse about an axis that turns the standing torso by `angle` (rad)."""
    if angle == 0.0:
        return 0.0

    def beyond(moment: float) -> float:
        moments = (moment, 0.0) if axis == ROLL else (0.0, moment)
        realised = RealisedCase(read_scene("flat").start.tendon_angle_deg, moments, 0.0)
        rpy = states(realised, quiet(), TRIAL)[0][:, :3]
        return float(rpy[:, axis].max()) - angle

    return float(brentq(beyond, 0.0, MOST_MOMENT, xtol=ANGLE_TOLERANCE))


def quiet(noise: float = 0.0) -> Scene:
    """The scene `flat` with the same noise on every state of the odometry, and none of the IMU."""
    odometry = {f"sensors.odometry.{name}": noise for name in NOISE_FIELDS}
    imu = ("rate_noise", "rate_bias", "acceleration_noise")
    return config.replace(
        read_scene("flat"), odometry | {f"sensors.imu.{n}": 0.0 for n in imu}
    )


def states(
    realised: RealisedCase, scene: Scene, duration: float
) -> tuple[Array, list[float], int]:
    """(n, 12) true states at the ticks, costs of the MPC, number of steps without a solution."""
    scene = config.replace(scene, {"start.tendon_angle_deg": realised.start_angle_deg})
    loop = ClosedLoop("flat", "stand", np.zeros(3), SEED)
    loop.plant = RobotSimulator(
        read_robot(), scene, read_servo(), np.random.default_rng(SEED)
    )
    sim, nothing = loop.plant.robot, np.zeros(3)
    moment = np.array([*realised.moment, 0.0])
    rows, costs, infeasible = [], [], 0
    for k, tick in enumerate(loop.run(round(duration / DT))):
        if k == 0 and realised.speed:
            sim.set_motion(np.array([realised.speed, 0.0, 0.0]), nothing)
        if k in {0, PULSE_TICKS}:
            sim.push(nothing, moment if k == 0 else -moment)
        rows.append(
            np.concatenate([sim.rpy, sim.position, sim.angular_velocity, sim.velocity])
        )
        costs.append(tick.plan.report.cost)
        infeasible += tick.plan.status != Status.SOLVED
    return np.array(rows), costs, infeasible


def run_robot(
    change: Mapping[int, float], duration: float, noise: float
) -> tuple[PerturbedRun, dict[str, float]]:
    """Run a case; returns the run and the perturbations that the robot really had."""
    realised = realise(change, read_scene("flat").start.tendon_angle_deg)
    rows, costs, infeasible = states(realised, quiet(noise), duration)
    peaks, height = np.abs(rows).max(axis=0), rows[:, P_Z]
    reached = {
        "peak_roll": peaks[ROLL],
        "peak_pitch": peaks[PITCH],
        "start_height": height[0],
    }
    reached |= {"v_x_error": realised.speed}
    reached |= dict(zip(("moment_x", "moment_y"), realised.moment))
    reached |= {"final_height": height[-1], "height_error": height[-1] - HEIGHT}
    assert all(math.isfinite(value) for value in reached.values())
    return PerturbedRun.of(DT * np.arange(len(rows)), costs, rows, infeasible), reached

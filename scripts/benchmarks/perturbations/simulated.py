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

The moments and the tendon angle were found by trial; the rows of the benchmark hold what is reached.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slot_core.control.policy import Status
from slot_core.simulation.closed_loop import ClosedLoop
from slot_paper.perturbations import (
    DT,
    HEIGHT,
    NOISE,
    P_Z,
    PITCH,
    ROLL,
    SPEED,
    PerturbedRun,
)

SEED = 0  # of the sensors' noise
PULSE_TICKS = 3
ODOMETRY = ("position_noise", "orientation_noise", "velocity_noise", "rate_noise")
IMU = ("rate_noise", "rate_bias", "acceleration_noise")


@dataclass(frozen=True)
class RealisedCase:
    """A case as inputs of the simulated robot."""

    start_angle_deg: float = (
        63.0  # tendon angle while it settles; this one: at the reference
    )
    moment: tuple[float, float] = (0.0, 0.0)  # N m about x and y, over the pulse
    speed: float = 0.0  # m/s added to v_x
    noise: float = 0.0  # standard deviation on every state of the odometry, SI


CASES = {
    "Baseline": RealisedCase(),
    "Roll": RealisedCase(moment=(1.0215, 0.0)),
    "Pitch": RealisedCase(moment=(0.0, 1.2397)),
    "Height": RealisedCase(0.0),
    "Velocity": RealisedCase(speed=0.05 - SPEED),
    "Combined": RealisedCase(47.735, (0.5107, 0.6378), 0.03 - SPEED),
    "Noise": RealisedCase(noise=NOISE),
}


def run_robot(name: str, duration: float) -> tuple[PerturbedRun, Mapping[str, float]]:
    """Run a case; returns the run and the perturbations that the robot really had."""
    case, nothing = CASES[name], np.zeros(3)
    changes = {f"scene.sensors.odometry.{name}": case.noise for name in ODOMETRY}
    changes |= {f"scene.sensors.imu.{name}": 0.0 for name in IMU}
    changes["scene.start.tendon_angle_deg"] = case.start_angle_deg
    loop = ClosedLoop("flat", "stand", nothing, SEED, changes=changes)
    sim, moment = loop.plant.robot, np.array([*case.moment, 0.0])
    rows, costs, infeasible = [], [], 0
    for k, tick in enumerate(loop.run(round(duration / DT))):
        if k == 0:
            sim.push(nothing, moment)
            if case.speed:
                sim.set_motion(np.array([case.speed, 0.0, 0.0]), nothing)
        elif k == PULSE_TICKS:
            sim.push(nothing, -moment)
        state = [sim.rpy, sim.position, sim.angular_velocity, sim.velocity]
        rows.append(np.concatenate(state))
        costs.append(tick.plan.report.cost)
        infeasible += tick.plan.status != Status.SOLVED
    states = np.array(rows)
    height = states[:, P_Z]
    reached = {
        "peak_roll": np.abs(states[:, ROLL]).max(),
        "peak_pitch": np.abs(states[:, PITCH]).max(),
        "start_height": height[0],
        "v_x_error": case.speed,
        "final_height": height[-1],
        "height_error": height[-1] - HEIGHT,
    }
    times = DT * np.arange(len(states))
    return PerturbedRun.of(times, np.array(costs), states, infeasible), reached

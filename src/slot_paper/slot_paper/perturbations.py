"""The seven perturbations of the stability analysis, sections V-E and VI-E, Table IV.

Each changes the initial state of the published problem (`problem`, policy `paper_code`) on its own
linear model. The front legs change roles every 2.5 s. Fifteen steps solve and apply u_0, five hold
it. Over the first three steps every applied f_z is at least m g / 4 + 0.2 N. Problem, model and the
raised forces are those of the authors' published walk; references, initial states and cycles are
the paper's.

Interpretation and defects:
- The authors' script for the table itself is not available. The 5 ms lag of their actuators is left
  out. They solve with SCS at its default accuracy; here Clarabel computes the optimum.
- P starts Baseline at the reference, where the cost would be 0. The costs of the table are reached
  with every state zero but the perturbation.
- Pitch is ill-posed: R leaves the normal forces nearly free, and the raised steps make a cost of it.
- Neither the seed of the noise nor its clipping are published, nor the interval of mean cost and
  settling.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.mpc.model import FEET, STATES
from slot_core.robot import GRAVITY, RobotParameters
from slot_paper.gaits import pulled_leg_at
from slot_paper.problem import AXES, PaperMpcSettings, PaperProblem

HEIGHT, SPEED = 0.04, 0.08  # m, m/s: the references of the paper
DURATION = 25.0  # s
DT = 0.033  # s
SOLVED_STEPS, HELD_STEPS = 15, 5  # of a cycle
# N per leg beyond m g / 4, in the first steps
RAISED_FORCE, RAISED_STEPS = (0.2, 3)
NOISE = 0.001  # standard deviation on every state, SI
# SI, limit of states with noise; the authors' limit is unknown
MOST_STATE = 1.0
SETTLED = 0.01  # cost below which a run counts as settled
# m, rad: where the torso counts as settled
HEIGHT_BAND, TILT_BAND = (2e-3, 10e-3)
ROLL, PITCH, P_Z, V_X = 0, 1, 5, 9  # indices in the state

CASES: Mapping[str, Mapping[int, float]] = {
    "Baseline": {},
    "Roll": {ROLL: 0.1},
    "Pitch": {PITCH: 0.1},
    "Height": {P_Z: 0.01},
    "Velocity": {V_X: 0.05},
    "Combined": {ROLL: 0.05, PITCH: 0.05, P_Z: 0.02, V_X: 0.03},
    "Noise": {},
}
"""Changes of the initial state by case, by index in the state; rad, m, m/s."""

FIGURES = ("max_cost", "mean_cost", "final_cost", "settling_cost_s")
TABLE = {
    "Baseline": (4.9739, 1.1665, 0.0000, 14.553),
    "Roll": (4.9719, 1.1659, 0.0000, 14.553),
    "Pitch": (4.7920, 1.1120, 0.0000, 13.695),
    "Height": (6.2248, 1.5397, 0.0000, 14.553),
    "Velocity": (2.3827, 0.1720, 0.0000, 10.098),
    "Combined": (3.6959, 0.7873, 0.0000, 12.606),
    "Noise": (2.3828, 0.2212, 0.4943, math.nan),
}
"""Table IV: maximum, mean and final cost, settling time, s (NaN: did not settle)."""


@dataclass(frozen=True)
class PerturbedRun:
    """A perturbed run; the cost is NaN in steps without one."""

    time: Array  # (n,) s
    cost: Array  # (n,)
    height: Array  # (n,) m
    tilt: Array  # (n,) rad, between body z and the vertical
    infeasible: int  # steps without an accepted solution

    @classmethod
    def of(
        cls, time: Array, cost: Array, states: Array, infeasible: int
    ) -> PerturbedRun:
        """The run with states (n, 12)."""
        upright = np.cos(states[:, ROLL]) * np.cos(states[:, PITCH])
        tilt = np.arccos(np.clip(upright, -1.0, 1.0))
        return cls(time, cost, states[:, P_Z], tilt, infeasible)

    def metrics(self) -> dict[str, float]:
        """The paper's metrics, and the time after which the torso stays level at the height."""
        high = np.abs(self.height - HEIGHT) < HEIGHT_BAND
        return {
            "max_cost": float(np.nanmax(self.cost)),
            "mean_cost": float(np.nanmean(self.cost)),
            "final_cost": float(self.cost[-1]),
            "settling_cost_s": settling_time(self.time, self.cost < SETTLED),
            "settling_s": settling_time(
                self.time, high & (self.tilt < TILT_BAND)
            ),
            "infeasible": self.infeasible,
        }


def settling_time(time: Array, inside: Any) -> float:
    """First time from which `inside` (n,) holds to the end; NaN if it does not hold at the end."""
    first = len(inside) - int(np.argmin(np.append(inside[::-1], False)))
    return float(time[first]) if first < len(time) else math.nan


def reference() -> Array:
    """(12,) the paper's reference."""
    target = np.zeros(STATES)
    target[[P_Z, V_X]] = HEIGHT, SPEED
    return target


def run_published(
    robot: RobotParameters,
    settings: PaperMpcSettings,
    case: str,
    duration: float = DURATION,
    seed: int = 1,
) -> PerturbedRun:
    """Run a case over whole cycles of 15 solved and 5 held steps; `seed`: of its noise."""
    noise = np.random.default_rng(seed) if case == "Noise" else None
    return run_change(robot, settings, CASES[case], duration, noise)


def run_change(  # noqa: PLR0917
    robot: RobotParameters,
    settings: PaperMpcSettings,
    change: Mapping[int, float],
    duration: float,
    noise: np.random.Generator | None = None,
    raised: float = RAISED_FORCE,
) -> PerturbedRun:
    """Run a change of the initial state; `noise` is added to the state.

    raised: N, by which every leg pushes beyond m g / 4, at least, in the first steps.
    """
    problem = PaperProblem(robot, settings)
    model, target = problem.predict(DT), reference()
    least = problem.mass * GRAVITY / FEET + raised
    cycle = SOLVED_STEPS + HELD_STEPS
    state, force = np.zeros(STATES), np.zeros((FEET, AXES))
    state[list(change)] = list(change.values())
    times, costs, states, infeasible = [], [], [], 0
    for step in range(int(duration / (cycle * DT)) * cycle):
        if step % cycle < SOLVED_STEPS:
            problem.set(state, target, pulled_leg_at(step * DT), DT)
            found = problem.solve()
            infeasible += bool(found.fault)
            force = problem.forces(found.z)[0]
            times.append(step * DT)
            costs.append(problem.cost(found.z))
            states.append(state)
        if step < RAISED_STEPS:
            force[:, 2] = np.maximum(force[:, 2], least)
        state = model.a @ state + model.b @ force.ravel() + model.drift
        if noise is not None:
            state = state + NOISE * noise.normal(size=STATES)
            state = np.clip(state, -MOST_STATE, MOST_STATE)
    return PerturbedRun.of(
        np.array(times), np.array(costs), np.array(states), infeasible
    )

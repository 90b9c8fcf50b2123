"""States and previews that are hard for the MPC's solvers."""

import dataclasses
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitCommand, GaitPreview, read_gaits

HEIGHT = 0.04  # m, of the standing torso
LOAD = 5.2  # N, about a quarter of the weight
DT = read_gaits().dt  # s, of a stage

Case = tuple[Estimate, GaitPreview]


def state(
    rpy: Any = (0, 0, 0),
    p: Any = (0, 0, HEIGHT),
    omega: Any = (0, 0, 0),
    v: Any = (0, 0, 0),
) -> Array:
    """(12,) state [rpy, p, omega, v]; rad, m, rad/s, m/s."""
    return np.concatenate([rpy, p, omega, v]).astype(float)


def torso(**parts: Any) -> Estimate:
    """A known state from the parts that `state` takes."""
    return Estimate.exact(state(**parts))


def standing(stages: int, **changes: Any) -> GaitPreview:
    """Preview of standing still on four feet; `changes` replace fields, arrays as (stages, ...)."""
    values: dict[str, Any] = {
        "stamp": 0,
        "contact": np.ones((stages, 4), dtype=bool),
        "friction": np.full((stages, 4), 0.4),
        "normal_force": np.full((stages, 4), LOAD),
        "tendon_angle": np.ones((stages, 4)),
        "reference": np.tile(state(), (stages, 1)),
        "dt": DT,
        "velocity_ahead": np.zeros((stages, 3)),
        "corrected": True,
        "command": GaitCommand(
            "stand", np.zeros(3), np.array([HEIGHT, 0.0, 0.0])
        ),
    }
    return GaitPreview(
        gait="stand", phase=0.0, period=0.72, **(values | changes)
    )


def hard_cases(stages: int) -> dict[str, Case]:
    """Cases by name; every case has a solution."""
    zeros, none = np.zeros((stages, 4)), np.zeros((stages, 4), dtype=bool)
    swing = np.ones((stages, 4), dtype=bool)
    swing[stages // 3 : 2 * stages // 3, 1] = False
    lifted, diagonal = (
        np.tile(feet, (stages, 1)) for feet in ([1, 0, 1, 1], [1, 0, 0, 1])
    )
    landing = np.repeat(np.arange(stages) >= stages // 2, 4).reshape(stages, 4)
    moving = torso(
        rpy=(0.02, -0.01, 0.2),
        p=(0, 0, 0.05),
        omega=(0.1, 0, 0),
        v=(0.1, 0.05, 0),
    )
    stance = standing(stages)
    return {
        "low": (torso(p=(0, 0, 0.01)), stance),
        "tilt of 0.5 rad": (torso(rpy=(0.5, -0.5, 0)), stance),
        "on its side": (torso(rpy=(1.5, 0, 0)), stance),
        "turned by 1 rad": (torso(rpy=(0.1, 0.05, 1.05)), stance),
        "height of 1000 m": (torso(p=(0, 0, 1e3)), stance),
        "depth of 1000 m": (torso(p=(0, 0, -1e3)), stance),
        "falling": (torso(v=(0, 0, -1.0)), stance),
        "spinning": (torso(omega=(2.0, -2.0, 1.0)), stance),
        "sliding": (torso(v=(1.0, -1.0, 0)), stance),
        "no friction": (moving, standing(stages, friction=zeros)),
        "hardly any friction": (
            moving,
            standing(stages, friction=zeros + 1e-6),
        ),
        "friction of 100": (moving, standing(stages, friction=zeros + 100.0)),
        "flight": (moving, standing(stages, contact=none)),
        "flight, then landing": (moving, standing(stages, contact=landing)),
        "a leg swings": (moving, standing(stages, contact=swing)),
        "a leg is lifted": (moving, standing(stages, contact=lifted)),
        "diagonal stance": (moving, standing(stages, contact=diagonal)),
        "load above the limit": (
            moving,
            standing(stages, normal_force=zeros + 15.0),
        ),
        "long stages": (moving, standing(stages, dt=0.09)),
        "short stages": (moving, standing(stages, dt=0.001)),
    }


def random_case(rng: np.random.Generator, stages: int) -> Case:
    """Random state, contacts, friction (0 to 0.8), normal forces and reference."""
    yaw = rng.uniform(-np.pi, np.pi)
    x = torso(
        rpy=(*rng.normal(0, 0.1, 2), yaw),
        p=(*rng.normal(0, 0.1, 2), rng.uniform(0.01, 0.12)),
        omega=rng.normal(0, 0.5, 3),
        v=rng.normal(0, 0.15, 3),
    )
    reference = np.tile(
        state(rpy=(0, 0, yaw + rng.normal(0, 0.2))), (stages, 1)
    )
    reference += np.linspace(0, 1, stages)[:, None] * rng.normal(0, 0.1, 12)
    return x, standing(
        stages,
        contact=rng.random((stages, 4)) < rng.choice([0.5, 0.8, 1.0]),
        friction=rng.uniform(0.0, 0.8, (stages, 4)),
        normal_force=rng.uniform(0.0, 8.0, (stages, 4)),
        reference=reference,
    )


def stretched(preview: GaitPreview, stages: int) -> GaitPreview:
    """The preview repeated periodically over `stages` stages."""
    rows = np.arange(stages) % len(preview.contact)
    names = ("contact", "friction", "normal_force", "tendon_angle", "reference")
    arrays: dict[str, Any] = {
        name: np.asarray(getattr(preview, name))[rows] for name in names
    }
    return dataclasses.replace(preview, **arrays)

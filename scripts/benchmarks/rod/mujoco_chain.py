"""MuJoCo's hinge chain as a peer of the rod: links in a plane with springs and dampers."""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import fsolve

from benchmarks.harness import cpu_time
from benchmarks.rod.exact import LEG, PUSH, TPU
from benchmarks.rod.release import DAMPED, DURATION, SAMPLES, percent
from slot_core.robot import Array

STEPS = (1e-3, 5e-4, 2e-4)  # at 2 ms the chain is unstable
LINKS = (10, 20, 30, 60)


def rows(exact: Array, repeats: int) -> Iterator[dict[str, Any]]:
    """The release test over the number of links and the time step."""
    for links, h in itertools.product(LINKS, STEPS):
        tip, start, cost = release(links, h, repeats)
        yield {
            "kind": "release",
            "simulator": "MuJoCo hinge chain",
            "version": mujoco.__version__,
            "physics": DAMPED.name,
            "nodes": links + 1,
            "h": h,
            "percent": percent(tip, exact, start),
            "cpu_s": cost,
        }


def release(links: int, h: float, repeats: int) -> tuple[Array, Array, float]:
    """Tip (SAMPLES, 2) of the released chain, m; its start (2,), m; CPU s per simulated s."""
    spring = springs(links)
    model = mujoco.MjModel.from_xml_string(description(h, spring))
    data, bent = mujoco.MjData(model), equilibrium(spring)
    every = round(DURATION / h) // SAMPLES
    tip = np.zeros((SAMPLES, 2))

    def run() -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = bent
        for sample in tip:
            mujoco.mj_step(model, data, every)
            mujoco.mj_kinematics(model, data)
            sample[:] = data.site_xpos[0, [0, 2]]

    run()
    if any(warning.number for warning in data.warning):  # MuJoCo resets a simulation that diverges
        tip[:] = math.nan
    angle = -np.cumsum(bent)
    start = LEG.length / links * np.array([np.cos(angle).sum(), np.sin(angle).sum()])
    return tip, start, cpu_time(run, repeats).median / DURATION


def springs(links: int) -> Array:
    """(links,) stiffness of the hinges, N m/rad; that at the clamp stands for half a cell."""
    at = np.arange(links) / links
    at[0] = 0.25 / links
    extent = np.full(links, LEG.length / links)
    extent[0] /= 2
    return TPU.young_modulus * LEG.section.second_moment(at) / extent


def equilibrium(spring: Array) -> Array:
    """(links,) hinge angles under the force PUSH, rad; positive turns x towards -z."""
    link = LEG.length / len(spring)

    def moments(turn: Array) -> Array:
        angle = -np.cumsum(turn)
        arm = np.cumsum((link * np.cos(angle))[::-1])[::-1]  # from each hinge to the tip
        return spring * turn + arm * PUSH.force[1]

    solution: Array = fsolve(moments, np.zeros(len(spring)), xtol=1e-12)
    return solution


def description(h: float, spring: Array) -> str:
    """The chain in MuJoCo's XML."""
    links, link, width = len(spring), LEG.length / len(spring), LEG.section.width
    area = LEG.section.area((np.arange(links) + 0.5) / links)
    body = f'<site name="tip" pos="{link} 0 0" size="0.001"/>'
    for i in reversed(range(links)):
        body = (
            f'<body pos="{link if i else 0} 0 0"><joint type="hinge" axis="0 1 0" '
            f'stiffness="{spring[i]}" damping="{spring[i] * TPU.damping_time}"/>'
            f'<geom type="box" size="{link / 2} {width / 2} {area[i] / width / 2}" '
            f'pos="{link / 2} 0 0" mass="{TPU.density * area[i] * link}" '
            f'contype="0" conaffinity="0"/>{body}</body>'
        )
    option = f'<option timestep="{h}" integrator="implicitfast" gravity="0 0 0"/>'
    return f'<mujoco><compiler angle="radian"/>{option}<worldbody>{body}</worldbody></mujoco>'

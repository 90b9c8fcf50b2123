"""MuJoCo's hinge chain as a peer of the rod: rigid links with three hinges each.

Its limit of many links is the rod without stretch whose sections have inertia about all axes. What
our own chain has is given to it too: the hinges' weights of fourth order, and links with the mass and
inertia of the tapered leg. A
joint's damping is its stiffness times the damping time, integrated implicitly by `implicitfast`;
contacts and constraints are switched off. The order of a joint's hinges is reversed from link to
link: with the same order everywhere the error is of first order in the links' length (20 links
.43 % instead of .20 %).
"""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import fsolve

from benchmarks.harness import cpu_time
from benchmarks.rod.release import (
    DAMPED,
    DURATION,
    LEG,
    PUSH,
    SAMPLES,
    TPU,
    percent,
    release_row,
)
from slot_core.arrays import Array
from slot_core.dynamics.rod import weights
from slot_core.rod.mesh import sections

STEPS = (1e-3, 5e-4, 2e-4, 1e-4)  # at 2 ms the chain is unstable
# by `quick`
LINKS = {True: (4, 6, 8, 12, 16, 20), False: (4, 6, 8, 10, 12, 16, 20, 24, 30)}
FINE = (16, 32)  # links, for its own converged motion
FINE_STEPS = (1e-4, 5e-5)
MEANINGFUL = 30.0  # percent; a row with a larger error has diverged or rings
AXES = np.eye(3)  # twist, in the plane, sideways


def rows(quick: bool, repeats: int) -> Iterator[dict[str, Any]]:
    """The release test over the number of links and the time step."""
    exact = converged()
    for links, h in itertools.product(LINKS[quick], STEPS):
        motion, start, cost = release(links, h, repeats)
        error = percent(motion, exact, start)
        if not error < MEANINGFUL:
            error = cost = math.nan
        yield release_row(
            "MuJoCo hinge chain",
            DAMPED,
            links + 1,
            h=h,
            percent=error,
            cpu_s=cost,
            version=mujoco.__version__,
        )


def converged() -> Array:
    """(SAMPLES, 3) tip, extrapolated to steps (first order) and links (second order) of zero."""
    few, many = (
        2 * release(links, FINE_STEPS[1], 0)[0]
        - release(links, FINE_STEPS[0], 0)[0]
        for links in FINE
    )
    return (4 * many - few) / 3


def release(links: int, h: float, repeats: int) -> tuple[Array, Array, float]:
    """Tip (SAMPLES, 3) of the released chain, m; its start (3,), m; CPU s per simulated s."""
    model = mujoco.MjModel.from_xml_string(description(links, h))
    data = mujoco.MjData(model)
    bent = equilibrium(model, data)
    start = data.site_xpos[0].copy()
    every = round(DURATION / SAMPLES / h)
    tip = np.zeros((SAMPLES, 3))

    def run() -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = bent
        for sample in tip:
            mujoco.mj_step(model, data, every)
            mujoco.mj_kinematics(model, data)
            sample[:] = data.site_xpos[0]

    run()
    # MuJoCo resets a simulation that diverges
    if any(warning.number for warning in data.warning):
        tip[:] = math.nan
    elif repeats:
        return tip, start, cpu_time(run, repeats) / DURATION
    return tip, start, math.nan


def equilibrium(model: Any, data: Any) -> Array:
    """(3 links,) hinge angles under the force PUSH, rad."""
    jacobian = np.zeros((3, model.nv))

    def imbalance(angles: Array, factor: float) -> Array:
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacSite(model, data, jacobian, None, 0)
        return model.jnt_stiffness * angles - jacobian.T @ (
            factor * np.array(PUSH.force)
        )

    angles = np.zeros(model.nv)
    for factor in (0.5, 1.0):
        angles, _, status, message = fsolve(
            imbalance, angles, (factor,), xtol=1e-10, full_output=True
        )
    if status != 1:
        raise ArithmeticError(f"no equilibrium of MuJoCo's chain: {message}")
    return angles


def description(links: int, h: float) -> str:
    """The chain in MuJoCo's XML; axes x, y, z as the rod's."""
    arc = np.linspace(0.0, LEG.length, links + 1)
    link, hinge = LEG.length / links, sections(TPU, LEG, arc)
    spring = np.array([hinge.torsion, hinge.bending, hinge.lateral]) / weights(
        np.diff(arc)
    )
    body = f'<site name="tip" pos="{link} 0 0" size="0.001"/>'
    for i in reversed(range(links)):
        joints = "".join(
            f'<joint type="hinge" axis="{axis[0]:g} {axis[1]:g} {axis[2]:g}" stiffness="{k}" '
            f'damping="{k * TPU.damping_time}"/>'
            for axis, k in list(zip(AXES, spring[:, i]))[:: 1 if i % 2 else -1]
        )
        body = f'<body pos="{link if i else 0} 0 0">{joints}{inertial(arc[i], link)}{body}</body>'
    option = (
        f'<option timestep="{h}" integrator="implicitfast" gravity="0 0 0">'
        '<flag contact="disable" constraint="disable"/></option>'
    )
    return f'<mujoco><compiler angle="radian"/>{option}<worldbody>{body}</worldbody></mujoco>'


def inertial(begin: float, link: float) -> str:
    """Mass, centre and inertia of the tapered link that begins at an arc length, m."""
    x, weight = np.polynomial.legendre.leggauss(6)
    x, weight = link * (x + 1) / 2, link * weight / 2
    part = sections(TPU, LEG, begin + x)
    mass, spin = float(weight @ part.mass), float(weight @ part.spin)
    centre = float(weight @ (part.mass * x)) / mass
    across = float(weight @ (part.mass * (x - centre) ** 2))
    inner = float(weight @ part.bending) * TPU.density / TPU.young_modulus
    inertia = f"{spin} {across + inner} {across + spin - inner}"
    return (
        f'<inertial pos="{centre} 0 0" mass="{mass}" diaginertia="{inertia}"/>'
    )

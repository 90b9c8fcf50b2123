"""Tabulates a gait on the simulated robot: normal forces, torso sway and forward speed.

The gait runs open loop. Once the motion is periodic, the normal forces and the motion of the torso
are fitted by least squares with a mean and two harmonics of the phase. The output is the part of
`config/gait.yaml` that follows from a gait's tendon angles.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slot_core.config import ConfigError
from slot_core.control.gait import Gait, read_gaits
from slot_core.control.reference import rotate
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulated_robot import Divergence, SimulatedRobot
from slot_core.robot import Array, read_robot
from slot_core.simulation.plant import make_robot

SAMPLE_STEPS = 3  # time steps between samples
WARM_UP_STRIDES = 6
STRIDES_MAX = 1000
AMPLITUDES = (0.0, 0.143, 0.286, 0.5, 0.714, 0.857, 1.0)
SWAY = ("roll", "pitch", "height", "v_x", "v_y")


@dataclass(frozen=True)
class GaitTable:
    """Response of the simulated robot to a gait; coefficients m, c1, s1, c2, s2."""

    normal_force: Array  # (4, 5) N
    sway: Array  # (5, 5) roll, pitch (rad), height (m), v_x, v_y about their mean (m/s)
    speed: float  # m/s, mean along the mean heading


def tabulate(
    sim: SimulatedRobot, gait: Gait, amplitude: float, hold: float, strides: int
) -> GaitTable:
    """Run the gait open loop and fit `strides` strides; each command is held for `hold` (s)."""
    phase, samples, track = _run(sim, gait, amplitude, hold, strides)
    heading = np.full(len(track), track[:, 3].mean())
    samples[:, 7:9] = rotate(samples[:, 7:9], -heading)
    p = 2 * np.pi * phase
    basis = np.column_stack([np.ones_like(p), np.cos(p), np.sin(p), np.cos(2 * p), np.sin(2 * p)])
    fit = np.linalg.lstsq(basis, samples, rcond=None)[0]
    table = fit.T.copy()
    table[7:9, 0] = 0.0
    distance = rotate((track[-1:, 1:3] - track[:1, 1:3]), -heading[:1])[0, 0]
    speed = distance / (track[-1, 0] - track[0, 0])
    return GaitTable(table[:4], table[4:], float(speed))


def _run(
    sim: SimulatedRobot, gait: Gait, amplitude: float, hold: float, strides: int
) -> tuple[Array, Array, Array]:
    """Samples once the motion is periodic.

    Returns phases (n,); four normal forces, roll, pitch, height, v_x, v_y (n, 9); time, x, y, yaw
    (n, 4). SI units, frame odom.
    """
    phases, samples, track = [], [], []
    while sim.time < (WARM_UP_STRIDES + strides) * gait.period:
        now = sim.time - sim.time % hold
        command = gait.course(np.array([now / gait.period % 1]), amplitude)[0, :4]
        sim.advance(SAMPLE_STEPS, command)
        if sim.time >= WARM_UP_STRIDES * gait.period:
            rpy, position, velocity = sim.rpy, sim.position, sim.velocity
            phases.append(sim.time / gait.period % 1)
            samples.append([*sim.ground_force[:, 2], *rpy[:2], position[2], *velocity[:2]])
            track.append([sim.time, *position[:2], rpy[2]])
    return np.array(phases), np.array(samples), np.array(track)


def yaml_lines(table: GaitTable, speeds: Sequence[float]) -> list[str]:
    """Lines of the gait's entry in `config/gait.yaml`; `speeds` (m/s), one for each amplitude."""

    def row(values: Sequence[float] | Array) -> str:
        return "[" + ", ".join(f"{value:.4g}" for value in values) + "]"

    return [
        f"    speed: {row(speeds)}",
        f"    amplitude: {row(AMPLITUDES)}",
        "    normal_force:",
        *(f"      - {row(values)}" for values in table.normal_force),
        "    sway:",
        *(f"      {name}: {row(values)}" for name, values in zip(SWAY, table.sway)),
    ]


def _strides(text: str) -> int:
    strides = int(text)
    if not 1 <= strides <= STRIDES_MAX:
        raise argparse.ArgumentTypeError(f"{text}: outside [1, {STRIDES_MAX}]")
    return strides


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/tabulate_gait`; prints YAML."""
    parser = argparse.ArgumentParser(prog="scripts/tabulate_gait", description=__doc__)
    parser.add_argument("gait", help="a gait of config/gait.yaml")
    parser.add_argument("--scene", default="flat", help="a scene of config/scene (default: flat)")
    parser.add_argument("--strides", type=_strides, default=20, help="strides (default: 20)")
    options = parser.parse_args(arguments)
    tables = []
    try:
        settings, scene = read_gaits(), read_scene(options.scene)
        gait = settings.find(options.gait)
        for amplitude in AMPLITUDES:
            print(f"amplitude {amplitude}", file=sys.stderr)
            sim = make_robot(read_robot(), scene, read_servo())
            tables.append(tabulate(sim, gait, amplitude, settings.dt, options.strides))
    except (ConfigError, Divergence) as error:
        print(f"scripts/tabulate_gait: {error}", file=sys.stderr)
        return 2
    print("\n".join(yaml_lines(tables[-1], [table.speed for table in tables])))
    return 0


if __name__ == "__main__":
    sys.exit(main())

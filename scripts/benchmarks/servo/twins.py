"""The same walk with servos of three kinds, on one simulated clock, and their distance.

sim    servo.yaml, as with `--hardware sim`: the emulated servos' loop and motor, no bus, no counts
line   the motor's torque-speed line with a first-order lag, whose angle does not sag under load
bus    driver, bus and emulated servos, as with `--hardware fake_bus`
"""

from __future__ import annotations

import dataclasses

import numpy as np

from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamixel.settings import read_settings
from slot_core.emulator.emulated_bus import read_emulator
from slot_core.robot import Array, Robot
from slot_core.simulation.closed_loop import ClosedLoop, PlantMaker
from slot_core.simulation.driven_plant import DrivenPlant
from slot_core.simulation.plant import Plant

VELOCITY = (0.05, 0.0, 0.0)  # m/s, m/s, rad/s: the walk's cruise
BUS_PERIOD = 0.01  # s, of a bus cycle, as in the driver's node


def _line(robot: Robot, scene: Scene, servo: ServoSettings, rng: np.random.Generator) -> Plant:
    return Plant(robot, scene, dataclasses.replace(servo, model="torque_speed"), rng)


def _bus(robot: Robot, scene: Scene, servo: ServoSettings, rng: np.random.Generator) -> Plant:
    return DrivenPlant(
        robot,
        scene,
        servo,
        rng,
        settings=read_settings(),
        emulator=read_emulator(),
        period=BUS_PERIOD,
    )


PLANTS: dict[str, PlantMaker] = {"sim": Plant, "line": _line, "bus": _bus}


def walk(make: PlantMaker, ticks: int, seed: int = 0) -> Array:
    """(ticks, 3) m, positions of the torso's centre in odom, one at every odometry reading."""
    loop = ClosedLoop("flat", "walk", np.array(VELOCITY), seed, make=make)
    return np.array([loop.plant.simulator.position for _ in loop.run(ticks)])


def rms_distance(one: Array, other: Array) -> float:
    """RMS distance of two paths (n, 3), m, without alignment."""
    return float(np.sqrt(np.mean(np.sum((one - other) ** 2, axis=1))))

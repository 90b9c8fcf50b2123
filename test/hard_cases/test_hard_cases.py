"""Hard cases of the simulator of the whole robot: their families, limits, and the run of one.

Every case runs at its time step h and at h/2, and must stay finite. `Limits` bound the energy over
the servos' work, the depth to which nodes and torso sink into the floor, and the difference between
the two solutions. The step control of `dynamics/integrator.py` keeps a case within them; a
`StressRecord` counts how often it acted.

If a node reaches the floor within a step, the theta scheme ends that step up to (1 - theta) v h
below the floor, v being the speed of the fall, with the energy k/2 ((1 - theta) v h)^2 in each
contact. It lasts until the rebound; `landing` bounds it.

A torso that falls on its corners sinks in like a mass on a spring: `bottom`, in mm.

The difference between the solutions at h and h/2 is the error of a first-order scheme where
contacts open and close. The limits are about 1.5 times the measured values, in `DROP` 1.5 times the
largest of its cases.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from leg_energy import robot_energy

from slot_core import config
from slot_core.arrays import Array
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, read_robot
from slot_core.simulation.rod_robot import RodRobot

Changes = Mapping[str, Any]
STANDING_DEG = 63.0
TILT_ARM = 0.1  # m, lever by which a tilt counts as a displacement
# Not the servo of servo.yaml: impacts do not repeat themselves, and the limits would change with it.
SERVO = ServoSettings(
    model="pid",
    lag=0.02,
    voltage=(11.1,),
    stall_torque=(1.4,),
    no_load_rpm=(57.0,),
    nominal_voltage=11.1,
    continuous_load=0.2,
    ideal_rpm=57.0,
    servo_per_tendon=1.0,
    proportional=14.253,
    integral=0.0,
    derivative=0.19,
    motor_time=0.01,
    backlash_deg=0.0,
)
FULL_DEG = read_robot().tendon.angle_max_deg
CONTACTS = 8  # two nodes per leg
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
SLACK = {"start.tendon_angle_deg": 0.0}
HALF_TURN = {"tendon.angle_max_deg": 180.0}


@dataclass(frozen=True)
class Limits:
    """Limits of a case."""

    gained: float  # J, energy beyond the initial one and the servos' work
    sunk: float  # mm, depth in the floor
    apart: float  # mm, between the answers at h and h/2, at any time


def hold(degrees: float) -> Callable[[float], Array]:
    """Command of four equal tendon angles at all times."""
    return lambda _: np.full(4, math.radians(degrees))


@dataclass(frozen=True)
class StressCase:
    """Changes of `robot.yaml` and of the scene `flat`, start, commands and limits of a case."""

    limits: Limits
    scene: Changes
    robot: Changes = field(default_factory=dict)
    # changes the initial state
    start: Callable[[RodRobot], Any] = lambda _: None
    # (4,) rad at a time, s
    command: Callable[[float], Array] = hold(STANDING_DEG)
    seconds: float = 0.6
    step: float = 1e-3  # s, h


@dataclass(frozen=True)
class StressRecord:
    """Measurements at h; `apart` compares with h/2."""

    lost: str  # cause of the divergence; empty: none
    gained: float  # J
    sunk: float  # mm
    apart: float  # mm
    halvings: int
    unconverged: int

    def holds(self, limits: Limits) -> bool:
        """Whether the case stayed finite and within the limits."""
        within = self.gained <= limits.gained and self.sunk <= limits.sunk
        return not self.lost and within and self.apart <= limits.apart


def examine(case: StressCase) -> StressRecord:
    """Run a case at h and at h/2, and record it."""
    coarse, fine = (
        MeasuredRun(case, case.step),
        MeasuredRun(case, case.step / 2),
    )
    apart, lost = math.inf, ""
    try:
        paths = [np.array(list(one.path())) for one in (coarse, fine)]
        apart = 1e3 * float(np.abs(paths[0] - paths[1]).max())
    except DivergenceError as error:
        lost = str(error)
    return StressRecord(
        lost,
        coarse.gained,
        coarse.sunk,
        apart,
        coarse.sim.halvings,
        coarse.sim.unconverged_steps,
    )


class MeasuredRun:
    """A run of a case at one time step, with the largest values of what the limits bound."""

    def __init__(self, case: StressCase, step: float) -> None:
        self._case, self._steps = case, round(case.step / step)
        # without the IMU, whose period is shorter than the longest time step
        changes = {
            **case.scene,
            "solver.step": step,
            "sensors.imu.enabled": False,
        }
        scene = config.replace(read_scene("flat"), changes)
        self.sim = RodRobot(
            config.replace(read_robot(), case.robot), scene, SERVO
        )
        case.start(self.sim)
        self.gained = self.sunk = -math.inf

    def path(self) -> Iterator[Array]:
        """Yield the torso's position and tilt times TILT_ARM (5,), m, after every h."""
        sim, budget = self.sim, robot_energy(self.sim)
        for k in range(round(self._case.seconds / self._case.step)):
            command = self._case.command(k * self._case.step)
            for _ in range(self._steps):
                before = sim.tendon_angle
                sim.advance(1, command)
                reeled = sim.parameters.tendon.spool_radius * (
                    sim.tendon_angle - before
                )
                budget += float(sim.tension @ reeled)
                if self._steps == 1:  # of the coarse run, the record's
                    self.gained = max(self.gained, robot_energy(sim) - budget)
                corners = (
                    sim.position + sim.model.torso.corners @ sim.rotation.T
                )
                lowest = min(sim.nodes[:, 1:, 2].min(), corners[:, 2].min())
                self.sunk = max(self.sunk, -1e3 * float(lowest))
            yield np.append(sim.position, TILT_ARM * sim.rotation[2, :2])


def landing(speed: float, step: float = 1e-3, stiffness: float = 2e4) -> float:
    """Bound of the contacts' energy at the end of the step of a landing, J."""
    return CONTACTS * stiffness / 2 * (0.45 * speed * step) ** 2


def bottom(
    speed: float, mass: float = 2.16, stiffness: float = 2e4, corners: int = 4
) -> float:
    """Depth to which a mass (kg) sinks that meets its corners' springs at `speed` (m/s), mm.

    A seventh more than the closed form, for the error of the time step.
    """
    weight = mass * GRAVITY / (corners * stiffness)
    return 1.15e3 * (
        weight + math.sqrt(weight**2 + speed**2 * mass / (corners * stiffness))
    )


def thrown(
    down: float, spin: tuple[float, float, float], height: float = 0.03
) -> Changes:
    """Start of a case in the air, with a speed downwards (m/s) and a spin (rad/s)."""

    def throw(sim: RodRobot) -> None:
        sim.set_motion(np.array([0.1, 0.0, -down]), np.array(spin))

    return {"start": throw, "scene": above(height)}


def above(height: float) -> Changes:
    """Scene of a case that starts at a height of the torso (m), without settling."""
    return {"start.height": height, "start.settle": 0.0}


def drop(robot: Changes | None = None, **floor_or_solver: Any) -> Changes:
    """A drop at 0.5 m/s from 30 mm with changes of the robot or the scene (`floor__friction`)."""
    case = thrown(0.5, (0.0, 0.0, 0.0))
    changes = {
        name.replace("__", "."): value
        for name, value in floor_or_solver.items()
    }
    return {**case, "robot": robot or {}, "scene": {**case["scene"], **changes}}


def wound(sim: RodRobot) -> None:
    """Set all spools to the largest tendon angle at once: the cables stretch by 17 mm and more."""
    sim.state.tendon_angle[:] = sim.parameters.tendon.angle_max


def wrung(sim: RodRobot) -> None:
    """Turn the legs about themselves by 200 deg from clamp to tip: 4 x 0.9 J."""
    state, part = sim.state, sim.model.rod.arc[1:] / sim.model.rod.arc[-1]
    along = np.diff(state.node, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    angle = np.radians(200.0) * part[:, None]
    across = np.cross(along, state.director)
    state.director[:] = np.cos(angle) * state.director + np.sin(angle) * across


def struck(sim: RodRobot) -> None:
    """Kick the legs sideways, those on the left to the left: their tips at 6 m/s."""
    part = sim.model.rod.arc / sim.model.rod.arc[-1]
    sim.state.node_velocity[:, :, 1] += (
        6.0 * part**2 * np.array([[1.0], [-1.0], [-1.0], [1.0]])
    )


def rolled(sim: RodRobot) -> None:
    """Roll the robot by 25 deg: it falls on one edge of its right legs."""
    c, s = math.cos(math.radians(25.0)), math.sin(math.radians(25.0))
    sim.state.rotation[:] = np.array(
        [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]
    )


def stretch_stiff(sim: RodRobot) -> None:
    """The drop, with a hundred times the axial stiffness at the same bending stiffness."""
    sim.model.rod.axial[:] *= 100.0
    sim.set_motion(np.array([0.1, 0.0, -0.5]), np.zeros(3))


def there_and_back(time: float) -> Array:
    """(4,) rad: 100 deg to 116 deg in 3 s and back."""
    return np.full(4, math.radians(116.0 - 16.0 * abs(time - 3.0) / 3.0))


# From 30 mm the legs fall 8 mm and the underside 13 mm, which adds 0.25 m^2/s^2 to speed squared.
IMPACTS = {
    "impact at 1 m/s": StressCase(
        Limits(landing(1.1), bottom(1.12), 3.0),
        seconds=1.0,
        **thrown(1.0, (0.5, 0.2, 0.0)),
    ),
    # It bounces to 0.4 m; one step more or less on the floor changes that by a tenth.
    "impact at 3 m/s": StressCase(
        Limits(landing(3.1), bottom(3.1), 60.0),
        seconds=1.0,
        **thrown(3.0, (0.5, 0.2, 0.0)),
    ),
    # Falls on its back or side from 0.25 m, at 2 m/s, on two corners first: 2 J each.
    **{
        f"spin of 20 rad/s about {axis}": StressCase(
            Limits(landing(2.0), bottom(2.0, corners=2), apart),
            **thrown(0.0, spin, 0.25),
            seconds=0.8,
        )
        for axis, spin, apart in zip(
            "xyz", 20.0 * np.eye(3), (15.0, 35.0, 15.0)
        )
    },
    # Falls 0.13 m onto its back and bounces: its pose after 1 s depends on every contact.
    "flipped robot": StressCase(
        Limits(landing(1.6), bottom(1.6), 35.0),
        above(0.15),
        start=lambda sim: np.copyto(sim.state.rotation, UPSIDE_DOWN),
        seconds=1.0,
    ),
}

# The servos' work is accounted for, so the energy limit covers rounding and the robot's settling.
PULLS = {
    "full pull, as fast as the servos can": StressCase(
        Limits(1e-4, 0.5, 0.2), SLACK, command=hold(FULL_DEG)
    ),
    # 40 J in the cables at once: nodes reach 9 m/s and the robot jumps.
    "full pull within one step": StressCase(
        Limits(1e-4, 4.0, 4.0), SLACK, start=wound, command=hold(FULL_DEG)
    ),
    "full pull within one step, in the air": StressCase(
        Limits(1e-4, 0.0, 0.2),
        {**SLACK, **above(2.0)},
        start=wound,
        command=hold(FULL_DEG),
        seconds=0.3,
    ),
    "pull by 180 deg": StressCase(
        Limits(1e-4, 1.0, 0.4), {}, HALF_TURN, command=hold(180.0), seconds=1.0
    ),
    "pull by 180 deg within one step": StressCase(
        Limits(1e-4, 4.0, 3.0), {}, HALF_TURN, start=wound, command=hold(180.0)
    ),
}

# A drop at 0.5 m/s: nodes reach the floor at 0.72 m/s.
DROP = Limits(landing(0.72), bottom(0.72), 5.0)
PARAMETERS = {
    **{
        f"E = {young} Pa": StressCase(
            replace(DROP, apart=apart),
            **drop({"leg.young_modulus": float(young)}),
        )
        for young, apart in {
            "1e5": 10.0,
            "1e6": 15.0,
            "1e7": 5.0,
            "1e8": 5.0,
            "1e9": 5.0,
        }.items()
    },
    "EA x 100": StressCase(DROP, **{**drop(), "start": stretch_stiff}),
    "contact of 1e5 N/m": StressCase(
        Limits(landing(0.72, stiffness=1e5), bottom(0.72, stiffness=1e5), 3.0),
        **drop(floor__stiffness=1e5, floor__line_stiffness=1.1e7),
    ),
    # Stiff edges rebound at other moments at half the step.
    "contact of 1e6 N/m": StressCase(
        Limits(0.04, bottom(0.72, stiffness=1e6), 10.0),
        **drop(floor__stiffness=1e6, floor__line_stiffness=1.1e8),
    ),
    "contact of 1e7 N/m": StressCase(
        Limits(0.04, bottom(0.72, stiffness=1e7), 35.0),
        **drop(floor__stiffness=1e7, floor__line_stiffness=1.1e9),
    ),
    "eps = 1e-4 m/s": StressCase(DROP, **drop(floor__friction_velocity=1e-4)),
    "eps = 1e-6 m/s": StressCase(DROP, **drop(floor__friction_velocity=1e-6)),
    "friction of bristles": StressCase(
        DROP, **drop(floor__friction_law="bristle")
    ),
    "tip of 1 mm": StressCase(DROP, **drop({"leg.thickness_tip": 1e-3})),
    "tip of 0.1 mm": StressCase(DROP, **drop({"leg.thickness_tip": 1e-4})),
    "torso of 0.02 kg": StressCase(DROP, **drop({"torso.mass": 0.02})),
    "torso of 20 kg": StressCase(
        replace(DROP, sunk=bottom(0.72, 20.16)), **drop({"torso.mass": 20.0})
    ),
    **{
        f"{nodes} nodes": StressCase(DROP, **drop(solver__nodes=nodes))
        for nodes in (8, 16, 31, 61, 121, 201, 401)
    },
}

# Slowly through the fold near 110 deg and back, with friction 0.4 and without friction.
BENT = {"start.tendon_angle_deg": 100.0}
FOLDS = {
    "snap-through": StressCase(
        Limits(1e-4, 0.5, 0.1), BENT, command=there_and_back, seconds=6.0
    ),
    # Without friction it snaps to one side or the other.
    "snap-through without friction": StressCase(
        Limits(1e-4, 0.5, 120.0),
        {**BENT, "floor.friction": [0.0] * 4, "floor.torso_friction": 0.0},
        command=there_and_back,
        seconds=6.0,
    ),
}

# Legs that leave their planes.
IN_SPACE = {
    "legs twisted by 200 deg": StressCase(
        Limits(landing(2.4), bottom(2.4), 15.0), above(0.3), start=wrung
    ),
    "legs kicked sideways": StressCase(
        Limits(1e-3, 3.0, 5.0), {}, start=struck
    ),
    "fall on one edge": StressCase(
        Limits(landing(1.4), bottom(1.4, corners=2), 15.0),
        above(0.16),
        start=rolled,
    ),
}

# The impact at 1 m/s; its limits grow with the time step.
STEPS = {
    f"time step of {1e3 * step:g} ms": StressCase(
        Limits(landing(1.12, step), bottom(1.12), apart),
        seconds=1.0,
        step=step,
        **thrown(1.0, (0.5, 0.2, 0.0)),
    )
    for step, apart in (
        (5e-4, 1.6),
        (2e-3, 7.0),
        (5e-3, 7.0),
        (1e-2, 13.0),
    )
}

CONVERGED = {**PULLS, **PARAMETERS, **STEPS}  # in every step
CASES = {**IMPACTS, **FOLDS, **IN_SPACE, **CONVERGED}


@pytest.mark.parametrize("name", CASES)
def test_a_hard_case_stays_within_its_limits(name):
    record = examine(CASES[name])
    assert record.holds(CASES[name].limits), record
    assert not (name in CONVERGED and record.unconverged)


@pytest.mark.parametrize(
    "name",
    ["full pull within one step, in the air", "contact of 1e7 N/m", "EA x 100"],
)
def test_the_case_diverges_without_halving(name):
    case = CASES[name]
    assert examine(case).halvings > 0
    whole = replace(case, scene={**case.scene, "solver.halvings": 0})
    assert "beyond 100.0 m/s" in examine(whole).lost

"""Invalid input is refused by name; a diverged solution reports time and place. No silent NaN.

Messages of refusals are one line, short and printable.

Functions before kernels, and others of the core, refuse arrays that a kernel could not read.
"""

import datetime
import math
import os
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from rod_robots import ROBOT, simulator

from slot_core import config
from slot_core.control.force_map import make_force_map, read_force_map
from slot_core.control.policy import TendonPlan
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.estimation.inertial_filter import (
    ImuSamples,
    InertialFilter,
    OdometryMotion,
)
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.legs.leg_table import LegSprings, LegTable, read_leg_springs
from slot_core.legs.tabulated_robot import TabulatedRobot
from slot_core.refusal import (
    LINE_MAX,
    VALUE_MAX,
    DivergenceError,
    InputError,
    printable,
    quoted,
    read_bytes,
)
from slot_core.robot import read_robot
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import (
    Geometry,
    Loads,
    Material,
    Pose,
    Rectangle,
    Support,
)
from slot_core.rollout_mpc.disturbance_observer import DisturbanceObserver
from slot_core.rollout_mpc.nominal_robot import NominalRobot
from slot_core.rollout_mpc.problem import PlanProblem
from slot_core.rollout_mpc.settings import read_rollout_mpc
from slot_core.simulation.many_robots import ManyRobots
from slot_core.simulation.rod_robot import RodRobot
from slot_core.vision.camera import nominal
from slot_core.vision.detector import MarkerDetector
from slot_core.vision.settings import read_vision
from slot_lab.leg_tests.held_leg import HeldLeg
from slot_lab.leg_tests.leg_map import StaticLeg, StickingLeg
from slot_paper.leg import PaperLegs, read_paper
from slot_paper.robot import PaperRobot


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "uneven"),
        ("1.0\n", "2 x 2"),
        ("0,nan\n0,0\n", "finite"),
        ("0,a\n0,0\n", "bad.csv"),
    ],
)
def test_an_invalid_height_map_is_refused_by_name(
    tmp_path, monkeypatch, text, message
):
    (tmp_path / "scene").mkdir()
    if text is not None:
        (tmp_path / "scene" / "bad.csv").write_text(text)
    name = "bad.csv" if text is not None else "uneven_elsewhere.csv"
    scene = config.replace(read_scene("flat"), {"floor.height_map": name})
    servo = read_servo()
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    with pytest.raises(config.ConfigError, match=message):
        RodRobot(ROBOT, scene, servo)


STILL, GOAL = [0.0, 0.0, 0.0], np.full(4, 0.5)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda sim: sim.advance(1, [0.5, 0.5, 0.5, math.inf]),
            r"inside \[0, 2\.02",
        ),
        (
            lambda sim: sim.advance(1, [0.5, -1e-6, 0.5, 0.5]),
            r"inside \[0, 2\.02",
        ),
        (
            lambda sim: sim.advance(1, [0.5, 0.5, 0.5, 2.03]),
            r"inside \[0, 2\.02",
        ),
        (lambda sim: sim.advance(1, [0.5] * 3), ""),
        (lambda sim: sim.advance(1, "pull"), ""),
        (lambda sim: sim.advance(-1, GOAL), "steps"),
        (lambda sim: sim.advance(0.5, GOAL), "steps"),
        (lambda sim: sim.push([math.nan, 0.0, 0.0], STILL), "push"),
        (lambda sim: sim.push(STILL, [0.0, math.inf, 0.0]), "push"),
        (lambda sim: sim.push([0.0, 0.0], STILL), "push"),
        (lambda sim: sim.damage_tendon(4), "leg"),
        (lambda sim: sim.damage_tendon(-1, broken=True), "leg"),
        (lambda sim: sim.damage_tendon(0, slack=-math.inf), "leg"),
    ],
)
def test_an_invalid_command_push_or_damage_is_refused_and_changes_nothing(
    act, message
):
    sim = simulator(servo={}, start__settle=0.0, start__height=0.5)
    before = sim.state.buffer.copy()
    with pytest.raises(ValueError, match=message):
        act(sim)
    np.testing.assert_array_equal(sim.state.buffer, before)
    assert sim.steps == 0


@pytest.mark.parametrize("solver", ["coarse", "map"])
def test_a_start_beyond_the_tendons_is_refused_by_name(solver):
    robot = config.replace(ROBOT, {"tendon.angle_max_deg": 58.14})
    scene = read_scene("map" if solver == "map" else "flat")
    kind = TabulatedRobot if solver == "map" else RodRobot
    with pytest.raises(
        config.ConfigError,
        match=r"start.tendon_angle_deg = 63: above .* 58\.14 deg",
    ):
        kind(robot, scene, read_servo())


@pytest.mark.parametrize("halvings", [0, 6])
@pytest.mark.parametrize(
    ("part", "index", "place"),
    [
        ("position", 1, "torso"),
        ("rotation", (0, 2), "torso"),
        ("velocity", 0, "torso"),
        ("rate", 2, "torso"),
        # NaN spreads in one step; the torso is checked first
        (
            "node",
            (2, 9, 1),
            "torso",
        ),
        ("node_velocity", (1, 21, 2), "torso"),
        # its tendon goes slack, so no node would show it
        (
            "tendon_angle",
            3,
            "leg RR node 0",
        ),
    ],
)
def test_a_nan_in_the_state_raises_divergence_with_its_place(
    halvings, part, index, place
):
    sim = simulator(servo={}, start__settle=0.0, solver__halvings=halvings)
    sim.advance(3, np.full(4, 1.0))
    getattr(sim.state, part)[index] = math.nan
    with pytest.raises(
        DivergenceError,
        match=rf"in step 4 at 0\.0030 s: {place} .* not a number",
    ):
        sim.advance(5, np.full(4, 1.0))
    assert sim.steps == 3


def test_a_node_beyond_the_speed_limit_raises_divergence_with_its_place():
    sim = simulator(
        servo={},
        start__settle=0.0,
        start__height=0.5,
        solver__speed_limit=5.0,
    )
    sim.state.node_velocity[2, 21] = [0.0, 0.0, 40.0]
    with pytest.raises(
        DivergenceError,
        match=r"in step 1 at 0\.0000 s: leg RL node (19|20|21) .* 5\.0",
    ):
        sim.advance(1, np.zeros(4))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2.0, "2.0"),
        (True, "True"),
        ("three", "'three'"),
        ([1, "a"], "[1, 'a']"),
        ("\x1b]0;x\x07", r"'\x1b]0;x\x07'"),
        (2**64, "an integer of 65 bits"),
        ([10**5000], "[an integer of 16610 bits]"),
        (datetime.date(2001, 2, 3), "datetime.date(2001, 2, 3)"),
    ],
)
def test_a_short_value_is_quoted_as_in_python(value, text):
    assert quoted(value) == text


def test_a_message_keeps_its_begin_and_its_end_and_a_long_value_is_cut():
    line = str(
        InputError("/bags/one: " + "a\nb\x1b[2J " * 10**6 + "no such topic")
    )
    assert line.startswith(r"/bags/one: a b\x1b[2J")
    assert line.endswith(" no such topic")
    assert line.isprintable()
    assert LINE_MAX - 10 < len(line) <= LINE_MAX
    assert (
        printable("10 \u00b5m a\x9b1mb\tc\u202ed")
        == "10 \u00b5m " + r"a\x9b1mb\tc\u202ed"
    )
    for value in (
        "x" * 10**7,
        [["y" * 50] * 50] * 50,
        np.zeros(10**6),
        {"k": "v" * 99},
    ):
        assert 20 < len(quoted(value)) <= VALUE_MAX


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("directory", "not a regular file"),
        ("device", "not a regular file"),
        ("pipe", "not a regular file"),
        ("long", "more than 10 bytes"),
        ("missing", "missing"),
    ],
)
def test_only_regular_files_are_read_and_only_so_far(tmp_path, name, reason):
    (tmp_path / "directory").mkdir()
    (tmp_path / "device").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "long").write_bytes(bytes(11))
    with pytest.raises((ValueError, OSError), match=reason):
        read_bytes(tmp_path / name, 10)
    assert read_bytes(tmp_path / "long", 11) == bytes(11)


NODES, DT = 8, 1 / 30
ANY_NUMBER = ("no element", "one more")  # of rows
ANY_AXES = ("an axis less", "an axis more", *ANY_NUMBER)


class Case(NamedTuple):
    """A call with good arguments; `fine` names changes that leave an argument usable."""

    call: Callable[..., Any]
    good: tuple[Any, ...]
    finite: bool = True  # whether every value has to be
    fine: tuple[str, ...] = ()


def scene(**changes):
    """The flat scene without settling, on few nodes."""
    return config.replace(
        read_scene("flat"),
        {"start.settle": 0.0, "solver.nodes": NODES} | changes,
    )


def _legs():
    robot, springs = read_robot(), read_leg_springs(4.0)
    heights, still = np.full(4, 0.06), StaticLeg(robot, NODES)
    grid = np.array([0.0, 1.0]), np.array([0.0, 0.1, 0.2]), np.ones((2, 3, 4))
    return {
        "LegSprings.at": Case(springs.at, (np.ones(4), heights), finite=False),
        "LegSprings.angle": Case(springs.angle, (np.ones(4), heights)),
        "LegSprings": Case(
            lambda *parts: LegSprings(LegTable(*parts), 1.0), grid
        ),
        "LegTable": Case(LegTable, grid, fine=("a million",)),  # of columns
        "StaticLeg.node": Case(
            lambda node: setattr(still, "node", node), (still.node,)
        ),
        "StaticLeg.solve": Case(still.solve, (0.1, 0.1)),
        "HeldLeg.pull": Case(HeldLeg(robot, NODES, 0.3, 0.1).pull, (0.01, 1.0)),
        "StickingLeg.stiffness": Case(
            StickingLeg(robot, NODES).stiffness, (still.node, 0.1, 0.1)
        ),
    }


def _robots():
    robot, servo = read_robot(), read_servo()
    rods = RodRobot(robot, scene(), servo)
    flat = config.replace(read_scene("map"), {"start.settle": 0.0})
    tabulated = TabulatedRobot(robot, flat, servo)
    leg, vector = PaperLegs(robot, read_paper()), np.zeros(3)
    paper = PaperRobot(
        robot, config.replace(read_scene("paper"), {"start.settle": 0.0}), servo
    )
    cases = {
        "PaperLegs.advance": Case(
            lambda pull: leg.advance(1, pull), (np.zeros(1),)
        ),
        # 1 may diverge
        "PaperRobot.advance": Case(paper.advance, (0, np.full(4, 0.5))),
    }
    for name, sim in (("RodRobot", rods), ("TabulatedRobot", tabulated)):
        cases[f"{name}.advance"] = Case(sim.advance, (1, np.full(4, 0.5)))
        cases[f"ManyRobots of {name}"] = Case(
            ManyRobots([sim, sim]).advance, (np.full((2, 1, 4), 0.5), 1)
        )
        cases[f"{name}.push"] = Case(sim.push, (vector, vector))
        cases[f"{name}.set_motion"] = Case(sim.set_motion, (vector, vector))
        cases[f"{name}.damage_tendon"] = Case(sim.damage_tendon, (0, 0.001))
    return cases


def _rods():
    material, vector, still = (
        Material(1e7, 3e6, 1200.0, 5e-4),
        (0.0, 0.1, 0.0),
        (0.0,) * 3,
    )
    rod = CosseratRod(
        material, Geometry(0.2, Rectangle(0.02, (8e-3, 4e-3))), NODES
    )
    names = tuple(vars(rod.state))

    def set_state(*parts):
        rod.state = type(rod.state)(**dict(zip(names, parts)))

    def bent(curvature):
        CosseratRod(
            material,
            Geometry(0.2, Rectangle(0.02, (8e-3, 4e-3)), lambda s: curvature),
            NODES,
        )

    return {
        "CosseratRod.state": Case(set_state, tuple(vars(rod.state).values())),
        "CosseratRod.run": Case(rod.run, (1e-3, 2)),
        "CosseratRod.step": Case(rod.step, (1e-3,)),
        "Loads": Case(lambda *parts: rod.energy(Loads(*parts)), (vector,) * 4),
        "Pose": Case(
            lambda *parts: rod.step(1e-3, base=Pose(*parts)), (still, still)
        ),
        "Support": Case(Support, ((True,) * 3, (True,) * 3), finite=False),
        "Geometry.curvature": Case(bent, (1.0,)),
    }


def _policies():
    settings, robot = read_rollout_mpc(), read_robot()
    model = NominalRobot(robot, settings.nominal, DT)
    problem, stages = (
        PlanProblem(settings, robot.tendon.angle_max, DT),
        settings.stages,
    )
    state, start = (
        np.zeros(12),
        model.at_rest(np.eye(12)[5] * 0.06, np.full(4, 1.0)),
    )
    observer = DisturbanceObserver(model, settings.observer, problem.scale, DT)
    wanted, angle = np.zeros((stages, 6)), np.full((stages + 1, 4), 1.0)
    linear = problem.linearised(np.zeros((len(problem.basis), 6 * stages)))
    springs, gaits = read_leg_springs(4.0), read_gaits()
    scheduler = GaitScheduler(gaits, robot, springs, "walk", None)
    preview = scheduler.step(0, np.eye(12)[5] * 0.06)
    force_map = make_force_map(robot, read_force_map(), 0.0)

    def mapped(force, planned, rate, state):
        force_map.step(TendonPlan(planned, rate, force), preview, state)

    return {
        "NominalRobot.set_wrench": Case(model.set_wrench, (np.zeros(3), 0.0)),
        "NominalRobot.at_rest": Case(model.at_rest, (state, np.full(4, 1.0))),
        "NominalRobot.measured": Case(
            model.measured, (start, state), finite=False
        ),
        "NominalRobot.place": Case(model.place, (start,), finite=False),
        "NominalRobot.roll_out": Case(
            model.roll_out,
            (start, angle[None]),
            finite=False,
            fine=ANY_NUMBER,
        ),
        "PlanProblem.reference": Case(
            lambda rows, place, drift: problem.reference(
                rows, place, drift, 0.0
            ),
            (np.zeros((stages + 1, 12)), np.zeros(3), np.zeros(3)),
            finite=False,
            fine=("one more",),
        ),
        "PlanProblem.errors": Case(
            lambda pose, wanted: problem.errors(pose, wanted, 0.0),
            (wanted[None], wanted),
            finite=False,
            fine=ANY_NUMBER,
        ),
        "PlanProblem.change": Case(
            lambda b, nominal: problem.change(
                np.zeros(6 * stages), linear, b, nominal
            ),
            (np.zeros_like(angle), angle),
        ),
        "DisturbanceObserver.observe": Case(
            lambda *parts: observer.observe(start, *parts), (state, angle[0])
        ),
        "ForceMap.step": Case(
            mapped,
            (np.zeros((2, 4, 3)), np.zeros((2, 4)), np.zeros(4), state),
            finite=False,
            fine=("one more",),
        ),
    }


def _estimation():
    filtered, stamps = (
        InertialFilter(read_estimator()),
        np.array([0, 5_000_000]),
    )
    attitude, vector = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    motion = (attitude, vector, vector, vector, np.ones(12))

    def use(values, stamps):
        filtered.use_gyro(ImuSamples(stamps, values), 1, 0.0)
        filtered.propagate(ImuSamples(stamps, values), 0, 1)

    return {
        "InertialFilter.restart": Case(
            lambda *parts: filtered.restart(OdometryMotion(0, *parts)), motion
        ),
        "InertialFilter.correct": Case(
            lambda *parts: filtered.correct(OdometryMotion(0, *parts)), motion
        ),
        "InertialFilter.extrapolate": Case(
            lambda imu: filtered.extrapolate(imu, 1e-3), (np.zeros(6),)
        ),
        "InertialFilter.propagate": Case(
            lambda values: use(values, stamps),
            (np.zeros((2, 6)),),
            finite=False,
        ),
    }


def _vision():
    settings = read_vision()
    camera = nominal(settings.camera)
    detector = MarkerDetector(settings.dictionary_number, camera)
    image = np.zeros((camera.height, camera.width), np.uint8)
    return {
        "Camera.rays": Case(camera.rays, (np.zeros((5, 2)),), False, ANY_AXES),
        "Camera.project": Case(
            camera.project, (np.ones((5, 3)),), False, ANY_AXES
        ),
        "MarkerDetector.find": Case(detector.find, (image,), finite=False),
    }


GROUPS = [_legs, _robots, _rods, _policies, _estimation, _vision]


def wrong(array, finite):
    """Name and value of changes to an argument that make it unusable."""
    shape = array.shape
    if array.dtype.kind == "i":
        return [("negative", -5), ("a fraction", 0.5)]
    found = [
        ("an axis more", np.zeros((*shape, 2), array.dtype)),
        ("text", np.full(shape, "x")[()]),
    ]
    if shape:
        many = np.zeros(
            (*shape[:-1], 2**20 // max(1, int(np.prod(shape[:-1]))))
        )
        found += [
            ("an axis less", array[0]),
            ("no element", array[:0]),
            ("a million", many),
            ("one element", np.ones((1,) * (array.ndim + 1), array.dtype)),
            ("one more", np.concatenate([array, array[-1:]])),
        ]
    if finite and array.dtype.kind == "f":
        last = np.zeros(shape, bool)
        last[(-1,) * array.ndim] = True
        found += [
            (str(bad), np.where(last, bad, array)[()])
            for bad in (np.nan, np.inf)
        ]
    return found


@pytest.mark.parametrize("group", GROUPS)
def test_arrays_of_wrong_shapes_types_and_values_are_refused(group):
    for name, case in group().items():
        for place, value in enumerate(case.good):
            for what, spoiled in wrong(np.asarray(value), case.finite):
                if what not in case.fine:
                    values = (
                        *case.good[:place],
                        spoiled,
                        *case.good[place + 1 :],
                    )
                    with pytest.raises(ValueError, match=r"^.{,300}$"):  # noqa: PT012
                        case.call(*values)
                        pytest.fail(
                            f"{name}, argument {place}: {what}: accepted"
                        )
        case.call(*case.good)

"""Invalid input is refused by name; a diverged solution reports time and place. No silent NaN.

Messages of refusals are one line, short and printable.

Falls, pulls, ends of ranges, folds, time steps: finite, no energy gain, same result at h/2.
"""

import dataclasses
import datetime
import math
import os

import numpy as np
import pytest
from rod_robots import ROBOT, simulator
from stress_cases import (
    FOLDS,
    IMPACTS,
    IN_SPACE,
    PARAMETERS,
    PULLS,
    STEPS,
    examine,
)

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
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
from slot_core.simulation.rod_robot import RodRobot


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
    whole = dataclasses.replace(
        case, scene={**case.scene, "solver.halvings": 0}
    )
    assert "beyond 100.0 m/s" in examine(whole).lost

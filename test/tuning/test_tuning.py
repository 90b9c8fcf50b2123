"""Search and identification of strides: symmetries, search, record, tables and the file."""

import dataclasses
from unittest.mock import Mock

import numpy as np
import pytest
from real_graph import changed_config, set_values

from slot_core import config
from slot_core.gait.gait import gait_misfit, harmonics, read_gaits
from slot_core.legs.fingerprint import fingerprint
from slot_core.legs.leg_table import require_own_leg_map
from slot_core.robot import read_robot
from slot_lab.tuning import identification, tune_command
from slot_lab.tuning.pattern_search import (
    FAILED,
    Goal,
    PatternSearch,
    cost,
)
from slot_lab.tuning.stride_run import (
    TIME,
    Job,
    StrideMotion,
    read_tuning,
    simulate,
)
from slot_lab.tuning.tune import write_gait

STRIDES, ROBOT = read_gaits().strides, read_robot()
WALK = STRIDES["walk"]
SETTINGS = config.replace(
    read_tuning(),
    {"friction": [0.4], "strides": 3, "settling_strides": 4, "population": 4},
)
PHASES = np.arange(20) / 20
RNG = np.random.default_rng(1)


def series(pattern, phase):
    """Tendon angles (n, 4), deg, of coefficients (4, 5) at phases (n,)."""
    return harmonics(phase % 1.0) @ pattern.T


@pytest.mark.parametrize(
    ("pattern", "legs", "sign"),
    [
        (identification.forward, [1, 0, 3, 2], 1),  # its mirror image
        (identification.turn, [3, 2, 1, 0], 1),  # after half a turn
        # whose mirror image steers to the other side
        (
            identification.steering,
            [1, 0, 3, 2],
            -1,
        ),
    ],
)
def test_a_pattern_has_its_symmetry_half_a_stride_later(pattern, legs, sign):
    made = pattern(RNG.normal(size=10))
    assert series(made, PHASES) == pytest.approx(
        sign * series(made, PHASES + 0.5)[:, legs]
    )


def motion(v_x=0.05, tilt=0.0, top=0.06):
    """Motion at a constant velocity."""
    track = np.zeros((10, 7))
    track[:, 3], track[:, 4] = WALK.height, tilt
    means = np.array([v_x, 0.0, 0.0, WALK.height, 0.0, 0.0])
    return StrideMotion(
        track,
        np.zeros(10),
        np.zeros((10, 4)),
        np.zeros((10, 2)),
        means,
        0.0,
        top,
        0.5,
    )


def test_a_faster_pattern_is_better_and_one_that_tilts_or_diverges_is_worse():
    goal = Goal("forward", top_max=0.07)
    costs = [
        cost([each, motion(v_x=0.025)], WALK, goal, SETTINGS)[0]
        for each in (
            motion(v_x=0.06),
            motion(),
            motion(tilt=0.2),
            motion(top=0.08),
            None,
        )
    ]
    assert costs[0] < costs[1] < min(costs[2:])
    assert costs[4] == FAILED


def parabola(jobs):
    """Motions whose speed falls with the distance of the pattern from that of the walk."""
    target = np.array(WALK.forward.angle_deg)
    for job in jobs:
        distance = np.square(
            np.array(job.stride.forward.angle_deg) - target
        ).mean()
        share = job.velocity[0] / WALK.forward.speed
        yield motion(v_x=share * (0.06 - 1e-4 * distance))


def test_a_start_beyond_the_largest_coefficient_is_refused_before_any_search(
    own_config, refusal
):
    # the walk's forward: 65
    set_values(own_config, {"tune": {"coefficient_max_deg": 68.0}})
    line = refusal(tune_command.main, "mine", "--like", "walk", "--quick")
    assert (
        "turn.angle_deg[1][4] = 69.84: outside [-68, 68], coefficient_max_deg"
        in line
    )


def search(evaluations, seed=1):
    settings = config.replace(SETTINGS, {"evaluations": evaluations})
    return PatternSearch(WALK, Goal("forward"), np.zeros(10), settings, seed)


def test_a_search_finds_the_pattern_and_its_record_is_of_no_other(tmp_path):
    found = search(1200).run(parabola, tmp_path / "record", print)
    pattern = identification.forward(found.x)
    assert pattern == pytest.approx(np.array(WALK.forward.angle_deg), abs=1.0)
    assert found.speed == pytest.approx([0.06], abs=1e-4)
    with pytest.raises(config.ConfigError, match="record of another search"):
        search(1200, seed=2).run(parabola, tmp_path / "record", print)


def test_an_interrupted_search_continues_where_it_ended(tmp_path):
    shares = []
    whole = search(38).run(  # in whole generations: 40
        parabola, tmp_path / "whole", lambda _, share: shares.append(share)
    )
    assert max(shares) == 1.0
    calls = []

    def interrupted(jobs):
        calls.append(len(jobs))
        if len(calls) == 5:
            raise KeyboardInterrupt
        return parabola(jobs)

    with pytest.raises(KeyboardInterrupt):
        search(40).run(interrupted, tmp_path / "record", print)
    with (tmp_path / "record").open("a") as record:
        record.write("[[1.0, [0.")  # cut off
    again = search(40).run(interrupted, tmp_path / "record", print)
    assert (again.x == whole.x).all()
    assert again.cost == whole.cost
    # The start and 40 candidates, each once, and the generation that was interrupted.
    assert sum(calls) == 2 * (1 + 40 + 4)  # at amplitude one and half of it


def simulated(jobs):
    return [simulate(job, SETTINGS, ROBOT) for job in jobs]


def test_the_means_are_those_of_whole_strides():
    """From the end of the stride before: a turn's speed varies by half within a stride."""
    settings = config.replace(SETTINGS, {"strides": 1, "settling_strides": 1})
    job = Job(WALK, 0.4, (0.0, 0.0, 0.1), hold_height=False)
    track = simulate(job, settings, ROBOT).track
    assert track[-1, TIME] - track[0, TIME] == pytest.approx(WALK.period)


def test_the_identification_repeats_the_shipped_walk():
    """Speeds within 15 %, forces within 1.2 N and sway within .06 of those of three floors.

    The speed of the turn depends most on friction: 30 %.
    """
    tables = identification.tabulate(WALK, SETTINGS, simulated)
    for name in identification.PATTERNS:
        shipped, found = getattr(WALK, name), tables[name]
        near = 0.3 if name == "turn" else 0.15
        assert found.speed == pytest.approx(shipped.speed, rel=near)
        assert found.table[4:8] == pytest.approx(shipped.table[4:8], abs=1.2)
        assert found.table[8:] == pytest.approx(shipped.table[8:], abs=0.06)


def test_the_written_file_is_read_as_the_same_stride(own_config):
    write_gait(
        own_config / "gait" / "own.yaml",
        WALK,
        ["scripts/tune own"],
        fingerprint(ROBOT),
    )
    assert gait_misfit("own", ROBOT) == ""
    read = read_gaits().strides["own"]
    for field in dataclasses.fields(WALK):
        assert getattr(read, field.name) == getattr(WALK, field.name)


def test_another_leg_gets_map_and_gait_that_a_run_takes_and_nothing_is_made_twice(
    tmp_path, monkeypatch
):
    """On few nodes and short runs, to no good gait."""
    monkeypatch.chdir(tmp_path)
    changes = {
        "robot": {"leg.width": 0.024},
        "leg_map": {"nodes": 8, "angles": 9, "heights": 9, "substeps": 3},
        "tune": {"friction": [0.4], "strides": 1, "settling_strides": 1}
        | {"population": 4, "scene": "quick"},
    }
    legs = changed_config(tmp_path / "legs", changes)
    (legs / "scene" / "quick.yaml").write_text("like: flat\nsolver: coarse\n")
    monkeypatch.setenv("SLOT_CONFIG", str(legs))
    words = f"leg {legs} --gaits walk --evaluations 4 --workers 1".split()
    with monkeypatch.context() as changed:  # what fails keeps no other search
        failing = Mock(side_effect=identification.IdentificationError("none"))
        changed.setattr(identification, "find_steering", failing)
        assert tune_command.main([*words, "--evaluations", "5"]) == 1
    assert tune_command.main(words) == 0
    robot, gaits = read_robot(), read_gaits()
    assert require_own_leg_map(robot) == gait_misfit("walk", robot) == ""
    walk = gaits.strides["walk"]
    gaits.require_velocity("walk", np.array([walk.cruise, 0.0, 0.0]))
    text = (legs / "gait" / "walk.yaml").read_text()
    assert text.startswith("# scripts/tune leg --evaluations 4\n")
    made = {path: path.stat().st_mtime_ns for path in legs.rglob("*")}
    assert tune_command.main(words) == 0
    assert made == {path: path.stat().st_mtime_ns for path in legs.rglob("*")}

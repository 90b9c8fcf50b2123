"""scripts/compare: what differs between two bags, figure by figure, and what it refuses."""

import dataclasses
import math
import re
from pathlib import Path

import pytest
from real_graph import set_values
from synthetic_walk import STRIDE, Walk, write_walk

from slot_core import config
from slot_core.dynamics.servo import read_servo
from slot_core.recording.origin import Origin, origin_here
from slot_lab.bags.bag import Bag
from slot_lab.report import compare
from slot_lab.report.metrics import figures, walk_metrics
from slot_lab.report.run_comparison import (
    compare_figures,
    exceeded,
    origin_lines,
    plot,
)

BAGS = Path(__file__).parents[1] / "bags"
FLAT = Walk(duration=2 * STRIDE)
FASTER = dataclasses.replace(FLAT, speed=0.06)
# the bags of the repository are shorter than the warm-up
SEEN = ["--warm-up", "0"]


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """The bags of FLAT and FASTER."""
    place = tmp_path_factory.mktemp("bags")
    return [
        Bag(write_walk(place / f"walk_{walk.speed}", walk))
        for walk in (FLAT, FASTER)
    ]


def pairs_of(bags):
    return compare_figures(
        *(figures(walk_metrics(bag, 0.0, read_servo())) for bag in bags)
    )


def test_differences_of_two_synthetic_walks_are_those_of_their_speeds(walks):
    found = {pair.first.name: pair for pair in pairs_of(walks)}
    speed, height = found["mean_v_x"], found["height_mean"]
    assert (speed.difference, speed.first.unit) == (pytest.approx(0.01), "m/s")
    assert height.first.value == pytest.approx(60.0)  # mm
    assert height.difference == 0.0
    # ms
    assert found["stages.mpc_controller.p99"].first.value == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("tolerances", "beyond"),
    [
        ((), []),
        ((("mean_v_?", 0.0101),), []),
        (
            (("mean_v_x", 0.0099),),
            ["mean_v_x +0.01 m/s, more than 0.0099 m/s"],
        ),
        ((("*", 0.0), ("*", 0.1)), []),  # the last one counts
        ((("height*", 0.0),), []),
    ],
)
def test_figures_beyond_their_tolerance_are_named(walks, tolerances, beyond):
    assert exceeded(pairs_of(walks), tolerances) == [
        f"beyond the tolerance: {line}" for line in beyond
    ]


def test_a_figure_of_one_bag_only_exceeds_every_tolerance(walks, tmp_path):
    """The other has no ground truth, and so no torques."""
    blind = Bag(
        write_walk(tmp_path / "blind", dataclasses.replace(FLAT, truth=False))
    )
    pairs = pairs_of([walks[0], blind])
    assert math.isinf(
        next(p for p in pairs if p.first.name == "servo_load.FL").difference
    )
    line = exceeded(pairs, [("servo_load.FL", 100.0)])
    assert line == ["beyond the tolerance: servo_load.FL is in one bag only"]


def test_a_bag_compared_with_itself_and_with_another_ends_with_0_and_1(capsys):
    walk, fault = str(BAGS / "walk"), str(BAGS / "fault")
    assert compare.main([walk, walk, *SEEN, "--tolerance", "*=0"]) == 0
    assert compare.main([walk, fault, *SEEN, "--tolerance", "tilt*=1"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "scene                   flat -> fault" in lines
    assert any(
        re.match(r"beyond the tolerance: tilt_max [+-]\d", line)
        for line in lines
    )


def changed(bag, path, origin):
    """A copy of a bag with another origin."""
    bag.origin, kept = origin, bag.origin
    bag.save(path)
    bag.origin = kept
    return Bag(path)


def test_what_differs_between_the_origins_is_named(walks, tmp_path, own_config):
    route = tmp_path / "way.csv"
    route.write_text("x,y\n0,0\n1,0\n")
    first = changed(
        walks[0], tmp_path / "a", origin_here({"gait": "walk", "seed": 1})
    )
    speed = config.load("gait/walk")["forward"]["speed"]
    set_values(own_config, {"gait/walk": {"forward.speed": 0.03}})
    (own_config / "leg_map.csv").unlink()
    now = origin_here({"gait": "walk", "seed": 2, "path": str(route)})
    second = changed(
        walks[1],
        tmp_path / "b",
        Origin({**now.about, "revision": "new"}, now.files),
    )
    assert origin_lines(first, first)[-1].split() == [
        "configuration",
        "the",
        "same",
    ]
    assert origin_lines(first, walks[1])[-1].endswith(
        "recorded -> not recorded"
    )
    lines = origin_lines(first, second)
    assert re.fullmatch(r"revision +\S+ -> new", lines[0])
    assert [" ".join(line.split()) for line in lines[1:]] == [
        "policy rollout_mpc",
        "seed 1 -> 2",
        "path - -> way.csv",
        "the same gait walk",
        "path.csv - -> a file",
        f"gait/walk.yaml forward.speed {speed} -> 0.03",
        "leg_map.csv a file -> -",
    ]


def test_the_plot_has_both_walks_and_their_difference(walks, tmp_path):
    forward, difference = plot(*walks).axes[:2]
    assert [len(ax.lines) for ax in (forward, difference)] == [2, 1]
    t, change = difference.lines[0].get_data()
    assert change == pytest.approx(0.01 * t, abs=1e-9)
    bags, out = [str(bag.path) for bag in walks], tmp_path / "new" / "c.svg"
    assert compare.main([*bags, *SEEN, "--plot", str(out)]) == 0
    assert out.read_text().startswith("<?xml")

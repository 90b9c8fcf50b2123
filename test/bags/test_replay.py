"""The cores reproduce a recorded walk; a change is reported by topic, stamp and field."""

import shutil
from pathlib import Path

import pytest
import yaml

from slot_core import config
from slot_core.bags import replay
from slot_core.bags.bag import Bag

WALK = Path(__file__).parent / "walk"
TOPICS = ["/mpc_state", "/gait_preview", "/ground_reaction_forces", "/desired_joint_angles"]


@pytest.fixture
def configure(tmp_path, monkeypatch):
    """Function that changes one value of one configuration file."""
    directory = tmp_path / "config"
    shutil.copytree(config.config_dir(), directory)
    monkeypatch.setenv("SLOT_CONFIG", str(directory))

    def change(name, *path, value):
        file = directory / f"{name}.yaml"
        mapping = yaml.safe_load(file.read_text())
        inner = mapping
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        file.write_text(yaml.safe_dump(mapping))

    return change


def first_differences():
    return {c.topic: c.first for c in replay.replay(Bag(WALK), replay.TOLERANCE)}


def test_the_bag_in_the_repository_is_small():
    assert sum(file.stat().st_size for file in WALK.iterdir()) < 300_000


def test_the_recorded_walk_replays():
    comparisons = replay.replay(Bag(WALK), replay.TOLERANCE)
    assert [c.topic for c in comparisons] == TOPICS
    for comparison in comparisons:
        assert comparison.first is None, str(comparison.first)
        assert comparison.compared > 43


@pytest.mark.parametrize(
    ("file", "path", "value", "topic"),
    [
        ("estimator", ("odometry", "position_noise"), 0.002, "/mpc_state"),
        ("gait", ("acceleration",), 0.11, "/gait_preview"),
        ("gait/walk", ("forward", "speed"), 0.07, "/gait_preview"),
        ("gait/walk", ("feedback", "gain"), 0.4, "/gait_preview"),
        ("mpc", ("model", "reference"), "zero", "/ground_reaction_forces"),
        ("mpc", ("map",), "paper", "/desired_joint_angles"),
    ],
)
def test_a_change_shows_only_at_its_own_stage(configure, file, path, value, topic):
    configure(file, *path, value=value)
    differences = first_differences()
    assert differences.pop(topic) is not None
    assert set(differences.values()) == {None}


def test_the_first_difference_is_reported(configure, capsys):
    configure("mpc", "model", "reference", value="zero")
    assert replay.main([str(WALK)]) == 1
    line = capsys.readouterr().out.strip().splitlines()[-1]
    assert line.startswith("first difference: /ground_reaction_forces at 1.0")
    assert " s: force[" in line


def test_replay_reports_every_compared_topic(capsys):
    assert replay.main([str(WALK)]) == 0
    shown = capsys.readouterr().out
    for topic in TOPICS:
        assert topic in shown


def test_a_missing_bag_is_an_error_of_one_line(tmp_path, capsys):
    assert replay.main([str(tmp_path / "nothing")]) == 2
    errors = capsys.readouterr().err
    assert errors.startswith("scripts/replay: ")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("tolerance", ["nan", "-1", "inf"])
def test_a_tolerance_that_is_negative_or_not_finite_is_refused(tolerance, capsys):
    with pytest.raises(SystemExit) as refusal:
        replay.main([str(WALK), "--tolerance", tolerance])
    assert refusal.value.code == 2
    assert f"argument --tolerance: {tolerance}: outside [0, inf)" in capsys.readouterr().err

"""Scenes: one file each, and only what differs from another."""

import pytest

from slot_core import config
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """A configuration directory of its own, to which scenes can be added."""
    for name in ("scene/flat.yaml", "solver/standard.yaml"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text((config.config_dir() / name).read_text())
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))

    def add(name, text):
        (tmp_path / "scene" / f"{name}.yaml").write_text(text)

    return add


def test_a_scene_like_another_holds_only_what_it_changes(scenes):
    scenes("ice", "like: flat\nfloor.torso_friction: 0.05\n")
    flat, ice = read_scene("flat"), read_scene("ice")
    assert ice.floor.torso_friction == 0.05
    assert config.replace(ice, {"floor.torso_friction": flat.floor.torso_friction}) == flat


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("like: moon\n", r"no configuration 'scene/moon' \(known: bad, flat\)"),
        ("like: bad\n", r"scene/bad\.yaml: like is not a setting"),
        ("like: flat\nfloor.grip: 1\n", r"scene/bad\.yaml: floor\.grip is not a setting"),
        ("like: flat\nsolver.step: 1.0\n", r"scene/bad\.yaml: solver\.step = 1\.0: outside"),
        ("like: flat\nsolver: magic\n", r"no configuration 'solver/magic' \(known: standard\)"),
        ("", r"scene/bad\.yaml: expected a mapping of Scene, got None"),
    ],
)
def test_a_scene_that_cannot_be_is_refused_by_name(scenes, text, message):
    scenes("bad", text)
    with pytest.raises(ConfigError, match=message):
        read_scene("bad")


def test_the_shipped_scenes_can_be_read():
    names = [path.stem for path in (config.config_dir() / "scene").glob("*.yaml")]
    assert {"flat", "slippery", "slope5", "split"} <= set(names)
    for name in names:
        # the odometry's period is the controller's, and both are whole time steps
        scene = read_scene(name)
        ratio = scene.sensors.odometry.period / scene.solver.step
        assert ratio == pytest.approx(round(ratio), abs=1e-9)

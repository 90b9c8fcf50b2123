"""Scenes: one file each, which may hold only its differences from another."""

import pytest

from slot_core import config
from slot_core.dynamics.scene import read_scene

PUSH = "pushes: {left: {time: %s, duration: 1, force: [0, 0, 0], moment: [0, 0, 0]}}"


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """A temporary configuration directory; returns a function that adds a scene."""
    for name in ("scene/flat.yaml", "solver/standard.yaml"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text((config.config_dir() / name).read_text())
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))

    def add(name, text):
        (tmp_path / "scene" / f"{name}.yaml").write_text(text)

    return add


def test_a_scene_like_another_differs_only_in_what_it_changes(scenes):
    scenes("ice", "like: flat\nfloor.torso_friction: 0.05\n")
    flat, ice = read_scene("flat"), read_scene("ice")
    assert ice.floor.torso_friction == 0.05
    assert (
        config.replace(ice, {"floor.torso_friction": flat.floor.torso_friction})
        == flat
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("like: moon\n", r"no configuration 'scene/moon' \(known: bad, flat\)"),
        ("like: bad\n", r"scene/bad\.yaml: like is not a setting"),
        (
            "like: flat\nfloor.colour: 1\n",
            r"scene/bad\.yaml: floor\.colour is not a setting",
        ),
        (
            "like: flat\nsolver.step: 1.0\n",
            r"scene/bad\.yaml: solver\.step = 1\.0: outside",
        ),
        (
            "like: flat\nsolver: magic\n",
            r"no configuration 'solver/magic' \(known: standard\)",
        ),
        ("", r"scene/bad\.yaml: expected a mapping of Scene, got None"),
        (
            "like: flat\ntendons.broken: [0, 0, 0, 0]\n",
            r"tendons\.broken\[0\] = 0: expected true or false",
        ),
        (
            "like: flat\nfloor.friction_law: dry\n",
            r"friction_law = 'dry': .* viscous, bristle",
        ),
        (
            "like: flat\nfloor.contact: heel\n",
            r"contact = 'heel': expected one of all, tip",
        ),
        (
            "like: flat\nfloor.friction_varies: 1\n",
            r"friction_varies = 1: expected text",
        ),
        (f"like: flat\n{PUSH % -1}\n", r"pushes\.left\.time = -1\.0: outside"),
        (
            "like: flat\npushes: {left: {time: 1}}\n",
            r"pushes\.left\.duration is missing",
        ),
        (
            "like: flat\nsensors.imu.period: 0.0005\n",
            r"bad\.yaml: sensors\.imu\.period = 0\.0005: shorter than solver\.step = 0\.001 s",
        ),
        (
            "like: flat\nsolver.step: 0.02\n",
            r"sensors\.imu\.period = 0\.005: shorter than solver\.step = 0\.02 s",
        ),
        (
            "like: flat\nsolver.step: 0.02\nsensors.imu.enabled: false\n",
            r"sensors\.joint_period = 0\.01: shorter",
        ),
    ],
)
def test_an_invalid_scene_is_refused_by_name_of_the_setting(
    scenes, text, message
):
    scenes("bad", text)
    with pytest.raises(config.ConfigError, match=message):
        read_scene("bad")


def test_the_shipped_scenes_can_be_read():
    for path in (config.config_dir() / "scene").glob("*.yaml"):
        # the controller runs at the period of the odometry, a whole number of time steps
        scene = read_scene(path.stem)
        ratio = scene.sensors.odometry.period / scene.solver.step
        assert ratio == pytest.approx(round(ratio), abs=1e-9)

"""Configuration files are read into typed, bounded dataclasses; bad values are refused by name.

Scenes: one file each, which may hold only its differences from another.
"""

import dataclasses
import os

import pytest
from damage import require_short

from slot_core import config
from slot_core.config import ConfigError, choice, flag, quantity
from slot_core.dynamics.scene import read_scene


@dataclasses.dataclass(frozen=True)
class Inner:
    gain: float = quantity("a gain", "N/m", 0.0, 10.0)
    axes: tuple[float, float] = quantity("two numbers", "", -1, 1)


@dataclasses.dataclass(frozen=True)
class Outer:
    count: int = quantity("a count", "", 1, 5)
    law: str = choice("one of two", "one", "two")
    on: bool = flag("a switch")
    inner: Inner
    table: dict[str, Inner] = dataclasses.field(
        metadata={"doc": "inner by name"}
    )


GOOD = {
    "count": 2,
    "law": "one",
    "on": True,
    "inner": {"gain": 3, "axes": [0.5, -1]},
    "table": {"a": {"gain": "1e-3", "axes": [0, 0]}},
}


BOMB = "a0: &a0 [1]\n" + "".join(
    f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(8)
)
HOSTILE = [
    "\x1b]0;x\x07",
    "x" * 300_000,
    "\ud800",
    ["y" * 100] * 1000,
    {"z": [1] * 10**6},
    16**9999,
]


def changed(**changes):
    return {**GOOD, **changes}


def test_values_arrive_with_their_types():
    outer = config.build(Outer, GOOD, "f.yaml")
    assert outer.inner == Inner(3.0, (0.5, -1.0))
    assert type(outer.inner.gain) is float
    assert outer.table["a"].gain == 1e-3  # YAML 1.1 reads 1e-3 as a string


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        (changed(count=9), "f.yaml: count = 9: outside [1, 5]"),
        (changed(count=2.5), "f.yaml: count = 2.5: expected a whole number"),
        (changed(count=True), "f.yaml: count = True: expected a whole number"),
        (
            changed(law="three"),
            "f.yaml: law = 'three': expected one of one, two",
        ),
        (changed(on="yes"), "f.yaml: on = 'yes': expected true or false"),
        (
            changed(extra=1),
            "f.yaml: extra is not a setting (known: count, law, on, inner, table)",
        ),
        (
            changed(inner={**GOOD["inner"], "gian": 1}),
            "f.yaml: inner.gian is not a setting (nearest: gain)",
        ),
        (changed(inner={"gain": 3}), "f.yaml: inner.axes is missing"),
        (
            changed(inner=[1]),
            "f.yaml: inner: expected a mapping of Inner, got [1]",
        ),
        (
            changed(inner={"gain": float("nan"), "axes": [0, 0]}),
            "f.yaml: inner.gain = nan: outside [0.0, 10.0] N/m",
        ),
        (
            changed(inner={"gain": 1, "axes": [0, 2]}),
            "f.yaml: inner.axes[1] = 2.0: outside [-1, 1]",
        ),
        (
            changed(inner={"gain": 1, "axes": [0]}),
            "f.yaml: inner.axes = [0]: expected 2 values, got 1",
        ),
        (
            changed(table={"a": {"gain": "x", "axes": [0, 0]}}),
            "f.yaml: table.a.gain = 'x': expected a number",
        ),
    ],
)
def test_a_bad_value_is_refused_with_name_value_and_limit(mapping, message):
    with pytest.raises(ConfigError) as refusal:
        config.build(Outer, mapping, "f.yaml")
    assert str(refusal.value) == message


def test_replaced_values_are_checked_like_values_read():
    outer = config.build(Outer, GOOD, "f.yaml")
    assert config.replace(outer, {"inner.gain": 4.0}).inner.gain == 4.0
    with pytest.raises(ConfigError, match=r"inner.gain = 11.0: outside"):
        config.replace(outer, {"inner.gain": 11.0})
    for changes in (None, [1], "text"):
        with pytest.raises(
            ConfigError, match=r"p\.yaml: expected a mapping of"
        ):
            config.replace(outer, changes, "p.yaml")
    for name, near in {
        "inner.none": "nearest: inner.gain",
        "count.x": "nearest: count",
        "inner.gain.x.y": "nearest: inner.gain",
        "table.b": "nearest: .*",
        "none.gain": "nearest: inner.gain",
        "axes": "nearest: inner.axes",
        "mass": "known: count, law, on, inner.gain, .*",
    }.items():
        with pytest.raises(
            ConfigError, match=rf"override: {name} is not a setting \({near}"
        ):
            config.replace(outer, {name: 1})


@pytest.mark.parametrize(
    "value", HOSTILE, ids=["escape", "long", "surrogate", "list", "map", "int"]
)
@pytest.mark.parametrize("name", ["count", "law", "on", "inner", "table"])
def test_what_is_refused_is_quoted_short_and_printable(value, name):
    key = value if isinstance(value, (str, int)) else ""
    refused = [changed(**{name: value}), value]
    refused += [{**GOOD, key: 1}, changed(table={key: 1})]
    for mapping in refused:
        with pytest.raises(ConfigError) as refusal:
            config.build(Outer, mapping, "f.yaml")
        require_short(str(refusal.value))
        assert str(refusal.value).startswith("f.yaml: ")


def test_a_missing_file_names_the_known_ones_and_a_pipe_is_refused_without_reading(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(
        ConfigError, match=r"configuration 'absent' \(known: pipe\)"
    ):
        config.read(Outer, "absent")
    with pytest.raises(ConfigError, match=r"pipe\.yaml: not a regular file"):
        config.read(Outer, "pipe")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1,\nb: 2", "broken.yaml: "),
        ("count: 1\ncount: 2\n", "broken.yaml: the key 'count' is repeated"),
        (
            "inner: {gain: 1, gain: 1}\n",
            "broken.yaml: the key 'gain' is repeated",
        ),
        ("a: " + "[" * 200_000, "broken.yaml: nested deeper than 100 levels"),
        ("a: 1\n" * 200_001, "broken.yaml: more than 1000000 bytes"),
        ("a: \0\n", "broken.yaml: "),
        (BOMB, "broken.yaml: line 2: no alias is allowed"),
        ("a: &a [*a]\n", "broken.yaml: line 1: no alias is allowed"),
        ("a: 1\nb: !!timestamp zz\n", "broken.yaml: line 2: no tag is allowed"),
        ("a: !!bool x\n", "broken.yaml: line 1: no tag is allowed"),
        (
            "a: !!python/name:os.system ''\n",
            "broken.yaml: line 1: no tag is allowed",
        ),
        ("a: ! 1\n", "broken.yaml: line 1: no tag is allowed"),
        ("a: 2001-99-99\n", "broken.yaml: month must be in 1..12"),
        ("? [1, 2]\n: 3\n", "broken.yaml: while constructing a mapping"),
        (
            "".join(f"{n}: 1\n" for n in range(80_000)) + "7: 1\n",
            "broken.yaml: the key 7 is",
        ),
        (f"gain: 1{'0' * 20}\naxes: [0, 0]\n", "broken.yaml: "),
        (f"gain: 1{'0' * 5000}\naxes: [0, 0]\n", "broken.yaml: "),
    ],
    ids=[
        "broken",
        "repeated",
        "repeated inside",
        "deep",
        "large",
        "unprintable",
        "alias bomb",
        "in itself",
        "timestamp",
        "bool",
        "object",
        "bare tag",
        "no date",
        "list as a key",
        "many keys",
        "beyond 64 bits",
        "long integer",
    ],
)
def test_a_file_that_cannot_be_a_configuration_is_one_line(
    tmp_path, monkeypatch, text, message
):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    (tmp_path / "broken.yaml").write_text(text)
    with pytest.raises(ConfigError) as refusal:
        config.read(Inner, "broken")
    require_short(str(refusal.value))
    assert str(refusal.value).startswith(message)


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
        ("like: bad\n", r"bad\.yaml: like = 'bad': .* scene without `like`"),
        (
            "like: flat\nfloor.colour: 1\n",
            r"floor\.colour is not a setting \(nearest: .*floor",
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
        (
            "like: flat\npushes: {left: {time: -1, duration: 1, force: [0, 0, 0],"
            " moment: [0, 0, 0]}}\n",
            r"pushes\.left\.time = -1\.0: outside",
        ),
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

"""Files of config/ and settings that cannot be used are refused in one short line."""

import re

from damage import examples, refusable, spliced
from hypothesis import given
from hypothesis import strategies as st

from slot_core import config
from slot_core.control.force_map import read_force_map
from slot_core.control.place_feedback import PlaceFeedback
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.settings import read_settings as read_dynamixel
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.mpc.settings import read_mpc
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_core.rollout_mpc.settings import read_rollout_mpc
from slot_core.safety.settings import read_supervisor
from slot_core.servos.registry import read_servo_bus
from slot_core.vision.settings import read_vision
from slot_lab.calibration.experiments import read_settings as read_experiments
from slot_lab.tuning.stride_run import read_tuning
from slot_lab.twin.strides import read_twin
from slot_paper.leg import read_paper
from slot_paper.problem import read_paper_mpc

FOLDERS = {  # of config/, and what reads a file of it by its name
    "gait": lambda name: read_gaits(),
    "mpc": read_paper_mpc,
    "parameters": lambda name: (read_robot(name), read_servo(name)),
    "scene": read_scene,
    "solver": lambda name: [
        read_scene(scene) for scene in ("flat", "map", "paper")
    ],
}
FILES = {
    "calibration": read_experiments,
    "dynamixel": read_dynamixel,
    "emulator": read_emulator,
    "estimator": read_estimator,
    "force_map": read_force_map,
    "gait": read_gaits,
    "mpc": read_mpc,
    "paper": read_paper,
    "place": lambda: PlaceFeedback.read_settings("place"),
    "rollout_mpc": read_rollout_mpc,
    "record": read_record_settings,
    "robot": read_robot,
    "servo": read_servo,
    "servo_bus": read_servo_bus,
    "supervisor": read_supervisor,
    "tune": read_tuning,
    "twin": read_twin,
    "vision": read_vision,
}
TOKENS = [
    token.encode()
    for token in (
        "!!timestamp zz",
        "!!bool x",
        "!!python/name:os.system ''",
        "&a [*a]",
        "*a",
        "<<: {a: 1}",
        ".inf",
        ".nan",
        "-.inf",
        "1e999",
        "9" * 400,
        "0x" + "f" * 9000,
        "2001-99-99",
        "[" * 200,
        "{" * 50,
        "? [1]",
        '"\\e]0;x\\a"',
        "\x00",
        "\x1b[2J",
        "x" * 20000,
        "=",
        "~",
        "''",
        "[]",
        "{}",
        "- 1",
        "%TAG",
        "|",
        ">",
        "@",
        "`",
        "\t",
        "\ufeff",
        "\u202e",
        "1:2:3",
        "._",
        "0o8",
        "1__",
        "true",
        "null",
    )
]


def reader_of(path):
    """Function that reads a file of config/ by its path there, if one does."""
    folder = FOLDERS.get(path.parent.name)
    return (lambda: folder(path.stem)) if folder else FILES.get(path.stem)


READ = sorted(
    path.relative_to(config.config_dir())
    for path in config.config_dir().rglob("*.yaml")
    if reader_of(path)
)


def changed_text(text):
    """Strategy of a file of YAML with a value replaced, a line inserted or doubled, or bytes."""
    lines = text.splitlines(keepends=True)
    values = [
        match.span(1) for match in re.finditer(rb": (.*)$", text, re.MULTILINE)
    ]
    inserted = st.sampled_from([*lines, *(token + b"\n" for token in TOKENS)])
    return (
        st.builds(
            lambda span, token: text[: span[0]] + token + text[span[1] :],
            st.sampled_from(values),
            st.sampled_from(TOKENS),
        )
        | st.builds(
            lambda n, line: b"".join([*lines[:n], line, *lines[n:]]),
            st.integers(0, len(lines)),
            inserted,
        )
        | spliced(text, *TOKENS)
    )


@given(st.data(), st.sampled_from(READ))
@examples(300)
def test_a_changed_file_of_the_configuration_is_read_or_refused(
    own_config, data, path
):
    file = own_config / path
    sound = file.read_bytes()
    try:
        file.write_bytes(data.draw(changed_text(sound)))
        with refusable(config.ConfigError):
            reader_of(path)()
    finally:
        file.write_bytes(sound)

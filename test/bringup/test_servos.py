"""scripts/servos against emulated servos."""

import signal
import subprocess
import sys
from contextlib import closing

import pytest

from slot_bringup.servos import main
from slot_core.config import ConfigError
from slot_core.dynamixel.checks import write_zero
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.emulator.pseudo_terminal import PseudoTerminal
from slot_core.dynamixel.settings import read_settings

PATIENT = 0.1  # s, answer timeout on a busy machine


@pytest.fixture
def dynamixel_yaml(own_config):
    """Path of dynamixel.yaml in a writable copy of the configuration."""
    path = own_config / "dynamixel.yaml"
    path.write_text(
        path.read_text().replace("timeout: 0.008", f"timeout: {PATIENT}")
    )
    return path


@pytest.fixture
def legs(dynamixel_yaml):
    return EmulatedDynamixels(
        read_settings(), read_emulator(), (0.1, 0.0, 0.0, 0.0)
    )


@pytest.fixture
def servos(legs):
    with closing(PseudoTerminal(legs.bus)) as terminal:
        yield lambda words: main(["--port", terminal.name, *words.split()])


def test_scan_finds_every_servo_at_its_rate(servos, legs, capsys):
    legs.bus.servos[1].memory["baud_rate"] = 1
    assert servos("--baud 1000000 scan") == 0
    found = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in found] == ["1000000"] * 3
    assert [line.split()[3] for line in found] == ["2", "3", "5"]
    assert servos("--baud 57600 scan") == 0
    assert "id   4  model 1060  firmware 45" in capsys.readouterr().out
    assert servos("--baud 115200 scan") == 1
    assert servos("--baud 4500000 scan") == 1  # which the port does not support
    none = "no servo answered: check power, cable and port\n"
    assert capsys.readouterr().err == 2 * none
    assert main(["--port", "/nowhere/x", "scan"]) == 1
    assert capsys.readouterr().err.startswith("scripts/servos: /nowhere/x: ")


def test_info_lists_differences_from_the_configuration_and_prepare_writes_them(
    servos, legs, capsys
):
    assert servos("info") == 0
    out = capsys.readouterr().out
    assert "servo FL (id 5): model 1060, firmware 45" in out
    assert (
        "tendon 5.7 deg, 11.1 V, 25 degC, torque off, hardware errors: none"
        in out
    )
    memory = legs.bus.servos[2].memory
    memory["shutdown"], memory["operating_mode"], memory["torque_enable"] = (
        52,
        16,
        1,
    )
    assert servos("info") == 1
    assert (
        "servo RL (id 2): shutdown is 52, expected 53"
        in capsys.readouterr().out
    )
    assert servos("prepare") == 0
    assert capsys.readouterr().out.splitlines() == [
        "servo RL (id 2): shutdown 52 -> 53",
        "servo RL (id 2): operating_mode 16 -> 3",
    ]
    assert memory["torque_enable"] == 0
    assert servos("info") == 0


def test_assign_refuses_unless_one_servo_is_on_the_line(servos, legs, capsys):
    assert servos("assign 9") == 1
    assert "expected exactly one" in capsys.readouterr().err
    for servo in legs.bus.servos[1:]:
        servo.memory["baud_rate"] = 0
    assert servos("assign 9 --to-baud 2000000") == 0
    memory = legs.bus.servos[0].memory
    assert (memory["id"], memory["baud_rate"]) == (9, 4)


def test_zero_measures_the_present_angle_and_writes_it(
    servos, legs, dynamixel_yaml, capsys
):
    comments = dynamixel_yaml.read_text().count("#")
    assert servos("zero FL") == 0
    assert read_settings().joints.zero_deg[0] == 130.0
    assert servos("zero FL --write") == 0
    # 0.1 rad of the tendon = 5.91 deg of the servo; the encoder rounds down to 0.088 deg.
    assert read_settings().joints.zero_deg == (
        pytest.approx(135.91, abs=0.09),
        130,
        130,
        130,
    )
    assert dynamixel_yaml.read_text().count("#") == comments
    assert servos("info") == 1  # the position limits depend on the zero
    assert servos("prepare") == 0
    assert servos("info") == 0


@pytest.mark.parametrize(
    ("key", "angle", "reason"),
    [
        ("zero_deg", 400.0, "zero_deg"),
        ("zero_deg", 300.0, "not within one turn"),
        ("zero", 100.0, "no line zero_deg"),
    ],
)
def test_a_zero_that_cannot_be_written_changes_nothing(
    dynamixel_yaml, key, angle, reason
):
    before = dynamixel_yaml.read_text().replace("zero_deg", key)
    dynamixel_yaml.write_text(before)
    with pytest.raises(ConfigError, match=reason):
        write_zero("RR", angle)
    assert dynamixel_yaml.read_text() == before


def test_emulate_answers_at_its_link_until_interrupted(
    tmp_path, dynamixel_yaml
):
    link = tmp_path / "servos"
    words = ["-m", "slot_bringup.servos", "emulate", "--link", str(link)]
    process = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline().strip() == str(link)
        assert main(["--port", str(link), "info"]) == 0
    finally:
        process.send_signal(signal.SIGINT)
    assert process.wait(10) == 0
    assert not link.exists()

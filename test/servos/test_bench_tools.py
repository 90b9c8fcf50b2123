"""scripts/servos on emulated servos: the weekend as its page has it, and what is refused."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from slot_bringup.servos import main
from slot_core.config import ConfigError
from slot_core.dynamixel import tools
from slot_core.dynamixel.checks import expected, write_zero
from slot_core.dynamixel.emulator.emulated_legs import MemoryPort
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import TABLE, Mode

PAGE = (Path(__file__).parents[2] / "slot_bringup/doc/hardware.md").read_text()
# command, and the lines below it
CONSOLE = re.compile(
    r"^\$ scripts/servos (.*?)(?: +#.*)?\n((?:[^$`].*\n)*)", re.MULTILINE
)
FAULTS = re.findall(r"^\|.*\| `--fault (\S+)` \| `(.*)` \|$", PAGE, re.M)


@pytest.fixture
def bench(own_config, monkeypatch, capsys):
    """A function that calls scripts/servos: exit code and lines; `legs`: what `emulate` serves.

    The line is in memory, and its time passes where a tool sleeps.
    """

    def call(words):
        code = main(["--port", "./servos", *words.split()])
        assert call.legs.powered() == ()
        return code, "".join(capsys.readouterr()).splitlines()

    def emulate(settings, options):
        call.legs = tools.emulated(settings, options)
        call.legs.advance(0.01)
        return 0

    def port(name, baud, timeout):
        return MemoryPort(call.legs.bus, baud, time.monotonic)

    def sleep(duration):
        call.legs.advance(duration)

    monkeypatch.setitem(tools.TOOLS, "emulate", emulate)
    monkeypatch.setattr(tools, "SerialPort", port)
    monkeypatch.setattr(tools, "time", SimpleNamespace(sleep=sleep))
    call("emulate")
    return call


def test_the_weekend_goes_as_its_page_says(bench):
    steps = CONSOLE.findall(PAGE)
    assert (len(steps), len(FAULTS)) == (7, 7)
    for words, lines in steps:
        assert bench(words) == (0, lines.splitlines()), words


IN_RAM = (
    "goal_pwm",
    "profile_velocity",
    "profile_acceleration",
    "position_p_gain",
    "position_i_gain",
    "position_d_gain",
    "feedforward_1st_gain",
    "feedforward_2nd_gain",
    "status_return_level",
    "bus_watchdog",
)
OTHERS = [  # registers
    ("operating_mode:FL:16", "operating_mode is 16, expected 3"),
    ("max_position_limit:FL:4095", "max_position_limit is 4095, expected"),
    ("shutdown:FL:52", "shutdown is 52, expected 53"),
    ("return_delay_time:FL:250", "return_delay_time is 250, expected 0"),
    ("velocity_limit:FL:20", "velocity_limit is 20, expected 265"),
]


@pytest.mark.parametrize(("fault", "line"), FAULTS + OTHERS)
def test_a_fault_is_named_and_mended_as_the_page_says(bench, fault, line):
    bench(f"emulate --fault {fault}")
    code, said = bench("info")
    assert code == 1
    assert line in "\n".join(said)
    assert bench("move FL 20")[0] == 1
    if fault.split(":")[0] in TABLE and "answers" not in line:
        assert bench("prepare")[0] == bench("info")[0] == 0


def test_a_leg_moves_whatever_another_tool_has_left_in_ram(bench):
    """No answers to writes, and no duty."""
    for name, value in ("status_return_level", 1), ("goal_pwm", 0):
        bench.legs.bus.servos[1].memory[name] = value
    assert bench("move FR 20 --rate 60") == (
        0,
        [
            "servo FR (id 4): there: at 20.0 deg, goal 20.0 deg",
            "servo FR (id 4): back: at 0.0 deg, goal 0.0 deg",
        ],
    )


@pytest.mark.parametrize("seed", range(6))
def test_any_registers_are_named_and_mended(bench, seed):
    draw, memory = np.random.default_rng(seed), bench.legs.bus.servos[0].memory
    wanted = expected(read_settings(), bench.legs.joints[0])
    # a servo of another rate or protocol does not answer
    for name in sorted({*wanted, *IN_RAM} - {"baud_rate", "protocol_type"}):
        register = TABLE[name]
        memory[name] = draw.integers(register.low, register.high + 1)
    memory["operating_mode"] = draw.choice([*Mode])
    found = {name: memory[name] for name in wanted}
    code, said = bench("info")
    assert code == 1
    assert set(
        re.findall(r"(\w+ is -?\d+, expected -?\d+);", "\n".join(said))
    ) == {
        f"{name} is {found[name]}, expected {value}"
        for name, value in wanted.items()
        if found[name] != value
    }
    assert bench("prepare")[0] == bench("info")[0] == 0
    assert bench("move FL 20 --rate 60") == (
        0,
        [
            "servo FL (id 5): there: at 20.0 deg, goal 20.0 deg",
            "servo FL (id 5): back: at 0.0 deg, goal 0.0 deg",
        ],
    )


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("move FL 117", "ANGLE 117: outside [0, 116.28]"),
        ("move FL 20 --rate 0", "--rate 0: outside [0.1, 60]"),
        ("assign 9", "4 servos on the line [2, 3, 4, 5], expected exactly one"),
        ("--baud 57600 scan", tools.NO_ANSWER),
        ("--baud 57600 prepare", "no answer: servo FL (id 5), servo FR (id 4)"),
        ("emulate --fault FL", "expected KIND:LEG"),
        ("emulate --fault x:FL", "expected spool, a register, or one of sil"),
        ("emulate --fault pwm_limit:FL:886", "outside [0, 885]"),
        ("emulate --fault wrong_id:FL:999", "value = 999.0: outside [0.0, 252"),
    ],
)
def test_what_a_tool_cannot_do_is_refused_in_one_line(bench, words, reason):
    code, (line,) = bench(words)
    assert code == 1
    assert reason in line


def test_zero_measures_the_present_angle_and_writes_it(bench, own_config):
    file = own_config / "dynamixel.yaml"
    comments = file.read_text().count("#")
    bench("emulate --fault spool:FL:5.73")
    assert "; not written without --write" in bench("zero FL")[1][0]
    assert read_settings().joints.zero_deg[0] == 130.0
    assert bench("zero FL --write")[0] == 0
    # 0.1 rad of the tendon = 5.91 deg of the servo; the encoder rounds down to 0.088 deg
    assert read_settings().joints.zero_deg == (
        pytest.approx(135.91, abs=0.09),
        130,
        130,
        130,
    )
    assert file.read_text().count("#") == comments
    assert bench("info")[0] == 1  # the position limits depend on the zero
    assert bench("prepare")[0] == bench("info")[0] == 0


@pytest.mark.parametrize(
    ("key", "angle", "reason"),
    [
        ("zero_deg", 400.0, "zero_deg"),
        ("zero_deg", 300.0, "not within one turn"),
        ("zero", 100.0, "no line zero_deg"),
    ],
)
def test_a_zero_that_cannot_be_written_changes_nothing(
    own_config, key, angle, reason
):
    file = own_config / "dynamixel.yaml"
    before = file.read_text().replace("zero_deg", key)
    file.write_text(before)
    with pytest.raises(ConfigError, match=reason):
        write_zero("RR", angle)
    assert file.read_text() == before


def test_emulate_answers_at_its_link_until_interrupted(tmp_path, capsys):
    link = tmp_path / "servos"
    words = ["-m", "slot_bringup.servos", "emulate", "--link", str(link)]
    process = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline().strip() == str(link)
        scan = ["--port", str(link), "--baud", "1000000", "scan"]
        assert main(scan) == 0
    finally:
        process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    assert main(scan) == 1
    assert "; serial ports: " in capsys.readouterr().err

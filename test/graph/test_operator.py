"""scripts/operate at a pseudo-terminal and by single words, on an attended graph."""

import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import termios
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from slot_bringup.graph import read_graph
from slot_bringup.processes import Processes

OPERATE = [sys.executable, "-m", "slot_bringup.operate"]
LIMIT = 60.0  # s that anything may take on a busy machine
CTRL_C = "\x03"


def attended(port):
    """The nodes of an attended graph on emulated servos."""
    graph = read_graph()
    values = {a.name: a.default for a in graph.arguments}
    return graph.nodes(values | {"hardware": "fake_bus", "attended": True, "port": str(port)})


def other_domain():
    """Far from those of tests that run beside this one."""
    return str(1 + (int(os.environ["ROS_DOMAIN_ID"]) + 49) % 100)


def specs(**values):
    """Nodes of the graph by name."""
    graph = read_graph()
    values = {a.name: a.default for a in graph.arguments} | values
    return {spec.name: spec for spec in graph.nodes(values)}


@pytest.fixture(scope="module")
def graph(environment, tmp_path_factory):
    """A simulated robot that does not move before somebody asks."""
    processes = Processes(tmp_path_factory.mktemp("log"), environment)
    processes.start(specs(attended=True).values())
    try:
        yield
        assert processes.failed() is None
    finally:
        processes.stop()


@pytest.fixture
def bench(environment, tmp_path):
    """Environment of a driver with emulated servos, nobody else, and a configuration of its own."""
    config = tmp_path / "config"
    shutil.copytree(environment["SLOT_CONFIG"], config)
    apart = environment | {"SLOT_CONFIG": str(config), "ROS_DOMAIN_ID": other_domain()}
    nodes = specs(hardware="fake_bus", port=str(tmp_path / "bus"))
    processes = Processes(tmp_path, apart)
    processes.start(nodes[name] for name in ("sim_robot", "dynamixel_driver"))
    log = processes.log_path("dynamixel_driver")
    try:
        end = time.monotonic() + LIMIT
        while "servos on" not in log.read_text():
            assert processes.failed() is None, log.read_text()
            assert time.monotonic() < end
            time.sleep(0.1)
        yield apart
    finally:
        processes.stop()


class Terminal:
    """A live scripts/operate, its keyboard, and all it has drawn."""

    def __init__(self, environment):
        self.end, theirs = pty.openpty()
        self.process = subprocess.Popen(
            ["setsid", "--ctty", *OPERATE], env=environment | {"COLUMNS": "160", "LINES": "40"},
            stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        os.close(theirs)
        self.drawn = bytearray()
        self._is_open = True
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self):
        """All the time: a full terminal would stop the program."""
        with suppress(OSError):  # the program has ended
            while self._is_open:
                self.drawn += os.read(self.end, 65536)

    @property
    def lines(self):
        """The newest whole picture."""
        pictures = self.drawn.decode().split("\x1b[H")
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", pictures[-2]).split("\r\n")

    def wait(self, condition):
        """Until the picture is as it should be; the picture."""
        end = time.monotonic() + LIMIT
        while self.drawn.count(b"\x1b[H") < 2 or not condition(self.lines):
            assert self.process.poll() is None, self.process.stderr.read()
            assert time.monotonic() < end, self.lines
            time.sleep(0.05)
        return self.lines

    def wait_for(self, *states):
        return self.wait(lambda lines: lines[0].startswith(states))

    def press(self, key):
        os.write(self.end, key.encode())

    def bring(self, key, state):
        """Press a key until it is granted: a busy machine has reasons to refuse at first."""
        until = time.monotonic() + LIMIT
        while not self.lines[0].startswith(state):
            assert time.monotonic() < until, self.lines
            self.press(key)
            time.sleep(0.5)

    def close(self):
        """As by the window's button."""
        self._is_open = False
        self._reader.join()  # it waits for the next picture at most
        if self.end is not None:
            os.close(self.end)
            self.end = None
        self.process.wait(20)
        self.process.stderr.close()


@contextmanager
def terminal(environment):
    """A terminal with the robot at rest."""
    opened = Terminal(environment)
    try:
        lines = opened.wait_for("IDLE", "ESTOP", "FAULT")
        if not lines[0].startswith("IDLE"):
            opened.bring("R", "IDLE")
        yield opened
    finally:
        if opened.process.poll() is None:
            opened.process.send_signal(signal.SIGKILL)
        opened.close()


def say(environment, *words):
    """Exit code, output and errors of scripts/operate with these words."""
    done = subprocess.run(
        [*OPERATE, *words],
        env=environment, capture_output=True, text=True, timeout=LIMIT, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


def insist(environment, word):
    """Ask until it is granted."""
    end = time.monotonic() + LIMIT
    while (answer := say(environment, word))[0]:
        assert time.monotonic() < end, (answer, say(environment, "state"))
    return answer


@pytest.mark.usefixtures("graph")
def test_keys_bring_the_robot_to_walk_and_to_rest(environment):
    with terminal(environment) as live:
        for key, state in (("r", "READY"), ("s", "STANDING"), ("w", "WALKING"), ("s", "STANDING")):
            live.bring(key, state)
        live.press("x")
        lines = live.wait_for("IDLE")
        assert "relax requested by the operator" in lines[0]


@pytest.mark.usefixtures("graph")
def test_words_bring_the_robot_to_walk_and_to_rest(environment):
    with terminal(environment) as live:
        for word, state in (("ready", "READY"), ("stand", "STANDING"), ("walk", "WALKING")):
            assert insist(environment, word) == (0, f"{word}: granted\n", "")
            live.wait_for(state)
        code, told, _ = say(environment, "state")
        assert code == 0
        assert re.match(r"WALKING for \d+\.\d s: walk requested by the operator\n", told)
        assert say(environment, "relax") == (0, "relax: granted\n", "")
        live.wait_for("IDLE")


@pytest.mark.usefixtures("graph")
def test_the_space_bar_stops_the_robot_until_a_reset(environment):
    with terminal(environment) as live:
        live.bring("r", "READY")
        live.press(" ")
        lines = live.wait_for("ESTOP")
        assert "e-stop pressed" in lines[0]
        told = "scripts/operate: READY changes nothing in ESTOP\n"
        assert say(environment, "ready") == (1, "", told)
        live.bring("R", "IDLE")


def state_after(environment, end):
    """What becomes of READY when its terminal comes to an end; why it cannot be reset."""
    with terminal(environment) as live:
        live.bring("r", "READY")
        if end == "closed":
            live.close()
        elif end == "interrupted":
            live.press(CTRL_C)
        else:
            live.process.send_signal(signal.SIGSTOP)
        limit = time.monotonic() + LIMIT
        while not (told := re.search("^(ESTOP|FAULT).*$", say(environment, "state")[1], re.M)):
            assert time.monotonic() < limit
        return told[0], say(environment, "reset")[2]


@pytest.mark.usefixtures("graph")
@pytest.mark.parametrize("end", ["closed", "interrupted", "suspended"])
def test_a_terminal_that_ends_stops_the_robot_until_a_reset_at_another(environment, end):
    for _ in range(3):
        told, refusal = state_after(environment, end)
        if not re.search("servo .. silent", told):  # a busy machine keeps a simulated robot waiting
            break
    assert re.match(r"ESTOP for .*: e-stop source silent for .* s, limit 2 s", told)
    assert refusal.startswith("scripts/operate: RESET refused in ESTOP: e-stop source silent")
    with terminal(environment) as another:
        another.wait_for("IDLE")


@pytest.mark.usefixtures("graph")
def test_the_terminal_is_given_back_as_it_was(environment):
    with terminal(environment) as live:
        settings = termios.tcgetattr(live.end)
        assert not settings[3] & (termios.ECHO | termios.ICANON)
        live.press("q")
        live.process.wait(20)
        assert live.process.returncode == 0
        settings = termios.tcgetattr(live.end)
        assert settings[3] & termios.ECHO
        assert settings[3] & termios.ICANON
    assert live.drawn.endswith(b"\x1b[?25h\x1b[?1049l")


def test_servos_without_torque_restart_and_are_zeroed(bench):
    assert say(bench, "reboot", "RL") == (0, "servo RL restarts\n", "")
    code, told, _ = say(bench, "zero", "FL")
    assert code == 0
    zero, path = re.fullmatch(r"zero of FL at (.*) deg, written to (.*)\n", told).groups()
    assert path == f"{bench['SLOT_CONFIG']}/dynamixel.yaml"
    assert f"zero_deg: [{zero}, 130.0, 130.0, 130.0]" in Path(path).read_text()


def test_the_screen_shows_the_servos_and_their_faults_come_and_go(bench):
    live = Terminal(bench)
    try:
        live.wait(lambda lines: sum(line.endswith("  off  none") for line in lines) == 4)
        injected = say(bench, "inject", "overheating", "FR", "--value", "50")
        assert injected == (0, "inject: granted\n", "")
        row = re.compile(r"FR .* 50 +\d+\.\d ")
        live.wait(lambda lines: any(row.match(line) for line in lines))
        assert say(bench, "inject", "overheating", "FR", "--clear")[0] == 0
        live.wait(lambda lines: not any(row.match(line) for line in lines))
    finally:
        live.close()
    code, _, refusal = say(bench, "inject", "tired")
    assert code == 1
    assert refusal.startswith("scripts/operate: inject: fault.kind = 'tired': expected one of")


@pytest.mark.parametrize(
    ("words", "who"),
    [
        (["state"], "supervisor"),
        (["zero", "FL"], "driver of servos"),
        (["inject", "silent"], "simulated robot"),
    ],
)
def test_without_a_graph_it_says_so_in_one_line(words, who):
    domain = other_domain()
    nobody = f"scripts/operate: no {who} answers in ROS domain {domain} within 5 s"
    told = say(os.environ | {"ROS_DOMAIN_ID": domain}, *words)
    assert told == (1, "", f"{nobody}: does scripts/run run?\n")

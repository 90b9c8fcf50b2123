"""scripts/operate at a pseudo-terminal and with arguments, on an attended graph.

Real time: the program's process and its terminal.
"""

import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from contextlib import contextmanager, suppress

import pytest
from real_graph import nodes_of

from slot_bringup.processes import Processes

pytestmark = pytest.mark.real_time

OPERATE = [sys.executable, "-m", "slot_bringup.operate_command"]
CTRL_C = "\x03"


@pytest.fixture(scope="module")
def graph(environment, tmp_path_factory):
    """Graph of a simulated robot that moves only on requests."""
    processes = Processes(tmp_path_factory.mktemp("log"), environment)
    processes.start(nodes_of(attended=True).values())
    try:
        yield
        assert processes.failed() is None
    finally:
        processes.stop()


class Terminal:
    """A running scripts/operate at a pseudo-terminal: keyboard input and screen output."""

    def __init__(self, environment):
        self.end, theirs = pty.openpty()
        self.process = subprocess.Popen(
            ["setsid", "--ctty", *OPERATE],
            env=environment | {"COLUMNS": "160", "LINES": "40"},
            stdin=theirs,
            stdout=theirs,
            stderr=subprocess.PIPE,
            text=True,
        )
        os.close(theirs)
        self.output_bytes = bytearray()
        self._is_open = True
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self):
        """Read all the time, because a full terminal blocks the program."""
        with suppress(OSError):  # the program has ended
            while self._is_open:
                self.output_bytes += os.read(self.end, 65536)

    @property
    def lines(self):
        """Lines of the newest complete frame."""
        frames = self.output_bytes.decode().split("\x1b[H")
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", frames[-2]).split("\r\n")

    def wait(self, condition):
        """Wait until a condition on the lines of the frame holds; return the lines."""
        while self.output_bytes.count(b"\x1b[H") < 2 or not condition(
            self.lines
        ):
            assert self.process.poll() is None, self.process.stderr.read()
            time.sleep(0.05)
        return self.lines

    def wait_for(self, *states):
        return self.wait(lambda lines: lines[0].startswith(states))

    def press(self, key):
        os.write(self.end, key.encode())

    def press_until(self, key, state):
        """Press a key until its request is granted; on a busy machine the first may be refused."""
        for _ in range(60):
            if self.lines[0].startswith(state):
                return
            self.press(key)
            time.sleep(0.5)
        pytest.fail("\n".join((f"{key}: no {state} in 30 s", *self.lines)))

    def reset(self):
        """Accept that the last terminal is gone."""
        self.press("R")
        self.press_until("R", "IDLE")

    def quit(self):
        """Quit, so that the supervisor does not miss this source of the e-stop seconds later."""
        self.press("x")
        self.wait_for("IDLE", "ESTOP", "FAULT")
        self.press("q")
        assert self.process.wait(20) == 0

    def close(self):
        """Close the terminal, as its window's button does."""
        self._is_open = False
        self._reader.join()  # it ends with the next frame
        if self.end is not None:
            os.close(self.end)
            self.end = None
        self.process.wait(20)
        self.process.stderr.close()


@contextmanager
def terminal(environment):
    """A terminal, once it shows a robot without torque."""
    opened = Terminal(environment)
    try:
        opened.wait_for("IDLE", "ESTOP", "FAULT")
        yield opened
    finally:
        if opened.process.poll() is None:
            opened.process.send_signal(signal.SIGKILL)
        opened.close()


def operate(environment, *arguments):
    """Exit code, output and errors of scripts/operate with arguments."""
    done = subprocess.run(
        [*OPERATE, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.usefixtures("graph")
def test_keys_start_a_walk_the_command_line_ends_it_and_the_terminal_is_as_before(
    environment,
):
    with terminal(environment) as live:
        settings = termios.tcgetattr(live.end)
        assert not settings[3] & (termios.ECHO | termios.ICANON)
        live.reset()
        for key, state in (("r", "READY"), ("s", "STANDING"), ("w", "WALKING")):
            live.press_until(key, state)
        code, output, _ = operate(environment, "state")
        assert code == 0
        assert re.match(
            r"WALKING for \d+\.\d s: walk requested by the operator\n", output
        )
        assert operate(environment, "relax") == (0, "relax: granted\n", "")
        assert "relax requested by the operator" in live.wait_for("IDLE")[0]
        live.quit()
        settings = termios.tcgetattr(live.end)
        assert settings[3] & termios.ECHO
        assert settings[3] & termios.ICANON
    assert live.output_bytes.endswith(b"\x1b[?25h\x1b[?1049l")


@pytest.mark.usefixtures("graph")
@pytest.mark.parametrize("end", ["closed", "interrupted"])
def test_end_of_the_terminal_stops_the_robot_until_a_reset_at_another(
    environment, end
):
    with terminal(environment) as live:
        live.reset()
        live.press_until("r", "READY")
        if end == "closed":
            live.close()
        else:
            live.press(CTRL_C)
            live.process.wait(20)
    while "in ESTOP" not in (refused := operate(environment, "reset"))[2]:
        pass
    assert refused[0] == 1
    assert re.match(
        "scripts/operate: RESET refused in ESTOP: e-stop source .* silent",
        refused[2],
    )
    with terminal(environment) as another:
        assert re.match(
            r"ESTOP for .*: e-stop source \S+ silent for .* s, limit 2 s",
            another.lines[0],
        )
        another.reset()
        another.quit()

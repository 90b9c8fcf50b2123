"""Child processes of the graph's nodes: start, supervision, and stop without orphans."""

import json
import os
import signal
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import cast

from ament_index_python.packages import get_package_prefix

from slot_bringup.arguments import PROGRAM
from slot_bringup.forked_node import fork, start_server
from slot_bringup.graph import RESTART, RESTARTS, NodeSpec, absolute, ends_graph
from slot_core.command_line import refuse

STOP_TIMEOUT = 5.0  # s, from SIGINT to SIGKILL


class Processes:
    """Child processes by name, each in its own session with its output in a log file."""

    def __init__(
        self, log_dir: Path, environment: dict[str, str] | None = None
    ):
        self.log_dir = log_dir
        self._environment = environment
        self._children: dict[str, BaseProcess] = {}
        self._specs: dict[str, NodeSpec] = {}
        self._restarts: Counter[str] = Counter()
        self.remarks: list[str] = []
        # processes that have ended, without which the graph goes on
        self.missing: set[str] = set()
        self._nodes: set[str] = set()
        log_dir.mkdir(parents=True, exist_ok=True)

    def start(self, specs: Iterable[NodeSpec]) -> None:
        """Start the nodes; their output goes to `<log_dir>/<name>.log`."""
        specs = list(specs)
        start_server(specs)
        for spec in specs:
            self._nodes.update(spec.nodes or [spec.name])
            self._specs[spec.name] = spec
            self._start(spec)

    def _start(self, spec: NodeSpec) -> None:
        self._children[spec.name] = fork(
            spec,
            command_line(spec),
            self.log_path(spec.name),
            {**(self._environment or os.environ), **spec.environment},
        )

    def __contains__(self, name: str) -> bool:
        """Whether a node of that name was started, also with others in one process."""
        return name in self._nodes

    def log_path(self, name: str) -> Path:
        """File with the output of a node."""
        return self.log_dir / f"{name}.log"

    def last_line(self, name: str) -> str:
        """Last line of a node's output that is not blank."""
        lines = self.log_path(name).read_text(errors="replace").split("\n")
        return next(
            (line for line in reversed(lines) if line.strip()), "(no output)"
        )

    def pid(self, name: str) -> int:
        """Process id of a node."""
        return cast(int, self._children[name].pid)

    def failed(self) -> tuple[str, int] | None:
        """Name and exit code of an ended process with which the graph ends, or None."""
        for name, code in self._ended():
            if ends_graph(self._specs[name].if_it_ends, code):
                return name, code
        return None

    def restart_ended(self, time: float) -> list[str]:
        """Restart processes without which the graph goes on, RESTARTS times each.

        Returns, and adds to `remarks`, a line for each that has ended; `time`: of the run, s.
        """
        lines = []
        for name, code in self._ended():
            if name in self.missing:
                continue
            spec = self._specs[name]
            line = f"at {time:.1f} s {name} ended with exit code {code}: {self.last_line(name)}"
            if spec.if_it_ends == RESTART and self._restarts[name] < RESTARTS:
                self._restarts[name] += 1
                self._start(spec)
                lines.append(f"{line}; restarted")
            else:
                self.missing.add(name)
                lines.append(f"{line}; the robot goes on without it")
        self.remarks += lines
        return lines

    def _ended(self) -> list[tuple[str, int]]:
        """Name and exit code of the processes that are no longer running."""
        return [
            (name, child.exitcode)
            for name, child in self._children.items()
            if child.exitcode is not None
        ]

    def stop(self, last: str = "") -> dict[str, int]:
        """Send SIGINT to every node, to `last` after the others; SIGKILL after STOP_TIMEOUT.

        A line on stderr names a node that had to be killed or failed at its end. Returns the exit
        code of every node.
        """
        others = [name for name in self._children if name != last]
        for names in (others, [last]):
            running = [name for name in names if self._is_running(name)]
            self._signal(running, signal.SIGINT)
            deadline = time.monotonic() + STOP_TIMEOUT
            for name in running:
                child = self._children[name]
                child.join(max(0.0, deadline - time.monotonic()))
                code = child.exitcode
                if code is None:
                    print_error(
                        f"{name} did not end within {STOP_TIMEOUT:g} s of SIGINT: killed"
                    )
                    self._signal([name], signal.SIGKILL)
                    child.join()
                elif code not in (0, -signal.SIGINT):
                    # SIGINT: ended while Python started
                    print_error(
                        f"{name} ended with exit code {code}: {self.last_line(name)}"
                    )
        return {
            name: child.exitcode or 0 for name, child in self._children.items()
        }

    def _is_running(self, name: str) -> bool:
        return name in self._children and self._children[name].exitcode is None

    def _signal(self, names: Iterable[str], number: signal.Signals) -> None:
        for name in names:
            if not self._is_running(name):
                continue
            try:
                os.killpg(self.pid(name), number)
            except ProcessLookupError:
                # it has ended meanwhile, or has no session of its own yet
                with suppress(ProcessLookupError):
                    os.kill(self.pid(name), number)


def command_line(spec: NodeSpec) -> list[str]:
    """Command line of a node; raises PackageNotFoundError if its package is not installed."""
    executable = Path(
        get_package_prefix(spec.package), "lib", spec.package, spec.name
    )
    remaps = dict(spec.remappings)
    if spec.node_name:
        remaps["__node"] = spec.node_name
    if spec.namespace:
        remaps["__ns"] = absolute(spec.namespace)
    command = [str(executable), *spec.nodes, "--ros-args"]
    for old, new in remaps.items():
        command += ["-r", f"{old}:={new}"]
    if spec.params_file:
        command += ["--params-file", spec.params_file]
    for name, value in spec.parameters.items():
        # JSON is YAML
        command += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
    return command


def print_error(line: str) -> None:
    """Print one line of `scripts/run` on stderr."""
    with suppress(OSError):  # the terminal may have been closed
        refuse(PROGRAM, line)

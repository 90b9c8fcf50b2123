"""Start of a node as a fork of a process that has imported all of them.

A node that is started from the shell imports Numba, rclpy and the core first. Python's fork
server (multiprocessing) imports them once, on the first start, and each node is a fork of it: its
own process, session, command line and log, as if it had been started from the shell.
"""

import ctypes
import gc
import multiprocessing
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution
from multiprocessing.forkserver import ensure_running
from multiprocessing.process import BaseProcess
from pathlib import Path

from setproctitle import setproctitle, setthreadtitle

from slot_bringup.graph import NodeSpec

C_LIBRARY = ctypes.CDLL(None)
PR_SET_PDEATHSIG = 1  # of prctl(2)
FROM_TERMINAL = (signal.SIGINT, signal.SIGHUP)
_SERVER = multiprocessing.get_context("forkserver")


def start_server(specs: Sequence[NodeSpec]) -> None:
    """Start the fork server, which imports the modules of the nodes; does nothing if it runs.

    It begins with the terminal's signals blocked, and puts itself out of their way.
    """
    entries = [_entry(spec.package, spec.name) for spec in specs]
    modules = [entry.module for entry in entries if entry is not None]
    modules += [
        f"slot_nodes.{name}_node" for spec in specs for name in spec.nodes
    ]
    _SERVER.set_forkserver_preload(["slot_bringup.fork_server", *modules])
    signal.pthread_sigmask(signal.SIG_BLOCK, FROM_TERMINAL)
    try:
        ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, FROM_TERMINAL)


def fork(
    spec: NodeSpec,
    command: Sequence[str],
    log: Path,
    environment: Mapping[str, str],
) -> BaseProcess:
    """Start a node with its command line; its output is appended to `log`."""
    log.touch()
    given = (spec, list(command), log, Path.cwd(), dict(environment))
    process = _SERVER.Process(
        target=_become, args=given, name=spec.name, daemon=True
    )
    process.start()
    return process


def end_with_parent() -> None:
    """Let the kernel send SIGTERM to this process when its parent ends, for whatever reason.

    Not SIGINT, which is lost while Python imports a module that catches it.
    """
    C_LIBRARY.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _entry(package: str, name: str) -> EntryPoint | None:
    """Entry point of a node's program; None if it is not written in Python."""
    try:
        programs = distribution(package).entry_points.select(
            group="console_scripts"
        )
    except PackageNotFoundError:
        return None
    return next((entry for entry in programs if entry.name == name), None)


def _become(
    spec: NodeSpec,
    command: list[str],
    log: Path,
    directory: Path,
    environment: dict[str, str],
) -> None:
    """Turn this process into the process of a node, and run it to its end."""
    gc.freeze()  # a collection would write to the memory that all forks share
    os.setsid()  # Ctrl-C reaches only the launcher, which ends the nodes
    end_with_parent()
    # before the environment, next to whose memory it is
    setproctitle(" ".join(command))
    setthreadtitle(spec.name)
    program = command[0].encode()  # of which rcl makes the name of its log file
    ctypes.c_char_p.in_dll(C_LIBRARY, "program_invocation_name").value = program
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(directory)
    output = os.open(log, os.O_WRONLY | os.O_APPEND)
    for descriptor in (1, 2):
        os.dup2(output, descriptor)
    os.close(output)
    entry = _entry(spec.package, spec.name)
    if entry is None:
        os.execv(command[0], command)
    sys.argv = command
    sys.exit(entry.load()())

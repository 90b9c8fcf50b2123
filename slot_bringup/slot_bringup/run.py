"""Runs the node graph for a given time, records a bag and prints a summary."""

import argparse
import shutil
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from slot_bringup import composition
from slot_bringup.arguments import PROGRAM, parse
from slot_bringup.check import check
from slot_bringup.graph import Graph, is_attended, is_simulated, read_graph
from slot_bringup.interrupts import deferred, on_interrupt
from slot_bringup.monitor import (
    START_TIMEOUT,
    RunError,
    require_no_other_graph,
    watch,
)
from slot_bringup.playing.main_page import live_page, require_viser
from slot_bringup.processes import Processes, print_error
from slot_core.command_line import progress, refuse, show
from slot_core.config import ConfigError
from slot_core.dynamics.servo import read_servo
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags.bag import Bag, BagError
from slot_lab.report import plots
from slot_lab.report.metrics import summary_lines, walk_metrics

TO_WALK = (
    "with --attended it waits for scripts/operate: r ready, s stand, w walk"
)


def check_options(options: argparse.Namespace) -> None:
    """Refuse values that cannot be run: ends the program with code 2 and one line."""
    try:
        for line in check(vars(options)):
            progress(f"{PROGRAM}: {line}")
        if options.view:
            require_viser()
    except ConfigError as error:
        refuse(PROGRAM, error)
        raise SystemExit(2) from None


def run(
    options: argparse.Namespace,
    graph: Graph,
    directory: Path,
    remarks: list[str],
) -> bool:
    """Run the graph for `options.duration`; bag and logs go to `directory`, which must be writable.

    Returns whether no process is missing at the end. `remarks` gets a line for each that has ended
    early and that the graph does not need. Raises RunError when another one ends, no torso state
    arrives for too long, an unattended robot goes slack, or another graph runs already.
    """
    composed, choice = composition.choose(vars(options))
    if choice:
        progress(f"{PROGRAM}: {choice}")
    values = vars(options) | {"bag": str(directory), "composed": composed}
    shown = (
        live_page(options.namespace, START_TIMEOUT)
        if options.view
        else nullcontext()
    )
    # the robot stops first
    with shown, started(graph, values, directory / "log") as processes:
        try:
            watch(
                processes,
                options.duration,
                is_attended(values),
                options.namespace,
                played=options.hardware == "none",
                remedy=_remedy(values),
            )
        finally:
            remarks += processes.remarks
        return not processes.missing


def _remedy(values: Mapping[str, Any]) -> str:
    """Advice for a graph that is slower than real time; "" where the robot's clock does not run in it."""
    if values["lockstep"] or values["hardware"] == "none":
        return ""
    fewer = "run fewer processes" + (
        "" if values["composed"] else " (--composed)"
    )
    return f"use --lockstep, or {fewer}" if is_simulated(values) else fewer


@contextmanager
def started(
    graph: Graph, values: Mapping[str, Any], logs: Path
) -> Iterator[Processes]:
    """Start the graph's processes; on exit stop them and copy their logs to `logs`.

    Raises RunError if another graph runs already.
    """
    require_no_other_graph(values["namespace"])
    with tempfile.TemporaryDirectory() as scratch:
        processes = Processes(Path(scratch))
        try:
            with deferred():
                processes.start(graph.nodes(values))
            yield processes
        finally:
            # the nodes are already being stopped
            with on_interrupt(signal.SIG_IGN):
                processes.stop(last="recorder")
                # the recorder has reported errors of the disk
                with suppress(OSError):
                    shutil.copytree(scratch, logs, dirs_exist_ok=True)


def report(
    directory: Path,
    keep: bool,
    namespace: str = "",
    remarks: Sequence[str] = (),
) -> bool:
    """Print the summary of the bag and remarks; with `keep` also write them, and the plots.

    Returns False if it cannot be printed.
    """
    bag = Bag(directory, namespace)
    if not bag.counts.get("/mpc_state"):
        raise BagError(f"the robot never stood; {TO_WALK}")
    figures = walk_metrics(bag, read_record_settings().warm_up, read_servo())
    lines = [*summary_lines(figures), *filter(None, [bag.remark]), *remarks]
    shown = show(PROGRAM, lines)
    if keep:
        (directory / "summary.txt").write_text("\n".join(lines) + "\n")
        plots.dashboard(bag, figures, directory / "walk.png")
        shown = shown and show(
            PROGRAM,
            ["", f"bag, summary.txt, walk.png and log/ are in {directory}"],
        )
    return shown


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run slot_bringup run`; returns the exit code."""
    return run_and_report(parse(arguments))


def run_and_report(options: argparse.Namespace) -> int:
    """Run the graph as the command line says, and report on it; returns the exit code."""
    check_options(options)
    graph = read_graph()
    name = f"{options.gait}_{datetime.now():%Y%m%d_%H%M%S}"
    with (
        on_interrupt(signal.default_int_handler),
        tempfile.TemporaryDirectory() as scratch,
    ):
        directory = (
            Path(scratch, name)
            if options.no_bag
            else options.bag or Path("bags", name)
        )
        code, remarks = 0, list[str]()
        try:
            code = 0 if run(options, graph, directory, remarks) else 1
        except RunError as error:
            print_error(str(error))
            code = 1
        except KeyboardInterrupt:
            print_error("interrupted, all nodes stopped")
            code = 130
        if code and not directory.exists():
            return code  # nothing was started
        try:
            if not report(
                directory, not options.no_bag, options.namespace, remarks
            ):
                code = code or 1
        except (BagError, ConfigError, OSError) as error:
            print_error(f"no summary: {error}")
            if not show(PROGRAM, remarks) or isinstance(error, OSError):
                code = code or 1
        except KeyboardInterrupt:
            print_error(
                "interrupted while computing the summary; the bag is complete"
            )
            code = 130
    return code

"""Fits free parameters of a leg to measurements and writes a parameter file.

DATA.csv has one measurement a row: the range of a marker, the force at a tendon angle or a
deflection. slot_lab/calibration/data.py describes the columns;
config/parameters/paper_single_leg.csv is an example.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slot_core import config
from slot_core.command_line import command_parser, positive_integer, progress, show
from slot_core.config import ConfigError
from slot_core.robot import Array, RobotParameters, read_parameters, read_robot
from slot_lab.calibration import parameter_file
from slot_lab.calibration.data import Data, read_data
from slot_lab.calibration.experiments import (
    ExperimentSettings,
    PredictionError,
    predict,
    read_settings,
)
from slot_lab.calibration.fit import (
    FitError,
    FitProblem,
    estimate,
    fit,
    parameters_of,
)
from slot_lab.calibration.plot import write_figure
from slot_lab.csv_table import TableError
from slot_lab.verdict import EXIT_CODES, Verdict

FREE = ("leg.young_modulus", "tendon.offset", "tendon.cable_stiffness", "tendon.slack")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate`: prints a table and the verdict, returns its exit code.

    Ends with exit code 2 and one line of error for invalid data, settings or arguments.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.plot and options.plot.suffix != ".png":
        parser.error(f"--plot {options.plot}: the name of a plot ends in .png")
    try:
        content, verdict = _run(options)
    except (TableError, ConfigError, FitError, PredictionError, OSError) as error:
        parser.error(str(error))
    lines = [*parameter_file.table(content), "", verdict.line]
    return verdict.code if show(parser.prog, lines) else 2


def _run(options: argparse.Namespace) -> tuple[dict[str, object], Verdict]:
    """Fit or evaluate, write the files, and return the content of the parameter file."""
    data, settings = read_data(options.data), read_settings()
    robot, full_set = read_robot(options.start), read_parameters(options.start)
    problem = build_problem(robot, options.free, data, settings)
    values = [p.start for p in problem.parameters]
    progress(f"{data.name}: {len(data.rows)} measurements, {len(values)} free parameters")
    origin = f"evaluation of {options.start}"
    if not options.evaluate:
        found = fit(problem, options.starts, progress)
        values = [parameter_file.rounded(value) for value in found.values]  # those of the file
        end = "" if found.converged else ", not converged"
        origin = f"fit, {options.starts} starts from {options.start}{end}"
    result = estimate(problem, values)
    fitted = {**full_set, **dict(zip(options.free, values))}
    content = parameter_file.record(data, options.free, result, fitted, origin, options.note)
    if options.out:
        parameter_file.write(options.out, content)
        progress(f"wrote {options.out}")
    if options.plot:
        write_figure(data, options.free, result, f"{data.name}: {content['from']}", options.plot)
        progress(f"wrote {options.plot}")
    return content, Verdict(result.chi_square, result.freedom, result.at_bound(options.free))


def build_problem(
    robot: RobotParameters, names: Sequence[str], data: Data, settings: ExperimentSettings
) -> FitProblem:
    """Fit problem of a robot's parameters `names` to measurements; raises ConfigError."""

    def predicted(values: Array) -> Array:
        changed = config.replace(robot, dict(zip(names, values.tolist())))
        return predict(changed, data.rows, settings)

    return FitProblem(
        parameters_of(robot, names),
        predicted,
        np.array([row.value for row in data.rows]),
        np.array([row.sigma for row in data.rows]),
    )


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("calibrate", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add("data", type=Path, metavar="FILE", help="measurements")
    add("--out", type=Path, metavar="FILE", help="parameter file to write (YAML)")
    add("--plot", type=Path, metavar="FILE", help="plot to write")
    free = "parameters to fit (default: " + " ".join(FREE) + ")"
    add("--free", nargs="+", metavar="NAME", default=FREE, help=free)
    add("--start", metavar="NAME", default="paper", help="set of config/parameters to start from")
    starts = "starts of the fit, scattered about the first (default: 8)"
    add("--starts", type=positive_integer, metavar="N", default=8, help=starts)
    add("--evaluate", action="store_true", help="evaluate the set of --start without a fit")
    add("--note", default="", metavar="TEXT", help="text for the parameter file")
    return parser


if __name__ == "__main__":
    sys.exit(main())

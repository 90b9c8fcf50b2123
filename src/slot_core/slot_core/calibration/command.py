"""Fits free parameters of a leg to measurements and writes a parameter file.

DATA.csv holds ranges of markers, forces at tendon angles and deflections, one a row;
slot_core/calibration/data.py describes it, config/parameters/paper_single_leg.csv is an example.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slot_core import config
from slot_core.calibration import parameter_file
from slot_core.calibration.data import Data, DataError, read_data
from slot_core.calibration.experiments import (
    ExperimentSettings,
    PredictionError,
    predict,
    read_settings,
)
from slot_core.calibration.fit import (
    FitError,
    FitProblem,
    ParameterEstimate,
    estimate,
    fit,
    parameters_of,
)
from slot_core.calibration.plot import picture
from slot_core.config import ConfigError
from slot_core.robot import Array, Robot, read_parameters, read_robot

FREE = ("leg.young_modulus", "tendon.offset", "tendon.cable_stiffness", "tendon.slack")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/calibrate`; prints a table, returns the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        content = _run(options)
    except (DataError, ConfigError, FitError, PredictionError, OSError) as error:
        parser.error(" ".join(str(error).split()))
    print("\n".join(parameter_file.table(content)))
    return 0


def _run(options: argparse.Namespace) -> dict[str, object]:
    data, settings = read_data(options.data), read_settings()
    robot, whole = read_robot(options.start), read_parameters(options.start)
    problem = build_problem(robot, options.free, data, settings)
    values = [p.start for p in problem.parameters]
    _say(f"{data.name}: {len(data.rows)} figures, {len(values)} free parameters")
    origin = f"evaluation of {options.start}"
    if not options.evaluate:
        found = fit(problem, options.starts, _say)
        values = _rounded(found.values)
        end = "" if found.converged else ", not converged"
        origin = f"fit, {options.starts} starts from {options.start}{end}"
    result = estimate(problem, values)
    fitted = {**whole, **dict(zip(options.free, values))}
    content = parameter_file.record(data, options.free, result, fitted, origin, options.note)
    _write(options, data, result, content)
    return content


def build_problem(
    robot: Robot, names: Sequence[str], data: Data, settings: ExperimentSettings
) -> FitProblem:
    """The fit of a robot's parameters to measurements; raises ConfigError."""

    def predicted(values: Array) -> Array:
        changed = config.replace(robot, dict(zip(names, values.tolist())))
        return predict(changed, data.rows, settings)

    return FitProblem(
        parameters_of(robot, names),
        predicted,
        np.array([row.value for row in data.rows]),
        np.array([row.sigma for row in data.rows]),
    )


def _rounded(values: Array) -> list[float]:
    """To the digits of the file: what it says of its values holds for them as they stand there."""
    return [float(f"{value:.{parameter_file.DIGITS}g}") for value in values]


def _write(
    options: argparse.Namespace, data: Data, result: ParameterEstimate, content: dict[str, object]
) -> None:
    if options.out:
        parameter_file.write(options.out, content)
        _say(f"wrote {options.out}")
    if options.plot:
        picture(data, options.free, result, f"{data.name}: {content['from']}", options.plot)
        _say(f"wrote {options.plot}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/calibrate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("data", type=Path, metavar="DATA.csv", help="the measurements")
    add("--out", type=Path, metavar="FILE", help="parameter file to write (YAML)")
    add("--plot", type=Path, metavar="PNG", help="picture to write")
    add("--free", nargs="+", metavar="NAME", default=FREE, help="default: " + " ".join(FREE))
    add("--start", metavar="SET", default="paper", help="set of config/parameters to start from")
    starts = "starts in all; the others scatter about the first (default: 8)"
    add("--starts", type=_count, metavar="N", default=8, help=starts)
    add("--evaluate", action="store_true", help="fit nothing: what the data say at --start")
    add("--note", default="", metavar="TEXT", help="kept in the file")
    return parser


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is below 1")
    return value


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())

"""Fit of a leg's free parameters to measurements, and the files that it writes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.progress import ProgressLine
from slot_core.robot import RobotParameters, read_parameters, read_robot
from slot_lab.calibration import parameter_file
from slot_lab.calibration.data import Data, read_data
from slot_lab.calibration.experiments import (
    ExperimentSettings,
    PredictionError,
    predict,
    read_settings,
)
from slot_lab.calibration.fit import FitError, FitProblem, estimate, fit, parameters_of
from slot_lab.calibration.plot import write_figure
from slot_lab.csv_table import TableError
from slot_lab.verdict import Verdict

ERRORS = (TableError, ConfigError, FitError, PredictionError, OSError)


def run(
    options: argparse.Namespace, progress: ProgressLine
) -> tuple[list[str], Verdict]:
    """Fit or evaluate, and write the files; returns the table of the parameters. Raises ERRORS."""
    data, settings = read_data(options.data), read_settings()
    robot, full_set = read_robot(options.start), read_parameters(options.start)
    problem = build_problem(robot, options.free, data, settings)
    values = [p.start for p in problem.parameters]
    progress.say(
        f"{data.name}: {len(data.rows)} measurements, {len(values)} free parameters"
    )
    origin = f"evaluation of {options.start}"
    if not options.evaluate:
        found = fit(problem, options.starts, progress.say, progress)
        values = [
            parameter_file.rounded(value) for value in found.values
        ]  # those of the file
        end = "" if found.converged else ", not converged"
        origin = f"fit, {options.starts} starts from {options.start}{end}"
    progress("intervals")
    result = estimate(problem, values)
    fitted = {**full_set, **dict(zip(options.free, values))}
    content = parameter_file.record(
        data, options.free, result, fitted, origin, options.note
    )
    if options.out:
        parameter_file.write(options.out, content)
        progress.say(f"wrote {options.out}")
    if options.plot:
        write_figure(
            data, options.free, result, f"{data.name}: {content['from']}", options.plot
        )
        progress.say(f"wrote {options.plot}")
    verdict = Verdict(result.chi_square, result.freedom, result.at_bound(options.free))
    return parameter_file.table(content), verdict


def build_problem(
    robot: RobotParameters,
    names: Sequence[str],
    data: Data,
    settings: ExperimentSettings,
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

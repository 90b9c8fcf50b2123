"""Fit of a leg's free parameters to measurements, and the files that it writes."""

import argparse
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slot_core import config
from slot_core.arrays import Array
from slot_core.command_line import ProgressLine
from slot_core.drawing import palette
from slot_core.robot import RobotParameters, read_parameters, read_robot
from slot_lab.calibration import parameter_file
from slot_lab.calibration.data import CONDITIONS, Data, read_data
from slot_lab.calibration.experiments import (
    ExperimentSettings,
    predict,
    read_settings,
)
from slot_lab.calibration.fit import (
    FitProblem,
    ParameterEstimate,
    estimate,
    fit,
    parameters_of,
)
from slot_lab.desk_command import Outcome, write_plot
from slot_lab.verdict import Verdict

DPI = 100
UNITS = {
    "marker_range": (1e3, "mm"),
    "force_angle": (1.0, "N"),
    "deflection": (1e3, "mm"),
}


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Fit or evaluate, and write the files; returns the table and the exit code.

    Raises TableError, ConfigError, FitError, PredictionError, OSError.
    """
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
        values = [parameter_file.rounded(value) for value in found.values]
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
        write_plot(
            figure(
                data, options.free, result, f"{data.name}: {content['from']}"
            ),
            options.plot,
            DPI,
        )
        progress.say(f"wrote {options.plot}")
    verdict = Verdict(
        result.chi_square, result.freedom, result.at_bound(options.free)
    )
    return [*parameter_file.table(content), "", verdict.line], verdict.code


def build_problem(
    robot: RobotParameters,
    names: Sequence[str],
    data: Data,
    settings: ExperimentSettings,
) -> FitProblem:
    """Fit problem of a robot's parameters `names` to measurements; raises ConfigError."""

    def predicted(values: Array) -> Array:
        return predict(
            config.replace(robot, dict(zip(names, values.tolist()))),
            data.rows,
            settings,
        )

    return FitProblem(
        parameters_of(robot, names),
        predicted,
        np.array([row.value for row in data.rows]),
        np.array([row.sigma for row in data.rows]),
    )


def figure(
    data: Data, names: Sequence[str], estimate: ParameterEstimate, title: str
) -> Figure:
    """The figure; the label of each axes is a kind of measurement, `residuals` or `correlation`."""
    kinds = [
        kind
        for kind in CONDITIONS
        if any(row.kind == kind for row in data.rows)
    ]
    out = Figure(
        figsize=(4.2 * (len(kinds) + 2), 4.4), dpi=DPI, layout="constrained"
    )
    out.suptitle(title, fontsize=13, fontweight="bold")
    labels = [*kinds, "residuals", "correlation"]
    axes = {
        n: out.add_subplot(1, len(labels), i, label=n)
        for i, n in enumerate(labels, 1)
    }
    for kind in kinds:
        _predicted_over_measured(axes[kind], data, kind, estimate.predicted)
    _residuals(axes["residuals"], data, estimate.predicted)
    _correlation(axes["correlation"], names, estimate.correlation)
    return out


def _predicted_over_measured(
    ax: Axes, data: Data, kind: str, predicted: Array
) -> None:
    members = [i for i, row in enumerate(data.rows) if row.kind == kind]
    scale, unit = UNITS[kind]
    measured = scale * np.array([data.rows[i].value for i in members])
    sigma = scale * np.array([data.rows[i].sigma for i in members])
    model = scale * predicted[members]
    both = np.concatenate([measured, model])
    ends = 1.05 * np.array([both.min(initial=0.0), both.max()])
    ax.plot(ends, ends, color=palette.PALE, lw=1.2, zorder=0)
    ax.errorbar(
        measured,
        model,
        xerr=sigma,
        fmt="o",
        color=_colour(kind),
        ms=6,
        capsize=3,
    )
    ax.set_title(kind.replace("_", " "), fontsize=11, color=palette.INK)
    ax.set(xlabel=f"measured, one sigma ({unit})", ylabel=f"predicted ({unit})")
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(color=palette.SHADE)


def _residuals(ax: Axes, data: Data, predicted: Array) -> None:
    off = [(p - row.value) / row.sigma for p, row in zip(predicted, data.rows)]
    ax.axhspan(-1, 1, color=palette.SHADE, zorder=0)
    ax.bar(
        range(1, len(off) + 1),
        off,
        color=[_colour(row.kind) for row in data.rows],
    )
    ax.axhline(0.0, color=palette.INK, lw=0.8)
    ax.set_title(
        "residuals, in the order of the file", fontsize=11, color=palette.INK
    )
    ax.set(xlabel="measurement", ylabel="(predicted - measured) / sigma")


def _correlation(ax: Axes, names: Sequence[str], correlation: Array) -> None:
    ax.imshow(np.ma.masked_invalid(correlation), cmap="RdBu_r", vmin=-1, vmax=1)
    ax.set_facecolor(palette.PALE)
    for (r, c), value in np.ndenumerate(correlation):
        determined = bool(np.isfinite(value))
        colour = "white" if determined and abs(value) > 0.6 else palette.INK
        text = f"{value:.2f}" if determined else "-"
        ax.text(c, r, text, ha="center", va="center", color=colour, fontsize=10)
    short = [name.split(".")[-1].replace("_", "\n") for name in names]
    ax.set_xticks(range(len(names)), short, fontsize=8)
    ax.set_yticks(range(len(names)), short, fontsize=8)
    ax.set_title("correlation", fontsize=11, color=palette.INK)


def _colour(kind: str) -> str:
    return palette.STAGE_COLOURS[list(CONDITIONS).index(kind)]

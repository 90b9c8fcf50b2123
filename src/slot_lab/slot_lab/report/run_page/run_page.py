"""Writes the page of a run, or of two runs: one HTML file that loads nothing from anywhere."""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from slot_core.drawing import palette
from slot_core.drawing.shapes import FORCE_SCALE, LEAST_FORCE
from slot_core.progress import untold
from slot_core.refusal import InputError
from slot_core.robot import RobotParameters, read_robot
from slot_lab.bags.bag import Bag
from slot_lab.report import traces
from slot_lab.report.run_page.run_frames import RunFrames, read_frames

HERE = Path(__file__).resolve().parent
SCRIPTS = ("frames.js", "scene.js", "plots.js", "page.js")  # in this order
SUFFIX = ".html"


class PageError(InputError):
    """A page cannot be made; the message is one line."""


def write_page(
    bags: Sequence[Bag], path: Path, progress: Callable[[str, float], object] = untold
) -> list[str]:
    """Write the page of one or two bags; returns lines on it.

    Raises PageError for another suffix, BagError if a bag holds no motion of the torso, OSError.
    """
    if path.suffix.lower() != SUFFIX:
        raise PageError(f"{path}: expected a name that ends in {SUFFIX}")
    robot = read_robot()
    runs = [
        read_frames(bag, robot, partial(progress, f"reading {bag.path}"))
        for bag in bags
    ]
    progress("writing", 0.0)
    text = page(content(runs, robot))
    path.write_text(text, encoding="utf-8")
    counts = ", ".join(f"{run.name} {run.count} frames{_thinned(run)}" for run in runs)
    left_out = [f"left out: {reason}" for run in runs for reason in run.left_out]
    return [f"{path}: {counts}, {len(text) / 1e3:.0f} kB", *left_out]


def _thinned(run: RunFrames) -> str:
    return f" (one of {run.every})" if run.every > 1 else ""


def content(runs: Sequence[RunFrames], robot: RobotParameters) -> dict[str, Any]:
    """Data of a page: robot, plots and runs."""
    held = {name for run in runs for name in run.columns}
    plots = [
        {
            "title": plot.title,
            "curves": [
                {
                    "column": f"{name}/{key}",
                    "names": curve.names,
                    "colours": curve.colours,
                }
                for key, curve in plot.curves.items()
                if f"{name}/{key}" in held
            ],
        }
        for name, plot in traces.PLOTS.items()
    ]
    return {
        "runs": [run.coded() for run in runs],
        "plots": [plot for plot in plots if plot["curves"]],
        "torso": robot.torso.size,
        "width": robot.leg.width,
        "force_scale": FORCE_SCALE,
        "least_force": LEAST_FORCE,
        "colours": {
            "legs": list(palette.LEG_COLOURS.values()),
            "unknown": palette.PALE,
            "torso": palette.TORSO,
            "runs": [palette.TRUE, palette.SECONDARY],
            "ink": palette.INK,
        },
    }


def page(shown: dict[str, Any]) -> str:
    """The page of a content; nothing in it can end the element that holds it."""
    names = " and ".join(run["name"] for run in shown["runs"])
    parts = {
        "title": html.escape(f"SLOT: {names}"),
        "style": _read("page.css"),
        "licence": _read("three/LICENSE").replace("--", "- -"),
        "core": _deflated("three/three.core.min.js"),
        "module": _deflated("three/three.module.min.js"),
        "content": json.dumps(shown, separators=(",", ":")).replace("<", "\\u003c"),
        "script": "\n".join(map(_read, SCRIPTS)),
    }
    before, *rest = _read("page.html").split("{{")
    pieces = (piece.split("}}", 1) for piece in rest)
    return before + "".join(parts[name] + after for name, after in pieces)


def _read(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


def _deflated(name: str) -> str:
    return base64.b64encode(zlib.compress((HERE / name).read_bytes(), 9)).decode()

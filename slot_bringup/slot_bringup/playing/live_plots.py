"""Plots of the last seconds beside the robot, from the messages that are drawn."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
import viser
from viser import uplot

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_lab.report import traces

SPAN = 10.0  # s shown
POINTS = 250
SHOWN = (
    "velocity",
    "height",
    "roll",
    "pitch",
    "angle",
    "force",
    "tension",
    "disturbance",
)
LEGEND = (
    "display:grid;grid-template-columns:repeat(4,auto);white-space:nowrap;"
    "font-size:0.7em;padding:0.7em 0.3em 0"
)
HEIGHT, AXIS = 150, 62  # px, of a plot and of the numbers at its side


class LivePlots:
    """Curves of `traces.PLOTS` over the last seconds."""

    def __init__(self, gui: viser.GuiApi) -> None:
        # rows of a curve by `plot/curve`; row 0: time, s
        self._rows: dict[str, slice] = {}
        self._plots: list[tuple[Any, slice]] = []
        # ns, first stamp; a graph's clock may count from 1970
        self._start: int | None = None
        shown, end = "", 1
        for name in SHOWN:
            # the same holds for those below
            if shown != (shown := legend(traces.PLOTS[name])):
                gui.add_html(shown)
            begin = end
            for key, curve in traces.PLOTS[name].curves.items():
                self._rows[f"{name}/{key}"] = slice(end, end + len(curve.names))
                end += len(curve.names)
            rows = slice(begin, end)
            self._plots.append((_add_plot(gui, traces.PLOTS[name]), rows))
        self._now: Array = np.full(end, np.nan)
        self._table = np.zeros((end, 0))

    def receive(self, topic: str, message: Any) -> None:
        """Take the values of a message."""
        for name, values in traces.values(topic, message).items():
            if name in self._rows:
                self._now[self._rows[name]] = values

    def advance(self, stamp: int) -> None:
        """Add a point at `stamp` (ns) of the values taken since the last."""
        self._start = stamp if self._start is None else self._start
        self._now[0] = time = to_seconds(stamp - self._start)
        if not self._table.shape[1] or time > self._table[0, -1]:
            table = np.column_stack([self._table, self._now])
            self._table = table[:, table[0] > time - SPAN][:, -POINTS * 2 :]

    def show(self) -> None:
        """Show the added points."""
        if self._table.shape[1] > 1:
            for handle, rows in self._plots:
                handle.data = (self._table[0], *self._table[rows])

    def clear(self) -> None:
        """Forget all values: time begins anew."""
        self._start, self._table = None, self._table[:, :0]


def legend(plot: traces.Plot) -> str:
    """HTML of the names of a plot's curves, in lines of four, each after its colour."""
    curves = [
        each
        for curve in plot.curves.values()
        for each in zip(curve.names, curve.colours)
    ]
    names = (
        f'<span><b style="color:{c}">\u25ac</b> {escape(name)}</span>'
        for name, c in curves
    )
    return f'<div style="{LEGEND}">{"".join(names)}</div>'


def _add_plot(gui: viser.GuiApi, plot: traces.Plot) -> Any:
    curves = [
        uplot.Series(label=name, stroke=colour)
        for curve in plot.curves.values()
        for name, colour in zip(curve.names, curve.colours)
    ]
    return gui.add_uplot(
        tuple(np.zeros((1 + len(curves), 2))),
        (uplot.Series(label="s"), *curves),
        title=plot.title,
        height=HEIGHT,
        scales={"x": uplot.Scale(time=False)},
        legend=uplot.Legend(show=False),
        axes=(uplot.Axis(), uplot.Axis(size=AXIS)),
    )

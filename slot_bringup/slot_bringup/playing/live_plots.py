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
        self._plots: dict[str, _LivePlot] = {}
        # ns, first stamp; a graph's clock may count from 1970
        self._start: int | None = None
        shown = ""
        for name in SHOWN:
            # the same holds for those below
            if shown != (shown := legend(traces.PLOTS[name])):
                gui.add_html(shown)
            self._plots[name] = _LivePlot(gui, name)

    def receive(self, topic: str, message: Any) -> None:
        """Take the values of a message."""
        for name, values in traces.values(topic, message).items():
            plot, _, curve = name.partition("/")
            if plot in self._plots:
                self._plots[plot].set(curve, values)

    def advance(self, stamp: int) -> None:
        """Add a point at `stamp` (ns) of the values taken since the last."""
        self._start = stamp if self._start is None else self._start
        for plot in self._plots.values():
            plot.advance(to_seconds(stamp - self._start))

    def show(self) -> None:
        """Show the added points."""
        for plot in self._plots.values():
            plot.show()

    def clear(self) -> None:
        """Forget all values: time begins anew."""
        self._start = None
        for plot in self._plots.values():
            plot.clear()


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


class _LivePlot:
    def __init__(self, gui: viser.GuiApi, name: str) -> None:
        plot = traces.PLOTS[name]
        self._rows: dict[str, slice] = {}
        curves: list[tuple[str, str]] = []
        for key, curve in plot.curves.items():
            self._rows[key] = slice(
                1 + len(curves), 1 + len(curves) + len(curve.names)
            )
            curves += list(zip(curve.names, curve.colours))
        self._now: Array = np.full(len(curves), np.nan)
        self._table = np.zeros((1 + len(curves), 0))  # row 0: time, s
        series = [
            uplot.Series(label="s"),
            *(uplot.Series(label=n, stroke=c) for n, c in curves),
        ]
        self._handle = gui.add_uplot(
            tuple(np.zeros((1 + len(curves), 2))),
            tuple(series),
            title=plot.title,
            height=HEIGHT,
            scales={"x": uplot.Scale(time=False)},
            legend=uplot.Legend(show=False),
            axes=(uplot.Axis(), uplot.Axis(size=AXIS)),
        )

    def set(self, curve: str, values: Array) -> None:
        rows = self._rows[curve]
        self._now[rows.start - 1 : rows.stop - 1] = values

    def advance(self, time: float) -> None:
        if self._table.shape[1] and time <= self._table[0, -1]:
            return
        table = np.column_stack([self._table, np.append(time, self._now)])
        self._table = table[:, table[0] > time - SPAN][:, -POINTS * 2 :]

    def show(self) -> None:
        if self._table.shape[1] > 1:
            self._handle.data = tuple(self._table)

    def clear(self) -> None:
        self._table = self._table[:, :0]

"""The page of a running graph: the robot, its steering, faults of its simulation, plots."""

import time
from collections.abc import Callable

import viser

from slot_bringup.playing import controls
from slot_bringup.playing.graph_robot import GraphRobot
from slot_bringup.playing.robot_display import PLOTTED, WINDOW, Page
from slot_bringup.playing.status_text import of_speed, strong
from slot_core.clock import to_seconds
from slot_core.messages import decode
from slot_lab.play.played_robot import FRAME
from slot_nodes.pace import Speed

STATE = "/robot_state"
# s without a state, which comes every 20 ms, until the page says so
SILENT = 2.0


class GraphPage(Page[GraphRobot]):
    """A page that shows and drives a running graph."""

    def __init__(self, server: viser.ViserServer, robot: GraphRobot) -> None:
        super().__init__(server, robot)
        self._pace = Speed(WINDOW)
        self._heard = 0.0  # time of the last state, s
        keys = controls.add_estop(server.gui, self.do)
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Drive"):
            controls.add_drive(server.gui, self.do, keys, robot.gait)
        with tabs.add_tab("Faults"):
            controls.add_faults(server.gui, self.do)
        with tabs.add_tab("Plots"):
            self.display.add_plots()
        with tabs.add_tab("Keys"):
            keys.show()

    def run(
        self,
        ended: Callable[[], bool],
        spin: Callable[[float], object],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Show the graph until `ended`; `spin` handles its messages for at most a time, s."""
        self._heard = due = clock()
        while not ended():
            spin(max(0.0, due - clock()))
            if clock() < due:
                continue
            due = max(due + FRAME, clock())
            self.do_wanted()
            begin = clock()
            self._show(begin)
            drawing = f"drawing {1e3 * (clock() - begin):.0f} ms of {1e3 * FRAME:.0f} ms"
            if (state := self.display.newest.get("/mpc_state")) is not None:
                self._pace.add(clock(), to_seconds(decode.stamp(state)))
            self.write(self._of_speed(clock(), drawing), self.robot.said)

    def _show(self, now: float) -> None:
        try:
            messages = self.robot.frame()
            if STATE in dict(messages):
                self._heard = now
            self.display.show(messages, plots=self.count % PLOTTED == 0)
        except ValueError as error:
            self.said = f"a message is refused: {error}"
        if now - self._heard > SILENT:
            self.display.newest.clear()  # it would be said of a graph that may have ended

    def _of_speed(self, now: float, drawing: str) -> str:
        if (silent := now - self._heard) > SILENT:
            return strong(
                f"no state for {silent:.0f} s: the graph has ended, or hangs"
            )
        return of_speed(self._pace.until(now), 1.0, drawing)

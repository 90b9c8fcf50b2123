"""Acts of a user, common to the pages of a played robot and of a running graph, and their answers."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import viser

from slot_bringup.playing.robot_display import RobotDisplay
from slot_bringup.playing.status_text import StatusText, block
from slot_core.config import ConfigError

Robot = TypeVar("Robot")
WINDOW = 2.0  # s, over which the speed is measured
PLOTTED, WRITTEN = 6, 3  # frames between two updates of the plots, of the text


class Page(Generic[Robot]):
    """A page that shows a robot, and acts on it between two frames."""

    def __init__(self, server: viser.ViserServer, robot: Robot) -> None:
        self.server, self.robot = server, robot
        self.display = RobotDisplay(server)
        self.count = 0  # of frames
        self.said = ""  # what the page said last: a refusal, a bag
        self._wanted: queue.SimpleQueue[Callable[[Robot], object]] = queue.SimpleQueue()
        self._status = StatusText()
        self._text: Any = server.gui.add_html("")

    def do(self, act: Callable[[Robot], object]) -> None:
        """Let something be done to the robot before its next frame."""
        self._wanted.put(act)

    def do_wanted(self) -> bool:
        """Carry out the waiting acts, and report refused ones."""
        wanted = not self._wanted.empty()
        while not self._wanted.empty():
            self.said = ""
            try:
                self._wanted.get()(self.robot)
            except ConfigError as error:
                self.said = str(error)
        return wanted

    def write(self, speed: str, *remarks: str) -> None:
        """Write the page's text on the robot, in every third frame."""
        if self.count % WRITTEN == 0:
            shown = self.display
            lines = self._status.of(shown.newest, shown.position, [*remarks, self.said])
            self._text.content = block([*lines, speed])
        self.count += 1

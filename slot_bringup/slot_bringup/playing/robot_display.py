"""A page with the robot, its plots and status text from the messages of a run, and a user's acts."""

import queue
from collections.abc import Callable, Iterable
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
import viser

from slot_bringup.playing.live_plots import LivePlots
from slot_bringup.playing.scene_view import SceneView
from slot_bringup.playing.status_text import StatusText, acts, block
from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.drawing.drawing import Bars, Drawing, Shape
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import LEGS, read_robot
from slot_lab.report import traces

Robot = TypeVar("Robot")
WINDOW = 2.0  # s, over which the speed is measured
PLOTTED, WRITTEN = 6, 3  # frames between two updates of the plots, of the text
# shapes of a policy that acts: its plan, and the forces
PLANNED = (
    "reference",
    "reference_path",
    "horizon",
    "predicted_path",
    "predicted_feet",
    "demanded_forces",
    "ground_forces",
)
Named: TypeAlias = tuple[str, Any]  # topic and message
TOPICS = tuple(dict.fromkeys((*Drawing.TOPICS, *traces.TOPICS)))
View: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Places of the camera, and of its target, m."""
WIDE: View = (0.28, -0.5, 0.25), (0.0, 0.0, 0.05)
# On a phone the panel of viser covers the lower 60 % of the page.
TALL: View = (0.5, -0.9, 0.41), (0.0, 0.0, -0.45)


class RobotDisplay:
    """Shows the messages of a run; `newest` has the newest by topic."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.view = SceneView(server.scene)
        self.newest: dict[str, Any] = {}
        self._drawing = _new_drawing()
        self._plots: LivePlots | None = None
        server.on_client_connect(_place_camera)

    def add_plots(self) -> None:
        """Add the plots where elements of the page are added now."""
        self._plots = LivePlots(self._server.gui)

    def show(self, messages: Iterable[Named], *, plots: bool) -> None:
        """Show messages, with the plots or without; raises ValueError for an invalid message."""
        shapes: dict[str, Shape] = {}
        with self._server.atomic():
            for topic, message in messages:
                shapes |= self._drawing.receive(topic, message)
                if self._plots is not None:
                    self._plots.receive(topic, message)
                self.newest[topic] = message
            # its stamps are the points of the plots, once the rest of the frame is there
            if self._plots is not None and "/mpc_state" in self.newest:
                self._plots.advance(decode.stamp(self.newest["/mpc_state"]))
            if not acts(self.newest):
                shapes = {n: s for n, s in shapes.items() if n not in PLANNED}
                self.view.remove(*PLANNED)
            self.view.update(shapes)
            if isinstance(legs := shapes.get("legs"), Bars):
                tips = legs.corners[:, -1].mean(axis=1)
                self.view.label(dict(zip(LEGS, tips)))
            if (position := self.position) is not None:
                self.view.centre(position)
            if plots and self._plots is not None:
                self._plots.show()

    @property
    def position(self) -> Array | None:
        """Position (3,) of the torso, m: the true one where it is known; None before the first."""
        if (truth := self.newest.get("/ground_truth/odom")) is not None:
            return np.array(decode.odometry(truth)[1])
        if (state := self.newest.get("/mpc_state")) is not None:
            return decode.estimate(state).state[3:6]
        return None

    def clear(self) -> None:
        """Forget all earlier messages: time begins anew."""
        self.newest.clear()
        self.view.remove("path", "reference_path")
        self._drawing = _new_drawing()
        if self._plots is not None:
            self._plots.clear()


def _new_drawing() -> Drawing:
    servo = read_servo()
    return Drawing(
        read_robot(), float(servo.tendon_stall(servo.nominal_voltage))
    )


def _place_camera(client: viser.ClientHandle) -> None:
    """Show the first view, and again where a page changes its shape, as a phone that is turned."""
    shown: View | None = None

    def place(camera: viser.CameraHandle) -> None:
        nonlocal shown
        wanted = TALL if camera.aspect < 1.0 else WIDE  # width over height
        if shown is not wanted:
            camera.position, camera.look_at = shown = wanted

    place(client.camera)
    client.camera.on_update(place)


class Page(Generic[Robot]):
    """A page that shows a robot, and acts on it between two frames."""

    def __init__(self, server: viser.ViserServer, robot: Robot) -> None:
        self.server, self.robot = server, robot
        self.display = RobotDisplay(server)
        self.count = 0  # of frames
        self.said = ""  # what the page said last: a refusal, a bag
        self._wanted: queue.SimpleQueue[Callable[[Robot], object]] = (
            queue.SimpleQueue()
        )
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
            lines = self._status.of(
                self.display.newest,
                self.display.position,
                [*remarks, self.said],
            )
            self._text.content = block([*lines, speed])
        self.count += 1

"""The page: the robot, its controls and plots, in step with the wall clock.

Everything that moves the robot happens in `run`, in one thread: what the controls ask for, the
frames of the robot, the drawing. The page says how fast that is, and where the time goes.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from slot_bringup.playing import controls, robot_messages
from slot_bringup.playing.live_plots import LivePlots, stamp_of
from slot_bringup.playing.scene_view import SceneView
from slot_bringup.playing.status_text import Costs, StatusText, block, of_speed
from slot_core.config import ConfigError
from slot_core.control.pace import Speed
from slot_core.drawing import palette
from slot_core.drawing.drawing import Drawing
from slot_core.drawing.shapes import FORCE_SCALE, Arrows, Shape, rgb
from slot_core.dynamics.servo import read_servo
from slot_core.recording.bag_error import BagError
from slot_core.robot import read_robot
from slot_lab.play.played_robot import FRAME, PlayedRobot

SPEEDS = {"real time": 1.0, "1/2": 0.5, "1/4": 0.25, "1/10": 0.1}
LATE = 0.25  # s behind the wall clock from which the robot's clock falls behind
WINDOW = 2.0  # s, over which the speed is measured
PLOTTED, WRITTEN = 6, 3  # frames between two updates of the plots, of the text
PULL, PULL_MAX = 60.0, 20.0  # N per m of the mouse, N
PUSHED, PUSH_WIDTH = rgb("#C00000"), 0.006  # m
CAMERA, LOOK_AT = (0.28, -0.5, 0.25), (0.0, 0.0, 0.05)
PAYLOAD = "/robot/torso/payload"


class PlayPage:
    """A page that shows and drives a played robot."""

    def __init__(self, server: viser.ViserServer, robot: PlayedRobot, bags: Path) -> None:
        """bags: directory for what is saved."""
        self._server, self.robot, self._bags = server, robot, bags
        self._wanted: queue.SimpleQueue[controls.Act] = queue.SimpleQueue()
        self._steps = 0  # to take while paused
        self._paused, self._said = False, ""  # what the page said last: a refusal, a bag
        self._speed, self._pace = 1.0, Speed(WINDOW)
        self._costs = Costs()
        self._view = SceneView(server.scene)
        self._drawing = self._new_drawing()
        self._size = np.array(read_robot().torso.size)
        self._payload: Any = None
        self._status, self._count = StatusText(), 0
        self._build()
        server.on_client_connect(_place_camera)
        server.on_client_disconnect(lambda _: self.do(_let_go))  # in the middle of a drag

    def do(self, act: controls.Act) -> None:
        """Let something be done to the robot before its next frame."""
        self._wanted.put(act)

    def run(
        self,
        ended: Callable[[], bool],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Play until `ended`; `clock`: s."""
        due = clock()
        while not ended():
            self._do_wanted()
            moves = not self._paused or self._steps > 0
            self._steps = max(0, self._steps - 1)
            if moves:
                self._frame()
                self._pace.add(clock(), self.robot.time)
            else:
                self._pace = Speed(WINDOW)
            if self._count % WRITTEN == 0:
                self._write(clock())
            self._count += 1
            due = max(due + FRAME / self._speed, clock() - LATE)
            sleep(max(0.0, due - clock()))

    def _build(self) -> None:
        gui = self._server.gui
        self._text = gui.add_html("")
        run = gui.add_button_group("time", ("pause", "go on", "step", "reset", "save"))
        run.on_click(lambda _: self._on_time(run.value))
        speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="real time")
        speed.on_update(lambda _: self.do(lambda _: self._set_speed(SPEEDS[speed.value])))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            controls.add_drive(gui, self.robot, self.do)
        with tabs.add_tab("World"):
            controls.add_world(gui, self.robot, self.do)
        with tabs.add_tab("Push"):
            controls.add_push(gui, self.do)
        with tabs.add_tab("Plots"):
            self._plots = LivePlots(gui)
        controls.add_key(gui, "P", "pause, or go on", self._toggle)
        for key, what in {"N": "step", "R": "reset", "B": "save"}.items():
            controls.add_key(gui, key, what, partial(self._on_time, what))
        controls.add_key(gui, "X", "e-stop", lambda: self.do(controls.REQUESTS["e-stop"]))

    def _toggle(self) -> None:
        self._on_time("go on" if self._paused else "pause")

    def _on_time(self, what: str) -> None:
        self.do(getattr(self, f"_{what.replace(' ', '_')}"))

    def _pause(self, _: PlayedRobot) -> None:
        self._paused = True

    def _go_on(self, _: PlayedRobot) -> None:
        self._paused = False

    def _step(self, _: PlayedRobot) -> None:
        self._paused, self._steps = True, self._steps + 1

    def _reset(self, robot: PlayedRobot) -> None:
        robot.reset()
        self._view.remove("path", "reference_path")
        self._plots.clear()
        self._drawing = self._new_drawing()
        self._pace = Speed(WINDOW)

    def _save(self, robot: PlayedRobot) -> None:
        path = self._bags / f"play_{datetime.now():%Y%m%d_%H%M%S}"
        try:
            count = robot_messages.save(robot, path)
        except BagError as error:
            self._said = str(error)
            return
        self._said = f"{count} messages are in {path}"

    def _set_speed(self, speed: float) -> None:
        self._speed = speed

    def _new_drawing(self) -> Drawing:
        servo = read_servo()
        return Drawing(read_robot(), float(servo.tendon_stall(servo.nominal_voltage)))

    def _do_wanted(self) -> None:
        while not self._wanted.empty():
            self._said = ""
            try:
                self._wanted.get()(self.robot)
            except ConfigError as error:
                self._said = str(error)

    def _frame(self) -> None:
        """Advance the robot by a frame, and draw it."""
        begin = time.perf_counter()
        happened = self.robot.advance()
        simulated = time.perf_counter()
        if self.robot.ended:
            return
        shapes: dict[str, Shape] = {}
        with self._server.atomic():
            for topic, message in robot_messages.of_frame(happened):
                shapes |= self._drawing.receive(topic, message)
                self._plots.receive(topic, message)
                if (stamp := stamp_of(topic, message)) is not None:
                    self._plots.advance(stamp)
            self._draw(shapes)
            if self._count % PLOTTED == 0:
                self._plots.show()
        self._costs.add(simulated - begin, time.perf_counter() - simulated)

    def _draw(self, shapes: dict[str, Shape]) -> None:
        """Show shapes, the force that pushes the torso, and the payload."""
        if (truth := self.robot.truth) is None:
            return
        model, position = self.robot.model, truth.odometry.position
        push = np.array([model.push[:3]])
        arrow = Arrows(position[None], FORCE_SCALE * push, PUSHED[None], PUSH_WIDTH)
        self._view.update(shapes | ({"push": arrow} if push.any() else {}))
        self._view.show("push", visible=bool(push.any()))
        self._view.centre(position)
        if self._payload is None:
            self._payload = self._add_payload()
        self._payload.visible = bool(model.payload[0])
        self._payload.position = model.payload[1:]

    def _add_payload(self) -> Any:
        """Add the payload, and let the mouse move it and pull at the torso."""
        colour = tuple(round(255 * c) for c in rgb(palette.SECONDARY))
        radius = controls.PAYLOAD_RADIUS
        payload = self._server.scene.add_icosphere(PAYLOAD, radius=radius, color=colour)
        payload.on_drag(self._on_payload)
        self._view.handle("torso").on_drag(self._on_torso)
        return payload

    async def _on_payload(self, event: Any) -> None:
        """Place the payload where the mouse is, on the torso."""
        seen = np.array([event.client.camera.position, event.end_position])

        def place(robot: PlayedRobot) -> None:
            if robot.truth is None:
                return
            position, quaternion = robot.truth.odometry.position, robot.truth.odometry.quaternion
            eye, mouse = Rotation.from_quat(quaternion).inv().apply(seen - [0.0, 0.0, position[2]])
            top = controls.on_top(robot)
            if min(eye[2] - top, eye[2] - mouse[2]) <= 0.0:
                return  # the line of sight does not meet the top
            point = eye + (mouse - eye) * (eye[2] - top) / (eye[2] - mouse[2])
            x, y = np.clip(point[:2], -self._size[:2] / 2, self._size[:2] / 2)
            robot.change({"scene.payload.place": [float(x), float(y), top]})

        self.do(place)

    async def _on_torso(self, event: Any) -> None:
        """Pull at the torso towards the mouse."""
        way = np.subtract(event.end_position, event.start_position)
        length = float(np.linalg.norm(way))
        force = way * min(PULL, PULL_MAX / max(length, 1e-9))
        self.do(_let_go if event.phase == "end" else lambda r: r.pull(force))

    def _write(self, now: float) -> None:
        """Write what the page says of the robot."""
        lines = self._status.of_robot(self.robot, self._said)
        factor = self._pace.until(now)
        speed = "paused" if self._paused else of_speed(factor, self._speed, self._costs)
        self._text.content = block([*lines, speed])


def _let_go(robot: PlayedRobot) -> None:
    robot.pull(np.zeros(3))


def _place_camera(client: viser.ClientHandle) -> None:
    client.camera.position, client.camera.look_at = CAMERA, LOOK_AT

"""The page: the robot, its controls and plots, in step with the wall clock.

Everything that moves the robot happens in `run`, in one thread: what the controls ask for, the
frames of the robot, the drawing. The page says how fast that is, and where the time goes.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation

from slot_bringup.playing import controls
from slot_bringup.playing.robot_display import PLOTTED, WINDOW, Named, Page
from slot_bringup.playing.scene_view import PUSHED
from slot_bringup.playing.status_text import Costs, of_speed, strong
from slot_core.clock import LOCKSTEP_START
from slot_core.control.controller import Tick
from slot_core.drawing import palette
from slot_core.drawing.drawing import force_arrows, rgb
from slot_core.recording.bag_writer import BagWriter, message_types
from slot_core.recording.origin import origin_here
from slot_core.recording.record_settings import BagError, read_record_settings
from slot_core.robot import read_robot
from slot_core.safety.supervisor import Report
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.readings import (
    ImuReading,
    OdometryReading,
    StampedHealth,
    TrueState,
)
from slot_lab.play.played_robot import FRAME, Happened, PlayedRobot
from slot_nodes import messages
from slot_nodes.pace import Pace, Speed

SPEEDS = {"real time": 1.0, "1/2": 0.5, "1/4": 0.25, "1/10": 0.1}
# the first word names the method
TIME_KEYS = {
    "p": "pause or go on",
    "n": "step",
    "backspace": "restart",
    "b": "save",
}
LATE = 0.25  # s behind the wall clock from which the robot's clock falls behind
PULL, PULL_MAX = 60.0, 20.0  # N per m of the mouse, N
PAYLOAD = "/robot/torso/payload"


class PlayPage(Page[PlayedRobot]):
    """A page that shows and drives a played robot."""

    def __init__(
        self, server: viser.ViserServer, robot: PlayedRobot, bags: Path
    ) -> None:
        """bags: directory for saved bags."""
        super().__init__(server, robot)
        self._bags = bags
        self._paused, self._steps = False, 0  # steps to take while paused
        self._speed, self._pace = 1.0, Speed(WINDOW)
        self._costs = Costs()
        self._size = np.array(read_robot().torso.size)
        self._payload: Any = None
        self._build()
        # in the middle of a drag
        server.on_client_disconnect(lambda _: self.do(_let_go))

    def run(
        self,
        ended: Callable[[], bool],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Play until `ended`; `clock`: s."""
        due = clock()
        while not ended():
            acted = self.do_wanted()
            moves = not self._paused or self._steps > 0
            self._steps = max(0, self._steps - 1)
            if moves:
                self._frame()
                self._pace.add(clock(), self.robot.time)
            else:
                self._pace = Speed(WINDOW)
                if acted:
                    self._draw()
            self.write(self._of_speed(clock()), self.robot.loop.refusal)
            due = max(due + FRAME / self._speed, clock() - LATE)
            sleep(max(0.0, due - clock()))

    def _build(self) -> None:
        gui = self.server.gui
        keys = controls.add_estop(gui, self.do)
        run = gui.add_button_group("time", tuple(TIME_KEYS.values()))
        run.on_click(lambda _: self._on_time(run.value))
        speed = gui.add_dropdown(
            "speed", tuple(SPEEDS), initial_value="real time"
        )
        speed.on_update(
            lambda _: self.do(lambda _: self._set_speed(SPEEDS[speed.value]))
        )
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            controls.add_policy(gui, self.do, keys, self.robot.policy)
            controls.add_drive(gui, self.do, keys)
        with tabs.add_tab("World"):
            controls.add_world(gui, self.robot, self.do)
        with tabs.add_tab("Push"):
            controls.add_push(gui, self.do)
        with tabs.add_tab("Plots"):
            self.display.add_plots()
        for key, what in TIME_KEYS.items():
            keys.bind(key, what, partial(self._on_time, what))
        with tabs.add_tab("Keys"):
            keys.show()

    def _on_time(self, what: str) -> None:
        self.do(getattr(self, f"_{what.partition(' ')[0]}"))

    def _pause(self, _: PlayedRobot) -> None:
        self._paused = not self._paused

    def _step(self, _: PlayedRobot) -> None:
        self._paused, self._steps = True, self._steps + 1

    def _restart(self, robot: PlayedRobot) -> None:
        robot.reset()
        self.display.clear()
        self._pace = Speed(WINDOW)

    def _save(self, robot: PlayedRobot) -> None:
        path = self._bags / f"play_{datetime.now():%Y%m%d_%H%M%S}"
        try:
            self.said = f"{save(robot, path)} messages are in {path}"
        except BagError as error:
            self.said = str(error)

    def _set_speed(self, speed: float) -> None:
        self._speed = speed

    def _frame(self) -> None:
        """Advance the robot by a frame, and draw it."""
        begin = time.perf_counter()
        happened = self.robot.advance()
        simulated = time.perf_counter()
        if self.robot.ended:
            return
        with self.server.atomic():
            self.display.show(
                of_frame(happened), plots=self.count % PLOTTED == 0
            )
            self._draw()
        self._costs.add(simulated - begin, time.perf_counter() - simulated)

    def _draw(self) -> None:
        """Show the force that pushes the torso, and the payload."""
        if (truth := self.robot.truth) is None:
            return
        model, position, view = (
            self.robot.model,
            truth.odometry.position,
            self.display.view,
        )
        push = np.array([model.push[:3]])
        view.update(
            {"push": force_arrows(position[None], push, rgb(PUSHED)[None])}
        )
        if self._payload is None:
            self._payload = self._add_payload()
        self._payload.visible = bool(model.payload[0])
        self._payload.position = model.payload[1:]

    def _add_payload(self) -> Any:
        """Add the payload, and let the mouse move it and pull at the torso."""
        colour = tuple(round(255 * c) for c in rgb(palette.SECONDARY))
        payload = self.server.scene.add_icosphere(
            PAYLOAD, radius=controls.PAYLOAD_RADIUS, color=colour
        )
        payload.on_drag(self._on_payload)
        self.display.view.handle("torso").on_drag(self._on_torso)
        return payload

    async def _on_payload(self, event: Any) -> None:
        """Place the payload where the mouse is, on the torso."""
        seen = np.array([event.client.camera.position, event.end_position])

        def place(robot: PlayedRobot) -> None:
            if robot.truth is None:
                return
            position, quaternion = (
                robot.truth.odometry.position,
                robot.truth.odometry.quaternion,
            )
            eye, mouse = (
                Rotation.from_quat(quaternion)
                .inv()
                .apply(seen - [0.0, 0.0, position[2]])
            )
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

    def _of_speed(self, now: float) -> str:
        if self.robot.ended:
            return strong(f"{self.robot.ended}: restart")
        speed = (
            "paused"
            if self._paused
            else of_speed(self._pace.until(now), self._speed, self._costs)
        )
        return f"t {self.robot.time:.1f} s; {speed}"


def _let_go(robot: PlayedRobot) -> None:
    robot.pull(np.zeros(3))


DRAWN = (TrueState, Tick, JointReading, Report)
PACE = Pace()  # without overruns: the robot's clock waits


def of_frame(happened: Iterable[Happened]) -> Iterator[Named]:
    """Messages for the drawing, from the newest value of each kind in a frame."""
    newest = {type(value): (time, value) for time, value in happened}
    for kind in DRAWN:
        if kind in newest:
            yield from _ENCODE[kind](*newest[kind])


# messages of a reading, tick or report at a stamp (ns) on the robot's clock
_ENCODE: dict[type, Callable[[int, Any], Iterable[Named]]] = {
    TrueState: lambda _, truth: [
        ("/ground_truth/odom", messages.odometry_to_msg(truth.odometry)),
        ("/ground_truth/legs", messages.legs_to_msg(truth)),
    ],
    Tick: lambda _, tick: [
        ("/mpc_state", messages.state_to_msg(tick.estimate)),
        ("/gait_preview", messages.preview_to_msg(tick.preview)),
        (
            "/tendon_plan",
            messages.plan_to_msg(tick.plan, tick.preview, 0.0, PACE),
        ),
        (
            "/desired_joint_angles",
            messages.command_to_msg(
                tick.estimate.stamp, tick.command.angle, tick.command.rate
            ),
        ),
        (
            "/force_map/status",
            messages.map_status_to_msg(tick.estimate.stamp, tick.command),
        ),
    ],
    StampedHealth: lambda stamp, report: [
        ("/servo_health", messages.health_to_msg(stamp, health))
        for health in (report.health,)
        if health is not None
    ],
    OdometryReading: lambda _, odom: [
        ("/odom", messages.odometry_to_msg(odom))
    ],
    ImuReading: lambda _, imu: [("/imu", messages.imu_to_msg(imu))],
    JointReading: lambda _, joints: [
        ("/joint_states", messages.joints_to_msg(joints))
    ],
    Report: lambda now, report: [
        ("/robot_state", messages.robot_state_to_msg(now, report))
    ],
}


def save(robot: PlayedRobot, path: Path) -> int:
    """Save the events of the robot as a bag; returns the number of messages.

    Changes of robot and scene are named in the bag. Raises BagError.
    """
    about = {"scene": robot.scene, "policy": robot.policy} | robot.changes
    begin, settings = (
        time.time_ns() - round(1e9 * robot.time),
        read_record_settings(),
    )
    types = message_types()
    count = 0
    with BagWriter(path, settings, origin_here(about)) as bag:
        for stamp, value in robot.history:
            for topic, message in _ENCODE[type(value)](stamp, value):
                kind = settings.topics[topic].type
                # rclpy adds some bytes to a message with an empty sequence of doubles
                size = 4 + types.get_msgdef(kind).getsize_cdr(0, message, types)
                data = serialize_message(message)[:size]
                bag.write(topic, kind, begin + stamp - LOCKSTEP_START, data)
                count += 1
    return count

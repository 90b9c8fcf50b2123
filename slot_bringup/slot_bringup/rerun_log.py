"""A run in rerun: its robot, curves and states on the robot's time line, and their layout.

rerun is optional (`scripts/setup --view`): whatever imports this module needs it.
"""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from slot_core.clock import to_seconds
from slot_core.command_line import refuse
from slot_core.drawing import palette
from slot_core.drawing.drawing import Drawing
from slot_core.drawing.shapes import Arrows, Bars, Box, Shape, Strips, halves, normals
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_lab.report import traces

APPLICATION = "slot"
TIME_LINE = "robot_time"
STATE_COLOURS = {
    "WALKING": palette.LEG_COLOURS["RL"], "STANDING": palette.TRUE, "READY": palette.TORSO,
    "SOLVED": palette.LEG_COLOURS["RL"], "HOLD": palette.LEG_COLOURS["FR"],
    "LATE": palette.LEG_COLOURS["FR"],
}  # fmt: skip


class RerunLog:
    """Logs the messages of a run, rclpy's or those of a bag; a context manager."""

    TOPICS = tuple(dict.fromkeys((*Drawing.TOPICS, *traces.TOPICS)))

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        servo = read_servo()
        loaded = float(servo.tendon_stall(servo.nominal_voltage))
        self._drawing = Drawing(read_robot(), loaded)
        self._start: int | None = None  # ns, stamp at time zero
        self._states: dict[str, str] = {}
        self._refused: set[str] = set()  # topics with a message that could not be drawn
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, plot in traces.PLOTS.items():
            for key, curve in plot.curves.items():
                lines = rr.SeriesLines(names=curve.names, colors=_rgba(*curve.colours))
                stream.log(f"plots/{name}/{key}", lines, static=True)
        names, shades = list(STATE_COLOURS), _rgba(*STATE_COLOURS.values())
        colours = rr.StateConfiguration(values=names, colors=shades)
        for name in traces.STATES:
            stream.log(f"states/{name}", colours, static=True)

    def receive(self, topic: str, message: Any) -> None:
        """Log a message at its stamp; of those that cannot be drawn the first is reported."""
        stamp = decode.stamp(message)
        self._start = stamp if self._start is None else self._start
        self._stream.set_time(TIME_LINE, duration=np.timedelta64(stamp - self._start, "ns"))
        try:
            self._log(topic, message)
        except ValueError as error:
            if topic not in self._refused:
                self._refused.add(topic)
                time = to_seconds(stamp - self._start)
                refuse("scripts/view", f"{topic} at {time:.3f} s cannot be drawn: {error}")

    def _log(self, topic: str, message: Any) -> None:
        for name, shape in self._drawing.receive(topic, message).items():
            self._stream.log(f"world/{name}", _archetype(shape))
        for name, values in traces.values(topic, message).items():
            self._stream.log(f"plots/{name}", rr.Scalars(values))
        for name, state in traces.states(topic, message).items():
            if self._states.get(name) != state:
                self._states[name] = state
                self._stream.log(f"states/{name}", rr.StateChange(state=state))

    def __enter__(self) -> RerunLog:
        return self

    def __exit__(self, *_: object) -> None:
        """Send what is waiting, and close the file."""
        self._stream.flush()
        self._stream.disconnect()


def to_file(path: Path) -> RerunLog:
    """Log to a file; raises OSError if it cannot be written."""
    path.open("wb").close()  # rerun would raise no OSError
    stream = _stream(rr.ChunkBatcherConfig.DEFAULT())
    stream.save(path, default_blueprint=blueprint())
    return RerunLog(stream)


def to_viewer(address: str) -> RerunLog:
    """Log to a viewer that runs."""
    stream = _stream(rr.ChunkBatcherConfig.LOW_LATENCY())
    stream.connect_grpc(address, default_blueprint=blueprint())
    return RerunLog(stream)


def _stream(batching: rr.ChunkBatcherConfig) -> rr.RecordingStream:
    stream = rr.RecordingStream(APPLICATION, recording_id=uuid.uuid4(), batcher_config=batching)
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    return stream


def blueprint() -> rrb.Blueprint:
    """Layout: the robot above its states, beside the plots."""
    plots = [
        rrb.TimeSeriesView(
            origin=f"/plots/{name}",
            name=plot.title,
            # the legs have the colours of the plot
            plot_legend=rrb.PlotLegend("LeftTop", visible=name in traces.OF_TORSO),
        )
        for name, plot in traces.PLOTS.items()
    ]
    robot = rrb.Spatial3DView(
        origin="/world",
        name="robot",
        background=0xF4F6F8FF,
        line_grid=rrb.LineGrid3D(spacing=0.1, color=0xC8D0D8FF),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(0.28, -0.5, 0.25),
            look_target=(0.0, 0.0, 0.05),
            eye_up=(0.0, 0.0, 1.0),
            tracking_entity="/world/torso",
        ),
    )
    states = rrb.StateTimelineView(origin="/states", name="states")
    half = (len(plots) + 1) // 2
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(robot, states, row_shares=[4, 1]),
            rrb.Vertical(*plots[:half]),
            rrb.Vertical(*plots[half:]),
            column_shares=[2, 1, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIME_LINE),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _archetype(shape: Shape) -> Any:
    shades = np.atleast_2d(shape.colour if isinstance(shape, Box) else shape.colours)
    colours = np.round(255 * shades).astype(np.uint8)
    if isinstance(shape, Box):
        return rr.Boxes3D(
            centers=[shape.centre], sizes=[shape.size], quaternions=[shape.quaternion],
            colors=colours, fill_mode="solid",
        )  # fmt: skip
    if isinstance(shape, Strips):
        points = shape.points.astype(np.float32)
        return rr.LineStrips3D(points, radii=shape.width / 2, colors=colours)
    if isinstance(shape, Bars):
        return _mesh(shape, colours)
    assert isinstance(shape, Arrows)
    width = shape.width / 2
    return rr.Arrows3D(origins=shape.tail, vectors=shape.vector, radii=width, colors=colours)


def _mesh(bars: Bars, colours: NDArray[np.uint8]) -> rr.Mesh3D:
    """Bars as one mesh; every face has corners of its own, so that edges are sharp in the light."""
    faces = np.concatenate(bars.faces)
    count = 4 * len(faces)
    return rr.Mesh3D(
        vertex_positions=faces.reshape(-1, 3).astype(np.float32),
        vertex_normals=np.repeat(normals(faces), 4, axis=0).astype(np.float32),
        vertex_colors=np.repeat(colours, count // len(colours), axis=0),
        triangle_indices=halves(np.arange(count).reshape(-1, 4)),
    )


def _rgba(*colours: str) -> NDArray[np.uint32]:
    """(n,) 0xRRGGBBAA of #RRGGBB or #RRGGBBAA."""
    return np.array([int(f"{c.removeprefix('#'):F<8}", 16) for c in colours], np.uint32)

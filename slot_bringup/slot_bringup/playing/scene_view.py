"""The robot's shapes in viser: meshes, lines and arrows, each updated in place."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import viser
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.drawing.drawing import (
    FORCE_SCALE,
    Arrows,
    Bars,
    Box,
    Shape,
    Strips,
    halves,
)

ROOT = "/robot"
# of an arrow's head: radius over the shaft's, length over radius
HEAD = (3.0, 4.0)
HEADING = 0.03  # m, of the arrow at the front of the torso
PUSHED = "#C00000"
# symbol, its colours, meaning
LEGEND = (
    ("\u2192", palette.LEG_COLOURS.values(), "measured ground force of a leg"),
    ("\u2192", [palette.INK], f"planned force, {1e3 * FORCE_SCALE:g} mm per N"),
    ("\u2192", [PUSHED], "push"),
    ("\u2192", [palette.TORSO], "heading"),
    ("\u25ac", [palette.SECONDARY], "reference"),
    ("\u25ac", [palette.INK], "predicted path"),
    ("\u25ac", palette.LEG_COLOURS.values(), "predicted feet"),
    ("\u25ac", [palette.TRUE], "path of the torso"),
    ("\u25ac", [palette.PALE, PUSHED], "tendon, slack to fully loaded"),
)
# at the left of the panel; on a phone over the whole width
LEGEND_STYLE = """<style>#slot_legend {
  position: fixed; top: 0; left: 0; max-width: calc(100% - 34em); padding: 0.4em 0.8em;
  display: flex; flex-wrap: wrap; gap: 0 1.2em; pointer-events: none;
  font: 13px/1.5 sans-serif; background: rgba(255, 255, 255, 0.8);
}
@media (max-width: 36em) { #slot_legend { max-width: none; font-size: 11px; } }
</style>"""
CELL, SECTION, FLOOR = 0.05, 0.1, 8.0  # m, lines of the floor and its size


def legend() -> str:
    """HTML of the meaning of arrows, lines and colours."""
    lines = (
        "".join(f'<b style="color:{colour}">{symbol}</b>' for colour in colours)
        + f" {meaning}"
        for symbol, colours, meaning in LEGEND
    )
    rows = "".join(f"<span>{line}</span>" for line in lines)
    return f'{LEGEND_STYLE}<div id="slot_legend">{rows}</div>'


class SceneView:
    """The scene around the robot, which stays in its middle: the floor moves under it."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._root = scene.add_frame(ROOT, show_axes=False)
        self._shown: dict[str, list[Any]] = {}
        self._labels: dict[str, Any] = {}
        self._bars: dict[
            str, Any
        ] = {}  # what a new shape of that name has in common with the last
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)  # slow without a GPU
        self._floor = scene.add_grid(
            f"{ROOT}/floor",
            width=FLOOR,
            height=FLOOR,
            cell_size=CELL,
            section_size=SECTION,
            plane="xy",
            cell_color=(222, 227, 231),
            section_color=(190, 199, 207),
        )

    def centre(self, position: Array) -> None:
        """Show the place below `position` (3,), m, in the middle, wherever the floor has lines."""
        x, y = SECTION * np.round(position[:2] / SECTION)
        self._floor.position = (x, y, 0.0)
        self._root.position = (-position[0], -position[1], 0.0)

    def update(self, shapes: Mapping[str, Shape]) -> None:
        """Show shapes by name, each in the place of the last of that name."""
        for name, shape in shapes.items():
            self._SHOW[type(shape)](self, name, shape, self._shown.get(name))

    def label(self, places: Mapping[str, Array]) -> None:
        """Show names below their places (3,), m."""
        for name, place in places.items():
            if name not in self._labels:
                self._labels[name] = self._scene.add_label(
                    f"{ROOT}/names/{name}", name, anchor="top-center"
                )
            self._labels[name].position = place

    def remove(self, *names: str) -> None:
        """Remove the shapes of these names, if they are shown."""
        for name in names:
            for handle in self._shown.pop(name, []):
                handle.remove()

    def handle(self, name: str) -> Any:
        """First shown part of the object `name`."""
        return self._shown[name][0]

    def _show_box(self, name: str, box: Box, shown: list[Any] | None) -> None:
        if shown is None:
            shown = self._shown[name] = [
                self._scene.add_box(
                    f"{ROOT}/{name}",
                    dimensions=tuple(box.size),
                    color=_bytes(box.colour),
                )
            ]
            front = box.size[0] / 2
            self._scene.add_arrows(
                f"{ROOT}/{name}/heading",
                np.array([[[front, 0.0, 0.0], [front + HEADING, 0.0, 0.0]]]),
                _bytes(box.colour),
                shaft_radius=0.003,
                head_radius=0.008,
                head_length=0.012,
            )
        x, y, z, w = box.quaternion
        shown[0].position, shown[0].wxyz = box.centre, (w, x, y, z)

    def _show_bars(
        self, name: str, bars: Bars, shown: list[Any] | None
    ) -> None:
        """Bars whose sections or colours have changed, as of legs whose shape is known now, are made anew."""
        corners = bars.corners.reshape(len(bars.corners), -1, 3).astype(
            np.float32
        )
        kind = corners.shape, bars.colours.tolist()
        if self._bars.get(name) != kind:
            self._bars[name] = kind
            faces = halves(bars.quads)
            self._shown[name] = [
                self._scene.add_mesh_simple(
                    f"{ROOT}/{name}/{k}",
                    points,
                    faces,
                    color=_bytes(colour),
                    flat_shading=True,
                )
                for k, (points, colour) in enumerate(zip(corners, bars.colours))
            ]
            return
        for handle, points in zip(shown or [], corners):
            handle.vertices = points

    def _show_strips(
        self, name: str, strips: Strips, shown: list[Any] | None
    ) -> None:
        points = np.stack([strips.points[:, :-1], strips.points[:, 1:]], axis=2)
        colours = np.repeat(_bytes(strips.colours), points.shape[1], axis=0)[
            :, None
        ].repeat(2, axis=1)
        points = points.reshape(-1, 2, 3).astype(np.float32)
        if shown is None:
            self._shown[name] = [
                self._scene.add_line_segments(
                    f"{ROOT}/{name}",
                    points,
                    colours,
                    thickness=strips.width,
                    thickness_units="world",
                )
            ]
            return
        shown[0].points, shown[0].colors = points, colours

    def _show_arrows(
        self, name: str, arrows: Arrows, shown: list[Any] | None
    ) -> None:
        points = np.stack(
            [arrows.tail, arrows.tail + arrows.vector], axis=1
        ).astype(np.float32)
        if shown is None:
            if not len(points):
                return
            head = HEAD[0] * arrows.width / 2
            self._shown[name] = [
                self._scene.add_arrows(
                    f"{ROOT}/{name}",
                    points,
                    _bytes(arrows.colours),
                    shaft_radius=arrows.width / 2,
                    head_radius=head,
                    head_length=HEAD[1] * head / 2,
                )
            ]
            return
        shown[0].visible = len(points) > 0
        if len(points):
            shown[0].points, shown[0].colors = points, _bytes(arrows.colours)

    _SHOW: ClassVar[dict[type, Callable[..., None]]] = {
        Box: _show_box,
        Bars: _show_bars,
        Strips: _show_strips,
        Arrows: _show_arrows,
    }


def _bytes(colours: Array) -> NDArray[np.uint8]:
    return np.round(255 * np.asarray(colours)).astype(np.uint8)

"""Camera of the simulated robot: images of the boards that stand in the world or on the torso."""

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.config import ConfigError
from slot_core.dynamics.scene import CameraSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.estimation.inertial_filter import Mount
from slot_core.estimation.state_estimator import read_estimator
from slot_core.geometry import Transform, optical
from slot_core.refusal import quoted
from slot_core.robot import BASE_FRAME, ODOM_FRAME
from slot_core.simulation.readings import ImageReading
from slot_core.vision.board import Board, GreyImage, make_board, print_of
from slot_core.vision.camera import nominal
from slot_core.vision.localizer import MarkerLocalizer
from slot_core.vision.settings import read_vision
from slot_core.vision.synthetic_camera import (
    Imperfections,
    Surface,
    SyntheticCamera,
)

MOMENT = 1e-3  # s, over which the motion of a board in the image is measured


def camera_link(mount: Mount) -> Transform:
    """camera_link in base_link from its mount."""
    return Transform.of(mount.position, mount.rpy)


class CameraSensor:
    """Renders the image of a scene's camera; its optics and the boards are in vision.yaml."""

    def __init__(self, settings: CameraSettings, rng: np.random.Generator):
        """Raises ConfigError for a board that is not in vision.yaml, or where it is not seen."""
        vision = read_vision()
        self.delay = settings.delay  # s
        self.camera = nominal(vision.camera)
        self._on_torso = settings.carrier == "torso"
        self._mount = optical(camera_link(read_estimator().mounts.camera))
        placed = vision.world_camera
        self._placed = optical(Transform.of(placed.position, placed.rpy))
        frame = ODOM_FRAME if self._on_torso else BASE_FRAME
        there = vision.boards_in(frame)
        for name in settings.boards:
            if name not in there:
                raise ConfigError(
                    f"sensors.camera.boards: {quoted(name)}: expected boards of vision.yaml in"
                    f" {frame} ({', '.join(there)}), which a camera on the {settings.carrier} can see"
                )
        self._boards: list[tuple[Board, GreyImage]] = [
            (board, print_of(board, vision.dictionary_number))
            for board in [make_board(there[name]) for name in settings.boards]
        ]
        self._camera = SyntheticCamera(
            self.camera,
            Imperfections(settings.noise, settings.blur, settings.exposure),
            rng,
        )

    def sample(self, sim: SimulatedRobot, stamp: int) -> ImageReading:
        """The image now, stamped `stamp` (ns)."""
        base = Transform(sim.rotation, sim.position)
        turn = Rotation.from_rotvec(MOMENT * sim.angular_velocity).as_matrix()
        soon = Transform(
            base.rotation @ turn, base.position + MOMENT * sim.velocity
        )
        surfaces = []
        for board, sheet in self._boards:
            now, then = (
                self._seen(board.pose, b).apply(board.outline)
                for b in (base, soon)
            )
            surfaces.append(Surface(sheet, now, (then - now) / MOMENT))
        return ImageReading(stamp, self._camera.image(surfaces))

    def _seen(self, board: Transform, base: Transform) -> Transform:
        """A board in the optical frame."""
        return (
            (base @ self._mount).inverse @ board
            if self._on_torso
            else self._placed.inverse @ base @ board
        )


def marker_localizer(settings: CameraSettings) -> MarkerLocalizer:
    """The localiser of a scene's images, as the node of that name has it."""
    vision = read_vision()
    return MarkerLocalizer(
        vision,
        nominal(vision.camera),
        camera_link(read_estimator().mounts.camera),
        settings.carrier,
    )

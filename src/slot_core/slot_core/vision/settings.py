"""Settings of `config/vision.yaml`: camera, boards, tracked markers, detection, printing."""

from dataclasses import dataclass

import cv2

from slot_core import config
from slot_core.config import ConfigError, choice, quantity, text
from slot_core.refusal import quoted
from slot_core.robot import BASE_FRAME, BODY_POINTS, ODOM_FRAME

CARRIERS = ("torso", "world")  # what the camera stands on


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera with the distortion of OpenCV: k1 k2 p1 p2 k3 (ROS: plumb_bob)."""

    width: int = quantity("width of the image", "px", 64, 8192)
    height: int = quantity("height of the image", "px", 64, 8192)
    focal: tuple[float, float] = quantity(
        "focal lengths f_x, f_y", "px", 10, 1e5
    )
    centre: tuple[float, float] = quantity(
        "principal point c_x, c_y", "px", 0, 8192
    )
    distortion: tuple[float, float, float, float, float] = quantity(
        "k1 k2 p1 p2 k3", "", -10, 10
    )


@dataclass(frozen=True)
class Placement:
    """Position and attitude in a frame."""

    position: tuple[float, float, float] = quantity(
        "position of the origin", "m", -100, 100
    )
    rpy: tuple[float, float, float] = quantity(
        "roll, pitch, yaw of the axes", "rad", -3.15, 3.15
    )


@dataclass(frozen=True)
class BoardSettings:
    """A grid of square markers in one plane: x to the right, y up, z towards the viewer."""

    pose: Placement
    frame: str = choice(
        "frame to which the object is fixed", ODOM_FRAME, BASE_FRAME
    )
    columns: int = quantity("number of markers in a row", "", 1, 50)
    rows: int = quantity("number of rows of markers", "", 1, 50)
    marker: float = quantity("edge of a marker", "m", 1e-3, 2.0)
    gap: float = quantity(
        "width of the white between two markers and around them", "m", 1e-4, 1.0
    )
    first_id: int = quantity(
        "id at the top left; ids increase along the rows", "", 0, 1000
    )

    @property
    def ids(self) -> range:
        """The ids of its markers."""
        return range(self.first_id, self.first_id + self.columns * self.rows)


@dataclass(frozen=True)
class TrackedMarkers:
    """Single markers on the torso and along the legs."""

    torso: Placement
    size: float = quantity("edge of a marker", "m", 1e-3, 0.5)
    stand_off: float = quantity(
        "distance from the side of a leg to the markers on it", "m", 0, 0.1
    )
    first_id: int = quantity(
        "id at the base of FL; then third, two_thirds, tip; the same of FR RL RR; the torso",
        "",
        0,
        1000,
    )

    @property
    def names(self) -> dict[int, str]:
        """Name of the point by id of its marker: `FL_base` ... `RR_tip`, `torso`."""
        return dict(enumerate(BODY_POINTS, self.first_id))


@dataclass(frozen=True)
class DetectionSettings:
    """Limits within which a pose from markers is accepted."""

    corner_noise: float = quantity(
        "smallest standard deviation of a corner that the covariance assumes",
        "px",
        1e-3,
        10,
    )
    error_max: float = quantity(
        "largest RMS reprojection error", "px", 0.1, 100
    )
    error_usual: float = quantity(
        "RMS reprojection error above which a warning is given", "px", 0.01, 100
    )
    ambiguity: float = quantity(
        "ratio of the errors of a plane's second and first pose, to be certain",
        "",
        1,
        100,
    )
    memory: float = quantity(
        "time for which the last pose decides between two solutions", "s", 0, 10
    )
    acceleration: float = quantity(
        "of the torso, that a velocity by differences misses", "m/s^2", 0, 100
    )
    angular_acceleration: float = quantity(
        "of the torso, that a rate by differences misses", "rad/s^2", 0, 1000
    )


@dataclass(frozen=True)
class ChessboardSettings:
    """The ChArUco board with which a camera is calibrated."""

    columns: int = quantity(
        "number of squares in a row of the chessboard", "", 3, 50
    )
    rows: int = quantity(
        "number of rows of squares of the chessboard", "", 3, 50
    )
    square: float = quantity("edge of a square", "m", 1e-3, 1.0)
    marker: float = quantity("edge of a marker in a square", "m", 1e-3, 1.0)


@dataclass(frozen=True)
class VisionSettings:
    """Settings of `config/vision.yaml`."""

    camera: Intrinsics
    world_camera: Placement
    film_camera: Placement
    points: TrackedMarkers
    detection: DetectionSettings
    chessboard: ChessboardSettings
    dictionary: str = text(
        "dictionary of the markers, a name of cv2.aruco as DICT_4X4_100"
    )
    carrier: str = choice(
        "what the camera of the localiser stands on", *CARRIERS
    )
    boards: dict[str, BoardSettings] = text("boards by name")

    def __post_init__(self) -> None:
        """Raise ConfigError for an unknown dictionary, and for markers that share an id."""
        if not self.dictionary.startswith("DICT_") or not hasattr(
            cv2.aruco, self.dictionary
        ):
            raise ConfigError(
                f"dictionary = {quoted(self.dictionary)}: not one of cv2.aruco"
            )
        size = len(
            cv2.aruco.getPredefinedDictionary(self.dictionary_number).bytesList
        )
        owners: dict[int, str] = dict.fromkeys(self.points.names, "points")
        for name, board in self.boards.items():
            for number in board.ids:
                if number in owners:
                    raise ConfigError(
                        f"boards.{name}: id {number} is also in {owners[number]}"
                    )
                owners[number] = f"boards.{name}"
        if max(owners) >= size:
            raise ConfigError(
                f"id {max(owners)}: {self.dictionary} ends at {size - 1}"
            )
        if (used := self.chessboard.columns * self.chessboard.rows // 2) > size:
            raise ConfigError(
                f"chessboard: {used} markers, {self.dictionary} has {size}"
            )
        if self.chessboard.marker >= self.chessboard.square:
            raise ConfigError(
                f"chessboard.marker = {self.chessboard.marker}: not smaller than square ="
                f" {self.chessboard.square} m"
            )

    @property
    def dictionary_number(self) -> int:
        """Number of the dictionary in cv2.aruco."""
        return int(getattr(cv2.aruco, self.dictionary))

    def boards_in(self, frame: str) -> dict[str, BoardSettings]:
        """The boards fixed in a frame, by name."""
        return {
            name: board
            for name, board in self.boards.items()
            if board.frame == frame
        }


def read_vision() -> VisionSettings:
    """The settings of `config/vision.yaml`; raises ConfigError."""
    return config.read(VisionSettings, "vision")

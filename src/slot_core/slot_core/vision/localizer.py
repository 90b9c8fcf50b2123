"""Marker localisation: where the torso is, from images of boards.

    carrier of the camera   boards                  pose of base_link in odom
    torso                   fixed in odom           T_odom_board T_board_camera T_camera_base
    world                   fixed on base_link      T_odom_camera T_camera_board T_board_base

A pose has the covariance of its reprojection error and of the calibration. The twist is the
difference of two poses, in which the error of the calibration cancels: late by half their interval,
so its variance includes the change of velocity of an accelerating torso. An image without a usable pose gives a reason
in its place.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.clock import SECOND, to_seconds
from slot_core.config import ConfigError
from slot_core.geometry import Transform, optical
from slot_core.robot import BASE_FRAME, ODOM_FRAME
from slot_core.vision.board import (
    BoardPose,
    GreyImage,
    board_poses,
    make_board,
    nearest,
)
from slot_core.vision.camera import Camera
from slot_core.vision.detector import (
    Detection,
    MarkerDetector,
    other_dictionary,
)
from slot_core.vision.settings import DetectionSettings, VisionSettings

# stamp, ns; base_link in odom; covariance (6, 6) of noise
Known = tuple[int, Transform, Array]
WRONG = "wrong calibration, a bent print, or boards other than in vision.yaml"
LONG = 10  # images without a marker, after which other dictionaries are tried


@dataclass(frozen=True)
class MarkerFix:
    """Pose of base_link in odom and twist in base_link, with their covariances."""

    stamp: int  # ns
    position: Array  # (3,) m
    quaternion: Array  # (4,) x y z w
    velocity: Array  # (3,) m/s
    angular_velocity: Array  # (3,) rad/s
    # (6, 6) of x y z and rotations about the axes of odom
    pose_covariance: Array
    twist_covariance: Array  # (6, 6) of velocity and angular velocity
    markers: int
    error: float  # px, RMS of the reprojection
    warning: str = ""  # one line, where that is larger than usual

    @property
    def odometry(self) -> tuple[int, Array, Array, Array, Array, Array]:
        """The arguments of `StateEstimator.add_odometry`."""
        pose = np.diag(self.pose_covariance)
        return (
            self.stamp,
            self.position,
            self.quaternion,
            self.velocity,
            self.angular_velocity,
            np.concatenate(
                [pose[3:], pose[:3], np.diag(self.twist_covariance)]
            ),
        )


@dataclass(frozen=True)
class NoFix:
    """An image without a usable pose, and why."""

    stamp: int  # ns
    reason: str

    @property
    def odometry(self) -> tuple[int, Array, Array, Array, Array, Array]:
        """Lost odometry, which the estimator rejects: a quaternion of zeros, as of RTAB-Map."""
        return (
            self.stamp,
            np.zeros(3),
            np.zeros(4),
            np.zeros(3),
            np.zeros(3),
            np.zeros(12),
        )


class MarkerLocalizer:
    """Poses of the torso from images, one after the other."""

    def __init__(
        self,
        settings: VisionSettings,
        camera: Camera,
        mount: Transform,
        carrier: str | None = None,
    ) -> None:
        """mount: camera_link in base_link, used if the carrier (default: that set) is the torso.

        Raises ConfigError without a board in the frame that the camera does not stand on.
        """
        on_torso = (carrier or settings.carrier) == "torso"
        frame = ODOM_FRAME if on_torso else BASE_FRAME
        placed = settings.world_camera
        self._settings, self._camera, self._on_torso = (
            settings.detection,
            camera,
            on_torso,
        )
        self._fixed = optical(
            mount if on_torso else Transform.of(placed.position, placed.rpy)
        )
        self._boards = {
            name: make_board(board)
            for name, board in settings.boards_in(frame).items()
        }
        if not self._boards:
            raise ConfigError(f"vision.yaml: boards: none in the frame {frame}")
        self._detector = MarkerDetector(settings.dictionary_number, camera)
        self._dictionary = settings.dictionary
        self._last: Known | None = None
        self._answer: MarkerFix | NoFix | None = None
        self._without = 0  # images in a row without a marker

    def locate(self, stamp: int, image: GreyImage) -> MarkerFix | NoFix:
        """The pose in a grey image (h, w) of `stamp`, ns; raises CameraError for another size.

        A stamp that repeats gives the same answer: the robot at rest repeats its image, and what
        follows must not depend on how often.
        """
        if self._answer is None or self._answer.stamp != stamp:
            self._answer = self._locate(stamp, image)
        return self._answer

    def _locate(self, stamp: int, image: GreyImage) -> MarkerFix | NoFix:
        found = self._detector.find(image)
        self._without = 0 if found.ids else self._without + 1
        seen = {
            name: _corners(board.corners, found)
            for name, board in self._boards.items()
        }
        name = max(seen, key=lambda key: len(seen[key][0]))
        points, rays = seen[name]
        if not len(points):
            return NoFix(stamp, self._absence(found, image))
        noise = self._settings.corner_noise / self._camera.focal
        pose = board_poses(points, rays, noise, self._camera)
        if pose is None:
            return NoFix(
                stamp,
                f"{len(points) // 4} markers of {name}: no pose explains them",
            )
        expected = self._expected(stamp, self._boards[name].pose)
        ambiguous = pose.ratio < self._settings.ambiguity
        chosen = nearest(pose, expected) if ambiguous and expected else pose
        error = chosen.error * self._camera.focal
        if error > self._settings.error_max:
            return NoFix(
                stamp,
                f"reprojection error {error:.2f} px, limit {self._settings.error_max:g} px:"
                f" {WRONG}",
            )
        if ambiguous and expected is None:
            return NoFix(
                stamp,
                f"{len(points) // 4} markers of {name}: two poses explain them, errors 1 :"
                f" {pose.ratio:.2f}, limit {self._settings.ambiguity:g}",
            )
        return self._fix(
            stamp, self._boards[name].pose, chosen, len(points) // 4
        )

    def _absence(self, found: Detection, image: GreyImage) -> str:
        """Why no marker of the boards was found."""
        if found.duplicates:
            return f"ids {', '.join(map(str, found.duplicates))} seen more than once"
        if found.ids:
            return f"no marker of the boards, only ids {', '.join(map(str, sorted(found.ids)))}"
        if self._without % LONG == 0 and (other := other_dictionary(image)):
            return f"no marker of {self._dictionary}, but {other}"
        return f"no marker of {self._dictionary}"

    def _base(self, board: Transform, seen: Transform) -> Transform:
        """base_link in odom from the board's pose in its frame and in the optical frame."""
        return (
            board @ seen.inverse @ self._fixed.inverse
            if self._on_torso
            else self._fixed @ seen @ board.inverse
        )

    def _expected(self, stamp: int, board: Transform) -> Transform | None:
        """Pose of the board in the optical frame as it was last; None if that is unknown."""
        if (last := self._recent(stamp)) is None:
            return None
        carrier = last[1].inverse if self._on_torso else last[1]
        return self._fixed.inverse @ carrier @ board

    def _recent(self, stamp: int) -> Known | None:
        """The last pose if it is before `stamp`, ns, by at most `memory`."""
        memory, last = self._settings.memory * SECOND, self._last
        return last if last and 0 < stamp - last[0] <= memory else None

    def _fix(
        self, stamp: int, board: Transform, pose: BoardPose, markers: int
    ) -> MarkerFix:
        base = self._base(board, pose.transform)
        noise, calibration = (
            self._pose_covariance(board, pose.transform, part)
            for part in (pose.covariance, pose.calibration)
        )
        velocity, rate, twist = self._twist(stamp, base, noise)
        self._last = stamp, base, noise
        error = pose.error * self._camera.focal
        return MarkerFix(
            stamp,
            base.position,
            base.quaternion,
            velocity,
            rate,
            noise + calibration,
            twist,
            markers,
            error,
            unusual(error, self._settings),
        )

    def _pose_covariance(
        self, board: Transform, seen: Transform, covariance: Array
    ) -> Array:
        """Covariance (6, 6) of base_link in odom, from the board's covariance in the optical frame.

        Let d and e be the errors of rotation and position of the board in the camera, p the torso's
        position and p_c the centre of the turn. Then the errors of rotation and position are

            R d,   R e + R d x (p - p_c)

        with R = -R_odom_board R_camera_board^T and the board as the centre if the camera is on the
        torso, and with R = R_odom_camera and the board's position in odom if it is in the world.
        """
        if self._on_torso:
            turn = -board.rotation @ seen.rotation.T
            centre = board.position
        else:
            turn = self._fixed.rotation
            centre = self._fixed.apply(seen.position)
        arm = self._base(board, seen).position - centre
        lever = np.cross(np.eye(3), arm)  # lever @ d = arm x d
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = jacobian[3:, 3:] = turn
        jacobian[:3, 3:] = -lever @ turn
        return jacobian @ covariance @ jacobian.T

    def _twist(
        self, stamp: int, base: Transform, covariance: Array
    ) -> tuple[Array, Array, Array]:
        """Velocity and rate in base_link with their covariance; unknown for the first pose."""
        s = self._settings
        if (last := self._recent(stamp)) is None:
            return np.zeros(3), np.zeros(3), np.diag(np.full(6, 1e6))
        before, dt = last[1], to_seconds(stamp - last[0])
        velocity = base.rotation.T @ (base.position - before.position) / dt
        turn = (
            Rotation.from_matrix(before.rotation.T @ base.rotation).as_rotvec()
            / dt
        )
        late = np.repeat(
            [s.acceleration * dt / 2, s.angular_acceleration * dt / 2], 3
        )
        to_base = np.kron(np.eye(2), base.rotation.T)
        noise = to_base @ (covariance + last[2]) @ to_base.T / dt**2
        return velocity, turn, noise + np.diag(late**2)


def unusual(error: float, settings: DetectionSettings) -> str:
    """A warning where a reprojection error (px) is larger than usual, else an empty string."""
    return (
        f"reprojection error {error:.2f} px, usually below {settings.error_usual:g} px: {WRONG}"
        if error > settings.error_usual
        else ""
    )


def _corners(
    corners: dict[int, Array], found: Detection
) -> tuple[Array, Array]:
    """Corners (n, 3) of a board's markers that were found, and their rays (n, 2)."""
    ids = [number for number in found.ids if number in corners]
    if not ids:
        return np.zeros((0, 3)), np.zeros((0, 2))
    return np.concatenate([corners[number] for number in ids]), np.concatenate(
        [found.rays[found.ids.index(number)] for number in ids]
    )

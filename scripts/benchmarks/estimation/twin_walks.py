"""Walks of changed robots as their bags would hold them: noisy, at the sensors' rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.estimation.measured_streams import walked
from slot_core.body_points import LEG_POINTS, TORSO, at_shares
from slot_core.clock import to_seconds
from slot_core.joint_reading import JointReading
from slot_core.robot import Array
from slot_core.simulation.plant import Reading, RobotSimulator, TrueState
from slot_lab.bags.measured import TendonAngles
from slot_lab.bags.recorded_walk import TorsoTrack
from slot_lab.bags.topics import MEASURED, ODOMETRY
from slot_lab.twin.recorded import BagRecording

POSITION_NOISE, ANGLE_NOISE = 1e-3, 2e-3  # m, rad: the odometry of config/scene/flat.yaml
ENCODER = 2 * np.pi / 4096  # rad, of the servos


class TruePlant(RobotSimulator):
    """A plant that keeps its tendon angles and its true states."""

    def __init__(self, *parts: Any):
        super().__init__(*parts)
        self.joints: list[JointReading] = []
        self.states: list[TrueState] = []

    def _read_joints(self) -> list[Reading]:
        readings = super()._read_joints()
        self.joints += [r for r in readings if isinstance(r, JointReading)]
        return readings

    def _read_odometry(self) -> list[Reading]:
        readings = super()._read_odometry()
        self.states += [r for r in readings if isinstance(r, TrueState)]
        return readings


@dataclass(frozen=True)
class TrueWalk:
    """Exact tendon angles, motion and points of a leg."""

    joints: list[JointReading]
    states: list[TrueState]

    @property
    def t(self) -> Array:
        """(n,) s, of the states."""
        return to_seconds(np.array([state.stamp for state in self.states]))

    def points(self) -> dict[str, Array]:
        """(n, 3) m, places of the torso and of LEG_POINTS of the first leg."""
        shares = np.array([at_shares(state.nodes[0]) for state in self.states])
        torso = np.array([state.odometry.position for state in self.states])
        return {TORSO: torso} | {f"FL_{name}": shares[:, k] for k, name in enumerate(LEG_POINTS)}

    def recorded(self, rng: np.random.Generator) -> BagRecording:
        """The walk as its bag would hold it: encoders, noisy odometry."""
        angle = np.array([r.angle for r in self.joints])
        stamps = to_seconds(np.array([r.stamp for r in self.joints]))
        angles = TendonAngles(MEASURED, stamps, np.round(angle / ENCODER) * ENCODER)
        exact = [state.odometry for state in self.states]
        position = np.array([o.position for o in exact])
        noise = rng.normal(scale=POSITION_NOISE, size=position.shape)
        turned = Rotation.from_rotvec(rng.normal(scale=ANGLE_NOISE, size=position.shape))
        attitude = turned * Rotation.from_quat([o.quaternion for o in exact])
        motion = TorsoTrack(
            ODOMETRY, self.t, position + noise, attitude.as_quat(), np.zeros_like(position)
        )
        return BagRecording("walk", angles, motion, None)


def walk(duration: float, changes: Mapping[str, Any], seed: int = 1) -> TrueWalk:
    """A walk of `duration` (s) of a robot changed as in `ClosedLoop`."""
    plant = walked(TruePlant, seed, duration, changes)
    return TrueWalk(plant.joints, plant.states)

"""ONNX policy: a learned network that changes a stride's angles (`--policy onnx:FILE`).

The network maps an observation (1, 17 + n) to an action (1, n), see `walk_actions.py`. Its metadata
name the gait that it has learned and the kind of its actions; in other gaits, and while the legs
are not to be corrected, the plan is the gait's. So it is, with a status that says why, for a state
or an action that is not finite. It runs on one thread, so that equal inputs give equal actions.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.config import ConfigError, text
from slot_core.control.policy import (
    Policy,
    Status,
    TendonPlan,
    Timer,
    gait_plan,
    state_fault,
)
from slot_core.control.walk_actions import (
    ACTIONS,
    deviation,
    observation,
    observation_size,
)
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview, read_gaits
from slot_core.key_frame import StateParts
from slot_core.names import ONNX
from slot_core.network_file import read_network, refused
from slot_core.refusal import quoted
from slot_core.robot import RobotParameters

STATE_MAX = 1e6  # SI, of an element of the state
GAIT, KIND = "gait", "actions"  # keys of the metadata


@dataclass(frozen=True)
class OnnxSettings:
    """Settings of the policy."""

    file: str = text("ONNX file of the network")


class OnnxPolicy(Policy):
    """Runs a network in the gait that it has learned."""

    STATE = StateParts("_action", "_missed")

    def __init__(
        self, robot: RobotParameters, settings: OnnxSettings, timer: Timer
    ):
        """Load the network; raises ConfigError for a file that is none, or another's."""
        self._session, gait, self._kind = _loaded(Path(settings.file))
        self._gait, self._stride = gait, read_gaits().strides[gait]
        self._input = self._session.get_inputs()[0].name
        self.reset()

    @staticmethod
    def read_settings(name: str) -> OnnxSettings:
        """Settings with the file of `onnx:FILE`; raises ConfigError as the constructor does."""
        found = OnnxSettings(name.removeprefix(ONNX))
        _loaded(Path(found.file))
        return found

    def reset(self) -> None:
        """Forget the last action."""
        self._action, self._missed = np.zeros((1, ACTIONS[self._kind])), 0

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The gait's angles, changed by the network's action."""
        if preview.gait != self._gait or not preview.corrected:
            self.reset()
            return gait_plan(preview)
        if fault := state_fault(estimate.state, STATE_MAX):
            return self._fall_back(Status.REJECTED, fault, preview)
        action = self.act(
            observation(
                np.asarray(estimate.state, dtype=float)[None],
                np.asarray(preview.reference, dtype=float)[:1],
                preview.phases[:1],
                preview.velocity_ahead[:1],
                self._action,
            )
        )
        if not np.isfinite(action).all():
            return self._fall_back(
                Status.NOT_SOLVED, "action not finite", preview
            )
        self._action, self._missed = np.clip(action, -1.0, 1.0), 0
        change = deviation(
            self._kind,
            self._action,
            self._stride,
            preview.phases,
            preview.velocity_ahead,
        )
        return gait_plan(preview, change)

    def _fall_back(
        self, cause: Status, fault: str, preview: GaitPreview
    ) -> TendonPlan:
        """The gait's plan with the cause, and as many cycles as it has been without an action."""
        self._action, self._missed = (
            np.zeros_like(self._action),
            self._missed + 1,
        )
        return replace(
            gait_plan(preview),
            status=cause,
            message=fault,
            fallback_cycles=self._missed,
        )

    def act(self, seen: Array) -> Array:
        """Action (1, n) of the network at an observation (1, 17 + n)."""
        (action,) = self._session.run(
            None, {self._input: seen.astype(np.float32)}
        )
        return np.asarray(action, dtype=float)


def _loaded(file: Path) -> tuple[Any, str, str]:
    """The network, its gait and the kind of its actions; raises ConfigError."""
    session, strides = _session(file), read_gaits().strides
    known = session.get_modelmeta().custom_metadata_map
    gait, kind = known.get(GAIT, ""), known.get(KIND, "")
    if gait not in strides or kind not in ACTIONS:
        raise ConfigError(
            f"policy {file}: its metadata name gait {quoted(gait)} and actions {quoted(kind)}:"
            f" expected one of {', '.join(strides)}, and one of {', '.join(ACTIONS)}"
        )
    _require_sizes(file, session, (observation_size(kind), ACTIONS[kind]))
    return session, gait, kind


def _session(file: Path) -> Any:
    """The network, ready to run; raises ConfigError."""
    content = read_network(file)
    with refused(file):
        import onnxruntime  # noqa: PLC0415 - not installed with the robot

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        return onnxruntime.InferenceSession(
            content, options, ["CPUExecutionProvider"]
        )


def _require_sizes(file: Path, session: Any, expected: tuple[int, int]) -> None:
    """Raise ConfigError for a network that does not map one observation to one action."""
    ports = session.get_inputs(), session.get_outputs()
    found = tuple(
        port[0].shape[-1] if len(port) == 1 and port[0].shape else 0
        for port in ports
    )
    if found != expected:
        raise ConfigError(
            f"policy {file}: the network maps {found[0]} values to {found[1]}, expected"
            f" {expected[0]} to {expected[1]}"
        )
    with refused(file):
        session.run(
            None,
            {ports[0][0].name: np.zeros((1, expected[0]), dtype=np.float32)},
        )

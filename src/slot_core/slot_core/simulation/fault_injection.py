"""Faults of a simulated robot, planned in its scene or injected in a run."""

import dataclasses
from functools import partial

from slot_core.clock import to_ns
from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.simulated_robot import KernelRobot, SimulatedRobot
from slot_core.faults import (
    BROKEN,
    BUS_KINDS,
    NAN,
    SLACK,
    Fault,
    legs_of,
    require_simulated_legs,
)
from slot_core.robot import LEGS
from slot_core.servos.brand import EmulatedServos
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.timeline import Timeline

ROBOT_WITH_FAULT = {SLACK: KernelRobot, BROKEN: KernelRobot, NAN: RodRobot}


class FaultInjection:
    """Present faults by kind and leg, which end on the robot's clock.

    Raises ConfigError if the scene has a fault that the robot does not support.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        scene: Scene,
        emulated: EmulatedServos | None,
        timeline: Timeline,
    ) -> None:
        self._robot, self._emulated, self._timeline = robot, emulated, timeline
        self._planned, self._tendons = scene.faults, scene.tendons
        self._faults: dict[tuple[str, str], Fault] = {}
        for fault in self._planned.values():
            self._require_supported(fault)

    def start(self) -> None:
        """Schedule the end of the present faults and the start of the scene's."""
        for present in self._faults.values():
            self._schedule_end(present)
        for fault in self._planned.values():
            self._timeline.act(
                self._timeline.now + to_ns(fault.time),
                partial(self.inject, fault),
            )

    def inject(self, fault: Fault) -> None:
        """Start a fault now, whatever its `time`; it replaces one of its kind at that leg.

        Its duration runs on the robot's clock. Raises ConfigError if the robot does not support it.
        """
        self._require_supported(fault)
        for leg in fault.legs:
            self._faults[fault.kind, leg] = fault
            self._set(fault, leg, True)
        if self._timeline.started:
            self._schedule_end(fault)

    def clear(self, kind: str, leg: str) -> None:
        """End the faults of a kind at a leg or at all; raises ValueError if there is none.

        Hardware errors of a servo remain until it is rebooted, a tripped bus watchdog until it is
        cleared.
        """
        active = [
            (kind, each)
            for each in legs_of(kind, leg)
            if (kind, each) in self._faults
        ]
        if not active:
            raise ValueError(f"no fault {kind!r} at {leg!r}")
        for key in active:
            self._end(*key)

    def change_scene(self, scene: Scene) -> None:
        """Take the damage of the tendons from another scene; faults stay."""
        self._tendons = scene.tendons
        for leg in LEGS:
            self._update_tendon(leg)

    def _schedule_end(self, fault: Fault) -> None:
        if fault.duration:
            self._timeline.act(
                self._timeline.now + to_ns(fault.duration),
                partial(self._expire, fault),
            )

    def _expire(self, fault: Fault) -> None:
        """End a fault unless it has been cleared or replaced."""
        for leg in fault.legs:
            if self._faults.get((fault.kind, leg)) is fault:
                self._end(fault.kind, leg)

    def _end(self, kind: str, leg: str) -> None:
        self._set(self._faults.pop((kind, leg)), leg, False)

    def _require_supported(self, fault: Fault) -> None:
        """Raise ConfigError if this robot does not support a fault."""
        if fault.kind in BUS_KINDS and self._emulated is not None:
            return
        require_simulated_legs(fault)
        if not isinstance(self._robot, ROBOT_WITH_FAULT[fault.kind]):
            raise ConfigError(
                f"fault {fault.kind!r}: legs of the model"
                f" {self._robot.scene.solver.legs!r} cannot have it"
            )

    def _set(self, fault: Fault, leg: str, on: bool) -> None:
        """Apply a fault that is in `_faults` to a leg, or remove it."""
        if fault.kind in BUS_KINDS:
            assert self._emulated is not None
            self._emulated.set_fault(dataclasses.replace(fault, leg=leg), on)
        elif fault.kind != NAN:
            self._update_tendon(leg)
        elif on:
            assert isinstance(self._robot, RodRobot)
            self._robot.set_tip_to_nan(LEGS.index(leg))

    def _update_tendon(self, leg: str) -> None:
        """Set slack and breakage of a tendon from the scene and the present faults."""
        assert isinstance(self._robot, KernelRobot)
        index, damage = LEGS.index(leg), self._tendons
        added = self._faults.get((SLACK, leg))
        slack = damage.slack[index] + (added.value if added else 0.0)
        broken = damage.broken[index] or (BROKEN, leg) in self._faults
        self._robot.damage_tendon(index, slack, broken)

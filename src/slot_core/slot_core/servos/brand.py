"""A brand of servos provides its settings and its bus, optionally an emulator and tools."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, TypeAlias

from slot_core.config import ConfigError

if TYPE_CHECKING:
    from slot_core.arrays import Array
    from slot_core.clock import Clock
    from slot_core.faults import Fault
    from slot_core.servos.servo_bus import ServoBus


class EmulatedPort(Protocol):
    """A device at which emulated servos answer."""

    @property
    def in_use(self) -> bool:
        """Whether a released port is still open at the driver's side."""

    def release(self) -> None:
        """Keep the device only while the driver has it open."""

    def close(self) -> None:
        """Remove the device; may be called again."""


class EmulatedServos(Protocol):
    """Four servos in this process that wind the tendons; their time passes only in `advance`."""

    def advance(self, dt: float, torques: Sequence[float] | Array) -> Array:
        """Advance by dt (s) under torques (4,), N m, on the tendon angles; returns these, rad."""

    def powered(self) -> tuple[str, ...]:
        """Names of the legs whose servos have torque on."""

    def driven(self) -> bool:
        """Whether the driver moves a servo: torque is on, with a goal away from where it is."""

    def watchdog_left(self) -> float:
        """Time until the first servo is stopped by its own watchdog, s; inf: none is armed."""

    def set_fault(self, fault: Fault, on: bool) -> None:
        """Start a fault of BUS_KINDS, or end it.

        A servo that it has stopped remains so until `ServoBus.activate`. Raises ConfigError for
        a kind that the servos cannot have.
        """

    def connect(self, clock: Clock) -> ServoBus:
        """A bus in this process; its exchanges take no time."""

    def serve(self, link: Path | None) -> EmulatedPort:
        """A device for a driver in another process, under the name `link` if there is one."""


Emulate: TypeAlias = (
    "Callable[[Sequence[float] | Array, float], EmulatedServos]"
)
"""Makes servos at tendon angles (4,), rad, and a supply voltage, V."""


def _no_emulator(angles: Sequence[float] | Array, voltage: float) -> NoReturn:
    raise ConfigError("servo_bus.yaml: servos of this brand cannot be emulated")


def _no_tools(arguments: Sequence[str] | None) -> NoReturn:
    raise ConfigError("servo_bus.yaml: servos of this brand have no tools")


@dataclass(frozen=True)
class Brand:
    """Servos of one brand; settings are its own, with the device as `bus.port`."""

    read_settings: Callable[[], Any]
    """Reads its settings from `config/`; raises ConfigError."""
    make_bus: Callable[[Any], ServoBus]
    """Makes the bus at the port of the settings, closed."""
    emulate: Emulate = _no_emulator
    """Makes emulated servos; raises ConfigError where there are none."""
    tools: Callable[[Sequence[str] | None], int] = _no_tools
    """Command line for servos on the bench; returns the exit code."""

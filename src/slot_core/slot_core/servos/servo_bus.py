"""The contract of a servo driver. Another brand implements `ServoBus` and enters the registry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

from slot_core.clock import Clock
from slot_core.robot import Array
from slot_core.servos.servo_state import BusFacts, Cycle, ServoStatus, TorqueOff


class ServoBus(Protocol):
    """Driver of the four servos: legs in the order of LEGS, angles of the tendons in rad.

    It starts closed, with torque unknown, and is used by one thread. It waits for answers only for
    a limited time: a servo that does not answer has no reading, and its `last_answer` stays.
    """

    facts: BusFacts
    clock: Clock  # s, of all times that the bus reports
    active: bool  # whether the bus has switched torque on and not off
    health: tuple[
        ServoStatus, ...
    ]  # of each servo; torque also after `activate`, `torque_off`

    def configure(self) -> tuple[str, ...]:
        """Open the port and check every servo against the settings; returns a line for each.

        Raises PortError, and RefusedError with all reasons, then with all torque off.
        """
        ...

    def activate(self) -> None:
        """Torque on without motion: the goals become the present angles.

        Arms the servos' own watchdogs first, if they have any. Raises RefusedError with all torque
        off, and where torque is on already.
        """
        ...

    def command(self, angles: Sequence[float] | Array) -> None:
        """Set the goals (4,), rad, that the next cycles write.

        Raises ValueError for angles outside of `facts`, and with torque off; the goals stay.
        """
        ...

    def goals(self) -> Array:
        """Goals (4,), rad: of the last command, or from `activate`."""
        ...

    def cycle(self) -> Cycle:
        """Exchange with all servos: goals out if active, readings in; raises ServoError."""
        ...

    def torque_off(self) -> TorqueOff:
        """Switch all torque off and read it back, also after an interrupted cycle; never raises."""
        ...

    def close(self) -> None:
        """Close the port; torque stays as it is. May be called again."""
        ...


@runtime_checkable
class ServoMaintenance(Protocol):
    """Optional services of a bus for one servo with torque off, beside ServoBus; raise ServoError."""

    def reboot(self, leg: str) -> None:
        """Restart a servo, as after a hardware error; it does not answer meanwhile."""
        ...

    def zero(self, leg: str, sleep: Callable[[float], None]) -> str:
        """Set the zero: the tendon is relaxed at the present angle, also in `config/`; returns a line.

        sleep: waits for a time (s). Raises ConfigError where the zero is not possible.
        """
        ...

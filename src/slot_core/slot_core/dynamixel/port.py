"""Serial port for dynamixel-sdk.

Differences from the SDK's own port: the clock is passed in (the SDK uses the wall clock, which may
jump); a read blocks until bytes arrive instead of polling; the answer timeout is a setting (34 ms
in the SDK); the port is opened exclusively; every error is a PortError.
"""

import select
import termios
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import serial
from dynamixel_sdk import PortHandler
from serial.tools.list_ports import comports

from slot_core.clock import Clock
from slot_core.servos.servo_bus import PortError

BITS_PER_BYTE = 10  # with start and stop bit
WRITE_TIMEOUT = 0.5  # s, for a device that does not accept bytes
TTY_CLASS = Path("/sys/class/tty")
UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


class BaudRateError(PortError):
    """The port does not support a baud rate."""


class SerialPort(PortHandler):
    """Port with the interface of the SDK's PortHandler, whose method names it keeps.

    `timeout` (s) is the time allowed for an answer beyond its transmission time; `clock` in s.
    """

    def __init__(
        self,
        name: str,
        baud: int,
        timeout: float,
        clock: Clock = time.monotonic,
    ) -> None:
        super().__init__(name)
        self._clock = clock
        self._timeout = timeout
        self.baudrate = baud

    def open(self) -> None:
        """Open the port at its baud rate; raises PortError with the cause."""
        if not self.setBaudRate(self.baudrate):
            raise BaudRateError(
                f"{self.port_name}: {self.baudrate} baud is not supported"
            )

    def close(self) -> None:
        """Close the port; may be called again."""
        if self.ser is not None:
            self.ser.close()
        self.is_open = False
        self.is_using = False

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the device exclusively; raises PortError."""
        self.close()
        try:
            self.ser = serial.Serial(
                port=self.port_name,
                baudrate=cflag_baud,
                timeout=0,
                write_timeout=WRITE_TIMEOUT,
                exclusive=True,
            )
        except (OSError, termios.error, ValueError) as error:
            ports = ", ".join(port.device for port in comports()) or "none"
            raise PortError(
                f"{self.port_name}: {error}; serial ports: {ports}"
            ) from None
        self.is_open = True
        self.tx_time_per_byte = 1e3 * BITS_PER_BYTE / self.baudrate
        return True

    def clearPort(self) -> None:  # noqa: N802
        """Discard the bytes received so far; raises PortError."""
        self._guard(lambda: self.ser.reset_input_buffer())  # noqa: PLW0108 - ser may be None

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Up to `length` bytes; blocks until the first or the timeout; raises PortError."""
        left = (self.packet_timeout - self.getTimeSinceStart()) * 1e-3
        return bytes(self._guard(lambda: self._await(length, max(left, 0.0))))

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        """Send a packet; returns the number of bytes sent; raises PortError."""
        return int(self._guard(lambda: self.ser.write(bytes(packet))))

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Start the timeout for an answer of `packet_length` bytes."""
        self.setPacketTimeoutMillis(
            self.tx_time_per_byte * packet_length + 1e3 * self._timeout
        )

    def getCurrentTime(self) -> float:  # noqa: N802
        """Time in ms."""
        return 1e3 * self._clock()

    def drain(self, quiet: float) -> None:
        """Discard input until the line is idle for `quiet` s, for timeout + quiet at most.

        Raises PortError.
        """
        # bound for a line that is never idle
        end = self._clock() + self._timeout + quiet
        while self._clock() < end:
            if not self._guard(
                lambda: self._await(self.ser.in_waiting or 1, quiet)
            ):
                break

    def _await(self, length: int, timeout: float) -> bytes:
        if length <= 0:  # the SDK asks for that after a corrupted length field
            return b""
        ready, _, _ = select.select([self.ser.fileno()], [], [], timeout)
        return bytes(self.ser.read(length)) if ready else b""

    def _guard(self, action: Callable[[], Any]) -> Any:
        """Result of `action`; an error of the operating system becomes a PortError."""
        try:
            if self.ser is None or not self.ser.is_open:
                raise OSError("the port is not open")
            return action()
        except (OSError, termios.error, TypeError, ValueError) as error:
            # TypeError, ValueError: another thread has closed the port
            self.is_using = False
            raise PortError(f"{self.port_name}: {error}") from None


def check_latency(
    name: str, limit: int, tty_class: Path = TTY_CLASS
) -> int | None:
    """Latency timer (ms) of a USB serial port; None if the port has none.

    FTDI chips buffer received bytes for this time, 16 ms by default. Raises PortError, with the
    udev rule that sets the timer, if it is above `limit` (ms).
    """
    device = Path(name).resolve().name  # /dev/serial/by-id/... are links
    try:
        found = int(
            (tty_class / device / "device" / "latency_timer").read_text()
        )
    except (OSError, ValueError):
        return None
    if found > limit:
        raise PortError(
            f"{name}: latency timer {found} ms, limit {limit} ms;"
            f" add to /etc/udev/rules.d/99-dynamixel.rules: {UDEV_RULE}"
        )
    return found

"""Emulated bus behind a pseudo-terminal, with the transmission times of a serial line.

A pseudo-terminal passes bytes at once. Here an instruction of n bytes is received 10 n / baud after
its first byte, and an answer is passed on when its last byte has been sent. The driver sets the
baud rate on its side. Bytes that the driver does not read in time are lost, as in a serial chip.
"""

import contextlib
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path

from slot_core.config import ConfigError
from slot_core.dynamixel.emulator.emulated_bus import EmulatedBus
from slot_core.dynamixel.port import BITS_PER_BYTE

TERMINALS = Path("/dev/pts")
CHUNK = 4096  # bytes, largest read
POLL_PERIOD = 0.01  # s, between two checks whether to stop
PACKET_GAP = 0.005  # s: after a longer pause a new packet begins
RATES = {  # baud, by termios speed code
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit()
}


class PseudoTerminal:
    """Thread that connects an emulated bus to a pseudo-terminal; `name`: port for the driver.

    While the bus is unplugged there is no port, and the driver's open port fails. Plugged in again,
    the port is under `link` if one was given, else its name may have changed.
    """

    def __init__(self, bus: EmulatedBus, link: Path | None = None) -> None:
        """Open the port; raises ConfigError if the link cannot be made, or is another file."""
        if link is not None:
            _require_free(link)
        self._bus, self._link = bus, link
        self._stopping = threading.Event()
        self._free_at = 0.0  # s, when the line is idle again
        self._last_input = time.monotonic()
        self._releasing = False
        self.in_use = True  # until a released port is closed by the driver
        self.slave = ""  # device of the driver's side; empty while unplugged
        self._plug()
        self._thread = threading.Thread(
            target=self._serve, name="emulated bus", daemon=True
        )
        self._thread.start()

    @property
    def name(self) -> str:
        """Path of the port: the link if there is one, else the device."""
        return str(self._link or self.slave)

    def release(self) -> None:
        """Keep the port open only while the driver does; `in_use` then tells whether it does."""
        self._releasing = True

    def close(self) -> None:
        """Remove the port and end the thread; may be called again."""
        self._stopping.set()
        self._thread.join()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            if self._bus.unplugged:
                self._unplug()
                self.in_use = not self._releasing
                self._stopping.wait(POLL_PERIOD)
                continue
            if not self.slave:
                self._plug()
            self._poll()
        self._unplug()

    def _poll(self) -> None:
        """Answer the next bytes, if any come within POLL_PERIOD."""
        if self._releasing:
            self._close_slave()
        ready, _, _ = select.select([self._master_fd], [], [], POLL_PERIOD)
        if not ready:
            return
        now = time.monotonic()
        if now - self._last_input > PACKET_GAP:
            self._bus.discard_partial()
        self._last_input = now
        try:
            self._respond(os.read(self._master_fd, CHUNK), now)
        except BlockingIOError:
            return
        except OSError:  # nobody has the port open
            self.in_use = False
            self._stopping.wait(POLL_PERIOD)

    def _respond(self, data: bytes, now: float) -> None:
        baud = RATES.get(termios.tcgetattr(self._master_fd)[4], 0) or 1
        byte = BITS_PER_BYTE / baud
        at = max(now, self._free_at) + len(data) * byte
        replies = self._bus.receive(data, baud)
        if replies:
            at += self._bus.settings.usb_latency
        for reply in replies:
            at += reply.delay + len(reply.data) * byte
            time.sleep(max(at - time.monotonic(), 0.0))
            with contextlib.suppress(BlockingIOError):
                os.write(self._master_fd, reply.data)
        self._free_at = at

    def _plug(self) -> None:
        self._master_fd, slave_fd = os.openpty()
        tty.setraw(slave_fd)
        os.set_blocking(self._master_fd, False)
        self.slave = os.ttyname(slave_fd)
        self._slave_fd: int | None = slave_fd
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.slave)

    def _unplug(self) -> None:
        if not self.slave:
            return
        self.slave = ""
        self._close_slave()
        os.close(self._master_fd)
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def _close_slave(self) -> None:
        """Close the own handle of the driver's side, which keeps the settings of the line."""
        if self._slave_fd is not None:
            os.close(self._slave_fd)
            self._slave_fd = None


def _require_free(link: Path) -> None:
    """Raise ConfigError unless a link of that name can be made; one to a terminal is replaced."""
    try:
        if link.exists() and TERMINALS not in link.resolve().parents:
            raise ConfigError(f"{link}: exists already")
        link.unlink(missing_ok=True)
        link.symlink_to(TERMINALS)
        link.unlink()
    except OSError as error:
        raise ConfigError(f"{link}: {error.strerror}") from None

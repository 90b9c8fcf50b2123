"""An emulated bus at the end of a pseudo-terminal, in the time that the bytes take on the wire.

A pseudo-terminal passes bytes at once. Here an instruction of n bytes is heard 10 n / baud after
its first byte, and an answer is passed on when its last byte has been sent; the rate is the one
that the driver has set on its side. What the driver does not fetch in time is lost, as in a serial
chip.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path
from types import TracebackType

from slot_core.clock import Clock
from slot_core.dynamixel.port import BITS_PER_BYTE
from slot_core.emulator.emulated_bus import EmulatedBus

CHUNK = 4096
TURN = 0.01  # s, between two looks at whether it is to end
PAUSE = 0.005  # s: a packet does not stop for so long
RATES = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit()
}


class PseudoTerminal:
    """A thread that answers for the bus; `name` is the port for the driver.

    While the bus is unplugged there is no port: what the driver holds is dead. Plugged in again, it
    is there under `link`, if one was given; without one the name may be another.
    """

    def __init__(
        self, bus: EmulatedBus, link: Path | None = None, clock: Clock = time.monotonic
    ) -> None:
        self._bus, self._link, self._clock = bus, link, clock
        self._stopping = threading.Event()
        self._free = 0.0  # when the line is free again
        self._heard = clock()
        self.slave = ""  # device of the driver's side; empty while unplugged
        self._plug()
        self._thread = threading.Thread(target=self._serve, name="emulated bus", daemon=True)
        self._thread.start()

    @property
    def name(self) -> str:
        """The port: the link, if one was asked for."""
        return str(self._link or self.slave)

    @property
    def silence(self) -> float:
        """Time since the driver sent something, s."""
        return self._clock() - self._heard

    def close(self) -> None:
        """Pull the plug for good; may be done again."""
        self._stopping.set()
        self._thread.join()

    def __enter__(self) -> PseudoTerminal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            if self._bus.unplugged:
                self._unplug()
                self._stopping.wait(TURN)
                continue
            if not self.slave:
                self._plug()
            self._listen()
        self._unplug()

    def _listen(self) -> None:
        """Answer what comes, for a moment at most."""
        ready, _, _ = select.select([self._master], [], [], TURN)
        if not ready:
            return
        now = self._clock()
        if now - self._heard > PAUSE:
            self._bus.hush()
        self._heard = now
        with contextlib.suppress(BlockingIOError):
            self._respond(os.read(self._master, CHUNK), now)

    def _respond(self, data: bytes, now: float) -> None:
        baud = self._baud()
        byte = BITS_PER_BYTE / baud
        at = max(now, self._free) + len(data) * byte
        replies = self._bus.receive(data, baud)
        if replies:
            at += self._bus.settings.usb_latency
        for reply in replies:
            at += reply.delay + len(reply.data) * byte
            self._sleep_until(at)
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, reply.data)
        self._free = at

    def _sleep_until(self, at: float) -> None:
        left = at - self._clock()
        if left > 0:
            time.sleep(left)

    def _baud(self) -> int:
        return RATES.get(termios.tcgetattr(self._held)[4], 0) or 1

    def _plug(self) -> None:
        self._master, self._held = os.openpty()
        tty.setraw(self._held)
        os.set_blocking(self._master, False)
        self.slave = os.ttyname(self._held)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.slave)

    def _unplug(self) -> None:
        if not self.slave:
            return
        self.slave = ""
        os.close(self._held)
        os.close(self._master)
        if self._link is not None:
            self._link.unlink(missing_ok=True)

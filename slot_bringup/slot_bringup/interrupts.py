"""Signals that end a program of this package, and blocks in which they act differently."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# SIGHUP: the terminal is closed
INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def on_interrupt(handler: Any) -> Iterator[None]:
    """Set `handler` for INTERRUPTS in the block; one ignored by the caller (nohup) stays so."""
    before = {number: signal.getsignal(number) for number in INTERRUPTS}
    handled = [number for number in before if before[number] != signal.SIG_IGN]
    try:
        for number in handled:
            signal.signal(number, handler)
        yield
    finally:
        for number in handled:
            signal.signal(number, before[number])


@contextmanager
def deferred() -> Iterator[None]:
    """Delay interrupts to the end of the block, then raise KeyboardInterrupt if there was one.

    An exception raised by a signal during a fork is lost. One raised while rclpy converts a message
    becomes a RuntimeError, or a null pointer in the converter's C code, which ends the process.
    Only the main thread is interrupted; in another one this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    with on_interrupt(lambda number, _: received.append(number)):
        yield
    if received:
        raise KeyboardInterrupt

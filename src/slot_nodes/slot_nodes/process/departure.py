"""Departure from DDS within a time limit.

Fast DDS waits for its callbacks about other participants before it deletes its own. Built for a C
library before 2.30, as the wheels are, it keeps the callbacks' lock while it waits: if another
participant leaves at the same moment the wait never ends (eProsima/Fast-DDS, issue 6513). rclpy
holds Python's lock meanwhile, so no code of Python can end it.
"""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import CLOCK_MONOTONIC

LIMIT = 2.0  # s, less than the launcher's patience with a node; it takes 0.1 s
C_LIBRARY = ctypes.CDLL(None, use_errno=True)
SIGEV_THREAD = 2  # of sigevent(7): a thread of the C library calls a function


class _Event(ctypes.Structure):
    """`struct sigevent` of a timer that calls a function, of 64 bytes."""

    _fields_ = (
        ("value", ctypes.c_void_p),  # argument of the function
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("rest", ctypes.c_byte * 32),
    )


@contextmanager
def limited(code: int, limit: float = LIMIT) -> Iterator[None]:
    """End the process with an exit code if the block takes longer than `limit`, s.

    Nothing else of the process runs then: what it must finish has to be finished before. Raises
    OSError if the operating system has no timer left.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    event = _Event(
        code,
        0,
        SIGEV_THREAD,
        ctypes.cast(C_LIBRARY._exit, ctypes.c_void_p).value,
    )
    timer = ctypes.c_void_p()
    # struct itimerspec: no interval, then the time in s and ns
    setting = (ctypes.c_long * 4)(0, 0, int(limit), int(limit % 1.0 * 1e9))
    if C_LIBRARY.timer_create(
        CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)
    ) or C_LIBRARY.timer_settime(timer, 0, ctypes.byref(setting), None):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    try:
        yield
    finally:
        C_LIBRARY.timer_delete(timer)

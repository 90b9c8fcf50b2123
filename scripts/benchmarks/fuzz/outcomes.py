"""Outcomes of calls with hostile input: what was refused in one line, and what was not."""

from __future__ import annotations

import contextlib
import io
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from slot_core.refusal import LINE_MAX, InputError, printable

SEED = 11
HANG = 60.0  # s, after which a call counts as one that does not end
REFUSED = 2  # exit code


class Hang(BaseException):
    """A call has not ended within HANG; nothing that catches errors catches it."""


@dataclass
class Outcomes:
    """Counts of the calls by outcome; `example` tells the first that is none of the first two."""

    tried: int = 0
    refused: int = 0  # in one line that is short and printable
    exceptions: int = 0  # that are not the project's own
    long: int = 0  # refusals of more than LINE_MAX characters
    unprintable: int = 0  # refusals of more than one line, or with control characters
    hangs: int = 0
    accepted: int = 0  # although the input is known to be wrong
    example: str = ""

    @property
    def faults(self) -> int:
        """Number of the outcomes that must not be."""
        return self.exceptions + self.long + self.unprintable + self.hangs + self.accepted

    def call(
        self, name: str, call: Callable[[], Any], allowed: type[Exception] = InputError,
        *, wrong: bool = False,
    ) -> None:  # fmt: skip
        """Count the outcome of a call that may raise `allowed`, and has to if it is `wrong`."""
        self.tried += 1
        try:
            with bounded():
                call()
        except allowed as error:
            self.line(name, str(error))
        except Hang:
            self._fault("hangs", name, "no end")
        except Exception as error:  # every other one is a fault
            self._fault("exceptions", name, repr(error))
        else:
            if wrong:
                self._fault("accepted", name, "accepted")

    def command(self, name: str, main: Callable[[Sequence[str]], Any], words: list[str]) -> None:
        """Count the outcome of a command line that has to end with REFUSED and one line."""
        self.tried += 1
        out, code = io.StringIO(), None
        try:
            with bounded(), contextlib.redirect_stderr(out), contextlib.redirect_stdout(out):
                code = main(words)
        except SystemExit as ended:
            code = ended.code
        except Hang:
            self._fault("hangs", name, f"no end of {words}")
            return
        except Exception as error:  # every one is a fault
            self._fault("exceptions", name, f"{error!r} of {words}")
            return
        if code == REFUSED:
            self.line(name, out.getvalue().removesuffix("\n"))
        else:
            self._fault("accepted", name, f"exit code {code} of {words}")

    def line(self, name: str, text: str) -> None:
        """Count a refusal by its text."""
        if not text.isprintable():
            self._fault("unprintable", name, text)
        elif len(text) > LINE_MAX:
            self._fault("long", name, text)
        else:
            self.refused += 1

    def _fault(self, kind: str, name: str, text: str) -> None:
        setattr(self, kind, getattr(self, kind) + 1)
        self.example = self.example or printable(f"{name}: {text}"[:LINE_MAX])


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Raise Hang in the block if it has not ended within HANG; only in the main thread."""

    def end(number: int, frame: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, HANG)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def tally_of(part: str, count: int) -> Outcomes:
    """Outcomes of a part, in this process, from a fixed seed."""
    found: Outcomes = import_module(f"benchmarks.fuzz.hostile_{part}").fuzz(
        count, np.random.default_rng(SEED)
    )
    return found

"""Damaged data for property tests, and how the project has to refuse what it cannot use.

A test tries its examples from a fixed seed. `SLOT_TRIES=100` makes it try a hundred times as many,
from a seed that is drawn.
"""

import os
from contextlib import contextmanager

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from slot_core.refusal import LINE_MAX, InputError

TRIES = int(os.environ.get("SLOT_TRIES", "0"))


def examples(count):
    """Settings of a property test of so many examples."""
    return settings(
        max_examples=count * max(TRIES, 1),
        derandomize=not TRIES,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def spliced(data, *inserted):
    """Strategy of `data` with bytes changed, inserted, removed or cut off, often near an end."""
    near = min(len(data), 4000)
    place = (
        st.integers(0, len(data))
        | st.integers(0, near)
        | st.integers(len(data) - near)
    )
    removed = st.sampled_from([0, 1, 4, 200, len(data)])
    new = st.binary(max_size=20) | st.sampled_from(inserted or [b""])
    return st.builds(
        lambda n, size, b: data[:n] + b + data[n + size :], place, removed, new
    )


def require_short(line):
    """Assert that a refusal is one printable line of at most LINE_MAX characters."""
    assert line.isprintable(), repr(line)
    assert len(line) <= LINE_MAX


@contextmanager
def refusable(kind=InputError):
    """Allow the block to refuse its input by an error of this kind."""
    try:
        yield
    except kind as error:
        require_short(str(error))

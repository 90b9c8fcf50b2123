"""Prints a digest of state, preview, plan and command of walks, for `test_same_bits.py`.

usage: python same_bits.py TICKS POLICY...
"""

import dataclasses
import hashlib
import sys

import numpy as np

from slot_core.simulation.closed_loop import ClosedLoop

# m/s, m/s, rad/s: forward, sideways, turning
VELOCITY = np.array([0.03, 0.01, 0.05])


def content(value):
    """Bytes of a number, text or array, or of all those in a dataclass."""
    if dataclasses.is_dataclass(value):
        fields = (
            getattr(value, field.name) for field in dataclasses.fields(value)
        )
        return b"".join(content(part) for part in fields)
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return repr(value).encode()


def main(ticks, policies):
    """Walk and print, after every tenth tick, the digest of each stage up to there."""
    for policy in policies:
        stages = {
            name: hashlib.sha256()
            for name in ("estimate", "preview", "plan", "command")
        }
        loop = ClosedLoop("flat", "walk", VELOCITY, seed=3, policy=policy)
        for k, tick in enumerate(loop.run(ticks)):
            for name, digest in stages.items():
                digest.update(content(getattr(tick, name)))
            if k % 10 == 9:
                print(
                    policy,
                    k + 1,
                    *(f"{n} {d.hexdigest()[:16]}" for n, d in stages.items()),
                )


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])

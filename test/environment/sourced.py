"""Environment after sourcing scripts/env."""

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def environment(
    mode: str = "",
    given: dict[str, str] | None = None,
    root: Path = ROOT,
    times: int = 1,
) -> dict[str, str]:
    """Variables in a shell that has only `given` ones and sources scripts/env in a mode.

    mode: "": as in a shell of the caller.
    """
    script = f". scripts/env {mode} && " * times + "env -0"
    shell = subprocess.run(
        ["bash", "-c", script],
        cwd=root,
        env={"PATH": os.defpath} | (given or {}),
        capture_output=True,
        text=True,
        check=True,
    )
    return dict(
        entry.split("=", 1) for entry in shell.stdout.split("\0") if entry
    )

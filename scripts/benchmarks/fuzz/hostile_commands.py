"""Command lines with a path, a name or a number that cannot be used, each to be refused."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.outcomes import Outcomes
from slot_bringup import run, view
from slot_bringup.arguments import parse
from slot_core import config
from slot_lab.bags import replay_command
from slot_lab.calibration import command as calibrate
from slot_lab.film import calibrate_camera, print_command, track_command
from slot_lab.report import compare, map_command
from slot_lab.twin import twin_command
from slot_lab.validation import validate

MEASURED = "parameters/paper_single_leg.csv"  # in config/
PATH, NAME, NUMBER = "PATH", "NAME", "NUMBER"  # places for something that cannot be used
NAMES = (
    "",
    "moon",
    "\x1b]0;x\x07",
    "x" * 5000,
    "..",
    "a b",
    "\u202e",
    "\udcff",
    "[1]",
    "/dev/zero",
)
NUMBERS = ("nan", "inf", "-inf", "1e400", "x", "", "\x1b[2J", "1" * 5000, "-1e9", "0x10", "1e309")
Main = Callable[[Sequence[str]], Any]


def tools() -> list[tuple[str, Main, list[list[str]]]]:
    """Name, entry point and forms of the command lines of every tool that needs no graph."""
    measured = str(config.config_dir() / MEASURED)

    def check(words: Sequence[str]) -> Any:
        return run.check_options(parse(words))

    return [
        ("run", check, [["--path", PATH], ["--calibration", PATH], ["--gait", NAME],
            ["--scene", NAME], ["--policy", NAME], ["--vx", NUMBER], ["--duration", NUMBER],
            ["--seed", NUMBER], ["--namespace", "\x1b" + "x" * 400], ["--frame-prefix", "fred"],
            ["--hardware", NAME], ["--yaw-rate", NUMBER]]),
        ("replay", replay_command.main, [[PATH], [PATH, "--tolerance", "1"],
            ["x", "--tolerance", NUMBER],
            ["x", "--remap", NAME], ["x", "--" + "y" * 3000]]),
        ("compare", compare.main, [[PATH, PATH], ["x", "x", "--tolerance", NAME],
            ["x", "x", "--warm-up", NUMBER], ["x", "x", "--plot", NAME]]),
        ("constraint_map", map_command.main, [[PATH], ["x", "--out", NAME]]),
        ("validate", validate.main, [[PATH, measured], [measured, PATH],
            ["x", "x", "--frame", NAME],
            ["x", "x", "--offset", NUMBER], ["x", "x", "--block", NUMBER]]),
        ("twin", twin_command.main, [[PATH], ["x", "--scene", NAME], ["x", "--period", NUMBER],
            ["x", "--fit", NAME + "y"], ["x", "--parameters", "moon" + NAME]]),
        ("calibrate", calibrate.main, [[PATH], [measured, "--start", NAME],
            [measured, "--free", NAME], [measured, "--starts", NUMBER]]),
        ("track", track_command.main, [[PATH], [PATH, "--camera", PATH], ["x", "--rate", NUMBER]]),
        ("calibrate_camera", calibrate_camera.main, [[PATH], ["x", "--every", NUMBER]]),
        ("print_markers", print_command.main, [[NAME], ["torso", "--dpi", NUMBER]]),
        ("view", view.main, [[PATH, "--animate", "x.gif"], ["x", "--animate", NAME],
            [PATH, "--html", "x.html"], ["x", "--html", NAME]]),
    ]  # fmt: skip


def fuzz(count: int, rng: np.random.Generator) -> Outcomes:
    """Count command lines, in turn through all their forms."""
    tally, before = Outcomes(), Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)
        try:
            paths = unusable(Path(scratch), rng)
            forms = [(name, main, words) for name, main, some in tools() for words in some]
            for number in range(count):
                name, main, words = forms[number % len(forms)]
                tally.command(name, main, list(filled(words, paths, rng)))
        finally:
            os.chdir(before)
    return tally


def unusable(directory: Path, rng: np.random.Generator) -> list[str]:
    """Paths that are no input: devices, pipes, directories, random bytes, names too long."""
    os.mkfifo(directory / "pipe.mcap")
    os.mkfifo(directory / "pipe.csv")
    os.mkfifo(directory / "pipe.mp4")
    (directory / "empty").mkdir()
    (directory / "piped").mkdir()
    os.mkfifo(directory / "piped" / "metadata.yaml")
    names = ["noise.csv", "noise.mcap", "noise.db3", "noise.yaml", "noise.mp4", "noise.py"]
    for name in names:
        (directory / name).write_bytes(rng.bytes(3000))
    (directory / "\x1b[2J").write_bytes(b"\x1b[2J")
    special = ["/dev/zero", "/dev/full", "/dev/stdin", "/proc/self/mem", "/nowhere/\x1b[2J"]
    here = ["pipe.mcap", "pipe.csv", "pipe.mp4", "empty", "piped", *names, "\x1b[2J"]
    return [*special, *here, "x" * 5000, "a\0b", "..", "\udcff"]


def filled(words: list[str], paths: list[str], rng: np.random.Generator) -> Iterator[str]:
    """The words with something for each place."""
    places: dict[str, Sequence[str]] = {PATH: paths, NAME: NAMES, NUMBER: NUMBERS}
    for word in words:
        for place, some in places.items():
            if place in word:
                word = word.replace(place, some[int(rng.integers(len(some)))])  # noqa: PLW2901
        yield word

"""Damaged and hostile bags to everything that reads bags."""

from __future__ import annotations

import io
import struct
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.outcomes import Outcomes
from benchmarks.harness import ROOT
from slot_core.dynamics.servo import read_servo
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.message_types import message_types
from slot_core.recording.origin import CONFIGURATION, Origin
from slot_core.recording.record_settings import read_record_settings
from slot_core.refusal import LINE_MAX, InputError
from slot_core.robot import read_robot
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag
from slot_lab.bags.measured import measured_motion, tendon_angles
from slot_lab.bags.replay_command import TOLERANCE
from slot_lab.report import compare_plot
from slot_lab.report.compare import compare_figures
from slot_lab.report.constraint_map import map_figure, read_map, summary_lines
from slot_lab.report.figures import figures
from slot_lab.report.metrics import walk_metrics
from slot_lab.report.origin_changes import origin_lines
from slot_lab.report.run_page.run_frames import read_frames
from slot_lab.report.run_page.run_page import content, page
from slot_lab.twin.recorded import read_recorded
from slot_lab.validation.recording import read_recording

WALK = ROOT / "test" / "bags" / "walk"
STRING = "std_msgs/msg/String"
TYPES = message_types()
SPAN = 500_000_000  # ns of the walk that a hostile bag holds
Change = Callable[[int, Any], tuple[int, Any]]


def fuzz(count: int, rng: np.random.Generator) -> Outcomes:
    """Count files with changed bytes; the hostile bags come beside them, once."""
    tally, whole = Outcomes(), (WALK / "walk.mcap").read_bytes()
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch, "walk.mcap")
        for _ in range(count):
            file.write_bytes(mutate(whole, rng))
            tally.call("bytes", lambda: read_all(file), InputError)
        for name, make in HOSTILE.items():
            path = Path(scratch, name.replace(" ", "_"))
            make(path)
            for reader, read in READERS.items():
                tally.call(f"{name}, {reader}", lambda p=path, r=read: r(p), InputError)
    return tally


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes changed, inserted, removed or cut off; every other time near one of the ends."""
    out, kind = bytearray(data), rng.integers(4)
    size = min(4000, len(out)) if rng.random() < 0.5 else len(out)
    where = int(rng.integers(size))
    where = where if rng.random() < 0.5 else len(out) - 1 - where
    if kind == 0:
        for _ in range(rng.integers(1, 9)):
            out[min(where + int(rng.integers(16)), len(out) - 1)] = int(rng.integers(256))
    elif kind == 1:
        out[where:where] = rng.bytes(rng.integers(1, 20))
    elif kind == 2:
        del out[where : where + int(rng.integers(1, 200))]
    else:
        del out[where:]
    return bytes(out)


def read_all(path: Path) -> None:
    """Read a bag as every command does first, then all messages."""
    bag = Bag(path)
    lines = bag.lines()
    if not all(line.isprintable() for line in lines):
        raise AssertionError(f"not printable: {lines!r}")
    for topic in bag.topics:
        for _, message in bag.messages(topic):
            del message


def _draw(path: Path) -> None:
    found = read_map(Bag(path))
    map_figure(found).canvas.draw()  # type: ignore[attr-defined]
    summary_lines(found)


def _compare(path: Path) -> None:
    """Both ways round with a sound bag, and with itself."""
    for paths in ((path, WALK), (WALK, path), (path, path)):
        bags = [Bag(place) for place in paths]
        walks = [figures(walk_metrics(bag, 0.0, read_servo())) for bag in bags]
        compare_plot.plot(*bags).canvas.draw()  # type: ignore[attr-defined]
        lines = [*origin_lines(*bags), *map(str, compare_figures(*walks))]
        if not all(len(line) < 2 * LINE_MAX for line in lines):
            raise AssertionError("a line that is too long")


READERS: Mapping[str, Callable[[Path], Any]] = {
    "all": read_all,
    "replay": lambda path: check_bag(Bag(path), TOLERANCE),
    "validate": read_recording,
    "motion": lambda path: measured_motion(Bag(path)),
    "angles": lambda path: tendon_angles(Bag(path)),
    "twin": lambda path: read_recorded(path, "", "", ""),
    "constraint_map": _draw,
    "compare": _compare,
    "page": lambda path: page(content([read_frames(Bag(path), read_robot())], read_robot())),
}


def copy(
    path: Path, change: Change | None = None, topic: str = "", origin: Origin | None = None
) -> None:
    """Write the begin of the walk, the messages of a topic (default: all) changed."""
    bag = Bag(WALK)
    with BagWriter(path, read_record_settings(), origin) as out:
        for name, time, data in bag.raw():
            if time > bag.start_ns + SPAN:
                break
            found = (time, bag.topics[name], data)
            if change is not None and topic in ("", name):
                found = _serialized(*change(time, bag.decode(name, data)))
            out.write(name, found[1], found[0], found[2])


def _serialized(time: int, message: Any) -> tuple[int, str, bytes]:
    kind = message.__msgtype__
    return time, kind, bytes(TYPES.serialize_cdr(message, kind))


def _changed(topic: str, edit: Callable[[Any], None]) -> Callable[[Path], None]:
    """A bag whose messages of a topic are edited."""

    def change(time: int, message: Any) -> tuple[int, Any]:
        edit(message)
        return time, message

    return lambda path: copy(path, change, topic)


def _retyped(topic: str) -> Callable[[Path], None]:
    """A bag with texts on a topic."""
    text = TYPES.types[STRING]("\x1b]0;x\x07")
    return lambda path: copy(path, lambda time, _: (time, text), topic)


def _set(**values: Any) -> Callable[[Any], None]:
    """An edit that sets fields, of an array all elements."""

    def edit(message: Any) -> None:
        for name, value in values.items():
            *parents, last = name.split("__")
            for parent in parents:
                message = getattr(message, parent)
            old = getattr(message, last)
            setattr(message, last, np.full_like(old, value) if np.ndim(old) else value)

    return edit


def _with_origin(about: Mapping[str, str], files: Mapping[str, bytes]) -> Callable[[Path], None]:
    return lambda path: copy(path, origin=Origin(about, files))


def _archive(edit: Callable[[bytearray], None]) -> bytes:
    """A ZIP archive of one file, edited."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("robot.yaml", "a" * 1000)
    data = bytearray(packed.getvalue())
    edit(data)
    return bytes(data)


def _encrypt(data: bytearray) -> None:
    """Set the flag of an encrypted file in its header and in the directory."""
    for place in (6, data.find(b"PK\x01\x02") + 8):
        data[place] |= 1


def _cut(data: bytearray) -> None:
    """Remove the begin."""
    del data[:40]


def _claim(data: bytearray) -> None:
    """Claim that the file is of 4 GB."""
    struct.pack_into("<I", data, data.find(b"PK\x01\x02") + 24, 2**32 - 2)


ABOUT = {"revision": "\x1b]0;x\x07", "gait": "x" * 100_000, "policy": "gait_alone"}
HOSTILE: dict[str, Callable[[Path], None]] = {
    "no archive": _with_origin(ABOUT, {CONFIGURATION: b"no zip"}),
    "encrypted archive": _with_origin(ABOUT, {CONFIGURATION: _archive(_encrypt)}),
    "archive of 4 GB": _with_origin(ABOUT, {CONFIGURATION: _archive(_claim)}),
    "cut archive": _with_origin(ABOUT, {CONFIGURATION: _archive(_cut)}),
    "path of noise": _with_origin({"path": "path.csv"}, {"path.csv": b"\xff\x00\x1b[2J"}),
    "policy that is none": _with_origin({"policy": "\x1b[2J"}, {}),
    "late": lambda path: copy(path, lambda time, message: (time + 2**63, message)),
    **{f"text on {topic[1:].replace('/', ' ')}": _retyped(topic) for topic in (
        "/odom", "/imu", "/mpc_state", "/gait_preview", "/tendon_plan", "/desired_joint_angles",
        "/ground_truth/odom", "/joint_states")},
    "forces of NaN": _changed("/tendon_plan", _set(force=np.nan, slack_friction=np.nan)),
    "slacks of NaN": _changed("/tendon_plan", _set(slack_normal_min=np.nan, slack_friction=np.nan,
        slack_angle=np.nan, slack_rate=np.nan, slack_normal_max=np.nan, slack_total=np.nan,
        slack_balance=np.nan)),
    "slacks of 1e308": _changed("/tendon_plan", _set(slack_friction=-1e308, slack_angle=1e308)),
    "no status": _changed("/tendon_plan", _set(status=99)),
    "states of NaN": _changed("/mpc_state", _set(rpy__x=np.nan)),
    "no validity": _changed("/mpc_state", _set(validity=99)),
    "lead of years": _changed("/mpc_state", _set(lead__sec=2**31 - 1)),
    "stages of none": _changed("/gait_preview", _set(stages=0)),
    "gait that is none": _changed("/gait_preview", _set(requested="\x1b[2J" + "x" * 1000)),
    "preview of NaN": _changed("/gait_preview", _set(dt=np.nan, tendon_angle=np.nan)),
    "dt of zero": _changed("/gait_preview", _set(dt=0.0)),
    "no quaternion": _changed("/ground_truth/odom", _set(pose__pose__orientation__w=9.0)),
    "odometry of NaN": _changed("/odom", _set(pose__pose__position__x=np.nan)),
    "joints of NaN": _changed("/joint_states", _set(position=np.nan)),
    "no joints": _changed("/joint_states", lambda m: setattr(m, "position", np.zeros(0))),
    "other joints": _changed("/joint_states", lambda m: setattr(m, "name", ["\x1b[2J"] * 4)),
    "equal stamps": _changed("/odom", _set(header__stamp__sec=1)),
    "nothing": lambda path: BagWriter(path, read_record_settings()).close(),
}  # fmt: skip
"""How a hostile bag is made at a path, by its name."""

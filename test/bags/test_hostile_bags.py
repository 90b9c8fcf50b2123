"""Damaged and hostile bags are read, or refused in one short line, by everything that reads bags."""

import contextlib
import io
import math
import struct
import zipfile
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from damage import examples, refusable, require_short, spliced
from hypothesis import given

from slot_core.recording.bag_writer import BagWriter, message_types
from slot_core.recording.origin import CONFIGURATION, Origin
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_lab.bags import replay_command
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import read_motion, tendon_angles
from slot_lab.report import compare, map_command
from slot_lab.report.run_page.run_page import content, read_frames
from slot_lab.twin.strides import read_recorded
from slot_lab.validation.recording import read_recording

WALK = Path(__file__).parent / "walk"


def read_all(path):
    """Read the origin of a bag and all its messages."""
    bag = Bag(path)
    for line in bag.lines():
        assert line.isprintable()
    for topic in bag.topics:
        assert sum(1 for _ in bag.messages(topic)) <= bag.counts[topic]


def tool(main, *words):
    """Function that calls a tool with a bag at the path {}."""

    def call(path):
        said = io.StringIO()
        with contextlib.suppress(SystemExit), contextlib.redirect_stderr(said):
            main([str(word).format(path) for word in words])
        for line in said.getvalue().splitlines():
            require_short(line)

    return call


READERS = [
    read_all,
    read_recording,
    lambda path: read_motion(Bag(path), "/odom"),
    lambda path: tendon_angles(Bag(path)),
    lambda path: read_recorded(path, "", "", ""),
    tool(replay_command.main, "{}"),
    tool(map_command.main, "{}", "--out", "{}/map.png"),
    lambda path: content([read_frames(Bag(path), read_robot())], read_robot()),
    tool(compare.main, WALK, "{}", "--warm-up", "0"),
    tool(compare.main, "{}", WALK, "--warm-up", "0"),
    tool(compare.main, "{}", "{}", "--warm-up", "0", "--plot", "{}/plot.png"),
]
"""Functions that read the bag at a path."""


@given(spliced((WALK / "walk.mcap").read_bytes()))
@examples(100)
def test_a_damaged_file_of_a_bag_is_read_or_refused(tmp_path, data):
    file = tmp_path / "walk.mcap"
    file.write_bytes(data)
    with refusable():
        read_all(file)


BAG, TYPES = Bag(WALK), message_types()
PART = [entry for entry in BAG.raw() if entry[1] < BAG.start_ns + 500_000_000]
ESCAPE = "\x1b]0;x\x07"


def write_part(
    path, topic="", changes=(), *, part=PART, late=0, text=None, origin=None
):
    """Write the begin of the walk with fields of a topic changed, or texts in their place."""
    with BagWriter(path, read_record_settings(), origin) as out:
        for name, time, data in part:
            kind, message = BAG.topics[name], BAG.decode(name, data)
            if name == topic and text is not None:
                kind = "std_msgs/msg/String"
                message = TYPES.types[kind](text)
            for field, new in changes if name == topic else ():
                *parents, last = field.split(".")
                inside = reduce(getattr, parents, message)
                old = getattr(inside, last)
                filled = isinstance(old, np.ndarray) and np.isscalar(new)
                setattr(inside, last, np.full_like(old, new) if filled else new)
            out.write(
                name, kind, time + late, TYPES.serialize_cdr(message, kind)
            )


def archive(encrypted=False, size=1000, begin=0):
    """A ZIP archive of one file, said to be encrypted or of another size, or without its begin."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("robot.yaml", "a" * 1000)
    data = bytearray(packed.getvalue())
    entry = data.find(b"PK\x01\x02")
    data[6] |= encrypted
    data[entry + 8] |= encrypted
    struct.pack_into("<I", data, entry + 24, size)
    return bytes(data[begin:])


ABOUT = {"revision": ESCAPE, "gait": "x" * 100_000, "policy": "gait_alone"}
PLAN, PREVIEW, STATE, TRUTH = (
    "/tendon_plan",
    "/gait_preview",
    "/mpc_state",
    "/ground_truth/odom",
)
BAGS = {
    **{
        f"archive: {name}": {"origin": Origin(ABOUT, {CONFIGURATION: data})}
        for name, data in {
            "none": b"no zip",
            "encrypted": archive(encrypted=True),
            "4 GB": archive(size=2**32 - 2),
            "cut": archive(begin=40),
        }.items()
    },
    "path of noise": {
        "origin": Origin({"path": "path.csv"}, {"path.csv": b"\xff\x00\x1b[2J"})
    },
    "policy that is none": {"origin": Origin({"policy": ESCAPE}, {})},
    "no message": {"part": ()},
    "late": {"late": 2**63},
    **{
        f"text on {topic[1:]}": {"topic": topic, "text": ESCAPE}
        for topic in (
            "/odom",
            "/imu",
            "/joint_states",
            "/desired_joint_angles",
            PLAN,
            PREVIEW,
            STATE,
            TRUTH,
        )
    },
    "forces of NaN": {
        "topic": PLAN,
        "changes": [("force", math.nan), ("slack_friction", math.nan)],
    },
    "slacks of NaN": {
        "topic": PLAN,
        "changes": [
            (f"slack_{name}", math.nan)
            for name in [
                "normal_min",
                "friction",
                "angle",
                "rate",
                "normal_max",
                "total",
                "balance",
            ]
        ],
    },
    "slacks of 1e308": {
        "topic": PLAN,
        "changes": [("slack_friction", -1e308), ("slack_angle", 1e308)],
    },
    "no status": {"topic": PLAN, "changes": [("status", 99)]},
    "states of NaN": {"topic": STATE, "changes": [("rpy.x", math.nan)]},
    "no validity": {"topic": STATE, "changes": [("validity", 99)]},
    "lead of years": {"topic": STATE, "changes": [("lead.sec", 2**31 - 1)]},
    "stages of none": {"topic": PREVIEW, "changes": [("stages", 0)]},
    "gait that is none": {
        "topic": PREVIEW,
        "changes": [("requested", ESCAPE + "x" * 1000)],
    },
    "preview of NaN": {
        "topic": PREVIEW,
        "changes": [("dt", math.nan), ("tendon_angle", math.nan)],
    },
    "dt of zero": {"topic": PREVIEW, "changes": [("dt", 0.0)]},
    "no quaternion": {
        "topic": TRUTH,
        "changes": [("pose.pose.orientation.w", 9.0)],
    },
    "odometry of NaN": {
        "topic": "/odom",
        "changes": [("pose.pose.position.x", math.nan)],
    },
    "joints of NaN": {
        "topic": "/joint_states",
        "changes": [("position", math.nan)],
    },
    "no joints": {
        "topic": "/joint_states",
        "changes": [("position", np.empty(0))],
    },
    "other joints": {
        "topic": "/joint_states",
        "changes": [("name", [ESCAPE] * 4)],
    },
    "records of no sensor": {
        "topic": "/stage_record",
        "changes": [("taken", np.full(1, 9, np.uint8))],
    },
    "equal stamps": {"topic": "/odom", "changes": [("header.stamp.sec", 1)]},
}
"""Arguments of `write_part` that make a bag of each kind."""


@pytest.mark.parametrize("kind", BAGS)
def test_a_hostile_bag_is_read_or_refused(tmp_path, kind):
    """By everything that reads bags."""
    write_part(tmp_path / "walk", **BAGS[kind])
    for read in READERS:
        with refusable():
            read(tmp_path / "walk")

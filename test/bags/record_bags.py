"""Records the bags of this directory in lockstep, and compares their figures with those before.

A bag is recorded by the graph as a user runs it, then thinned to what a replay and the figures
need, and cut off at its duration; test_replay.py limits its size.
"""

import argparse
import dataclasses
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from geometry_msgs.msg import TwistStamped
from real_graph import changed_config

from slot_bringup import run
from slot_bringup.arguments import parse
from slot_bringup.graph import read_graph
from slot_bringup.monitor import RunError, listener
from slot_core.clock import SECOND
from slot_core.messages import decode
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.origin import CONFIGURATION, Origin
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags.bag import Bag
from slot_lab.bags.replayed_stages import RECORDS
from slot_lab.bags.topics import ESTIMATE, OUTPUTS, SENSORS
from slot_lab.report import compare
from slot_msgs.msg import MpcState
from slot_nodes import qos

BAGS = Path(__file__).parent
INPUTS = (*SENSORS, RECORDS)  # of a replay
LATER = (
    2 * SECOND // 5
)  # ns, until which the last states are recorded as replayable
LEFT_OUT = ("/tf", "/force_map/status", "/diagnostics", "/ground_truth/legs")


BROKEN = """
like: flat
faults:
  fl: {kind: tendon_broken, leg: FL, time: 1.0, duration: 0.0, value: 0.0}
"""
LOST = """
like: flat
sensors.odometry.dropouts:
  lost: {time: 0.8, duration: 0.7}
"""


@dataclass(frozen=True)
class Case:
    """A bag to record: options of scripts/run, and what else happens."""

    duration: float  # s, by the stamps of the states
    options: tuple[str, ...] = ()
    scene: str = ""  # content of a scene file of its own
    # m/s, rad/s on /cmd_vel while it walks
    velocity: tuple[float, float] | None = None
    keeps: tuple[str, ...] = ()  # of LEFT_OUT
    lacks: tuple[str, ...] = ()  # besides LEFT_OUT


CASES = {
    "walk": Case(1.45, keeps=("/ground_truth/legs", "/tf")),
    "turn": Case(  # with a stride that is whole, after the blend
        2.5,
        velocity=(0.0, 0.11),
        lacks=("/ground_truth/odom", "/servo_health"),
    ),
    "path": Case(1.82, ("--path", str(BAGS / "path.csv"))),
    "fault": Case(2.08, scene=BROKEN),
    "lost_odometry": Case(2.08, scene=LOST),
}


def record(name: str, case: Case, scratch: Path) -> Path:
    """Run the graph for a case and return its bag, thinned; a fault may end the run early."""
    config = changed_config(scratch, {})
    options = [
        "--lockstep",
        "--seed",
        "1",
        "--duration",
        str(case.duration),
        *case.options,
    ]
    if case.scene:
        (config / "scene" / f"{name}.yaml").write_text(case.scene)
        options += ["--scene", name]
    os.environ["SLOT_CONFIG"] = str(config)
    graph, recorded = read_graph(), scratch / "recorded"
    with commanded(case.velocity):
        try:
            run.run(
                parse([*options, "--bag", str(recorded)]), graph, recorded, []
            )
        except RunError as error:
            print(f"{name}: {error}", file=sys.stderr)
    return thinned(Bag(recorded), scratch / name, case)


@contextmanager
def commanded(velocity: tuple[float, float] | None) -> Iterator[None]:
    """Publish a velocity, if there is one, at every state, as a user's joystick would."""
    if velocity is None:
        yield
        return
    ended = threading.Event()

    def publish() -> None:
        with listener("joystick") as (node, executor):
            topic = node.create_publisher(TwistStamped, "cmd_vel", qos.SENSOR)
            message = TwistStamped()  # its stamp, zero, means now
            message.twist.linear.x, message.twist.angular.z = velocity
            node.create_subscription(
                MpcState, "mpc_state", lambda _: topic.publish(message), 50
            )
            while not ended.is_set():
                executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=publish, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def thinned(bag: Bag, path: Path, case: Case) -> Path:
    """Copy of a bag up to its duration, without LEFT_OUT and the configuration's files."""
    _, first = next(iter(bag.messages(ESTIMATE)))
    end = decode.stamp(first) + case.duration * SECOND

    # of one process, messages are not in the order of their stamps
    kept = {
        topic: {
            time
            for time, message in bag.messages(topic)
            if decode.stamp(message) <= end + LATER * (topic in INPUTS)
        }
        for topic in (*OUTPUTS, *INPUTS)
    }
    last = max(kept[ESTIMATE])
    files = {
        name: data
        for name, data in bag.origin.files.items()
        if name != CONFIGURATION
    }
    settings = dataclasses.replace(read_record_settings(), split=0.0)
    left_out = {*LEFT_OUT, *case.lacks} - {*case.keeps}
    with BagWriter(path, settings, Origin(bag.origin.about, files)) as out:
        for topic, time, data in bag.raw():
            is_kept = time in kept[topic] if topic in kept else time <= last
            if is_kept and topic not in left_out:
                out.write(topic, bag.topics[topic], time, data)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="test/bags/record", description=__doc__
    )
    parser.add_argument(
        "names",
        nargs="*",
        choices=[*CASES, []],
        metavar="NAME",
        help=", ".join(CASES),
    )
    for name in parser.parse_args().names or CASES:
        with tempfile.TemporaryDirectory() as scratch:
            bag = record(name, CASES[name], Path(scratch))
            if CASES[name].velocity and "/cmd_vel" not in Bag(bag).topics:
                sys.exit(
                    f"{name}: the graph did not hear /cmd_vel: record it again"
                )
            if (BAGS / name).exists():
                compare.main([str(BAGS / name), str(bag), "--warm-up", "0"])
                shutil.rmtree(BAGS / name)
            shutil.copytree(bag, BAGS / name)


if __name__ == "__main__":
    main()

"""Bags of synthetic walks whose metrics are known in closed form; without ROS and simulator."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.recording.bag_writer import (
    BagWriter,
    MessageType,
    message_types,
    types_inside,
)
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import TENDON_JOINTS, read_robot

MESSAGES = Path(__file__).parents[1] / "slot_msgs" / "msg"
TYPES = message_types()
ROBOT = read_robot()
TOPICS = {
    name: topic.type for name, topic in read_record_settings().topics.items()
}
RATE = 30  # Hz, odometry
TRUTH_RATE = 120  # Hz, a multiple of RATE: both have a sample at every odometry
WALL = 1_700_000_000_000_000_000  # ns, wall clock when the walk starts
NODES = 22
STRIDE = 0.72  # s
TORSO_HEIGHT = 0.06  # m


def blank(typename: str) -> Any:
    """A message with every field zero, empty or false."""
    fields = {name: _zero(*kind) for name, kind in TYPES.fielddefs[typename][1]}
    return TYPES.types[typename](**fields)


def _zero(node: Nodetype, inner: Any) -> Any:
    if node == Nodetype.NAME:
        return blank(inner)
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(inner[0], 0)
    (kind, name), length = inner
    if kind == Nodetype.BASE and name[0] != "string":
        return np.zeros(length, name[0])
    return [_zero(kind, name) for _ in range(length)]


def message(topic: str, stamp: float, **fields: Any) -> Any:
    """A message of a topic at graph time `stamp` (s); `a__b=value` sets the field a.b."""
    built = blank(TOPICS[topic])
    built.header.stamp.sec, built.header.stamp.nanosec = divmod(
        round(stamp * 1e9), 1_000_000_000
    )
    for path, value in fields.items():
        *parents, last = path.split("__")
        node = built
        for parent in parents:
            node = getattr(node, parent)
        setattr(node, last, _fill(getattr(node, last), value))
    return built


def _fill(old: Any, value: Any) -> Any:
    """`value` in the type of the field's old value; numbers fill a message's fields in order."""
    if hasattr(old, "__dataclass_fields__"):
        names = list(old.__dataclass_fields__)
        return type(old)(**dict(zip(names, (float(v) for v in value))))
    if (
        isinstance(old, list)
        and old
        and hasattr(old[0], "__dataclass_fields__")
    ):
        return [_fill(old[0], row) for row in value]
    return (
        np.asarray(value, old.dtype).ravel()
        if isinstance(old, np.ndarray)
        else value
    )


def encode(topic: str, built: Any) -> bytes:
    """CDR bytes of a message."""
    return bytes(TYPES.serialize_cdr(built, TOPICS[topic]))


@dataclass(frozen=True)
class Walk:
    """A straight walk, or with a yaw rate a circular one, with a swinging torso."""

    duration: float = 4.0  # s
    speed: float = 0.05  # m/s
    # rad, direction of the motion to the left of the heading
    course: float = 0.0
    yaw_rate: float = 0.0  # rad/s; yaw starts at zero
    roll: float = 0.0  # rad, amplitude of roll = A sin(2 pi t / STRIDE)
    bounce: float = 0.0  # m, amplitude of the height
    latencies: tuple[float, ...] = (0.002, 0.001, 0.006, 0.001)  # s per stage
    real_time_factor: float = 1.0
    unanswered: tuple[int, ...] = ()  # ticks without a command
    lost: tuple[
        int, ...
    ] = ()  # ticks without odometry, and so without any other message
    late: tuple[int, ...] = ()  # ticks whose MPC takes a control period longer
    fallback: tuple[int, ...] = ()  # ticks whose MPC found no solution
    rejected: tuple[
        int, ...
    ] = ()  # ticks whose odometry the estimator rejected
    truth: bool = True  # ground truth is recorded
    voltage: float = 11.1  # V, as the servos report it; NaN: not
    start: float = 100.0  # s, graph time of the first tick

    def position(self, t: float) -> Array:
        """(3,) m at time t after the start."""
        turned = self.yaw_rate * t
        # of an arc with that turn
        chord = self.speed * t * np.sinc(turned / (2 * np.pi))
        direction = self.course + turned / 2
        height = TORSO_HEIGHT + self.bounce * np.sin(2 * np.pi * t / STRIDE)
        return np.array(
            [chord * np.cos(direction), chord * np.sin(direction), height]
        )

    def rpy(self, t: float) -> Array:
        """(3,) rad."""
        return np.array(
            [self.roll * np.sin(2 * np.pi * t / STRIDE), 0.0, self.yaw_rate * t]
        )

    def velocity(self, t: float) -> Array:
        """(3,) m/s in odom."""
        rate = 2 * np.pi / STRIDE
        lift = self.bounce * rate * np.cos(rate * t)
        course = self.course + self.yaw_rate * t
        return np.array(
            [self.speed * np.cos(course), self.speed * np.sin(course), lift]
        )


def write_walk(path: Path, walk: Walk) -> Path:
    entries = [*_ticks(walk)]
    if walk.truth:
        entries += _truth(walk)
    return write_messages(path, sorted(entries, key=lambda entry: entry[0]))


def write_messages(path: Path, entries: Iterable[tuple[int, str, Any]]) -> Path:
    """Write a bag of messages, each after its time (ns) and topic."""
    with BagWriter(path, read_record_settings()) as bag:
        for time, topic, built in entries:
            bag.write(topic, TOPICS[topic], time, encode(topic, built))
    return path


def _wall(walk: Walk, t: float, latency: float = 0.0) -> int:
    return WALL + round((t / walk.real_time_factor + latency) * 1e9)


def _ticks(walk: Walk) -> list[tuple[int, str, Any]]:
    entries = []
    for tick in range(round(walk.duration * RATE) + 1):
        if tick in walk.lost:
            continue
        t = tick / RATE
        latency = np.cumsum(walk.latencies) + (
            1 / RATE if tick in walk.late else 0.0
        ) * np.array([0, 0, 1, 1])
        names = [
            "/mpc_state",
            "/gait_preview",
            "/tendon_plan",
            "/desired_joint_angles",
        ]
        for name, delay, built in zip(names, latency, _chain(walk, tick, t)):
            if not (
                tick in walk.unanswered and name == "/desired_joint_angles"
            ):
                entries.append((_wall(walk, t, delay), name, built))
        entries.append((_wall(walk, t), "/odom", _odometry(walk, "/odom", t)))
        stamp, saturated = walk.start + t, angles(t) >= np.radians(100.0)
        for name, delay, fields in (
            ("/force_map/status", latency[-1], {"saturated": saturated}),
            ("/robot_state", 0.0, {"action": 3}),
            (
                "/servo_health",
                0.0,
                {"action": 3, "voltage": [walk.voltage] * 4},
            ),
            ("/stage_record", 0.0, {}),
        ):
            entries.append(
                (_wall(walk, t, delay), name, message(name, stamp, **fields))
            )
    return entries


def _odometry(walk: Walk, topic: str, t: float) -> Any:
    rotation = Rotation.from_euler("xyz", walk.rpy(t))
    return message(
        topic,
        walk.start + t,
        pose__pose__position=walk.position(t),
        pose__pose__orientation=rotation.as_quat(),
        twist__twist__linear=rotation.inv().apply(walk.velocity(t)),
    )


def _chain(walk: Walk, tick: int, t: float) -> list[Any]:
    stamp = walk.start + t
    force = np.column_stack([np.zeros((4, 2)), normal_forces(t)])
    return [
        message(
            "/mpc_state",
            stamp,
            rpy=walk.rpy(t),
            position=walk.position(t),
            linear_velocity=walk.velocity(t),
            validity=2 if tick in walk.rejected else 0,
        ),
        message(
            "/gait_preview",
            stamp,
            gait="walk",
            period=STRIDE,
            phase=(t / STRIDE) % 1.0,
            velocity=[0.05, 0.0, 0.0],
        ),
        message(
            "/tendon_plan",
            stamp,
            stages=1,
            force=force,
            status=1 if tick in walk.fallback else 0,
            fallback_cycles=int(tick in walk.fallback),
            violation=1e-6 * (tick + 1),
            slack_normal_min=force[:, 2],
            slack_normal_max=6.0 - force[:, 2],
            slack_friction=0.4 * force[:, 2] - 0.5,
        ),
        message(
            "/desired_joint_angles",
            stamp,
            name=list(TENDON_JOINTS),
            position=angles(t),
        ),
    ]


def swing(t: float) -> Array:
    """(4,) a sine per leg, each at another phase."""
    return np.sin(
        2 * np.pi * t / STRIDE + np.pi * np.array([0.0, 1.0, 0.5, -0.5])
    )


def angles(t: float) -> Array:
    """(4,) rad, plausible tendon angles."""
    return np.radians(65.0 + 38.0 * swing(t))


def normal_forces(t: float) -> Array:
    """(4,) N, plausible normal forces whose sum is the weight."""
    return ROBOT.weight / 4 * (1 + 0.5 * swing(t))


def _truth(walk: Walk) -> list[tuple[int, str, Any]]:
    entries = []
    for k in range(round(walk.duration * TRUTH_RATE) + 1):
        t = k / TRUTH_RATE
        wall = _wall(walk, t)
        entries.append(
            (
                wall,
                "/ground_truth/odom",
                _odometry(walk, "/ground_truth/odom", t),
            )
        )
        joints = message(  # in the reverse order of the legs: a driver may publish any order
            "/joint_states",
            walk.start + t,
            name=list(TENDON_JOINTS[::-1]),
            position=(0.97 * angles(t - 0.04))[::-1],
            velocity=np.zeros(4),
            effort=np.array([0.5, 2.0 if t >= 2.0 else 0.5, 0.5, 0.5]),
        )
        entries.append((wall, "/joint_states", joints))
        if k % 4 == 0:
            legs = message(
                "/ground_truth/legs",
                walk.start + t,
                tension=50 * angles(t),
                ground_force=np.column_stack(
                    [
                        0.1 * normal_forces(t),
                        np.zeros(4),
                        1.05 * normal_forces(t - 0.03),
                    ]
                ),
                nodes=NODES,
                position=leg_nodes(walk, t),
            )
            entries.append((wall, "/ground_truth/legs", legs))
    return entries


def leg_nodes(walk: Walk, t: float) -> Array:
    """(4, NODES, 3) m: arcs from the clamps to the feet, which lift off the ground in turn."""
    rotation = Rotation.from_euler("xyz", walk.rpy(t))
    clamps = walk.position(t) + rotation.apply(ROBOT.clamps)
    feet = walk.position(t) + ROBOT.clamps + 0.145 * ROBOT.outward
    feet[:, 2] = 0.018 * np.clip(
        np.sin(2 * np.pi * t / STRIDE + np.arange(4) * np.pi / 2), 0, 1
    )
    s = np.linspace(0.0, 1.0, NODES)[None, :, None]
    nodes = clamps[:, None] * (1 - s) + feet[:, None] * s
    nodes[..., 2] += 0.035 * np.sin(np.pi * s[..., 0]) ** 1.5
    return nodes


def write_old(path: Path, topic: str, now: Any, field: str = "") -> Path:
    """Write a bag of one message, whose type ends before a field (default: the last)."""
    kind = TOPICS[topic]
    names = [name for name, _ in TYPES.fielddefs[kind][1]]
    field = field or names[-1]
    known = names[: names.index(field)]
    text = (MESSAGES / f"{Path(kind).name}.msg").read_text()
    definition = text[: text.rindex("\n", 0, text.index(f" {field} "))] + "\n"
    types = types_inside(((kind, definition),))
    old = types.types[kind](*(getattr(now, name) for name in known))
    with BagWriter(path, read_record_settings()) as bag:
        bag.add_topic(topic, MessageType(kind, definition))
        bag.write(topic, kind, WALL, bytes(types.serialize_cdr(old, kind)))
    return path

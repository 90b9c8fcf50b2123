"""Bags of synthetic walks whose metrics are known in closed form; without simulator."""

import functools
import operator
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation

from slot_core.recording.bag_writer import (
    BagWriter,
    MessageType,
    types_inside,
)
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import TENDON_JOINTS, read_robot
from slot_nodes.messages import header, message_class

MESSAGES = Path(__file__).parents[1] / "slot_msgs" / "msg"
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


def message(topic, stamp, **fields):
    """A message of a topic at graph time `stamp` (s); `a__b=value` sets the field a.b."""
    built = message_class(TOPICS[topic])(header=header(round(stamp * 1e9), ""))
    for path, value in fields.items():
        *parents, last = path.split("__")
        owner = functools.reduce(getattr, parents, built)
        setattr(owner, last, _filled(getattr(owner, last), value))
    return built


def _filled(old, value):
    """`value` in the type of a field's old one; numbers fill a message's fields in order."""
    if hasattr(old, "get_fields_and_field_types"):
        names = old.get_fields_and_field_types()
        return type(old)(**dict(zip(names, map(float, value))))
    if isinstance(old, list) and hasattr(next(iter(old), 0), "SLOT_TYPES"):
        return [_filled(old[0], row) for row in value]
    if isinstance(old, (array, list, np.ndarray)):
        return np.ravel(value).tolist()
    return value


@dataclass(frozen=True)
class Walk:
    """A straight walk, or with a yaw rate a circular one, with a swinging torso."""

    duration: float = 4.0  # s
    speed: float = 0.05  # m/s
    course: float = 0.0  # rad, of the motion to the left of the heading
    yaw_rate: float = 0.0  # rad/s; yaw starts at zero
    roll: float = 0.0  # rad, amplitude of roll = A sin(2 pi t / STRIDE)
    bounce: float = 0.0  # m, amplitude of the height
    latencies: tuple = (0.002, 0.001, 0.006, 0.001)  # s per stage
    real_time_factor: float = 1.0
    unanswered: tuple = ()  # ticks without a command
    lost: tuple = ()  # ticks without odometry, and so without any message
    late: tuple = ()  # ticks whose MPC takes a control period longer
    fallback: tuple = ()  # ticks whose MPC found no solution
    rejected: tuple = ()  # ticks whose odometry the estimator rejected
    truth: bool = True  # ground truth is recorded
    voltage: float = 11.1  # V, as the servos report it; NaN: not
    start: float = 100.0  # s, graph time of the first tick

    def position(self, t):
        """(3,) m at time t after the start."""
        turned = self.yaw_rate * t
        # of an arc with that turn
        chord = self.speed * t * np.sinc(turned / (2 * np.pi))
        direction = self.course + turned / 2
        height = TORSO_HEIGHT + self.bounce * np.sin(2 * np.pi * t / STRIDE)
        return np.array(
            [chord * np.cos(direction), chord * np.sin(direction), height]
        )

    def rpy(self, t):
        """(3,) rad."""
        return np.array(
            [self.roll * np.sin(2 * np.pi * t / STRIDE), 0.0, self.yaw_rate * t]
        )

    def velocity(self, t):
        """(3,) m/s in odom."""
        rate = 2 * np.pi / STRIDE
        lift = self.bounce * rate * np.cos(rate * t)
        course = self.course + self.yaw_rate * t
        return np.array(
            [self.speed * np.cos(course), self.speed * np.sin(course), lift]
        )


def write_walk(path, walk):
    """Write the bag of a walk."""
    entries = [
        (WALL + round(1e9 * (t / walk.real_time_factor + delay)), topic, built)
        for t, delay, topic, built in (*_ticks(walk), *_truth(walk))
    ]
    return write_messages(path, sorted(entries, key=operator.itemgetter(0)))


def write_messages(path, entries):
    """Write a bag of messages, each after its time (ns) and topic."""
    with BagWriter(path, read_record_settings()) as bag:
        for time, topic, built in entries:
            bag.write(topic, TOPICS[topic], time, serialize_message(built))
    return path


def _ticks(walk):
    """Messages of every tick, each after its time, its delay (s) and its topic."""
    for tick in range(round(walk.duration * RATE) + 1):
        if tick in walk.lost:
            continue
        t = tick / RATE
        delays = np.cumsum(walk.latencies)
        if tick in walk.late:
            delays[2:] += 1 / RATE
        for topic, fields in _fields(walk, tick, t).items():
            if tick in walk.unanswered and topic == "/desired_joint_angles":
                continue
            delay = delays[STAGES[topic]] if topic in STAGES else 0.0
            yield t, delay, topic, message(topic, walk.start + t, **fields)


STAGES = {  # whose latency has passed when a topic is published
    "/mpc_state": 0,
    "/gait_preview": 1,
    "/tendon_plan": 2,
    "/desired_joint_angles": 3,
    "/force_map/status": 3,
}


def _fields(walk, tick, t):
    """Fields of the messages of a tick by topic."""
    normal, fails = normal_forces(t), tick in walk.fallback
    return {
        "/odom": _odometry(walk, t),
        "/mpc_state": {
            "rpy": walk.rpy(t),
            "position": walk.position(t),
            "linear_velocity": walk.velocity(t),
            "validity": 2 if tick in walk.rejected else 0,
        },
        "/gait_preview": {
            "gait": "walk",
            "period": STRIDE,
            "phase": (t / STRIDE) % 1.0,
            "velocity": [0.05, 0.0, 0.0],
        },
        "/tendon_plan": {
            "stages": 1,
            "force": np.column_stack([np.zeros((4, 2)), normal]),
            "status": int(fails),
            "fallback_cycles": int(fails),
            "violation": 1e-6 * (tick + 1),
            "slack_normal_min": normal,
            "slack_normal_max": 6.0 - normal,
            "slack_friction": 0.4 * normal - 0.5,
        },
        "/desired_joint_angles": {
            "name": TENDON_JOINTS,
            "position": angles(t),
        },
        "/force_map/status": {"saturated": angles(t) >= np.radians(100.0)},
        "/robot_state": {"action": 3},
        "/servo_health": {"action": 3, "voltage": [walk.voltage] * 4},
        "/stage_record": {},
    }


def _odometry(walk, t):
    rotation = Rotation.from_euler("xyz", walk.rpy(t))
    return {
        "pose__pose__position": walk.position(t),
        "pose__pose__orientation": rotation.as_quat(),
        "twist__twist__linear": rotation.inv().apply(walk.velocity(t)),
    }


def swing(t):
    """(4,) a sine per leg, each at another phase."""
    return np.sin(
        2 * np.pi * t / STRIDE + np.pi * np.array([0.0, 1.0, 0.5, -0.5])
    )


def angles(t):
    """(4,) rad, plausible tendon angles."""
    return np.radians(65.0 + 38.0 * swing(t))


def normal_forces(t):
    """(4,) N, plausible normal forces whose sum is the weight."""
    return ROBOT.weight / 4 * (1 + 0.5 * swing(t))


def _truth(walk):
    """Messages of the simulated robot, as those of `_ticks`."""
    for k in range(round(walk.duration * TRUTH_RATE) + 1 if walk.truth else 0):
        t = k / TRUTH_RATE
        force = np.column_stack(
            [
                0.1 * normal_forces(t),
                np.zeros(4),
                1.05 * normal_forces(t - 0.03),
            ]
        )
        fields = {
            "/ground_truth/odom": _odometry(walk, t),
            "/joint_states": {  # in the reverse order of the legs: a driver may publish any order
                "name": TENDON_JOINTS[::-1],
                "position": (0.97 * angles(t - 0.04))[::-1],
                "velocity": np.zeros(4),
                "effort": np.array([0.5, 2.0 if t >= 2.0 else 0.5, 0.5, 0.5]),
            },
            "/ground_truth/legs": {
                "tension": 50 * angles(t),
                "ground_force": force,
                "nodes": NODES,
                "position": leg_nodes(walk, t),
            },
        }
        for topic, values in fields.items():
            if k % 4 == 0 or topic != "/ground_truth/legs":
                yield t, 0.0, topic, message(topic, walk.start + t, **values)


def leg_nodes(walk, t):
    """(4, NODES, 3) m: straight from the clamps to the floor."""
    turn = Rotation.from_euler("xyz", walk.rpy(t))
    clamps = walk.position(t) + turn.apply(ROBOT.clamps)
    feet = clamps + 0.145 * ROBOT.outward
    feet[:, 2] = 0.0
    return np.linspace(clamps, feet, NODES, axis=1)


def write_old(path, topic, now):
    """Write a bag of one message, of a type that ends before its last field."""
    kind = TOPICS[topic]
    *known, last = now.get_fields_and_field_types()
    text = (MESSAGES / f"{Path(kind).name}.msg").read_text()
    definition = text[: text.rindex("\n", 0, text.index(f" {last} "))] + "\n"
    types = types_inside(((kind, definition),))
    values = (getattr(now, name) for name in known)
    old = types.types[kind](
        *(np.array(v) if isinstance(v, array) else v for v in values)
    )
    with BagWriter(path, read_record_settings()) as bag:
        bag.add_topic(topic, MessageType(kind, definition))
        bag.write(topic, kind, WALL, bytes(types.serialize_cdr(old, kind)))
    return path

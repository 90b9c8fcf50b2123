"""The controller's stages in a bag, and the same stages on the recorded inputs, without ROS."""

import json
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

from slot_core import config
from slot_core.clock import to_seconds
from slot_core.control.effort import Effort
from slot_core.control.force_map import (
    ForceMap,
    make_force_map,
    read_force_map,
    read_springs,
)
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.control.policy import (
    Status,
    TendonPlan,
    TunedPolicy,
    is_late,
    policy_class,
)
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.state_estimator import (
    BEFORE_ALL_TIMES,
    StateEstimator,
    read_estimator,
)
from slot_core.estimation.unaided_estimator import make_estimator
from slot_core.gait.gait import GaitPreview, read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.gait.route import KEPT, Route, read_route
from slot_core.key_frame import restore
from slot_core.messages import decode
from slot_core.names import ONNX
from slot_core.recording.origin import FILES, NETWORK
from slot_core.recording.record_settings import root_of
from slot_core.robot import read_robot
from slot_core.ros_parameters import of_node, parse_parameters
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.topics import OUTPUTS, PLANS, SENSORS

RECORDS, NODES = "/stage_record", "/recorded_nodes"
PATH, PARAMETERS = FILES["path"], FILES["params_file"]
T = TypeVar("T")
PREVIEW = (
    "phase",
    "period",
    "dt",
    "contact",
    "friction",
    "normal_force",
    "tendon_angle",
    "reference",
    "velocity_ahead",
    "corrected",
)
READERS = dict(
    zip(SENSORS, (decode.torso_odometry, decode.imu, decode.joint_loads))
)
TAKERS = dict(zip(SENSORS, ("add_odometry", "add_imu", "add_joints")))
PLAN = ("angle", "rate", "force", "pose", "status", "fallback_cycles")
Fields = dict[str, Any]
"""Values by the name of the message's field."""


class RecordedStages:
    """The stages in a bag, read once."""

    def __init__(self, bag: Bag, own_policy: str = "") -> None:
        """own_policy: file of the policy, needed if the bag's policy is a file of Python."""
        self.own_policy, self._scratch = own_policy, TemporaryDirectory()
        self.bag, self.origin, self.robot = bag, bag.origin, read_robot()
        # messages in their order, by topic and stamp (ns)
        self.sensors: defaultdict[tuple[str, int], list[Any]] = defaultdict(
            list
        )
        self.messages: dict[str, list[Any]] = {topic: [] for topic in OUTPUTS}
        self.records: dict[str, list[Any]] = {
            node: [] for node in OUTPUTS.values()
        }
        self.taken: set[str] = set()  # sensors, by the records
        self.nodes: dict[
            str, list[str]
        ] = {}  # that published a topic, as far as it is known
        self._entries: list[
            tuple[str, Any]
        ] = []  # node and record, or topic and stamp (ns)
        topics = [
            t for t in (*SENSORS, *OUTPUTS, RECORDS, NODES) if bag.counts.get(t)
        ]
        for topic, _, message in bag.merged(*topics) if topics else ():
            with bag.using(topic):
                self._add(topic, message)

    def _add(self, topic: str, message: Any) -> None:
        if topic == NODES:
            self.nodes = {
                str(t): list(map(str, n))
                for t, n in json.loads(message.data).items()
            }
        elif topic == RECORDS:
            if message.node in self.records:
                self.records[message.node].append(message)
                self.taken.update(SENSORS[kind] for kind in message.taken)
                self._entries.append((message.node, message))
        elif topic in OUTPUTS:
            self.messages[topic].append(message)
            self._entries.append((topic, decode.stamp(message)))
        else:
            self.sensors[topic, decode.stamp(message)].append(message)

    def outputs(self, topic: str) -> Iterator[Any]:
        """Records of a stage, and stamps (ns) of its outputs, in their order."""
        names = topic, OUTPUTS[topic]
        return (entry for name, entry in self._entries if name in names)

    def own_nodes(self, topic: str) -> list[str]:
        """Nodes that published a stage's output in place of ours."""
        nodes = self.nodes.get(topic, [])
        names = [name.rpartition("/")[2] for name in nodes]
        return [] if OUTPUTS[topic] in names else nodes

    @cached_property
    def estimates(self) -> dict[int, Estimate]:
        """Estimated states by stamp."""
        return self._by_stamp("/mpc_state", decode.estimate)

    @cached_property
    def begins_mid_run(self) -> bool:
        """Whether the states before the first one are not in the bag.

        An estimator's states are initialising for `gate.initial_time`. Of a bag without a valid one
        it is not known: it counts as begun. Of a bag with records of the stages these tell.
        """
        if any(self.records.values()):
            return False
        settings = read_estimator()
        valid = [
            stamp
            for stamp, estimate in self.estimates.items()
            if estimate.validity is Validity.VALID
        ]
        initial = to_seconds(min(valid) - min(self.estimates)) if valid else inf
        return initial < settings.gate.initial_time - settings.timing.period

    @cached_property
    def previews(self) -> dict[int, GaitPreview]:
        """Gait previews by stamp."""
        return self._by_stamp("/gait_preview", decode.preview)

    @cached_property
    def plans(self) -> dict[int, TendonPlan]:
        """Plans by stamp."""
        return self._by_stamp(PLANS, lambda message: decode.plan(message)[1])

    @cached_property
    def changes(self) -> dict[int, dict[str, Any]]:
        """Settings of the policy that were changed while it ran, by stamps of the plans."""
        return self._by_stamp(
            PLANS, lambda m: json.loads(getattr(m, "settings", "") or "{}")
        )

    def _by_stamp(
        self, topic: str, convert: Callable[[Any], Any]
    ) -> dict[int, Any]:
        with self.bag.using(topic):
            return {decode.stamp(m): convert(m) for m in self.messages[topic]}

    @cached_property
    def policy(self) -> str:
        """Name of the policy, or file of a user's policy; the default if none is named.

        A network is taken from the bag. Raises BagError for a policy of Python whose file is not
        given: a replay executes no code of a bag.
        """
        named = self.origin.about.get("policy", DEFAULT_POLICY)
        if NETWORK in self.origin.files and not self.own_policy:
            file = Path(self._scratch.name, NETWORK)
            file.write_bytes(self.origin.files[NETWORK])
            return f"{ONNX}{file}"
        if named.endswith(".py") and not self.own_policy:
            raise BagError(
                f"{self.bag.path}: its policy is a file, {named}: add --policy FILE"
            )
        return self.own_policy or named

    def settings(self, node: str, settings: T) -> T:
        """Settings of a node, as the parameter file in the bag has changed them.

        Raises ConfigError for a value that does not fit them.
        """
        if PARAMETERS not in self.origin.files:
            return settings
        found = parse_parameters(
            self.origin.files[PARAMETERS].decode(), PARAMETERS
        )
        given = of_node(
            found, f"{root_of(self.origin.about.get('namespace', ''))}/{node}"
        )
        known = {name for name, _, _ in config.leaves(settings)} & given.keys()
        return config.replace(
            settings, {name: given[name] for name in known}, node
        )

    @property
    def path(self) -> Route | None:
        """The path that was followed, at the speed of the recorded commands; None without one."""
        if PATH not in self.origin.files:
            return None
        with TemporaryDirectory() as scratch:
            file = Path(scratch, PATH)
            file.write_bytes(self.origin.files[PATH])
            return read_route(file, self.origin.about.get("path_heading", KEPT))

    @property
    def lost_path(self) -> str:
        """Path that was followed but is not in the bag, as of `ros2 bag record`; else ""."""
        return (
            ""
            if PATH in self.origin.files
            else self.origin.about.get("path", "")
        )


@dataclass
class Replayed:
    """Output of a replayed stage, and the recorded outputs that cannot be compared with it."""

    fields: dict[int, Fields] = field(default_factory=dict)  # by stamp, ns
    # stamps, ns, of a state that is not known
    unknown: set[int] = field(default_factory=set)
    # an input that the bag does not hold, though the stage has taken it
    lost: str = ""


def estimates(recorded: RecordedStages) -> Replayed:
    """State estimates, as fields of MpcState, from the recorded sensors.

    The readings are taken in the order of the node's records, those that it refuses left out. The
    estimator starts as its node does, or at a key frame. Where a record or a reading is missing,
    the estimates are unknown up to the next key frame.
    """
    settings = recorded.settings("state_estimator", read_estimator())
    if source := recorded.origin.about.get("odometry"):
        settings = config.replace(settings, {"odometry.source": source})
    found = Replayed()
    readings = {key: deque(rest) for key, rest in recorded.sensors.items()}
    make = partial(make_estimator, settings, recorded.robot, read_springs())
    estimator: StateEstimator | None = None
    known: list[tuple[int, int]] = []  # stamps of the outputs: after, up to
    expected, before = -1, BEFORE_ALL_TIMES
    for record in recorded.records["state_estimator"]:
        if record.number == 0:
            estimator, expected = make(), 1
            continue
        if record.number != expected:
            estimator = None
        expected = record.number + 1
        for kind, stamp in zip(record.taken, record.stamp):
            if (
                not _take_next(
                    estimator,
                    SENSORS[kind],
                    readings.get((SENSORS[kind], int(stamp)), deque()),
                )
                and estimator is not None
            ):
                estimator = None
                lost = f"{SENSORS[kind]} at {to_seconds(int(stamp)):.6f} s is not in the bag"
                found.lost = (found.lost or lost) if known else ""
            if estimator is not None:
                found.fields.update(_polled(estimator))
        if estimator is not None:
            known.append((before, decode.stamp(record)))
        elif record.state:
            estimator = make()
            restore(estimator, record.state)
        before = decode.stamp(record)
    found.unknown = {
        stamp
        for stamp in recorded.estimates
        if not any(a < stamp <= b for a, b in known)
    }
    return found


def _take_next(
    estimator: StateEstimator | None, topic: str, waiting: deque[Any]
) -> bool:
    """Let the estimator take the first of the messages that its node does not refuse, if any."""
    while waiting:
        with suppress(ValueError):
            reading = READERS[topic](waiting.popleft())
            if estimator is not None:
                getattr(estimator, TAKERS[topic])(*reading)
            return True
    return False


def _polled(estimator: StateEstimator) -> dict[int, Fields]:
    """The estimates that are ready, by stamp."""
    fields = {}
    while (estimate := estimator.poll()) is not None:
        x = estimate.state
        fields[estimate.stamp] = {
            "rpy": x[0:3],
            "position": x[3:6],
            "angular_velocity": x[6:9],
            "linear_velocity": x[9:12],
            "covariance": estimate.covariance,
            "validity": int(estimate.validity),
            "leg_stiffness": estimate.leg_stiffness,
            "legs_are_known": estimate.legs_are_known,
            "message": list(estimate.message.encode()),
            "gravity": estimate.gravity,
        }
    return fields


def _stepped(
    recorded: RecordedStages,
    topic: str,
    make: Callable[[int], T],
    step: Callable[[T, int], Fields],
    is_independent: Callable[[int], bool] = lambda stamp: False,
) -> Replayed:
    """Outputs of a stage that gives one for each of its stamps, from its start or a key frame.

    make: the stage as at its start, for the output of a stamp (ns). step: fields of the output of
    a stamp; raises KeyError if the bag lacks an input, and outputs are unknown up to the next key
    frame. is_independent: whether an output does not depend on what came before it.
    """
    found, records = Replayed(), recorded.records[OUTPUTS[topic]]
    starts = _Starts(records, recorded.begins_mid_run)
    stage: T | None = None
    for entry in recorded.outputs(topic):
        if not isinstance(entry, int):
            if entry.number == 0:
                stage = None
            starts.add(entry)
            continue
        if stage is None and (
            starts.are_known_at(entry) or is_independent(entry)
        ):
            at, frame = starts.frame or (entry, "")
            stage = make(at)
            if frame:
                restore(stage, frame)
        starts.pass_by(entry)
        if stage is None:
            found.unknown.add(entry)
            continue
        try:
            found.fields[entry] = step(stage, entry)
        except KeyError:
            if records or not found.fields:
                stage = None
                found.unknown.add(entry)
    return found


class _Starts:
    """From where a stage can be replayed: its start, or the key frame after an output.

    A late recorder also gets records and outputs from before, but not all of them. So a key frame
    counts right after the output that it names, and the start right before the first output, which
    the first key frame names.
    """

    def __init__(self, records: list[Any], begins_mid_run: bool) -> None:
        self._second = {r.number: decode.stamp(r) for r in records}.get(1)
        # stamp (ns) and text, "": the start; now
        self.frame: tuple[int, str] | None = None
        self._waiting: tuple[int, str] | None = None  # for its output
        self._last = -1  # ns, stamp of the last output
        self._begins = not records and not begins_mid_run

    def add(self, record: Any) -> None:
        """Take a record."""
        if record.number == 0:
            self._begins, self._waiting, self.frame = True, None, None
        elif record.state:
            self._waiting = decode.stamp(record), record.state
            self._activate()

    def are_known_at(self, stamp: int) -> bool:
        """Whether the state before the output of a stamp, ns, is known: `frame`, or the start."""
        if self._begins and self._second in (None, stamp):
            self.frame = None
            return True
        return self.frame is not None

    def pass_by(self, stamp: int) -> None:
        """Take an output."""
        self._last, self._begins, self.frame = stamp, False, None
        self._activate()

    def _activate(self) -> None:
        if self._waiting is not None and self._waiting[0] == self._last:
            self.frame = self._waiting


def previews(recorded: RecordedStages) -> Replayed:
    """Gait previews, as fields of GaitPreview, from the recorded states and commands."""
    gaits = recorded.settings("gait_scheduler", read_gaits())

    def make(stamp: int) -> GaitScheduler:
        first = recorded.previews.get(
            stamp, next(iter(recorded.previews.values()))
        ).command
        return GaitScheduler(
            gaits,
            recorded.robot,
            read_springs(),
            first.gait,
            first.velocity,
            recorded.path,
        )

    def step(scheduler: GaitScheduler, stamp: int) -> Fields:
        estimate = recorded.estimates[stamp]
        scheduler.set_command(recorded.previews[stamp].command)
        preview = scheduler.step(
            estimate.time, estimate.state, estimate.leg_stiffness
        )
        return {name: getattr(preview, name) for name in PREVIEW}

    return _stepped(recorded, "/gait_preview", make, step)


def plans(recorded: RecordedStages) -> Replayed:
    """Plans of the policy, as fields of TendonPlan.

    Its steps take no time, but those that were recorded as late; its effort is the recorded one.
    """
    kind, timer = policy_class(recorded.policy), _Timer()
    settings = recorded.settings(
        "mpc_controller", kind.read_settings(recorded.policy)
    )
    last = BEFORE_ALL_TIMES

    def make(stamp: int) -> TunedPolicy:
        policy = TunedPolicy(lambda s: kind(recorded.robot, s, timer), settings)
        if recorded.changes.get(stamp):
            policy.use(recorded.changes[stamp])
        return policy

    def step(policy: TunedPolicy, stamp: int) -> Fields:
        nonlocal last
        estimate, preview = recorded.estimates[stamp], recorded.previews[stamp]
        if recorded.changes[stamp] != policy.changes:
            policy.use(recorded.changes[stamp])
        if stamp < last:
            policy.reset()
        last = stamp
        timer.is_late = is_late(recorded.plans[stamp])
        policy.use_effort(Effort.of(recorded.plans[stamp].message))
        policy.prepare()
        plan = policy.step(estimate, preview)
        return {name: getattr(plan, name) for name in PLAN} | vars(plan.report)

    return _stepped(recorded, PLANS, make, step)


class _Timer:
    """Time of a policy in a replay, s: none passes in a step, or far more than any budget."""

    def __init__(self) -> None:
        self.is_late, self._now = False, 0.0

    def __call__(self) -> float:
        self._now += 1e6 * self.is_late
        return self._now


def commands(recorded: RecordedStages) -> Replayed:
    """Tendon angles and their rates, as fields of JointState.

    Angles that are held from before the bag begins are unknown.
    """
    settings = recorded.settings("force_mapper", read_force_map())
    delay = recorded.settings(
        "state_estimator", read_estimator()
    ).timing.command_delay

    def step(force_map: ForceMap, stamp: int) -> Fields:
        plan, preview = recorded.plans[stamp], recorded.previews[stamp]
        seen = recorded.estimates[stamp]
        command = force_map.step(plan, preview, seen.state, seen.lead)
        return {"position": command.angle, "velocity": command.rate}

    def is_planned(stamp: int) -> bool:
        return (
            stamp in recorded.plans
            and recorded.plans[stamp].status is not Status.STOPPED
        )

    return _stepped(
        recorded,
        "/desired_joint_angles",
        lambda _: make_force_map(recorded.robot, settings, delay),
        step,
        is_planned,
    )


class ReplayedStage(NamedTuple):
    """A stage of the controller in a replay."""

    replay: Callable[[RecordedStages], Replayed]
    inputs: tuple[str, ...]  # besides those that its records name


STAGES = {
    "/mpc_state": ReplayedStage(estimates, ()),
    "/gait_preview": ReplayedStage(previews, ("/mpc_state",)),
    PLANS: ReplayedStage(plans, ("/mpc_state", "/gait_preview")),
    "/desired_joint_angles": ReplayedStage(
        commands, ("/mpc_state", "/gait_preview", PLANS)
    ),
}
"""By their output, in the order of the graph."""

"""Stages of the controller on the recorded inputs of their nodes, without ROS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from slot_core import config
from slot_core.clock import to_ns
from slot_core.control.force_map import make_force_map, read_force_map, read_springs
from slot_core.control.policy import DEFAULT_POLICY, Status, TendonPlan, policy_class
from slot_core.control.tuned_policy import TunedPolicy
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.state_estimator import BEFORE_ALL_TIMES, StateEstimator, read_estimator
from slot_core.gait.gait import GaitPreview, read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.gait.route import KEPT, Route, read_route
from slot_core.messages import decode
from slot_core.recording.origin import FILES, NETWORK
from slot_core.recording.record_settings import root_of
from slot_core.robot import read_robot
from slot_core.ros_parameters import of_node, parse_parameters
from slot_lab.bags.bag import Bag, BagError

ODOMETRY, PLANS = "/odom", "/tendon_plan"
SENSORS = (ODOMETRY, "/imu")
PATH, PARAMETERS = FILES["path"], FILES["params_file"]
PREVIEW = ("phase", "period", "dt", "contact", "friction", "normal_force", "tendon_angle",
           "reference", "velocity_ahead", "corrected")  # fmt: skip
PLAN = ("angle", "rate", "force", "pose", "status", "fallback_cycles")
T = TypeVar("T")
Fields = dict[str, Any]
"""Values by the name of the message's field."""


class RecordedStages:
    """What a bag holds of the stages, read once."""

    def __init__(self, bag: Bag, own_policy: str = "") -> None:
        """own_policy: file of the policy, needed if the bag's policy is a file."""
        self.own_policy = own_policy
        self.bag, self.origin, self.robot = bag, bag.origin, read_robot()
        self.sensors: list[tuple[str, Any]] = []  # topic and message
        self.messages: dict[str, list[Any]] = {topic: [] for topic in STAGES}
        topics = [t for t in (*SENSORS, *STAGES) if bag.counts.get(t)]
        for topic, _, message in bag.merged(*topics) if topics else ():
            with bag.using(topic):
                decode.stamp(message)
            if topic in STAGES:
                self.messages[topic].append(message)
            else:
                self.sensors.append((topic, message))

    @cached_property
    def estimates(self) -> dict[int, Estimate]:
        """Estimated states by stamp."""
        return self._by_stamp("/mpc_state", decode.estimate)

    @cached_property
    def begins_mid_run(self) -> bool:
        """Whether the states before the first one are not in the bag.

        Before its first valid state an estimator publishes `gate.initial_readings` - 1 states that
        are initialising. Of a bag without a valid one it is not known: it counts as begun.
        """
        found = [estimate.validity for estimate in self.estimates.values()]
        if Validity.VALID not in found:
            return False
        initial = found[: found.index(Validity.VALID)].count(Validity.INITIALISING)
        return initial < read_estimator().gate.initial_readings - 1

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
        return self._by_stamp(PLANS, lambda m: json.loads(getattr(m, "settings", "") or "{}"))

    def _by_stamp(self, topic: str, convert: Callable[[Any], Any]) -> dict[int, Any]:
        with self.bag.using(topic):
            return {decode.stamp(m): convert(m) for m in self.messages[topic]}

    def matched(self) -> Iterator[tuple[int, Estimate, GaitPreview, TendonPlan]]:
        """Estimate, preview and plan of the stamps that have all three, in the order of the states.

        A state that the recorded controller skipped has no plan.
        """
        for stamp, estimate in self.estimates.items():
            if stamp in self.previews and stamp in self.plans:
                yield stamp, estimate, self.previews[stamp], self.plans[stamp]

    @property
    def policy(self) -> str:
        """Name of the policy, or file if it is one of one's own; the default if none is named.

        Raises BagError for a policy of one's own whose file is not given.
        """
        named = self.origin.about.get("policy", DEFAULT_POLICY)
        is_file = named.endswith(".py") or NETWORK in self.origin.files
        if is_file and not self.own_policy:
            raise BagError(f"{self.bag.path}: its policy is a file, {named}: add --policy FILE")
        return self.own_policy or named

    def settings(self, node: str, settings: T) -> T:
        """Settings of a node, as the parameter file in the bag has changed them.

        Raises ConfigError for one that does not fit them.
        """
        if PARAMETERS not in self.origin.files:
            return settings
        found = parse_parameters(self.origin.files[PARAMETERS].decode(), PARAMETERS)
        given = of_node(found, f"{root_of(self.origin.about.get('namespace', ''))}/{node}")
        known = {name for name, _, _ in config.leaves(settings)} & given.keys()
        return config.replace(settings, {name: given[name] for name in known}, node)

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
        return "" if PATH in self.origin.files else self.origin.about.get("path", "")


def estimates(recorded: RecordedStages) -> dict[int, Fields]:
    """State estimates, as fields of MpcState, from the recorded odometry and IMU.

    Readings that the node refuses are left out.
    """
    settings = recorded.settings("state_estimator", read_estimator())
    estimator = StateEstimator(settings)
    delay = to_ns(settings.timing.command_delay)
    fields = {}
    for topic, message in _as_they_arrived(recorded, delay):
        with suppress(ValueError):
            if topic == ODOMETRY:
                estimator.add_odometry(*decode.torso_odometry(message))
            else:
                estimator.add_imu(*decode.imu(message))
        while (estimate := estimator.poll()) is not None:
            x = estimate.state
            fields[estimate.stamp] = {
                "rpy": x[0:3],
                "position": x[3:6],
                "angular_velocity": x[6:9],
                "linear_velocity": x[9:12],
                "covariance": estimate.covariance,
                "validity": int(estimate.validity),
            }
    return fields


def _as_they_arrived(recorded: RecordedStages, delay: int) -> Iterator[tuple[str, Any]]:
    """Sensor readings in the order in which the estimator got them, as (topic, message).

    The recorder may have received odometry and IMU in another order. A recorded state tells the
    newest IMU sample it was predicted with, at header.stamp + lead - `delay` (ns), and its odometry
    follows that sample. Other readings keep their order. Odometry before that of a first state
    that is initialising is left out: the estimator did not listen yet.
    """
    first = next(iter(recorded.estimates.values()), None)
    initial = first is not None and first.validity is Validity.INITIALISING
    begin = first.stamp if first is not None and initial else BEFORE_ALL_TIMES
    imu = {decode.stamp(message) for topic, message in recorded.sensors if topic != ODOMETRY}
    place: dict[int, int] = {}  # stamp of the odometry: stamp of the IMU sample before it
    for stamp, estimate in recorded.estimates.items():
        if estimate.validity != Validity.ODOMETRY_LOST and estimate.time - delay in imu:
            place[stamp] = estimate.time - delay
    after: dict[int, list[Any]] = {}
    for topic, message in recorded.sensors:
        if topic == ODOMETRY and decode.stamp(message) in place:
            after.setdefault(place[decode.stamp(message)], []).append(message)
    for topic, message in recorded.sensors:
        stamp = decode.stamp(message)
        if topic != ODOMETRY:
            yield topic, message
            yield from ((ODOMETRY, late) for late in after.pop(stamp, ()))
        elif stamp not in place and stamp >= begin:
            yield topic, message


def previews(recorded: RecordedStages) -> dict[int, Fields]:
    """Gait previews, as fields of GaitPreview, from the recorded states and commands."""
    gaits = recorded.settings("gait_scheduler", read_gaits())
    first = next(iter(recorded.previews.values())).command
    scheduler = GaitScheduler(
        gaits, recorded.robot, read_springs(), first.gait, first.velocity, recorded.path
    )
    fields = {}
    for stamp, estimate in recorded.estimates.items():
        if stamp in recorded.previews:
            scheduler.set_command(recorded.previews[stamp].command)
            preview = scheduler.step(estimate.time, estimate.state)
            fields[stamp] = {name: getattr(preview, name) for name in PREVIEW}
    return fields


def plans(recorded: RecordedStages) -> dict[int, Fields]:
    """Plans of the policy, as fields of TendonPlan; its steps take no time."""
    kind = policy_class(recorded.policy)
    settings = recorded.settings("mpc_controller", kind.read_settings(recorded.policy))
    policy = TunedPolicy(lambda s: kind(recorded.robot, s, lambda: 0.0), settings)
    changes, fields = recorded.changes, {}
    for stamp, estimate, preview, _ in recorded.matched():
        if changes[stamp] != policy.changes:
            policy.use(changes[stamp])
        plan = policy.step(estimate, preview)
        policy.prepare()
        fields[stamp] = {name: getattr(plan, name) for name in PLAN} | vars(plan.report)
    return fields


def commands(recorded: RecordedStages) -> dict[int, Fields]:
    """Tendon angles and their rates, as fields of JointState.

    The first angles that are held are left out of a bag that begins mid-run: they were commanded
    before.
    """
    settings = recorded.settings("force_mapper", read_force_map())
    force_map = make_force_map(recorded.robot, settings)
    fields, held = {}, recorded.begins_mid_run
    for stamp, estimate, preview, plan in recorded.matched():
        held = held and plan.status is Status.STOPPED
        if held:
            continue
        command = force_map.step(plan, preview, estimate.state)
        fields[stamp] = {"position": command.angle, "velocity": command.rate}
    return fields


STAGES: dict[str, tuple[Any, ...]] = {
    "/mpc_state": (estimates, ODOMETRY),
    "/gait_preview": (previews, "/mpc_state"),
    PLANS: (plans, "/mpc_state", "/gait_preview"),
    "/desired_joint_angles": (commands, "/mpc_state", "/gait_preview", PLANS),
}
"""By the output of each stage its function here, then its inputs; in the order of the graph."""
REMEMBERING = ("/mpc_state", "/gait_preview", PLANS)
"""Outputs of stages that depend on all that came before."""

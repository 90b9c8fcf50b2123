"""The controller's stages in a bag, with their inputs and records."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from slot_core import config
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.control.policy import TendonPlan
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import GaitPreview
from slot_core.gait.route import KEPT, Route, read_route
from slot_core.messages import decode
from slot_core.recording.origin import FILES, NETWORK
from slot_core.recording.record_settings import root_of
from slot_core.robot import read_robot
from slot_core.ros_parameters import of_node, parse_parameters
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.topics import OUTPUTS, PLANS, SENSORS

RECORDS, NODES = "/stage_record", "/recorded_nodes"
PATH, PARAMETERS = FILES["path"], FILES["params_file"]
T = TypeVar("T")


class RecordedStages:
    """The stages in a bag, read once."""

    def __init__(self, bag: Bag, own_policy: str = "") -> None:
        """own_policy: file of the policy, needed if the bag's policy is a file."""
        self.own_policy = own_policy
        self.bag, self.origin, self.robot = bag, bag.origin, read_robot()
        self.sensors: list[tuple[str, Any]] = []  # topic and message
        self.messages: dict[str, list[Any]] = {topic: [] for topic in OUTPUTS}
        self.records: dict[str, list[Any]] = {node: [] for node in OUTPUTS.values()}
        self.nodes: dict[
            str, list[str]
        ] = {}  # that published a topic, as far as it is known
        self._entries: list[
            tuple[str, Any]
        ] = []  # node and record, or topic and stamp (ns)
        topics = [t for t in (*SENSORS, *OUTPUTS, RECORDS, NODES) if bag.counts.get(t)]
        for topic, _, message in bag.merged(*topics) if topics else ():
            with bag.using(topic):
                self._add(topic, message)

    def _add(self, topic: str, message: Any) -> None:
        if topic == NODES:
            self.nodes = {
                str(t): list(map(str, n)) for t, n in json.loads(message.data).items()
            }
        elif topic == RECORDS:
            if message.node in self.records:
                self.records[message.node].append(message)
                self._entries.append((message.node, message))
        elif topic in OUTPUTS:
            self.messages[topic].append(message)
            self._entries.append((topic, decode.stamp(message)))
        else:
            decode.stamp(message)
            self.sensors.append((topic, message))

    def outputs(self, topic: str) -> Iterator[Any]:
        """Records of a stage, and stamps (ns) of its outputs, in their order."""
        names = topic, OUTPUTS[topic]
        return (entry for name, entry in self._entries if name in names)

    def own_nodes(self, topic: str) -> list[str]:
        """Nodes that published a stage's output in place of ours."""
        nodes = self.nodes.get(topic, [])
        ours = OUTPUTS[topic]
        return [] if ours in [name.rpartition("/")[2] for name in nodes] else nodes

    @cached_property
    def estimates(self) -> dict[int, Estimate]:
        """Estimated states by stamp."""
        return self._by_stamp("/mpc_state", decode.estimate)

    @cached_property
    def begins_mid_run(self) -> bool:
        """Whether the states before the first one are not in the bag.

        Before its first valid state an estimator publishes `gate.initial_readings` - 1 states that
        are initialising. Of a bag without a valid one it is not known: it counts as begun. Of a
        bag with records of the stages these tell.
        """
        if any(self.records.values()):
            return False
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
        return self._by_stamp(
            PLANS, lambda m: json.loads(getattr(m, "settings", "") or "{}")
        )

    def _by_stamp(self, topic: str, convert: Callable[[Any], Any]) -> dict[int, Any]:
        with self.bag.using(topic):
            return {decode.stamp(m): convert(m) for m in self.messages[topic]}

    @property
    def policy(self) -> str:
        """Name of the policy, or file of a user's policy; the default if none is named.

        Raises BagError for a user's policy whose file is not given.
        """
        named = self.origin.about.get("policy", DEFAULT_POLICY)
        is_file = named.endswith(".py") or NETWORK in self.origin.files
        if is_file and not self.own_policy:
            raise BagError(
                f"{self.bag.path}: its policy is a file, {named}: add --policy FILE"
            )
        return self.own_policy or named

    def settings(self, node: str, settings: T) -> T:
        """Settings of a node, as the parameter file in the bag has changed them.

        Raises ConfigError for one that does not fit them.
        """
        if PARAMETERS not in self.origin.files:
            return settings
        found = parse_parameters(self.origin.files[PARAMETERS].decode(), PARAMETERS)
        given = of_node(
            found, f"{root_of(self.origin.about.get('namespace', ''))}/{node}"
        )
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

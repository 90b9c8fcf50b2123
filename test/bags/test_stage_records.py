"""Bags with records of the stages replay in whatever order their readings came, also from a cut."""

import json
import re

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from synthetic_walk import TYPES
from test_replay import WALK

from slot_core import config
from slot_core.clock import to_seconds
from slot_core.control.force_map import read_springs
from slot_core.estimation.inertial_filter import NO_ODOMETRY
from slot_core.estimation.state_estimator import read_estimator
from slot_core.estimation.unaided_estimator import make_estimator
from slot_core.key_frame import capture
from slot_core.messages import decode
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.origin import Origin
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_lab.bags import check_bag as replay
from slot_lab.bags import replay_command
from slot_lab.bags.bag import Bag
from slot_lab.bags.replayed_stages import READERS, TAKERS
from slot_lab.bags.topics import SENSORS
from slot_msgs.msg import StageRecord
from slot_nodes import messages

LATENCY = 40_000_000  # ns, at most, of a reading
EVERY = 12  # records from a key frame to the next


class Recording:
    """A state estimator that takes readings in an order of its own, and what is recorded of it."""

    def __init__(self, seed, state=False, topics=SENSORS, source="topic"):
        """Take the walk's readings, each after a latency; state: whether there are key frames.

        source: of the odometry.
        """
        rng = np.random.default_rng(seed)
        settings = read_estimator()
        settings = config.replace(settings, {"odometry.source": source})
        estimator = make_estimator(settings, read_robot(), read_springs())
        self.origin = Origin({"odometry": source})
        self.entries, self.number, self.taken, self.stamp = [], 0, [], 0
        self._record(0, "")
        source = Bag(WALK)
        readings = list(source.merged(*topics))
        stamps = [decode.stamp(message) for *_, message in readings]
        late = stamps + rng.integers(0, LATENCY, len(stamps))
        for k in np.argsort(late):
            topic, _, message = readings[k]
            kind, now = source.topics[topic], int(late[k])
            self.entries.append(
                (stamps[k], topic, kind, TYPES.serialize_cdr(message, kind))
            )
            self.taken.append((SENSORS.index(topic), stamps[k]))
            getattr(estimator, TAKERS[topic])(*READERS[topic](message))
            while (estimate := estimator.poll()) is not None:
                self.stamp = estimate.stamp
                self.write(now, "/mpc_state", messages.state_to_msg(estimate))
                due = state and self.number % EVERY == 0
                self._record(now + 1, capture(estimator) if due else "")

    def _record(self, now, state):
        topics, stamps = zip(*self.taken) if self.taken else ((), ())
        record = StageRecord(
            header=messages.header(self.stamp),
            node="state_estimator",
            number=self.number,
            taken=topics,
            stamp=stamps,
            state=state,
        )
        self.number, self.taken = self.number + 1, []
        self.write(now, "/stage_record", record)

    def write(self, now, topic, message):
        kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
        self.entries.append((now, topic, kind, serialize_message(message)))

    def bag(self, path, keep=lambda k, entry: True):
        """The bag of the entries to keep, in the order of their times."""
        with BagWriter(path, read_record_settings(), self.origin) as bag:
            ordered = sorted(self.entries, key=lambda entry: entry[0])
            for k, (time, topic, kind, data) in enumerate(ordered):
                if keep(k, (time, topic)):
                    bag.write(topic, kind, time + 10**9, data)
        return path


def states(path):
    (found, *_) = replay.check_bag(Bag(path), 0.0)
    return found


@pytest.mark.parametrize("seed", range(4))
def test_the_order_in_which_the_estimator_took_its_readings_is_replayed(
    tmp_path, seed
):
    recording = Recording(seed)
    path = recording.bag(tmp_path / "bag")
    found = states(path)
    assert found.compared == Bag(path).counts["/mpc_state"] > 40
    assert found.largest == 0.0
    without = recording.bag(
        tmp_path / "old", lambda _, e: e[1] != "/stage_record"
    )
    with pytest.raises(replay.BagError, match="no record of state_estimator"):
        states(without)


def test_the_estimator_without_odometry_is_replayed_without_it(tmp_path):
    recording = Recording(0, topics=SENSORS[1:], source=NO_ODOMETRY)
    found = states(recording.bag(tmp_path / "bag"))
    assert found.compared > 40
    assert found.largest == 0.0


@pytest.mark.parametrize("share", [0.1, 0.4, 0.6])
def test_a_bag_begun_in_mid_run_is_compared_from_its_first_key_frame_on(
    tmp_path, share
):
    recording = Recording(1, state=True)
    times = [entry[0] for entry in recording.entries]
    begin = np.quantile([t for t in times if t], share)
    found = states(
        recording.bag(tmp_path / "bag", lambda _, entry: entry[0] >= begin)
    )
    assert found.compared > 4
    assert (found.largest, found.gaps) == (0.0, 0)
    assert f", from {to_seconds(found.begin):.3f} s on" in str(found)
    bare = Recording(1)
    with pytest.raises(replay.BagError, match="begins mid-run"):
        states(bare.bag(tmp_path / "bare", lambda _, entry: entry[0] >= begin))


@pytest.mark.parametrize("topic", [*SENSORS, "/stage_record"])
def test_after_a_lost_message_the_replay_goes_on_at_the_next_key_frame(
    tmp_path, topic
):
    recording = Recording(2, state=True)
    ordered = sorted(recording.entries, key=lambda entry: entry[0])
    places = [k for k, entry in enumerate(ordered) if entry[1] == topic]
    lost = places[len(places) // 3]
    path = recording.bag(tmp_path / "bag", lambda k, _: k != lost)
    found = states(path)
    assert found.largest == 0.0
    assert 0 < found.gaps <= 2 * EVERY
    assert found.compared + found.gaps == Bag(path).counts["/mpc_state"]
    if topic in SENSORS:
        assert re.search(
            rf"; \d+ are not: {topic} at \d+\.\d+ s is not in the bag",
            str(found),
        )


def test_the_output_of_a_node_of_a_users_own_is_left_out_and_its_node_named(
    tmp_path,
):
    recording = Recording(3)
    nodes = json.dumps({"/mpc_state": ["/fred/my_filter"]})
    recording.write(1, "/recorded_nodes", String(data=nodes))
    path = recording.bag(tmp_path / "bag")
    with pytest.raises(replay.BagError, match="no stage can be compared"):
        replay.check_bag(Bag(path), 0.0)
    (found, *_) = replay.check_bag(Bag(path), 0.0, only=["state_estimator"])
    assert found.compared > 40
    assert str(found).endswith("; published by /fred/my_filter")


@pytest.mark.parametrize("option", ["--skip", "--only"])
def test_stages_are_left_out_at_request_with_a_line_that_says_so(
    capsys, option
):
    assert replay_command.main([str(WALK), option, "mpc_controller"]) == 0
    lines = {
        line.split()[0]: line for line in capsys.readouterr().out.splitlines()
    }
    for topic in replay.STAGES:
        left_out = f"left out: {option} mpc_controller" in lines[topic]
        assert left_out == ((topic == "/tendon_plan") == (option == "--skip"))

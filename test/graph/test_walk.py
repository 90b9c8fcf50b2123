"""The whole graph as processes, in lockstep; the bag is read with the mcap library."""

from itertools import pairwise

import numpy as np
import pytest
from graph_bag import commands_of_core, first_times, read, record, recorded_commands, stamps

from slot_core.clock import SECOND
from slot_core.dynamics.scene import read_scene
from slot_lab.bags import check_bag as replay
from slot_lab.bags.bag import Bag

CHAIN = ("/odom", "/mpc_state", "/gait_preview", "/tendon_plan", "/desired_joint_angles")
OTHERS = ("/clock", "/imu", "/joint_states", "/tf", "/force_map/status", "/ground_truth/odom",
          "/ground_truth/legs")  # fmt: skip
PERIOD = round(read_scene("flat").sensors.odometry.period * SECOND)  # ns


@pytest.fixture(scope="module")
def messages(walk):
    return read(walk)


def numbers(message):
    """All numbers of a message and of its nested messages."""
    if isinstance(message, (bool, int, float)):
        yield float(message)
    elif isinstance(message, (list, tuple, np.ndarray)):
        for item in message:
            yield from numbers(item)
    elif hasattr(message, "__slots__"):
        for name in message.__slots__:
            yield from numbers(getattr(message, name))


def test_every_topic_is_recorded(messages):
    for topic in (*CHAIN, *OTHERS, "/robot_state", "/servo_health"):
        assert len(messages[topic]) > 100, topic


def test_every_odometry_passes_the_chain_with_its_stamp(messages):
    odometry_stamps = stamps(messages["/odom"])
    assert set(np.diff(sorted(set(odometry_stamps)))) == {PERIOD}
    for topic in CHAIN[1:]:
        # the last tick may be cut off by the end of the run
        answered = stamps(messages[topic])
        assert answered == sorted(set(odometry_stamps))[: len(answered)], topic
        assert len(answered) >= len(set(odometry_stamps)) - 1, topic


def test_no_output_precedes_its_input(messages):
    """Publishing times of a stamp increase along the chain; the clock is not behind a stamp.

    The last tick may lack any message: at the end a node may be gone before the recorder, on a busy
    machine, reads what the node has sent.
    """
    times = [first_times(messages[topic]) for topic in CHAIN]
    last = max(map(max, times))
    for before, after in pairwise(times):
        for stamp, time in after.items():
            assert stamp == last or before[stamp] < time
    clock = np.array([m.clock.sec * 10**9 + m.clock.nanosec for _, m in messages["/clock"]])
    assert (np.diff(clock) > 0).all()
    assert clock.max() >= max(stamps(messages["/odom"]))


def test_equal_seeds_give_bit_equal_states_also_in_one_process(walk, messages, tmp_path):
    """Of another seed `test_graph_gives_the_commands_of_the_core` tells."""
    options = ("--lockstep", "--composed", "--duration", "2", "--seed", "3")
    composed = read(record(tmp_path / "composed", *options))
    for topic in ("/mpc_state", "/gait_preview", "/desired_joint_angles", "/force_map/status"):
        first, second = values(messages[topic]), values(composed[topic])
        shared = min(len(first), len(second))
        assert shared > 55
        assert first[:shared] == second[:shared], topic


def test_graph_gives_the_commands_of_the_core_in_one_process(walk):
    """Bit-equal, supervisor included: processes, DDS and the order of arrival have no effect."""
    commands = commands_of_core(seed=3, seconds=4.6)
    recorded = recorded_commands(walk)
    assert len(commands) > 130
    for stamp, command in commands.items():
        assert np.array_equal(recorded[stamp], command), stamp
    other = commands_of_core(seed=4, seconds=2.5)  # the first stride needs no feedback
    assert any(not np.array_equal(recorded[stamp], sent) for stamp, sent in other.items())


def values(rows):
    return [tuple(numbers(message)) for _, message in rows]


def test_replay_of_the_bag_gives_bit_equal_results(walk):
    for comparison in replay.check_bag(Bag(walk), tolerance=0.0):
        assert comparison.first is None, str(comparison.first)
        assert comparison.compared > 100

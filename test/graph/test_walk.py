"""The whole graph in lockstep, as processes and beside it, in a namespace, in one process.

The bags are read with the mcap library where the recorder is under test.
"""

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from graph_bag import (
    commands_of_core,
    first_times,
    read,
    recorded_commands,
    stamps,
)
from recorded_run import patient

from slot_bringup import monitor, run
from slot_bringup.graph import read_graph
from slot_core.clock import SECOND
from slot_core.estimation.state_estimator import read_estimator
from slot_core.messages import decode
from slot_lab.bags import check_bag as replay
from slot_lab.bags.bag import Bag

CHAIN = (
    "/mpc_state",
    "/gait_preview",
    "/tendon_plan",
    "/desired_joint_angles",
)
PERIOD = round(read_estimator().timing.period * SECOND)  # ns
IMU_PERIOD = 5_000_000  # ns
DURATION = 5.0  # s of the robot's time
BESIDE = 2.5  # s, of the graph in the namespace
SPACE, PREFIX = "/fleet/ida", "ida/"  # of topics and of frames
# Topics of the machine, once a second; with key frames before or after the policy has prepared; of
# names alone.
OF_THE_MACHINE = {"/diagnostics", "/stage_record", "/recorded_nodes"}
# that differ from run to run
FIELDS_OF_THE_MACHINE = {"solve_time", "overruns"}


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Bags of two graphs that walk at once in one ROS domain with seed 3, by namespace."""
    directory, graph = tmp_path_factory.mktemp("bags"), read_graph()
    values = {argument.name: argument.default for argument in graph.arguments}
    values |= {"lockstep": True, "seed": 3}
    paths = {"": directory / "walk", SPACE: directory / "beside"}
    alone = values | {"bag": str(paths[""])}
    spaced = {"namespace": SPACE, "frame_prefix": PREFIX, "composed": True}
    spaced = values | spaced | {"bag": str(paths[SPACE])}
    with (
        patient(),
        ThreadPoolExecutor(1) as pool,
        run.started(graph, alone, directory / "log") as processes,
        run.started(graph, spaced, directory / "log_beside") as others,
    ):

        def walk_beside():
            monitor.watch(others, BESIDE, namespace=SPACE)
            others.stop(last="recorder")

        beside = pool.submit(walk_beside)
        monitor.watch(processes, DURATION)
        beside.result()
    return paths


@pytest.fixture(scope="module")
def walk(bags):
    return bags[""]


@pytest.fixture(scope="module")
def messages(walk):
    return read(walk)


def test_every_tick_of_the_imu_passes_the_chain_with_its_stamp(messages):
    ticks = stamps(messages[CHAIN[0]])
    assert set(np.diff(ticks)) == {PERIOD}
    # the sample that leads to the next tick may be the last message of the run
    assert max(stamps(messages["/imu"])) - ticks[-1] < PERIOD + IMU_PERIOD
    for topic in CHAIN[1:]:
        # the last tick may be cut off by the end of the run
        answered = stamps(messages[topic])
        assert answered == ticks[: len(answered)], topic
        assert len(answered) >= len(ticks) - 1, topic


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
    clock = np.array(
        [m.clock.sec * 10**9 + m.clock.nanosec for _, m in messages["/clock"]]
    )
    assert (np.diff(clock) > 0).all()
    assert clock.max() >= max(stamps(messages["/odom"]))


def test_graph_gives_the_commands_of_the_core_in_one_process(walk):
    """Bit-equal, supervisor included: processes, DDS and the order of arrival have no effect."""
    commands = commands_of_core(seed=3, seconds=4.6)
    recorded = recorded_commands(walk)
    assert len(commands) > 130
    for stamp, command in commands.items():
        assert np.array_equal(recorded[stamp], command), stamp
    # the first stride needs no feedback
    other = commands_of_core(seed=4, seconds=2.5)
    assert any(
        not np.array_equal(recorded[stamp], sent)
        for stamp, sent in other.items()
    )


def test_replay_of_the_bag_gives_bit_equal_results(walk):
    for comparison in replay.check_bag(Bag(walk), tolerance=0.0):
        assert comparison.first is None, str(comparison.first)
        assert comparison.compared > 100


def stamp(message):
    part = getattr(message, "transforms", [message])[0]
    return decode.time(
        part.clock if hasattr(part, "clock") else part.header.stamp
    )


def leaves(message, prefix):
    """All values of a message but FIELDS_OF_THE_MACHINE, its frames without the prefix."""
    if dataclasses.is_dataclass(message):
        for field in dataclasses.fields(message):
            value = getattr(message, field.name)
            if field.name.endswith("frame_id") and value:
                assert value.startswith(prefix)
                yield value.removeprefix(prefix)
            elif field.name not in FIELDS_OF_THE_MACHINE:
                yield from leaves(value, prefix)
    elif isinstance(message, np.ndarray):
        yield message.tobytes()
    elif isinstance(message, (list, tuple)):
        for item in message:
            yield from leaves(item, prefix)
    else:
        yield message


def content(bag, topic, prefix):
    """{stamp: values} of the messages of a topic."""
    return {stamp(m): tuple(leaves(m, prefix)) for _, m in bag.messages(topic)}


def test_a_walk_in_a_namespace_and_one_process_is_that_of_processes_but_for_names(
    bags,
):
    """Equal seeds give equal bits."""
    alone, spaced = Bag(bags[""]), Bag(bags[SPACE], SPACE)
    assert (
        set(alone.topics)
        == set(spaced.topics)
        > {"/clock", "/odom", "/tf", "/mpc_state"}
    )
    for topic in set(alone.topics) - OF_THE_MACHINE:
        here, there = content(alone, topic, ""), content(spaced, topic, PREFIX)
        shared = here.keys() & there.keys()
        assert len(shared) > 0.9 * BESIDE * 30, topic
        for when in shared:
            # NaN too
            assert repr(here[when]) == repr(there[when]), (topic, when)


def test_a_bag_holds_the_topics_of_its_own_namespace_only(bags):
    assert all(
        topic.startswith(f"{SPACE}/") for topic in Bag(bags[SPACE]).topics
    )
    assert not any(
        topic.startswith(f"{SPACE}/") for topic in Bag(bags[""]).topics
    )


def test_the_summary_of_a_walk_in_a_namespace_reads_its_bag(bags, capsys):
    run.report(bags[SPACE], keep=False, namespace=SPACE)
    assert "motion from         /ground_truth/odom" in capsys.readouterr().out

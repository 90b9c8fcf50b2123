"""The whole graph in lockstep, as processes and beside it, in a namespace, in one process.

Also on emulated servos: driver and bus on the robot's clock.
"""

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from recorded_run import patient, record

from slot_bringup import monitor, run
from slot_bringup.graph import read_graph
from slot_core.messages import decode
from slot_core.simulation.supervised_loop import SupervisedLoop
from slot_lab.bags import check_bag as replay
from slot_lab.bags.bag import Bag

CHAIN = (
    "/mpc_state",
    "/gait_preview",
    "/tendon_plan",
    "/desired_joint_angles",
)
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


def stamp(message):
    part = getattr(message, "transforms", [message])[0]
    return decode.time(
        part.clock if hasattr(part, "clock") else part.header.stamp
    )


def first_times(bag, topic):
    """{stamp: publishing time of the first message with it}, both in ns."""
    rows = [*Bag(bag).messages(topic)]
    return {stamp(message): time for time, message in rows[::-1]}


def test_no_output_precedes_its_input(walk):
    """Publishing times of a stamp increase along the chain; the clock is not behind a stamp.

    The last tick may lack any message: at the end a node may be gone before the recorder, on a busy
    machine, reads what the node has sent.
    """
    times = [first_times(walk, topic) for topic in CHAIN]
    last = max(map(max, times))
    for before, after in pairwise(times):
        for when, time in after.items():
            assert when == last or before[when] < time
    clock = np.array([stamp(m) for _, m in Bag(walk).messages("/clock")])
    assert (np.diff(clock) > 0).all()
    assert clock.max() >= max(first_times(walk, "/odom"))


def assert_that_of_the_core(bag, seed, seconds, hardware="sim"):
    """Commands and states of a bag are bit-equal to those of the core in one process."""
    loop = SupervisedLoop("flat", "walk", None, seed, hardware=hardware)
    commands, offer = {}, loop.servos.offer

    def keep(now, stamp, *command):
        commands[stamp] = command
        offer(now, stamp, *command)

    loop.servos.offer = keep
    reports = [(loop.plant.now, report) for report in loop.run(seconds)]
    assert len(commands) > 25 * seconds
    for sent in Bag(bag).messages("/desired_joint_angles"):
        stamp, *command = decode.joint_command(sent[1])
        if stamp in commands:
            assert np.array_equal(command, commands.pop(stamp)), stamp
    assert commands == {}
    # a state is kept until the next: while the recorder is late, it may miss some
    states = {decode.stamp(m): m for _, m in Bag(bag).messages("/robot_state")}
    shared = [(states[now], r) for now, r in reports if now in states]
    assert len(shared) > 0.8 * len(reports)
    for sent, report in shared:
        assert (sent.state, sent.reason) == (report.state, report.reason)
        np.testing.assert_array_equal(sent.slack, report.slack)


def test_graph_gives_the_commands_and_states_of_the_core_in_one_process(walk):
    """Processes, DDS and the order of arrival have no effect."""
    assert_that_of_the_core(walk, 3, 4.6)
    # the first stride needs no feedback
    with pytest.raises(AssertionError):
        assert_that_of_the_core(walk, 4, 2.5)


BUS = ("--lockstep", "--composed", "--hardware", "fake_bus", "--seed", "3")


def test_on_emulated_servos_too_and_it_ends_with_torque_off(tmp_path):
    bag = record(tmp_path / "bag", *BUS, "--duration", "2")
    assert_that_of_the_core(bag, 3, 1.9, "fake_bus")
    log = (bag / "log/controller.log").read_text()
    assert "servos left under torque: none" in log


def test_replay_of_the_bag_gives_bit_equal_results(walk):
    for comparison in replay.check_bag(Bag(walk), tolerance=0.0):
        assert comparison.first is None, str(comparison.first)
        assert comparison.compared > 100


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

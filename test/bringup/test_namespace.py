"""Graphs in one ROS domain: namespaces keep them apart, and nothing else changes."""

import dataclasses
from contextlib import ExitStack

import numpy as np
import pytest

from slot_bringup import monitor, run
from slot_bringup.graph import read_graph
from slot_core.messages import decode
from slot_lab.bags.bag import Bag

DURATION = 3.0  # s of the robot's time
SPACE = "/fleet/ida"
PREFIXES = {"": "", SPACE: "ida/"}  # of the frames, by namespace
# Topics of the machine, once a second; with key frames before or after the policy has prepared; of
# names alone.
OTHERS = {"/diagnostics", "/stage_record", "/recorded_nodes"}
OF_THE_MACHINE = {"solve_time", "overruns"}  # fields that differ from run to run


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Bags of two graphs that walk in lockstep at once, by namespace."""
    directory, graph = tmp_path_factory.mktemp("bags"), read_graph()
    paths = {space: directory / f"bag{n}" for n, space in enumerate(PREFIXES)}
    values = {argument.name: argument.default for argument in graph.arguments}
    with ExitStack() as stack:
        running = {}
        for space, prefix in PREFIXES.items():
            given = {"namespace": space, "frame_prefix": prefix, "bag": str(paths[space])}
            given = values | given | {"lockstep": True}
            logs = directory / f"log{len(running)}"
            running[space] = stack.enter_context(run.started(graph, given, logs))
        for space, processes in running.items():
            monitor.watch(processes, DURATION, namespace=space)
    return paths


def stamp(message):
    part = getattr(message, "transforms", [message])[0]
    return decode.time(part.clock if hasattr(part, "clock") else part.header.stamp)


def leaves(message, prefix):
    """All values of a message but those of OF_THE_MACHINE, its frames without the prefix."""
    if dataclasses.is_dataclass(message):
        for field in dataclasses.fields(message):
            value = getattr(message, field.name)
            if field.name.endswith("frame_id") and value:
                assert value.startswith(prefix)
                yield value.removeprefix(prefix)
            elif field.name not in OF_THE_MACHINE:
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


def test_a_walk_in_a_namespace_is_the_walk_without_one_but_for_names(bags):
    alone, spaced = Bag(bags[""]), Bag(bags[SPACE], SPACE)
    assert set(alone.topics) == set(spaced.topics) > {"/clock", "/odom", "/tf", "/mpc_state"}
    for topic in set(alone.topics) - OTHERS:
        here, there = content(alone, topic, ""), content(spaced, topic, PREFIXES[SPACE])
        shared = here.keys() & there.keys()
        assert len(shared) > 0.9 * DURATION * 30, topic
        for when in shared:
            assert repr(here[when]) == repr(there[when]), (topic, when)  # NaN too


def test_a_bag_holds_the_topics_of_its_own_namespace_only(bags):
    assert all(topic.startswith(f"{SPACE}/") for topic in Bag(bags[SPACE]).topics)
    assert not any(topic.startswith(f"{SPACE}/") for topic in Bag(bags[""]).topics)


def test_the_summary_of_a_walk_in_a_namespace_reads_its_bag(bags, capsys):
    run.report(bags[SPACE], keep=False, namespace=SPACE)
    assert "motion from         /ground_truth/odom" in capsys.readouterr().out

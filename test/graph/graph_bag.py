"""Bags of the graph, read with the mcap library, independently of the recorder."""

from collections import defaultdict
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from slot_bringup import run
from slot_bringup.graph import read_graph


def record(bag: Path, *arguments: str) -> Path:
    """Run the graph with a bag and return the directory of the bag."""
    graph = read_graph()
    run.run(run.parse([*arguments, "--bag", str(bag)], graph), graph, bag)
    return bag


def read(bag):
    """{topic: [(publishing time ns, message), ...]} in the order of publishing."""
    messages = defaultdict(list)
    with next(bag.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, raw, message in reader.iter_decoded_messages():
            messages[channel.topic].append((raw.publish_time, message))
    return messages


def stamps(rows):
    """Header stamps in ns."""
    return [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in rows]


def first_times(rows):
    """{stamp: publishing time of the first message with it}, both in ns."""
    times = {}
    for (time, _), stamp in zip(rows, stamps(rows)):
        times.setdefault(stamp, time)
    return times

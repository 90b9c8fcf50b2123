"""A bag through the mcap library, which shares no code with the one that writes it."""

from collections import defaultdict

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


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
    """{stamp: publishing time of the first message that bears it}, both in ns."""
    times = {}
    for (time, _), stamp in zip(rows, stamps(rows)):
        times.setdefault(stamp, time)
    return times

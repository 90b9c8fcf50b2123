"""Bags of the graph, read with the mcap library, independently of the recorder."""

from collections import defaultdict

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from slot_core.messages import decode
from slot_core.simulation.supervised_loop import SupervisedLoop
from slot_lab.bags.bag import Bag


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
    return [
        m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in rows
    ]


def first_times(rows):
    """{stamp: publishing time of the first message with it}, both in ns."""
    times = {}
    for (time, _), stamp in zip(rows, stamps(rows)):
        times.setdefault(stamp, time)
    return times


def recorded_commands(bag):
    """{stamp: [angle, rate]} of the commands in a bag."""
    commands = {}
    for _, message in Bag(bag).messages("/desired_joint_angles"):
        stamp, *command = decode.joint_command(message)
        commands[stamp] = command
    return commands


def commands_of_core(seed, seconds, hardware="sim"):
    """{stamp: (angle, rate)} of the core in one process, walking on flat ground."""
    loop = SupervisedLoop("flat", "walk", None, seed, hardware=hardware)
    commands, offer = {}, loop.servos.offer

    def record(now, stamp, *command):
        commands[stamp] = command
        offer(now, stamp, *command)

    loop.servos.offer = record
    list(loop.run(seconds))
    return commands

"""Command line of `ros2 bag record` for the topics of `config/record.yaml`."""

import json
from collections.abc import Mapping
from tempfile import NamedTemporaryFile

import yaml

from slot_core.recording.bag_writer import MEGABYTE
from slot_core.recording.origin import origin_here
from slot_core.recording.record_settings import (
    RecordSettings,
    read_record_settings,
    root_of,
)
from slot_nodes.recorder_node import SENSORS


def record_command(
    bag: str,
    namespace: str,
    about: str,
    remappings: Mapping[str, str],
    best_effort_sensors: bool = False,
) -> list[str]:
    """Words of the command; `about` are the graph's arguments as JSON, kept as custom data.

    remappings: as of the nodes; the bag has these topics by their new names. best_effort_sensors:
    as of the own recorder. Custom data holds no files: a bag of the own recorder also has the
    configuration.
    """
    settings = read_record_settings(namespace)
    renamed = {
        _resolved(a, namespace): _resolved(b, namespace)
        for a, b in remappings.items()
    }
    names = {topic: renamed.get(topic, topic) for topic in settings.topics}
    origin = origin_here(json.loads(about)).about
    size = round(settings.split * MEGABYTE)
    return [
        "ros2",
        "bag",
        "record",
        "--output",
        bag,
        "--storage",
        "mcap",
        "--storage-preset-profile",
        "zstd_fast",
        "--qos-profile-overrides-path",
        _profiles(settings, names, best_effort_sensors),
        *(["--max-bag-size", str(size)] if size else []),
        "--custom-data",
        *(f"{name}={value}" for name, value in origin.items()),
        "--topics",
        *names.values(),
    ]


def _profiles(
    settings: RecordSettings, names: Mapping[str, str], best_effort: bool
) -> str:
    """A new file with the quality of service of the own recorder.

    With rosbag2's queue of 10 messages a busy machine loses IMU readings, 50 ms of which fill it.
    """
    profiles = {
        names[name]: {
            "history": "keep_last",
            "depth": settings.depth,
            "reliability": "best_effort"
            if best_effort and topic.type in SENSORS
            else topic.reliability,
            "durability": topic.durability,
        }
        for name, topic in settings.topics.items()
    }
    with NamedTemporaryFile(
        "w", prefix="slot_qos_", suffix=".yaml", delete=False
    ) as file:
        yaml.safe_dump(profiles, file)
    return file.name


def _resolved(topic: str, namespace: str) -> str:
    """Full name of a topic in a namespace."""
    return topic if topic.startswith("/") else f"{root_of(namespace)}/{topic}"

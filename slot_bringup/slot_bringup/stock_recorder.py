"""Command line of `ros2 bag record` for the topics of `config/record.yaml`."""

from __future__ import annotations

import json
from collections.abc import Mapping

from slot_core.recording.bag_writer import MEGABYTE
from slot_core.recording.origin import origin_here
from slot_core.recording.record_settings import read_record_settings, root_of


def record_command(
    bag: str, namespace: str, about: str, remappings: Mapping[str, str]
) -> list[str]:
    """Words of the command; `about` are the graph's arguments as JSON, kept as custom data.

    remappings: as of the nodes; the bag has these topics by their new names. Custom data holds no
    files: a bag of the own recorder also has the configuration.
    """
    settings = read_record_settings(namespace)
    renamed = {_resolved(a, namespace): _resolved(b, namespace) for a, b in remappings.items()}
    origin = origin_here(json.loads(about)).about
    size = round(settings.split * MEGABYTE)
    return [
        "ros2", "bag", "record", "--output", bag,
        "--storage", "mcap", "--storage-preset-profile", "zstd_fast",
        *(["--max-bag-size", str(size)] if size else []),
        "--custom-data", *(f"{name}={value}" for name, value in origin.items()),
        "--topics", *(renamed.get(topic, topic) for topic in settings.topics),
    ]  # fmt: skip


def _resolved(topic: str, namespace: str) -> str:
    """Full name of a topic in a namespace."""
    return topic if topic.startswith("/") else f"{root_of(namespace)}/{topic}"

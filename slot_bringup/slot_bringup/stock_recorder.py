"""Command line of `ros2 bag record` for the topics of `config/record.yaml`."""

from __future__ import annotations

import json

from slot_core.bags.bag_writer import MEGABYTE
from slot_core.bags.origin import origin_here
from slot_core.bags.record_settings import read_record_settings


def record_command(bag: str, namespace: str, about: str) -> list[str]:
    """Words of the command; `about` are the graph's arguments as JSON, kept as custom data.

    Custom data holds no files: a bag of the own recorder also has the configuration.
    """
    settings = read_record_settings(namespace)
    origin = origin_here(json.loads(about)).about
    size = round(settings.split * MEGABYTE)
    return [
        "ros2", "bag", "record", "--output", bag,
        "--storage", "mcap", "--storage-preset-profile", "zstd_fast",
        *(["--max-bag-size", str(size)] if size else []),
        "--custom-data", *(f"{name}={value}" for name, value in origin.items()),
        "--topics", *settings.topics,
    ]  # fmt: skip

"""Recorded topics, how the files of a bag are written (`config/record.yaml`), errors of bags."""

from dataclasses import dataclass, replace

from slot_core import config
from slot_core.config import choice, quantity, text
from slot_core.refusal import InputError

VELOCITY = "cmd_vel"


class BagError(InputError):
    """A bag that cannot be read or written; the message has its path and the cause."""


class NoFieldError(BagError):
    """The messages of a topic have no field of that name."""


@dataclass(frozen=True)
class RecordedTopic:
    """One recorded topic: its type, and the quality of service requested and stored in the bag."""

    type: str = text("message type, package/msg/Name")
    reliability: str = choice("reliability", "reliable", "best_effort")
    durability: str = choice("durability", "volatile", "transient_local")


@dataclass(frozen=True)
class RecordSettings:
    """Recorded topics, how they are written, and the warm-up that the metrics leave out."""

    warm_up: float = quantity(
        "time at the start left out by the metrics", "s", 0.0, 60.0
    )
    depth: int = quantity("queue of each subscription", "messages", 1, 100_000)
    poll: float = quantity(
        "time between two looks at the queues", "s", 0.001, 1.0
    )
    flush: float = quantity(
        "time between two chunks: what SIGKILL loses at most", "s", 0.02, 60.0
    )
    split: float = quantity(
        "size from which the bag goes on in a new file; 0: none", "MB", 0.0
    )
    topics: dict[str, RecordedTopic] = text("recorded topics by name")


def read_record_settings(
    namespace: str = "", stamped_cmd_vel: bool = True
) -> RecordSettings:
    """The settings of `config/record.yaml`, topics in a namespace; raises ConfigError.

    stamped_cmd_vel: whether /cmd_vel has the type of the file, else it is a Twist.
    """
    settings = config.read(RecordSettings, "record")
    if not stamped_cmd_vel and VELOCITY in settings.topics:
        settings.topics[VELOCITY] = replace(
            settings.topics[VELOCITY], type="geometry_msgs/msg/Twist"
        )
    return replace(
        settings,
        topics={
            f"{root_of(namespace)}/{name}": topic
            for name, topic in settings.topics.items()
        },
    )


def root_of(namespace: str) -> str:
    """Prefix of the topics in a namespace: /fred for fred, nothing for none."""
    return f"/{namespace.strip('/')}".rstrip("/")

"""ROS domain and configuration of tests that start nodes as processes."""

import os
import shutil
from pathlib import Path

import pytest

DOMAINS = 100  # above 101 the ports of DDS lie in the range that Linux assigns dynamically


def process_domain():
    """ROS domain of this process, 1 .. DOMAINS."""
    return str(1 + os.getpid() % DOMAINS)


@pytest.fixture(scope="session", autouse=True)
def domain():
    """Separate ROS domain for every test process, so that their graphs do not communicate."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", process_domain())
        yield


def changed_config(directory, changes):
    """Copy config/ below `directory` and replace texts in it: {file: {before: after}}."""
    config = directory / "config"
    shutil.copytree(Path(__file__).parents[1] / "config", config)
    for name, replaced in changes.items():
        text = (config / name).read_text()
        for before, after in replaced.items():
            assert text.count(before) == 1, before
            text = text.replace(before, after)
        (config / name).write_text(text)
    return config

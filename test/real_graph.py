"""What tests need that start nodes as processes."""

import os
import shutil
from pathlib import Path

import pytest

DOMAINS = 100  # beyond, the ports of DDS run into those that the system hands out


@pytest.fixture(scope="session", autouse=True)
def domain():
    """A ROS domain for every process that runs tests: their graphs do not hear each other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % DOMAINS))
        yield


def changed_config(directory, changes):
    """A copy of config/ below `directory` with texts replaced: {file: {before: after}}."""
    config = directory / "config"
    shutil.copytree(Path(__file__).parents[1] / "config", config)
    for name, replaced in changes.items():
        text = (config / name).read_text()
        for before, after in replaced.items():
            assert text.count(before) == 1, before
            text = text.replace(before, after)
        (config / name).write_text(text)
    return config

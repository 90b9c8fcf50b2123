"""Limits of tests in real time that hold on a busy machine."""

import os

import pytest
from real_graph import PATIENT, changed_config


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Environment variables with a configuration of longer time limits."""
    config = changed_config(tmp_path_factory.mktemp("patient"), PATIENT)
    return os.environ | {"SLOT_CONFIG": str(config)}

"""Quality of service with which `ros2 bag record` records the graph."""

from pathlib import Path

import pytest
import yaml

from slot_bringup.stock_recorder import record_command
from slot_core.recording.record_settings import read_record_settings


@pytest.mark.parametrize(
    ("best_effort", "sensors"), [(False, "reliable"), (True, "best_effort")]
)
def test_every_topic_has_the_profile_of_the_own_recorder(
    monkeypatch, tmp_path, best_effort, sensors
):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    words = record_command("bag", "fred", "{}", {"odom": "/rtabmap/odom"}, best_effort)
    file = words[words.index("--qos-profile-overrides-path") + 1]
    profiles = yaml.safe_load(Path(file).read_text())
    settings = read_record_settings("fred")
    assert [*profiles] == sorted(words[words.index("--topics") + 1 :])
    assert {p["depth"] for p in profiles.values()} == {settings.depth}
    assert {p["history"] for p in profiles.values()} == {"keep_last"}
    plan = profiles["/fred/tendon_plan"]
    assert (plan["reliability"], plan["durability"]) == ("reliable", "transient_local")
    assert profiles["/fred/imu"]["reliability"] == sensors
    assert profiles["/rtabmap/odom"]["reliability"] == sensors
    assert profiles["/fred/joint_states"]["reliability"] == "reliable"

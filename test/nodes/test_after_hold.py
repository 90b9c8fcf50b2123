"""What a robot does after a HOLD: it resumes what was requested last, and nothing else."""

import numpy as np
import pytest
from geometry_msgs.msg import Vector3

from slot_core.safety.states import State
from slot_msgs.msg import GaitPreview
from slot_msgs.srv import SetGait
from slot_nodes import qos

V_X = 9  # in the state of a reference
STOPPED = 0.25  # s, longer than command_hold


@pytest.fixture(scope="module")
def rig(simulate):
    made = simulate()
    made.subscribe("/gait_preview", GaitPreview, qos.CONTROL)
    return made


def hold(rig):
    """A HOLD by a force_mapper that is stopped for a moment; returns when the robot walks again."""
    begin = rig.pause("force_mapper")
    rig.run(STOPPED)
    rig.resume("force_mapper")
    rig.wait_for_state(State.HOLD, begin)
    since, _ = rig.wait_for_state(State.WALKING, begin)
    return since


def request_gait(rig, gait, v_x):
    answer = rig.call(SetGait, "/set_gait", gait=gait, velocity=Vector3(x=v_x))
    assert answer.success, answer.message
    rig.wait_for(lambda: rig.last("/gait_preview").gait == gait)


def test_a_robot_that_was_told_to_stand_does_not_walk_off_after_a_hold(rig):
    rig.walk_steadily()
    request_gait(rig, "stand", 0.0)
    previews = previews_after(rig, hold(rig))
    assert {preview.gait for preview in previews} == {"stand"}


def test_a_velocity_that_was_requested_last_holds_after_a_hold(rig):
    rig.walk_steadily()
    request_gait(rig, "walk", 0.02)
    previews = previews_after(rig, hold(rig))
    assert {preview.gait for preview in previews} == {"walk"}
    # two strides; the velocity of the start is 0.05 m/s
    assert np.mean([preview.reference[V_X] for preview in previews]) == pytest.approx(
        0.02, abs=0.01
    )


def previews_after(rig, since):
    """Two strides of previews."""
    rig.wait_for(lambda: len(rig.since("/gait_preview", since)) > 44)
    return rig.since("/gait_preview", since)[:44]

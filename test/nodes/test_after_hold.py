"""After a HOLD a robot resumes the last request, and nothing else."""

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


@pytest.mark.parametrize(("gait", "v_x"), [("stand", 0.0), ("walk", 0.02)])
def test_what_was_requested_last_holds_after_a_hold(rig, gait, v_x):
    """A robot that was told to stand does not walk off; the velocity of the start is 0.05 m/s."""
    rig.walk_steadily()
    answer = rig.call(SetGait, "/set_gait", gait=gait, velocity=Vector3(x=v_x))
    assert answer.success, answer.message
    rig.wait_for(lambda: rig.last("/gait_preview").gait == gait)
    begin = rig.pause("force_mapper")
    rig.run(STOPPED)
    rig.resume("force_mapper")
    rig.wait_for_state(State.HOLD, begin)
    since, _ = rig.wait_for_state(State.WALKING, begin)
    rig.wait_for(lambda: len(rig.since("/gait_preview", since)) > 44)
    previews = rig.since("/gait_preview", since)[:44]  # two strides
    assert {preview.gait for preview in previews} == {gait}
    mean = np.mean([preview.reference[V_X] for preview in previews])
    assert mean == pytest.approx(v_x, abs=0.01)

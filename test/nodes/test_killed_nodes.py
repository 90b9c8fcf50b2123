"""Each node of a walking graph is killed or slowed down, and comes back: the robot walks again.

Limits and times of the table of faults are tested in test/simulation/test_fault_table.py. An
injected fault that cannot be is refused.
"""

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from rig import SOLVE_TIME

from slot_core.messages import decode
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import GaitPreview, MpcState, TendonPlan
from slot_msgs.srv import InjectFault, SetGait
from slot_nodes import qos

TIMING = read_supervisor().timing
TICK = 0.033  # s, between two odometry readings
V_X = 9  # in the state of a reference


@pytest.fixture(scope="module")
def rig(simulate):
    """A robot with simulated servos."""
    made = simulate()
    made.subscribe("/mpc_state", MpcState, qos.CONTROL)
    made.subscribe("/tendon_plan", TendonPlan, qos.CONTROL)
    made.subscribe("/gait_preview", GaitPreview, qos.CONTROL)
    return made


@pytest.mark.parametrize(
    "name",
    [
        "state_estimator",
        "gait_scheduler",
        "mpc_controller",
        "force_mapper",
        "sim_robot",
    ],
)
def test_after_a_killed_node_the_robot_walks_again_with_a_new_one(
    walking, name
):
    walking.wait_for_state(State.FAULT, walking.kill(name))
    walking.start(name)
    walking.walk()


def test_after_an_estop_and_a_killed_supervisor_a_new_one_waits_for_an_operator(
    walking,
):
    """Though the graph is unattended."""
    begin = walking.now()
    walking.request("estop")
    walking.wait_for_state(State.ESTOP, begin)
    walking.kill("supervisor")
    begin = walking.now()
    walking.start("supervisor")
    walking.run(1.0)
    assert walking.state is State.IDLE
    assert not any(any(m.torque) for m in walking.since("/servo_health", begin))
    assert "obeyed an earlier supervisor" in walking.log("supervisor")
    walking.walk()


@pytest.mark.parametrize(
    "name", ["sim_robot", "state_estimator", "mpc_controller"]
)
def test_a_node_that_was_suspended_for_a_second_catches_up(walking, name):
    walking.pause(name)
    walking.run(1.0)
    walking.resume(name)
    walking.run(0.1)
    resumed, commands = walking.now(), walking.messages["/desired_joint_angles"]
    walking.wait_for(
        lambda: sum(decode.stamp(m) > resumed for m in commands) > 15, 2.0
    )
    walking.walk()


def test_a_controller_slower_than_its_period_skips_states_without_a_queue(
    walking,
):
    walking.pause("mpc_controller")
    walking.run(0.2)  # six states
    before = walking.last("/tendon_plan")
    walking.resume("mpc_controller")
    # the first plan is of the newest state that has arrived at this node
    since = decode.stamp(before) + 1
    after, *_ = walking.wait_for(lambda: walking.since("/tendon_plan", since))
    skipped = round((decode.stamp(after) + 1 - since) * 1e-9 / TICK) - 1
    assert after.skipped - before.skipped == skipped > 3
    walking.solve_time = 1.5 * TICK
    walking.run(3 * TICK)
    walking.solve_time = SOLVE_TIME
    # two or three ticks, and one whose state has waited
    assert 2 <= walking.last("/tendon_plan").overruns - after.overruns <= 4


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (
            {"kind": "tired"},
            "inject: fault.kind = 'tired': expected one of silent, ",
        ),
        (
            {"kind": "tendon_broken", "clear": True},
            "no fault 'tendon_broken' at 'FL'",
        ),
    ],
)
def test_a_fault_that_cannot_be_is_refused_with_the_reason(rig, fault, reason):
    answer = rig.call(
        InjectFault, "/sim_robot/inject", **({"leg": "FL"} | fault)
    )
    assert not answer.success
    assert answer.message.startswith(reason)


@pytest.mark.parametrize(("gait", "v_x"), [("stand", 0.0), ("walk", 0.02)])
def test_what_was_requested_last_holds_after_a_hold(walking, gait, v_x):
    """A robot that was told to stand does not walk off; the velocity of the start is 0.05 m/s."""
    request = {"gait": gait, "velocity": Vector3(x=v_x)}
    assert walking.call(SetGait, "/set_gait", **request).success
    walking.wait_for(lambda: walking.last("/gait_preview").gait == gait)
    begin = walking.pause("force_mapper")
    walking.run(2 * TIMING.command_hold)
    walking.resume("force_mapper")
    walking.wait_for_state(State.HOLD, begin)
    since, _ = walking.wait_for_state(State.WALKING, begin)
    walking.wait_for(lambda: len(walking.since("/gait_preview", since)) > 44)
    previews = walking.since("/gait_preview", since)[:44]  # two strides
    assert {preview.gait for preview in previews} == {gait}
    mean = np.mean([preview.reference[V_X] for preview in previews])
    assert mean == pytest.approx(v_x, abs=0.01)

"""Settings of the policy as parameters: set while the robot stands, recorded, and replayed."""

import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message

from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.record_settings import read_record_settings
from slot_core.safety.states import State
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag
from slot_lab.bags.replay_command import TOLERANCE
from slot_msgs.msg import EmergencyStop, GaitPreview, MpcState, TendonPlan
from slot_nodes import qos

KINDS = {
    "/mpc_state": MpcState,
    "/gait_preview": GaitPreview,
    "/tendon_plan": TendonPlan,
}
WEIGHT = Parameter("cost.height", value=0.003)


@pytest.fixture(scope="module")
def rig(simulate):
    """A robot that stands."""
    made = simulate(attended=True)
    for topic, kind in KINDS.items():
        made.subscribe(topic, kind, qos.CONTROL)
    estop = made.publisher(EmergencyStop, "estop", qos.SENSOR)
    made.every(0.1, lambda: estop.publish(EmergencyStop(source="button")))
    for request in ("ready", "stand"):
        made.wait_for(lambda name=request: not made.request(name))
    made.wait_for(lambda: made.state is State.STANDING)
    made.run(1.5)
    return made


def set_parameters(rig, *wanted):
    """The answer of mpc_controller to `ros2 param set`."""
    return rig.nodes["mpc_controller"].set_parameters_atomically(list(wanted))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("cost.height", 1e3, "cost.height out of range Min: 1e-05, Max: 10.0"),
        (
            "stages",
            90,
            "stages: no plan yet; preview.contact: shape (24, 4), needs (92, 4)",
        ),
        ("knots", [0, 3, 2], "knots = (0, 3, 2): expected 0, then rising"),
        (
            "observer.drift_max",
            [1.0],
            "drift_max = [1.0]: expected 3 values, got 1",
        ),
        ("policy", "force_mpc", "read-only"),
    ],
)
def test_a_setting_that_does_not_fit_is_refused_with_a_reason(
    rig, name, value, reason
):
    answer = set_parameters(rig, Parameter(name, value=value))
    assert not answer.successful
    assert reason in answer.reason
    rig.run(0.1)
    assert rig.last("/tendon_plan").settings == ""


def test_a_weight_set_while_standing_acts_and_the_bag_replays_it(rig, tmp_path):
    rig.run(0.5)
    assert set_parameters(
        rig, WEIGHT, Parameter("use_sim_time", value=False)
    ).successful
    rig.run(0.5)
    assert rig.last("/tendon_plan").settings == '{"cost.height": 0.003}'
    assert rig.last("/tendon_plan").status == TendonPlan.SOLVED
    rig.wait_for(lambda: not rig.request("walk"))
    rig.walk()
    rig.run(2.0)
    refused = set_parameters(rig, Parameter("cost.height", value=0.002))
    assert (
        refused.reason
        == "gait walk: settings change in stand only, see /set_gait"
    )

    assert differences(rig, tmp_path / "bag") == set()
    for plan in rig.messages["/tendon_plan"]:
        plan.settings = ""
    assert differences(rig, tmp_path / "without") == {"/tendon_plan"}


def differences(rig, path):
    """Topics whose replay differs, of a bag of what the rig has published."""
    with BagWriter(path, read_record_settings()) as bag:
        for topic, kind in KINDS.items():
            name = f"slot_msgs/msg/{kind.__name__}"
            for number, message in enumerate(rig.messages[topic]):
                bag.write(
                    topic, name, 1000 * number, serialize_message(message)
                )
    compared = check_bag(Bag(path), TOLERANCE)
    assert next(c for c in compared if c.topic == "/tendon_plan").compared > 100
    return {c.topic for c in compared if c.first is not None}

"""Velocities as teleop_twist_keyboard and Nav2 publish them: without a stamp, beyond the reach."""

import pytest
from geometry_msgs.msg import Twist, TwistStamped

from slot_bringup.monitor import listener
from slot_core.gait.gait import read_gaits
from slot_msgs.msg import GaitPreview
from slot_nodes import qos

PERIOD = 0.05  # s, of a controller of Nav2
TELEOP = 0.5, 1.0  # m/s, rad/s of its first key
KINDS = {True: TwistStamped, False: Twist}


@pytest.fixture(scope="module", params=KINDS)
def rig(request, simulate):
    made = simulate(stamped_cmd_vel=request.param)
    made.stamped = request.param
    made.subscribe("/gait_preview", GaitPreview, qos.CONTROL)
    yield made
    made.close()


def test_the_speed_of_a_keyboard_walks_the_robot_as_fast_as_it_can_on_that_curve(
    walking,
):
    begin, message = walking.now(), KINDS[walking.stamped]()
    twist = message.twist if walking.stamped else message
    twist.linear.x, twist.angular.z = TELEOP
    out = walking.publisher(type(message), "cmd_vel", qos.SENSOR)
    timer = walking.every(PERIOD, lambda: out.publish(message))
    walking.run(2.0)
    timer.cancel()
    for preview in walking.messages["/gait_preview"][-10:]:
        v_x, v_y, turn = preview.velocity
        assert (v_y, turn) == pytest.approx((0.0, 2.0 * v_x))
        assert v_x == read_gaits().clipped("walk", [0.5, 0.0, 1.0])[0][0] > 0.01
    said = {
        line
        for m in walking.since("/robot_state", begin)
        for line in m.warnings
    }
    assert len(said) == 1
    assert said.pop().startswith(
        "velocity clipped to the reach of gait walk: v_x 0.5 to "
    )
    assert walking.log("gait_scheduler") == ""  # nothing is refused
    walking.run(1.0)
    assert list(walking.last("/robot_state").warnings) == []


def test_a_publisher_of_the_other_type_is_named(walking):
    wrong = KINDS[not walking.stamped]
    change = "false" if walking.stamped else "true"
    line = (
        f"cmd_vel of teleop is not heard, a {wrong.__name__}: "
        f"start with stamped_cmd_vel {change}"
    )
    with listener("teleop") as (node, _):
        node.create_publisher(wrong, "cmd_vel", qos.SENSOR)
        walking.wait_for(
            lambda: list(walking.last("/robot_state").warnings) == [line]
        )
    # once; DDS may tell the name of a new node a moment after its publisher
    assert walking.logs["gait_scheduler"].count(line) == 1
    walking.wait_for(lambda: not walking.last("/robot_state").warnings)

"""What switches the robot off: the e-stop, its source's silence, and a torso that tilts."""

import pytest
from relay import FOR_RELAYS, Relay, remaps
from scipy.spatial.transform import Rotation
from std_msgs.msg import Bool

from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import RobotState
from slot_nodes import qos

TICK = 0.033  # s, between two odometry readings
BUSY = 0.3  # s that a busy machine may add
REPEAT = 0.1  # s, between two words of the e-stop


class EStop:
    """An e-stop that says all the time whether it is pressed, unless its cable is cut."""

    def __init__(self, rig):
        self.rig, self.pressed, self.cut = rig, False, False
        self._out = rig.node.create_publisher(Bool, "/estop", qos.SENSOR)
        rig.node.create_timer(REPEAT, self.tell)

    def tell(self):
        if not self.cut:
            self._out.publish(Bool(data=self.pressed))

    def press(self, pressed):
        """Returns the time before it."""
        begin = self.rig.now()
        self.pressed = pressed
        self.tell()
        return begin


@pytest.fixture(scope="module")
def rig(make_rig):
    made = make_rig(hardware="sim", config=FOR_RELAYS, remaps=remaps("odom"))
    made.relay = Relay(made, "odom")
    made.estop = EStop(made)
    return made


@pytest.fixture
def walking(rig):
    rig.walk_on()
    return rig


def settled(rig):
    """Wait until the e-stop's last word has been heard."""
    told = rig.now()
    rig.wait_for(lambda: rig.now() - told > 2e9 * REPEAT)


def test_a_pressed_estop_switches_off_at_once_until_it_is_released_and_reset(walking):
    begin = walking.estop.press(True)
    stopped, reason = walking.reached(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < BUSY
    assert reason == "e-stop pressed"
    assert walking.last("/robot_state").action == RobotState.ACTION_OFF
    assert walking.ask("reset") == "RESET refused in ESTOP: e-stop pressed"
    walking.estop.press(False)
    settled(walking)
    assert walking.state is State.ESTOP
    assert walking.ask("ready") == "READY changes nothing in ESTOP"
    assert walking.ask("reset") == ""
    walking.wait_for(lambda: walking.state is State.IDLE)
    assert max(walking.last("/joint_states").position) < 0.05  # the tendons have unwound


def test_an_estop_whose_source_is_lost_switches_off_until_it_is_back_and_reset(walking):
    begin = walking.now()
    walking.estop.cut = True
    stopped, reason = walking.reached(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < walking.limit("estop") + BUSY
    assert reason.startswith("e-stop source silent for ")
    assert reason.endswith(" s, limit 0.5 s")
    assert "e-stop source silent" in walking.ask("reset")
    walking.estop.cut = False
    settled(walking)
    assert walking.state is State.ESTOP
    assert walking.ask("reset") == ""


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_torso_beyond_half_a_radian_goes_slack_and_stays_so_until_it_is_upright(walking, axis):
    """A jump of the odometry is doubted first, as one of 10 cm is: it is believed when it stays."""

    def tilt(message):
        turned = message.pose.pose.orientation
        before = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w])
        after = before * Rotation.from_euler(axis, 0.75)
        turned.x, turned.y, turned.z, turned.w = (float(part) for part in after.as_quat())

    name = {"x": "roll", "y": "pitch"}[axis]
    with walking.relay.changed(tilt) as begin:
        relaxed, reason = walking.reached(State.RELAX, begin)
        assert (relaxed - begin) * 1e-9 < 7 * TICK + BUSY
        assert reason.startswith(f"{name} +0.")
        assert reason.endswith(f" rad, limit {read_supervisor().estimate.tilt_max:g} rad")
        walking.reached(State.FAULT, relaxed)
        assert walking.ask("reset") == ""
        assert walking.ask("ready").startswith(f"READY refused in IDLE: {name} +0.")
    walking.walk()


def test_where_an_estop_is_required_nothing_moves_without_its_source(walking):
    walking.kill("supervisor")
    walking.estop.cut = True
    walking.start("supervisor", parameters={"estop_required": True})
    walking.wait_for(lambda: walking.state is State.IDLE)
    refusal = "READY refused in IDLE: e-stop source silent for ever, limit 0.5 s"
    walking.wait_for(lambda: walking.ask("ready") == refusal)
    assert walking.state is State.IDLE
    walking.estop.cut = False
    walking.walk()

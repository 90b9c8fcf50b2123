"""Each node of a walking graph is killed with SIGKILL: by whose rule the robot stops, and how soon.

Times are those of the messages' stamps. BUSY is what a busy machine may add to a limit.
"""

import numpy as np
import pytest

from slot_core.bags import decode
from slot_core.safety.states import State

TICK = 0.033  # s, between two odometry readings
BUSY = 0.3  # s
# As PATIENT, but no longer than it takes to tell the limits apart.
QUICK = {
    "supervisor.yaml": {
        "slack_max: 1.4e-3": "slack_max: 2.0e-2",  # late commands are not the tendons' fault
        "command_hold: 0.1": "command_hold: 0.4", "command_lost: 0.5": "command_lost: 1.2",
        "heartbeat: 0.5": "heartbeat: 1.2", "servo_silent: 0.5": "servo_silent: 1.2",
        "coast_cycles: 3 ": "coast_cycles: 30 ",
    },
    "mpc.yaml": {"time_budget: 0.02": "time_budget: 0.2"},
}  # fmt: skip
CONTROLLER = ("state_estimator", "gait_scheduler", "mpc_controller", "force_mapper")


@pytest.fixture(scope="module")
def rig(make_rig, tmp_path_factory):
    """A robot on simulated servos that is recorded."""
    bag = tmp_path_factory.mktemp("killed") / "bag"
    made = make_rig(hardware="sim", config=QUICK, bag=str(bag))
    made.bag = bag
    return made


@pytest.fixture
def walking(rig):
    rig.walk_on()
    return rig


def seconds_to(rig, state, begin):
    return (rig.reached(state, begin)[0] - begin) * 1e-9


def is_slack(rig):
    """Whether the servos have let go and the tendons have unwound."""
    return max(rig.last("/joint_states").position) < 0.05


@pytest.mark.parametrize("name", [*CONTROLLER, "sim_robot"])
def test_without_a_node_the_supervisor_holds_then_relaxes_and_the_robot_walks_again_with_it(
    walking, name
):
    begin = walking.kill(name)
    hold, relax = (seconds_to(walking, s, begin) for s in (State.HOLD, State.RELAX))
    assert hold < walking.limit("command_hold") + TICK + BUSY
    assert relax < walking.limit("command_lost") + TICK + BUSY
    walking.reached(State.FAULT, begin)
    if name != "sim_robot":  # which has taken its servos with it
        walking.wait_for(lambda: is_slack(walking))
    walking.start(name)
    walking.walk()


def test_without_the_supervisor_the_servos_hold_then_relax_and_the_robot_walks_again_with_it(
    walking,
):
    before = len(walking.log("sim_robot"))
    begin = walking.kill("supervisor")
    walking.wait_for(lambda: is_slack(walking))
    told = walking.log("sim_robot")[before:]
    for action, limit in (("HOLD", "command_hold"), ("RELAX", "command_lost")):
        taken = logged(told, f"{action} no message of the supervisor") - begin * 1e-9
        assert taken < walking.limit(limit) + BUSY
    walking.start("supervisor")
    walking.wait_for(lambda: walking.state is not State.WALKING)
    walking.walk()
    moving = walking.now()
    walking.wait_for(lambda: angles(walking, moving).size and np.ptp(angles(walking, moving)) > 0.5)


def logged(text, words):
    """Time of the first line with `words`, s."""
    line = next(line for line in text.splitlines() if words in line)
    return float(line.split("[")[2].split("]")[0])


def angles(rig, begin):
    """Measured tendon angles since `begin`, rad."""
    joints = rig.heard["/joint_states"][-200:]
    return np.array([list(m.position) for m in joints if decode.stamp(m) > begin])


def test_without_the_recorder_the_robot_walks_on(walking):
    begin = walking.kill("recorder")
    walking.wait_for(lambda: walking.now() - begin > 1.5e9)
    after = [state for since, state, _ in walking.transitions if since >= begin]
    assert State.RELAX not in after
    walking.walk()


def test_a_rod_that_is_nowhere_ends_the_simulation_and_keeps_its_state(walking):
    begin = walking.inject("nan", "FL")
    assert walking.exit_code("sim_robot") == 1
    line = walking.log("sim_robot").splitlines()[-1]
    assert "simulation stopped: solution lost in step" in line
    (file,) = walking.bag.glob("lost_*.npz")
    assert line.endswith(f"; its state is in {file}")
    hold, relax = (seconds_to(walking, s, begin) for s in (State.HOLD, State.RELAX))
    assert hold < walking.limit("command_hold") + TICK + BUSY
    assert relax < walking.limit("command_lost") + TICK + BUSY
    walking.reached(State.FAULT, begin)

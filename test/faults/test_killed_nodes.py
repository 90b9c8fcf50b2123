"""SIGKILL of each node of a walking graph: which limit stops the robot, and how soon.

Times are those of the messages' stamps.
"""

import numpy as np
import pytest
from real_graph import SLOW_MPC
from rig import BUSY, TICK

from slot_core.bags import decode
from slot_core.safety.states import State

# Shorter than PATIENT, but so long that the limits can be distinguished.
QUICK = {
    "supervisor": {
        "timing.command_hold": 0.4,
        "timing.command_lost": 1.2,
        "timing.heartbeat": 1.2,
        "timing.servo_silent": 1.2,
        "estimate.coast_cycles": 30,
        "estimate.silence": 1.0,
    },
    "mpc": SLOW_MPC,
}
CONTROLLER = ("state_estimator", "gait_scheduler", "mpc_controller", "force_mapper")


@pytest.fixture(scope="module")
def rig(make_rig, tmp_path_factory):
    """A robot with simulated servos, recorded in a bag."""
    bag = tmp_path_factory.mktemp("killed") / "bag"
    made = make_rig(hardware="sim", config=QUICK, bag=str(bag))
    made.bag = bag
    return made


@pytest.fixture
def walking(rig):
    rig.walk_steadily()
    return rig


def seconds_to(rig, state, begin):
    """Wait for a state; returns the seconds since `begin`."""
    return (rig.wait_for_state(state, begin)[0] - begin) * 1e-9


def is_slack(rig):
    """Whether the tendons are slack."""
    return max(rig.last("/joint_states").position) < 0.05


@pytest.mark.parametrize("name", [*CONTROLLER, "sim_robot"])
def test_a_killed_node_ends_in_hold_then_relax_and_the_robot_walks_again_with_a_new_one(
    walking, name
):
    begin = walking.kill(name)
    hold, relax = (seconds_to(walking, s, begin) for s in (State.HOLD, State.RELAX))
    assert hold < walking.limit("command_hold") + TICK + BUSY
    assert relax < walking.limit("command_lost") + TICK + BUSY
    walking.wait_for_state(State.FAULT, begin)
    if name != "sim_robot":  # the servos end with it
        walking.wait_for(lambda: is_slack(walking))
    walking.start(name)
    walking.walk()


def test_a_killed_supervisor_ends_in_hold_then_relax_and_the_robot_walks_again_with_a_new_one(
    walking,
):
    before = len(walking.log("sim_robot"))
    begin = walking.kill("supervisor")
    walking.wait_for(lambda: is_slack(walking))
    log = walking.log("sim_robot")[before:]
    for action, limit in (("HOLD", "command_hold"), ("RELAX", "command_lost")):
        taken = time_logged(log, f"{action} no message of the supervisor") - begin * 1e-9
        assert taken < walking.limit(limit) + BUSY
    walking.start("supervisor")
    walking.wait_for(lambda: walking.state is not State.WALKING)
    walking.walk()
    moving = walking.now()
    walking.wait_for(lambda: angles(walking, moving).size and np.ptp(angles(walking, moving)) > 0.5)


def time_logged(log, part):
    """Time of the first line of a log that contains `part`, s."""
    line = next(line for line in log.splitlines() if part in line)
    return float(line.split("[")[2].split("]")[0])


def angles(rig, begin):
    """Measured tendon angles since `begin`, rad."""
    joints = rig.messages["/joint_states"][-200:]
    return np.array([list(m.position) for m in joints if decode.stamp(m) > begin])


def test_the_robot_walks_on_without_the_recorder(walking):
    begin = walking.kill("recorder")
    walking.wait_for(lambda: walking.now() - begin > 1.5e9)
    after = [state for since, state, _ in walking.transitions if since >= begin]
    assert State.RELAX not in after
    walking.walk()


def test_a_lost_simulation_ends_its_node_and_writes_its_state(walking):
    begin = walking.inject("nan", "FL")
    assert walking.exit_code("sim_robot") == 1
    line = walking.log("sim_robot").splitlines()[-1]
    assert "simulation diverged in step" in line
    (file,) = walking.bag.glob("lost_*.npz")
    assert line.endswith(f"; its state is in {file}")
    hold, relax = (seconds_to(walking, s, begin) for s in (State.HOLD, State.RELAX))
    assert hold < walking.limit("command_hold") + TICK + BUSY
    assert relax < walking.limit("command_lost") + TICK + BUSY
    walking.wait_for_state(State.FAULT, begin)

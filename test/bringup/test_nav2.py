"""Parameters for Nav2 against what the robot reaches, its frames, topics and size."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from slot_core.gait.gait import read_gaits
from slot_core.robot import read_robot

FILE = Path(__file__).parents[2] / "slot_bringup/nav2/nav2_params.yaml"
NODES = {
    name: content.get("ros__parameters") or content[name]["ros__parameters"]
    for name, content in yaml.safe_load(FILE.read_text()).items()
}
FOLLOW, BEHAVIOR = (
    NODES["controller_server"]["FollowPath"],
    NODES["behavior_server"],
)


@pytest.mark.parametrize(
    "velocity",
    [
        [FOLLOW["desired_linear_vel"], 0.0, 0.0],
        [FOLLOW["regulated_linear_scaling_min_speed"], 0.0, 0.0],
        [0.0, 0.0, FOLLOW["rotate_to_heading_angular_vel"]],
        [0.0, 0.0, BEHAVIOR["max_rotational_vel"]],
        [0.0, 0.0, BEHAVIOR["min_rotational_vel"]],
    ],
)
def test_the_gait_reaches_every_speed(velocity):
    assert read_gaits().clipped("walk", velocity)[1] == ""


def test_acceleration_and_progress_are_those_of_the_robot():
    turns = FOLLOW["max_angular_accel"], BEHAVIOR["rotational_acc_lim"]
    assert max(turns) <= read_gaits().turn_acceleration
    progress = NODES["controller_server"]["progress_checker"]
    slowest = (
        progress["required_movement_radius"]
        / progress["movement_time_allowance"]
    )
    assert slowest < 0.5 * FOLLOW["regulated_linear_scaling_min_speed"]


@pytest.mark.parametrize("costmap", ["local_costmap", "global_costmap"])
def test_the_footprint_holds_the_feet_of_straight_legs(costmap):
    corners = np.array(json.loads(NODES[costmap]["footprint"]))
    robot = read_robot()
    tips = robot.clamps[:, :2] + robot.leg.reach * robot.outward[:, :2]
    assert (np.abs(tips) < corners.max(axis=0)).all()

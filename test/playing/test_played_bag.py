"""Bag of a played robot: the checks of a recorded walk hold for it."""

import numpy as np

from slot_bringup.playing import play_page
from slot_lab.bags.bag import Bag
from slot_lab.bags.check_bag import check_bag
from slot_lab.play.played_robot import PlayedRobot


def test_a_saved_bag_replays_equal_to_the_last_bit_though_the_world_has_changed(
    tmp_path,
):
    robot = PlayedRobot()
    robot.wishes.gait, robot.wishes.velocity = (
        "walk",
        np.array([0.05, 0.0, 0.0]),
    )
    for frame in range(125):
        if frame == 100:
            robot.change({"scene.payload.mass": 0.2})
            robot.push([0.0, 5.0, 0.0], 0.2)
        robot.advance()
    count = play_page.save(robot, tmp_path / "bag")
    bag = Bag(tmp_path / "bag")
    assert sum(bag.counts.values()) == count
    states, *found = check_bag(bag, 0.0)
    assert states.why == "no record of state_estimator in the bag"
    assert all(stage.compared > 100 for stage in found)
    assert [stage.first for stage in found] == [None] * 3

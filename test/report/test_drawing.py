"""Drawing and curves of a run: what each message of the graph changes."""

from pathlib import Path

import numpy as np
import pytest
from bag_messages import message
from scipy.spatial.transform import Rotation

from slot_core.drawing import drawing as shapes
from slot_core.drawing.drawing import Drawing
from slot_core.robot import TENDON_JOINTS, read_robot
from slot_lab.bags.bag import Bag
from slot_lab.report import traces

WALK = Path(__file__).parents[1] / "bags" / "walk"
ROBOT = read_robot()
TORQUE = 1.4  # N m
STAGES = 3


def preview():
    """A preview of STAGES stages at 60 mm and 50 mm/s, to the left."""
    reference = np.zeros((STAGES, 12))
    reference[:, [2, 5, 10]] = np.pi / 2, 0.06, 0.05
    each = np.zeros((STAGES, 4))
    arrays = dict.fromkeys(("friction", "normal_force", "tendon_angle"), each)
    return message(
        "/gait_preview",
        1.0,
        gait="walk",
        stages=STAGES,
        contact=each.astype(bool),
        reference=reference,
        velocity_ahead=np.zeros((STAGES, 3)),
        **arrays,
    )


def legs():
    """Four legs of 22 nodes, without stress."""
    drawn = shapes.natural_legs(
        np.zeros(3), Rotation.identity().as_quat(), ROBOT, 22
    )
    return message(
        "/ground_truth/legs",
        1.0,
        tension=np.array([0.0, 70.0, 140.0, 9.0]),
        ground_force=np.tile([0.0, 0.0, 5.0], (4, 1)),
        nodes=22,
        position=drawn.nodes,
    )


def joints(torque):
    return message(
        "/joint_states",
        1.0,
        name=list(TENDON_JOINTS),
        position=np.zeros(4),
        effort=torque,
    )


def test_legs_reach_from_the_clamps_to_the_feet_with_their_tendons_below():
    turn, place = (
        Rotation.from_euler("xyz", [0.2, -0.1, 0.9]),
        np.array([0.3, -0.2, 0.08]),
    )
    drawn = shapes.natural_legs(place, turn.as_quat(), ROBOT, 30)
    assert np.allclose(drawn.nodes[:, 0], place + turn.apply(ROBOT.clamps))
    assert np.allclose(drawn.nodes[:, -1], place + turn.apply(ROBOT.feet))
    tendon = shapes.tendon_strips(drawn, np.zeros(4), ROBOT, 1.0).points
    apart = (tendon - drawn.nodes[:, : tendon.shape[1]]).reshape(-1, 3)
    assert np.allclose(np.linalg.norm(apart, axis=1), ROBOT.tendon.offset)
    assert np.all(turn.inv().apply(apart)[:, 2] < -0.8 * ROBOT.tendon.offset)
    share = tendon.shape[1] / 30  # up to the anchor
    assert share == pytest.approx(ROBOT.tendon.end_fraction, abs=1.5 / 30)


def test_a_simulated_walk_is_drawn_with_its_bent_legs_where_they_were():
    drawing, seen, last, bag = Drawing(ROBOT, TORQUE), {}, {}, Bag(WALK)
    for topic, _, received in bag.merged(*Drawing.TOPICS):
        seen |= drawing.receive(topic, received)
        last[topic] = received
    assert set(seen) == {
        "torso",
        "path",
        "legs",
        "tendons",
        "ground_forces",
        "demanded_forces",
        "predicted_path",
        "predicted_feet",
        "horizon",
        "reference",
        "reference_path",
    }
    place = last["/ground_truth/odom"].pose.pose.position
    end = np.array([place.x, place.y, place.z])
    assert np.allclose(seen["torso"].centre, end)
    middles = seen["legs"].corners.mean(axis=2)
    nodes = last["/ground_truth/legs"].position.reshape(middles.shape)
    assert np.allclose(middles, nodes, atol=1e-6)  # float32
    assert np.allclose(seen["ground_forces"].tail, middles[:, -1])
    (path,) = seen["path"].points
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).min() >= 0.005
    assert np.linalg.norm(path[-1] - end) < 0.005


def test_without_a_simulator_the_legs_are_drawn_as_without_stress_and_loaded_by_the_servos():
    drawing = Drawing(ROBOT, TORQUE)
    # no pose yet
    assert drawing.receive("/joint_states", joints(np.zeros(4))) == {}
    state = message(
        "/mpc_state", 1.0, rpy=[0.1, 0.0, 0.5], position=[0.2, 0.1, 0.07]
    )
    seen = drawing.receive("/mpc_state", state)
    quaternion = Rotation.from_euler("xyz", [0.1, 0.0, 0.5]).as_quat()
    natural = shapes.natural_legs(
        np.array([0.2, 0.1, 0.07]), quaternion, ROBOT, 20
    )
    assert np.allclose(
        seen["legs"].corners, shapes.leg_bars(natural, ROBOT).corners
    )
    assert np.array_equal(seen["legs"].colours, np.tile(shapes.SLACK, (4, 1)))
    loaded = drawing.receive(
        "/joint_states", joints(TORQUE * np.array([0.0, 0.5, 1.0, 2.0]))
    )
    assert np.allclose(
        loaded["tendons"].colours[[0, 2, 3]],
        [shapes.SLACK, *2 * [shapes.LOADED]],
    )
    drawing.receive("/ground_truth/legs", legs())
    assert drawing.receive("/mpc_state", state) == {}  # the exact pose counts


@pytest.mark.parametrize(
    ("topic", "broken", "reason"),
    [
        ("/ground_truth/legs", {"nodes": 7}, "not 4 legs of 7 nodes"),
        ("/ground_truth/legs", {"position": np.full(264, np.nan)}, "finite"),
        (
            "/ground_truth/legs",
            {"director": np.ones(264)},
            "director has 264 values",
        ),
        ("/ground_truth/legs", {"director": np.full(252, np.nan)}, "finite"),
        ("/gait_preview", {"stages": 2}, "not 2 stages"),
        ("/mpc_state", {}, "finite"),
    ],
)
def test_a_message_that_does_not_fit_is_refused_with_its_reason(
    topic, broken, reason
):
    received = {
        "/ground_truth/legs": legs(),
        "/gait_preview": preview(),
        "/mpc_state": message("/mpc_state", 1.0, position=[np.nan, 0.0, 0.0]),
    }[topic]
    for name, value in broken.items():
        setattr(received, name, value)
    with pytest.raises(ValueError, match=reason):
        Drawing(ROBOT, TORQUE).receive(topic, received)


def test_curves_of_the_torso_are_along_its_heading_in_the_units_of_their_plots():
    rpy, place = np.array([0.1, -0.05, 0.4]), [0.3, -0.2, 0.06]
    turn, velocity = Rotation.from_euler("xyz", rpy), [0.05, 0.02, 0.01]
    truth = {
        "pose__pose__position": place,
        "pose__pose__orientation": turn.as_quat(),
        "twist__twist__linear": turn.inv().apply(velocity),
    }
    state = {"rpy": rpy, "position": place, "linear_velocity": velocity}
    seen = traces.values(
        "/ground_truth/odom", message("/ground_truth/odom", 1.0, **truth)
    ) | traces.values("/mpc_state", message("/mpc_state", 1.0, **state))
    ahead = 0.05 * np.cos(0.4) + 0.02 * np.sin(0.4)
    for source in ("true", "estimated"):
        assert seen[f"velocity/{source}"] == pytest.approx([ahead])
        assert seen[f"height/{source}"] == pytest.approx([60.0])
        assert seen[f"roll/{source}"] == pytest.approx([np.degrees(0.1)])
        assert seen[f"pitch/{source}"] == pytest.approx([-np.degrees(0.05)])
    reference = traces.values("/gait_preview", preview())
    assert reference["velocity/reference"] == pytest.approx([0.05])
    assert reference["height/reference"] == pytest.approx([60.0])


def test_states_are_named_and_disturbances_in_a_users_units():
    walking = message("/robot_state", 1.0, state=3)
    assert traces.states("/robot_state", walking) == {"supervisor": "WALKING"}
    plan = message("/tendon_plan", 1.0, stages=1, status=2, force=np.zeros(12))
    plan.wrench[0], plan.drift[:] = -0.981, [0.02, -0.01, np.pi / 180]
    assert traces.states("/tendon_plan", plan) == {"mpc": "LATE"}
    seen = traces.values("/tendon_plan", plan)["disturbance/mpc"]
    assert seen == pytest.approx([1.0, 2.0, -1.0, 1.0])  # 100 g, cm/s, deg/s


def test_curves_of_the_legs_are_in_their_order_whatever_that_of_the_message():
    given = {"name": TENDON_JOINTS[::-1], "position": [0.4, 0.3, 0.2, 0.1]}
    for topic, curve in (
        ("/joint_states", "angle/measured"),
        ("/desired_joint_angles", "angle/commanded"),
    ):
        seen = traces.values(topic, message(topic, 1.0, **given))[curve]
        assert seen == pytest.approx(np.degrees([0.1, 0.2, 0.3, 0.4]))
    truth = traces.values("/ground_truth/legs", legs())
    assert np.array_equal(truth["tension/simulated"], [0.0, 70.0, 140.0, 9.0])
    assert np.array_equal(truth["force/ground"], np.full(4, 5.0))

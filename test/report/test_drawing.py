"""Drawing and curves of a run: what each message of the graph changes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import ROBOT, STRIDE, Walk, angles, leg_nodes, message, write_walk

from slot_core.drawing import shapes
from slot_core.drawing.drawing import Drawing
from slot_core.robot import TENDON_JOINTS
from slot_lab.bags.bag import Bag
from slot_lab.report import traces

WALK = Walk(duration=0.8, roll=0.1, bounce=0.004, yaw_rate=0.1)
TORQUE = 1.4  # N m
STAGES = 3


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return Bag(write_walk(tmp_path_factory.mktemp("bags") / "walk", WALK))


def preview(stamp=1.0, speed=0.05, height=0.06):
    """A preview of STAGES stages; with a roll, along the direction of a yaw."""
    reference = np.zeros((STAGES, 12))
    reference[:, 0], reference[:, 2] = 0.02, np.pi / 2
    reference[:, 3] = 0.01 * np.arange(STAGES)
    reference[:, 5], reference[:, 10] = height, speed
    each = np.zeros((STAGES, 4))
    arrays = dict.fromkeys(("friction", "normal_force", "tendon_angle"), each)
    return message(
        "/gait_preview",
        stamp,
        gait="walk",
        stages=STAGES,
        contact=each.astype(bool),
        reference=reference,
        velocity_ahead=np.zeros((STAGES, 3)),
        **arrays,
    )


def legs(nodes, stamp=1.0, director=()):
    return message(
        "/ground_truth/legs",
        stamp,
        tension=np.array([0.0, 70.0, 140.0, 9.0]),
        ground_force=np.tile([0.0, 0.0, 5.0], (4, 1)),
        nodes=nodes.shape[1],
        position=nodes,
        director=director,
    )


def joints(torque):
    return message(
        "/joint_states",
        1.0,
        name=list(TENDON_JOINTS),
        position=np.zeros(4),
        effort=torque,
    )


def test_a_simulated_walk_is_drawn_with_its_bent_legs_where_they_were(bag):
    drawing, seen = Drawing(ROBOT, TORQUE), {}
    for topic, _, received in bag.merged(
        *set(Drawing.TOPICS) & set(bag.topics) - {"/gait_preview"}
    ):
        seen |= drawing.receive(topic, received)
    assert set(seen) == {
        "torso",
        "path",
        "legs",
        "tendons",
        "ground_forces",
        "demanded_forces",
    }
    end = WALK.duration
    assert np.allclose(seen["torso"].centre, WALK.position(end))
    middles = seen["legs"].corners.mean(axis=2)
    assert np.allclose(middles, leg_nodes(WALK, end), atol=1e-6)  # float32
    assert np.allclose(seen["ground_forces"].tail, middles[:, -1])
    (path,) = seen["path"].points
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.min() >= 0.005
    assert np.linalg.norm(path[-1] - WALK.position(end)) < 0.005


def test_without_a_simulator_the_legs_are_drawn_as_without_stress_and_loaded_by_the_servos():
    drawing = Drawing(ROBOT, TORQUE)
    assert drawing.receive("/imu", object()) == {}  # is not drawn
    assert drawing.receive("/joint_states", joints(np.zeros(4))) == {}  # no pose yet
    state = message("/mpc_state", 1.0, rpy=[0.1, 0.0, 0.5], position=[0.2, 0.1, 0.07])
    seen = drawing.receive("/mpc_state", state)
    quaternion = Rotation.from_euler("xyz", [0.1, 0.0, 0.5]).as_quat()
    natural = shapes.natural_legs(np.array([0.2, 0.1, 0.07]), quaternion, ROBOT, 20)
    assert np.allclose(seen["legs"].corners, shapes.leg_bars(natural, ROBOT).corners)
    assert np.array_equal(seen["legs"].colours, np.tile(shapes.SLACK, (4, 1)))
    loaded = drawing.receive(
        "/joint_states", joints(TORQUE * np.array([0.0, 0.5, 1.0, 2.0]))
    )
    assert np.allclose(
        loaded["tendons"].colours[[0, 2, 3]], [shapes.SLACK, *2 * [shapes.LOADED]]
    )


def test_the_exact_pose_replaces_the_estimate_once_there_is_one():
    drawing = Drawing(ROBOT, TORQUE)
    drawing.receive("/ground_truth/legs", legs(leg_nodes(WALK, 0.0)))
    assert drawing.receive("/mpc_state", message("/mpc_state", 1.0)) == {}
    assert drawing.receive("/joint_states", joints(np.ones(4))) == {}


def test_the_reference_is_a_box_in_its_pose_with_its_way_over_the_horizon():
    seen = Drawing(ROBOT, TORQUE).receive("/gait_preview", preview())
    corners = seen["reference"].points[0]
    assert np.allclose(corners.mean(axis=0)[[2]], 0.06, atol=1e-9)
    half_y = np.abs(corners[:, 0]).max()  # turned by 90 deg: the width lies along x
    assert half_y == pytest.approx(ROBOT.torso.size[1] / 2, rel=0.05)
    assert np.allclose(seen["horizon"].points[0, :, 0], [0.0, 0.01, 0.02])


def test_a_plan_shows_the_predicted_way_of_torso_and_feet():
    drawing = Drawing(ROBOT, TORQUE)
    pose, foot = np.arange(12.0).reshape(2, 6), np.arange(24.0)
    fields = {"stages": 2, "force": np.ones(24), "pose": pose.ravel(), "foot": foot}
    plan = message("/tendon_plan", 1.0, **fields)
    assert drawing.receive("/tendon_plan", plan) == {}  # no pose yet
    drawing.receive("/mpc_state", message("/mpc_state", 1.0))
    seen = drawing.receive("/tendon_plan", plan)
    assert np.array_equal(seen["predicted_path"].points, pose[None, :, 3:])
    assert np.array_equal(
        seen["predicted_feet"].points[1], [[3.0, 4.0, 5.0], [15.0, 16.0, 17.0]]
    )
    plan.foot = foot[:-1]
    with pytest.raises(ValueError, match="foot has 23 values"):
        drawing.receive("/tendon_plan", plan)


def test_disturbances_are_curves_in_a_users_units():
    fields = {
        "wrench": np.array([-0.981, 0.0, 0.0]),
        "drift": np.array([0.02, -0.01, np.pi / 180]),
    }
    seen = traces.values(
        "/tendon_plan",
        message("/tendon_plan", 1.0, stages=1, force=np.ones(12), **fields),
    )
    assert seen["disturbance/mpc"] == pytest.approx(
        [1.0, 2.0, -1.0, 1.0]
    )  # 100 g, cm/s, deg/s


@pytest.mark.parametrize(
    ("topic", "broken", "reason"),
    [
        ("/ground_truth/legs", {"nodes": 7}, "not 4 legs of 7 nodes"),
        ("/ground_truth/legs", {"position": np.full(264, np.nan)}, "finite"),
        ("/ground_truth/legs", {"director": np.ones(264)}, "director has 264 values"),
        ("/ground_truth/legs", {"director": np.full(252, np.nan)}, "finite"),
        ("/gait_preview", {"stages": 2}, "not 2 stages"),
        ("/mpc_state", {}, "finite"),
    ],
)
def test_a_message_that_does_not_fit_is_refused_with_its_reason(topic, broken, reason):
    received = {
        "/ground_truth/legs": legs(leg_nodes(WALK, 0.0)),
        "/gait_preview": preview(),
        "/mpc_state": message("/mpc_state", 1.0, position=[np.nan, 0.0, 0.0]),
    }[topic]
    for name, value in broken.items():
        setattr(received, name, value)
    with pytest.raises(ValueError, match=reason):
        Drawing(ROBOT, TORQUE).receive(topic, received)


def test_curves_of_the_torso_are_along_its_heading_in_the_units_of_their_plots(bag):
    seen = {}
    for topic in ("/ground_truth/odom", "/mpc_state"):
        for _, received in bag.messages(topic):
            seen |= traces.values(topic, received)
    end = WALK.duration
    roll, pitch, _ = np.degrees(WALK.rpy(end))
    for source in ("true", "estimated"):
        # the walk's course turns half as fast as its heading, by less than 0.1 rad
        assert seen[f"velocity/{source}"] == pytest.approx([WALK.speed], abs=2e-3)
        assert seen[f"height/{source}"] == pytest.approx([1e3 * WALK.position(end)[2]])
        assert seen[f"roll/{source}"] == pytest.approx([roll], abs=1e-6)
        assert seen[f"pitch/{source}"] == pytest.approx([pitch], abs=1e-6)
    reference = traces.values("/gait_preview", preview())
    assert reference["velocity/reference"] == pytest.approx([0.05])
    assert reference["height/reference"] == pytest.approx([60.0])


def test_curves_of_the_legs_are_in_their_order_whatever_that_of_the_message(bag):
    for topic, curve, rate, gain, late in (
        ("/joint_states", "angle/measured", 120, 0.97, 0.04),
        ("/desired_joint_angles", "angle/commanded", 30, 1.0, 0.0),
    ):
        seen = [
            traces.values(topic, received)[curve] for _, received in bag.messages(topic)
        ]
        k = round(STRIDE * rate)
        assert np.allclose(seen[k], gain * np.degrees(angles(k / rate - late)))
    truth = traces.values("/ground_truth/legs", legs(leg_nodes(WALK, 0.0)))
    assert np.array_equal(truth["tension/simulated"], [0.0, 70.0, 140.0, 9.0])
    assert np.array_equal(truth["force/ground"], np.full(4, 5.0))


def test_states_are_named_by_their_messages():
    assert traces.values("/imu", object()) == traces.states("/imu", object()) == {}
    walking = message("/robot_state", 1.0, state=3)
    late = message(
        "/tendon_plan", 1.0, stages=1, force=np.zeros(12), status=2, solve_time=0.004
    )
    assert traces.states("/robot_state", walking) == {"supervisor": "WALKING"}
    assert traces.states("/tendon_plan", late) == {"mpc": "LATE"}
    assert traces.values("/tendon_plan", late)["solve_time/mpc"] == pytest.approx([4.0])
    assert traces.states("/gait_preview", preview()) == {"gait": "walk"}

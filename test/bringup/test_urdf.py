"""URDF, RViz and Foxglove files against slot_core.robot and the messages of the graph."""

import graphlib
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from slot_core.dynamics.servo import read_servo
from slot_core.robot import BASE_FRAME, LEGS, ODOM_FRAME, TENDON_JOINTS, read_robot
from slot_msgs.msg import MpcState, TendonPlan

ROOT = Path(__file__).parents[2]
SHARE = ROOT / "slot_bringup"
URDF = ET.parse(SHARE / "urdf/slot.urdf").getroot()
SIDES = "child", "parent"
MESSAGES = {
    "mpc_state": MpcState,
    "tendon_plan": TendonPlan,
    "desired_joint_angles": JointState,
}
LAYOUT = json.loads((SHARE / "foxglove/slot.json").read_text())
RVIZ = yaml.safe_load((SHARE / "rviz/slot.rviz").read_text())["Visualization Manager"]
ROBOT = read_robot()
WRITTEN = {"rtol": 1e-5, "atol": 1e-9}  # the URDF is written with six digits


def numbers(element, path, attribute):
    return np.array(element.find(path).get(attribute).split(), dtype=float)


def link(name):
    return URDF.find(f"link[@name='{name}']")


def joint(name):
    return URDF.find(f"joint[@name='{name}']")


def test_links_form_one_tree_rooted_in_the_base_frame():
    links = [element.get("name") for element in URDF.iter("link")]
    joints = URDF.findall("joint")
    ends = {name: [j.find(name).get("link") for j in joints] for name in SIDES}
    assert len(links) == len(set(links)) == 2 + 2 * len(LEGS)
    assert sorted([BASE_FRAME, *ends["child"]]) == sorted(links)
    levels = graphlib.TopologicalSorter()
    for child, parent in zip(ends["child"], ends["parent"]):
        levels.add(child, parent)
    assert next(levels.static_order()) == BASE_FRAME  # and there is no circle


def test_torso_has_the_size_mass_and_inertia_of_the_robot():
    torso = link("torso_link")
    assert list(link(BASE_FRAME)) == []  # KDL accepts no inertia on the root link
    assert joint("torso").get("type") == "fixed"
    assert joint("torso").find("origin") is None
    for kind in ("visual", "collision"):
        size = numbers(torso, f"{kind}/geometry/box", "size")
        np.testing.assert_allclose(size, ROBOT.torso.size, **WRITTEN)
        assert torso.find(f"{kind}/origin") is None  # centred
    np.testing.assert_allclose(
        numbers(torso, "inertial/mass", "value"), ROBOT.torso.mass
    )
    inertia = torso.find("inertial/inertia").attrib
    found = [
        [float(inertia["i" + "".join(sorted(a + b))]) for b in "xyz"] for a in "xyz"
    ]
    np.testing.assert_allclose(found, ROBOT.torso.inertia, **WRITTEN)


@pytest.mark.parametrize("index", range(4), ids=LEGS)
def test_leg_frames_are_at_the_clamps_and_point_along_the_azimuths(index):
    clamp = joint(f"{LEGS[index]}_clamp")
    assert clamp.get("type") == "fixed"
    assert clamp.find("parent").get("link") == BASE_FRAME
    assert clamp.find("child").get("link") == f"leg_{LEGS[index]}_link"
    place, rpy = (numbers(clamp, "origin", name) for name in ("xyz", "rpy"))
    np.testing.assert_allclose(place, ROBOT.clamps[index], **WRITTEN)
    axes = Rotation.from_euler("xyz", rpy).apply(np.eye(3))  # URDF: about fixed axes
    np.testing.assert_allclose(axes[0], ROBOT.outward[index], atol=1e-5)
    np.testing.assert_allclose(axes[2], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("leg", LEGS)
def test_boxes_of_a_leg_join_along_its_natural_shape(leg):
    start = np.zeros(3)
    for visual in link(f"leg_{leg}_link").findall("visual"):
        length, width, thickness = numbers(visual, "geometry/box", "size")
        centre = numbers(visual, "origin", "xyz")
        along = Rotation.from_euler("xyz", numbers(visual, "origin", "rpy")).apply(
            [length, 0, 0]
        )
        np.testing.assert_allclose(
            centre - along / 2, start, atol=1e-6
        )  # m, six digits
        start = centre + along / 2
        drop = ROBOT.leg.shape(start[0]) - ROBOT.leg.shape(0.0)
        np.testing.assert_allclose(start, [start[0], 0.0, drop], atol=1e-6)
        taper = [ROBOT.leg.thickness_clamp, ROBOT.leg.thickness_tip]
        expected = np.interp(centre[0], [0, ROBOT.leg.reach], taper)
        np.testing.assert_allclose(
            [width, thickness], [ROBOT.leg.width, expected], **WRITTEN
        )
    np.testing.assert_allclose(start[0], ROBOT.leg.reach, atol=1e-6)  # up to the tip


def test_tendon_joints_are_spools_with_the_limits_of_tendon_and_servo():
    revolute = [j for j in URDF.findall("joint") if j.get("type") == "revolute"]
    assert tuple(j.get("name") for j in revolute) == TENDON_JOINTS
    servo = read_servo()
    volts = servo.nominal_voltage
    most = [
        ROBOT.tendon.angle_max,
        servo.tendon_stall(volts),
        servo.tendon_speed(volts),
    ]
    for leg, tendon in zip(LEGS, revolute):
        limit = tendon.find("limit").attrib
        found = [float(limit[key]) for key in ("lower", "upper", "effort", "velocity")]
        np.testing.assert_allclose(found, [0.0, *most], **WRITTEN)
        assert tendon.find("parent").get("link") == f"leg_{leg}_link"
        assert tendon.find("origin") is None  # at the clamp
        spool = link(tendon.find("child").get("link"))
        cylinder = spool.find("visual/geometry/cylinder").attrib
        size = [float(cylinder[key]) for key in ("radius", "length")]
        assert size == [ROBOT.tendon.spool_radius, ROBOT.leg.width]
        rpy = numbers(spool, "visual/origin", "rpy")
        drum = Rotation.from_euler("xyz", rpy).apply([0, 0, 1])
        axis = numbers(tendon, "axis", "xyz")
        np.testing.assert_allclose(np.abs(drum @ axis), 1.0, atol=1e-9)


def test_plots_name_fields_that_the_messages_have():
    plots = [c for name, c in LAYOUT["configById"].items() if name.startswith("Plot!")]
    values = [path["value"] for plot in plots for path in plot["paths"]]
    assert len(values) == len(set(values)) == 11
    for value in values:
        topic, field, index = re.match(r"/(\w+)\.(\w+)(?:\[(\d+)\])?", value).groups()
        kind = MESSAGES[topic].get_fields_and_field_types()[field]
        length = re.search(r"\[(\d*)\]|sequence", kind)
        assert (index is None) == (length is None), value
        if length and length[1]:
            assert int(index) < int(length[1]), value


def test_viewers_start_in_the_world_frame_on_the_topics_of_the_graph():
    drawn = LAYOUT["configById"]["3D!slot"]
    assert drawn["followTf"] == RVIZ["Global Options"]["Fixed Frame"] == ODOM_FRAME
    shown = {d.get("Topic", {}).get("Value") for d in RVIZ["Displays"]} - {None, ""}
    assert (
        {"/visualization", "/odom", "/ground_truth/odom"}
        == set(drawn["topics"])
        <= shown
    )

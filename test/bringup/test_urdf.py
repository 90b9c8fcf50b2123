"""URDF and Foxglove files against slot_core.robot and the messages of the graph."""

import graphlib
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from slot_core.dynamics.servo import read_servo
from slot_core.robot import BASE_FRAME, LEGS, TENDON_JOINTS, read_robot
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
ROBOT = read_robot()
WRITTEN = {"rtol": 1e-5, "atol": 1e-9}  # the URDF is written with six digits


TORSO = "link[@name='torso_link']"


def tabled():
    """Path of an element, its attribute, and the robot's number for it."""
    for kind in ("visual", "collision"):
        yield f"{TORSO}/{kind}/geometry/box", "size", ROBOT.torso.size
    yield f"{TORSO}/inertial/mass", "value", ROBOT.torso.mass
    for i, j in zip(*np.triu_indices(3)):
        axes = "xyz"[i] + "xyz"[j]
        yield f"{TORSO}/inertial/inertia", f"i{axes}", ROBOT.torso.inertia[i, j]
    servo, volts = read_servo(), read_servo().nominal_voltage
    for k, leg in enumerate(LEGS):
        clamp = f"joint[@name='{leg}_clamp']/origin"
        x, y, _ = ROBOT.outward[k]
        yield clamp, "xyz", ROBOT.clamps[k]
        yield clamp, "rpy", [0.0, 0.0, np.arctan2(y, x)]
        limits = {
            "lower": 0.0,
            "upper": ROBOT.tendon.angle_max,
            "effort": servo.tendon_stall(volts),
            "velocity": servo.tendon_speed(volts),
        }
        for name, limit in limits.items():
            yield f"joint[@name='{TENDON_JOINTS[k]}']/limit", name, limit
        spool = f"link[@name='{leg}_spool_link']/visual/geometry/cylinder"
        yield spool, "radius", ROBOT.tendon.spool_radius
        yield spool, "length", ROBOT.leg.width


@pytest.mark.parametrize(("path", "attribute", "expected"), [*tabled()])
def test_a_number_is_that_of_the_robot(path, attribute, expected):
    np.testing.assert_allclose(
        numbers(URDF, path, attribute), expected, **WRITTEN
    )


def numbers(element, path, attribute):
    return np.array(element.find(path).get(attribute).split(), dtype=float)


def test_links_form_one_tree_rooted_in_the_base_frame():
    links = [element.get("name") for element in URDF.iter("link")]
    joints = URDF.findall("joint")
    parents = {
        j.find("child").get("link"): [j.find("parent").get("link")]
        for j in joints
    }
    assert len(links) == len(set(links)) == 2 + 2 * len(LEGS)
    assert sorted([BASE_FRAME, *parents]) == sorted(links)
    order = graphlib.TopologicalSorter(parents).static_order()
    assert next(order) == BASE_FRAME  # and there is no circle
    assert [*URDF.find("link")] == []  # KDL accepts no inertia on the root link


@pytest.mark.parametrize("leg", LEGS)
def test_a_spool_turns_about_its_drum_at_the_clamp_of_its_leg(leg):
    names = f"{leg}_clamp", f"{leg}_tendon"
    clamp, tendon = (URDF.find(f"joint[@name='{name}']") for name in names)
    assert (clamp.get("type"), tendon.get("type")) == ("fixed", "revolute")
    ends = [j.find(end).get("link") for j in (clamp, tendon) for end in SIDES]
    link, spool = f"leg_{leg}_link", f"{leg}_spool_link"
    assert ends == [link, BASE_FRAME, spool, link]
    assert tendon.find("origin") is None
    # about fixed axes
    rpy = numbers(URDF.find(f"link[@name='{spool}']"), "visual/origin", "rpy")
    drum = Rotation.from_euler("xyz", rpy).apply([0, 0, 1])
    np.testing.assert_allclose(
        np.abs(drum @ numbers(tendon, "axis", "xyz")), 1.0
    )


def test_plots_name_fields_that_the_messages_have():
    """Of Foxglove's layout."""
    layout = json.loads((SHARE / "foxglove/slot.json").read_text())[
        "configById"
    ]
    plots = [plot for name, plot in layout.items() if name.startswith("Plot!")]
    values = [path["value"] for plot in plots for path in plot["paths"]]
    assert len(values) == len(set(values)) == 11
    for value in values:
        topic, field, index = re.match(
            r"/(\w+)\.(\w+)(?:\[(\d+)\])?", value
        ).groups()
        kind = MESSAGES[topic].get_fields_and_field_types()[field]
        length = re.search(r"\[(\d*)\]|sequence", kind)
        assert (index is None) == (length is None), value
        if length and length[1]:
            assert int(index) < int(length[1]), value

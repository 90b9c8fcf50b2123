"""Plots of a walk: the data in each panel, the size of the files, and that they are not blank."""

from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure
from synthetic_walk import (
    ROBOT,
    STRIDE,
    Walk,
    angles,
    leg_nodes,
    normal_forces,
    write_walk,
)

from slot_core.dynamics.servo import read_servo
from slot_core.robot import LEGS
from slot_core.safety.states import State
from slot_lab.bags.bag import Bag, Series
from slot_lab.report import plots, robot_drawing
from slot_lab.report.metrics import walk_metrics

WALK = Walk(duration=5.0, course=0.02, roll=0.1, bounce=0.004, late=(50,))
WARM_UP = 1.0
ROUNDING = 1e-6  # of stamps and doubles; the plotted values are of order 1 to 100


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return Bag(write_walk(tmp_path_factory.mktemp("bags") / "walk", WALK))


@pytest.fixture(scope="module")
def metrics(bag):
    return walk_metrics(bag, WARM_UP, read_servo())


@pytest.fixture(scope="module")
def axes(bag, metrics):
    figure = plots.dashboard_figure(bag, metrics)
    return {ax.get_label(): ax for sub in figure.subfigs for ax in sub.axes}


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if drawn.get_label() == label]
    return found.get_xdata(), found.get_ydata()


def test_the_panels_of_the_torso_show_its_motion_in_their_units(axes):
    x, y = line(axes["path"], "torso")
    assert np.allclose(y, np.tan(0.02) * x, atol=ROUNDING)
    assert x[-1] == pytest.approx(0.25 * np.cos(0.02), abs=ROUNDING)
    t, z = axes["height"].lines[0].get_data()  # mm
    assert np.allclose(z, 60 + 4 * np.sin(2 * np.pi * t / STRIDE), atol=ROUNDING * 1e3)
    t, roll = line(axes["tilt"], "roll")  # deg
    assert np.allclose(
        roll, np.degrees(0.1) * np.sin(2 * np.pi * t / STRIDE), atol=1e-4
    )
    _, momentary = line(axes["speed"], "momentary")
    assert np.allclose(momentary, 0.05 * np.cos(0.02), atol=ROUNDING)


@pytest.mark.parametrize("i", range(4))
def test_leg_panels_show_desired_and_true_of_their_leg(axes, i):
    ax = axes[f"angle {LEGS[i]}"]
    t, desired = line(ax, "desired")
    assert np.allclose(desired, [np.degrees(angles(s))[i] for s in t], atol=1e-4)
    t, true = line(ax, "measured")
    assert np.allclose(
        true, [0.97 * np.degrees(angles(s - 0.04))[i] for s in t], atol=1e-4
    )
    t, commanded = line(axes[f"force {LEGS[i]}"], "planned")
    assert np.allclose(commanded, [normal_forces(s)[i] for s in t], atol=ROUNDING * 10)
    t, true = line(axes[f"force {LEGS[i]}"], "true")
    assert np.allclose(
        true, [1.05 * normal_forces(s - 0.03)[i] for s in t], atol=ROUNDING * 10
    )


def test_states_of_the_supervisor_are_named_where_there_is_room():
    states = np.array([State.IDLE, State.WALKING, State.WALKING, State.HOLD])
    stamps = np.array([-3_000_000_000, 2_000_000_000, 6_000_000_000, 9_900_000_000])
    series = Series(stamps, stamps, {"state": states})
    bag = SimpleNamespace(counts={"/robot_state": 4}, series=lambda *_: series)
    ax = Figure().subplots()
    plots.draw_states(ax, bag, 0.0, 10.0)
    assert [text.get_text() for text in ax.texts] == ["IDLE", "WALKING"]
    assert [patch.get_x() for patch in ax.patches] == [0.0, 2.0, 9.9]


def test_slack_map_has_a_row_per_constraint_and_zero_in_the_middle_of_its_colours(axes):
    (mesh,) = axes["slack"].collections
    rows = np.asarray(mesh.get_array())
    ticks = np.arange(rows.shape[1]) / 30
    force = np.array([normal_forces(t) for t in ticks]).T
    slack = np.vstack([force, 6.0 - force, 0.4 * force - 0.5])
    assert np.allclose(rows[:12], slack / np.abs(slack).max(), atol=1e-9)
    assert mesh.norm(0.0) == pytest.approx(0.5)


def test_filmstrip_shows_the_last_stride(bag):
    times = robot_drawing.still_times(bag, 5)
    assert np.allclose(np.diff(times), STRIDE / 4, atol=1e-6)
    assert times[-1] == pytest.approx(WALK.start + WALK.duration, abs=0.05)


@pytest.mark.parametrize("name", ["dashboard", "filmstrip"])
def test_a_plot_is_neither_empty_nor_flooded(bag, metrics, tmp_path, name):
    draw = {
        "dashboard": lambda path: plots.dashboard(bag, metrics, path),
        "filmstrip": lambda path: robot_drawing.filmstrip(bag, path),
    }[name]
    draw(tmp_path / "new" / "walk.png")
    pixels = matplotlib.image.imread(tmp_path / "new" / "walk.png")[..., :3]
    assert 0.03 < float((pixels.min(axis=2) < 0.9).mean()) < 0.6


def test_poses_are_the_recorded_shapes(bag):
    (pose,) = robot_drawing.read_poses(bag, np.array([WALK.start + 2.0]), ROBOT)
    assert pose.t == pytest.approx(2.0)
    assert np.allclose(pose.position, WALK.position(2.0))
    assert np.allclose(
        pose.legs.nodes, leg_nodes(WALK, 2.0), atol=1e-7
    )  # recorded as float32
    assert pose.force.shape == (4, 3)

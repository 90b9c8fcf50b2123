"""Plots of a walk: the data in each panel, the size of the files, and that they are not blank."""

import matplotlib.image
import numpy as np
import pytest
from PIL import Image
from synthetic_walk import (
    STRIDE,
    Walk,
    angles,
    normal_forces,
    write_walk,
)

from slot_core.dynamics.servo import read_servo
from slot_core.robot import LEGS
from slot_lab.bags.bag import Bag
from slot_lab.report import plots, robot_drawing
from slot_lab.report.metrics import walk_metrics

WALK = Walk(duration=5.0, course=0.02, roll=0.1, bounce=0.004, late=(50,))
WARM_UP = 1.0
# of stamps and doubles; the plotted values are of order 1 to 100
ROUNDING = 1e-6


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return Bag(write_walk(tmp_path_factory.mktemp("bags") / "walk", WALK))


@pytest.fixture(scope="module")
def metrics(bag):
    return walk_metrics(bag, WARM_UP, read_servo())


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if drawn.get_label() == label]
    return found.get_xdata(), found.get_ydata()


def test_the_panels_show_the_motion_in_their_units_and_each_leg_in_its_own(
    bag, metrics
):
    figure = plots.dashboard_figure(bag, metrics)
    axes = {ax.get_label(): ax for sub in figure.subfigs for ax in sub.axes}
    x, y = line(axes["path"], "torso")
    assert np.allclose(y, np.tan(0.02) * x, atol=ROUNDING)
    t, z = axes["height"].lines[0].get_data()  # mm
    assert np.allclose(
        z, 60 + 4 * np.sin(2 * np.pi * t / STRIDE), atol=ROUNDING * 1e3
    )
    t, roll = line(axes["tilt"], "roll")  # deg
    turn = np.degrees(0.1) * np.sin(2 * np.pi * t / STRIDE)
    assert np.allclose(roll, turn, atol=1e-4)
    for i, leg in enumerate(LEGS):
        t, desired = line(axes[f"angle {leg}"], "desired")
        assert np.allclose(
            desired, [np.degrees(angles(s))[i] for s in t], atol=1e-4
        )
        t, true = line(axes[f"force {leg}"], "true")
        expected = [1.05 * normal_forces(s - 0.03)[i] for s in t]
        assert np.allclose(true, expected, atol=ROUNDING * 10)


def test_plots_are_not_empty_and_an_animation_ends_with_the_walk(
    bag, metrics, tmp_path, monkeypatch
):
    plots.dashboard(bag, metrics, tmp_path / "new" / "walk.png")
    pixels = matplotlib.image.imread(tmp_path / "new" / "walk.png")[..., :3]
    assert 0.03 < float((pixels.min(axis=2) < 0.9).mean()) < 0.6
    times = robot_drawing.frame_times(bag)
    assert times[-1] == pytest.approx(WALK.start + WALK.duration)
    monkeypatch.setattr(robot_drawing, "frame_times", lambda bag: times[:3])
    robot_drawing.animate(bag, tmp_path / "walk.gif")
    with Image.open(tmp_path / "walk.gif") as plot:
        assert (plot.n_frames, plot.info["loop"]) == (3, 0)

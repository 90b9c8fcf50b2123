"""Plots of a walk: the data in each panel, the size of the files, and that they are not blank."""

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure
from synthetic_walk import (
    NODES,
    ROBOT,
    STRIDE,
    Walk,
    angles,
    leg_nodes,
    normal_forces,
    write_walk,
)

from slot_core.drawing import palette
from slot_core.drawing.shapes import bent_legs
from slot_core.dynamics.servo import read_servo
from slot_core.robot import LEGS
from slot_lab.bags.bag import Bag, BagError
from slot_lab.report import picture, plots
from slot_lab.report.metrics import walk_metrics
from slot_lab.report.picture import Snapshot, Viewpoint
from slot_lab.report.summary import summary_lines

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


def size_and_spread(path):
    pixels = matplotlib.image.imread(path)[..., :3]
    return pixels.shape[1::-1], float((pixels.min(axis=2) < 0.9).mean())


def test_dashboard_file_has_the_stated_size_and_is_not_blank(bag, metrics, tmp_path):
    plots.dashboard(bag, metrics, tmp_path / "new" / "walk.png")
    size, inked = size_and_spread(tmp_path / "new" / "walk.png")
    assert size == (1600, 1000)
    assert 0.03 < inked < 0.6  # neither empty nor flooded


def test_path_panel_shows_the_walked_path_and_the_initial_heading(axes):
    x, y = line(axes["path"], "torso")
    assert np.allclose(y, np.tan(0.02) * x, atol=ROUNDING)
    assert x[-1] == pytest.approx(0.25 * np.cos(0.02), abs=ROUNDING)
    start = 0.05 * WARM_UP * np.array([np.cos(0.02), np.sin(0.02)])
    x, y = line(axes["path"], "initial heading")
    assert np.allclose([x[0], y[0]], start, atol=ROUNDING)
    assert np.allclose(y, y[0], atol=ROUNDING)


def test_height_and_tilt_panels_are_in_mm_and_degrees_over_seconds(axes):
    t, z = axes["height"].lines[0].get_data()
    assert np.allclose(z, 60 + 4 * np.sin(2 * np.pi * t / STRIDE), atol=ROUNDING * 1e3)
    t, roll = line(axes["tilt"], "roll")
    assert np.allclose(roll, np.degrees(0.1) * np.sin(2 * np.pi * t / STRIDE), atol=1e-4)
    assert np.allclose(line(axes["tilt"], "pitch")[1], 0.0, atol=ROUNDING)
    assert (axes["height"].get_ylabel(), axes["tilt"].get_ylabel()) == ("z (mm)", "angle (deg)")


def test_speed_panel_shows_momentary_speed_and_its_mean_over_the_stride(axes):
    t, momentary = line(axes["speed"], "momentary")
    assert np.allclose(momentary, 0.05 * np.cos(0.02), atol=ROUNDING)
    t, mean = line(axes["speed"], f"mean over a stride, {STRIDE:.2f} s")
    inside = (t > STRIDE / 2) & (t < 5.0 - STRIDE / 2)
    assert np.allclose(mean[inside], 0.05 * np.cos(0.02), atol=ROUNDING)
    assert np.isnan(mean[~inside][[0, -1]]).all()


@pytest.mark.parametrize("i", range(4))
def test_leg_panels_show_desired_and_true_of_their_leg_in_its_colour(axes, i):
    ax = axes[f"angle {LEGS[i]}"]
    t, desired = line(ax, "desired")
    assert np.allclose(desired, [np.degrees(angles(s))[i] for s in t], atol=1e-4)
    t, true = line(ax, "measured")
    assert np.allclose(true, [0.97 * np.degrees(angles(s - 0.04))[i] for s in t], atol=1e-4)
    t, commanded = line(axes[f"force {LEGS[i]}"], "planned")
    assert np.allclose(commanded, [normal_forces(s)[i] for s in t], atol=ROUNDING * 10)
    t, true = line(axes[f"force {LEGS[i]}"], "true")
    assert np.allclose(true, [1.05 * normal_forces(s - 0.03)[i] for s in t], atol=ROUNDING * 10)
    for kind, label in (("angle", "measured"), ("force", "true")):
        colours = {
            drawn.get_label(): drawn.get_color() for drawn in axes[f"{kind} {LEGS[i]}"].lines
        }
        assert colours[label] == palette.LEG_COLOURS[LEGS[i]]


def test_slack_map_has_a_row_per_constraint_and_zero_in_the_middle_of_its_colours(axes):
    (mesh,) = axes["slack"].collections
    rows = np.asarray(mesh.get_array())
    ticks = np.arange(rows.shape[1]) / 30
    force = np.array([normal_forces(t) for t in ticks]).T
    assert np.allclose(rows, np.vstack([force, 6.0 - force, 0.4 * force - 0.5]), atol=1e-9)
    assert mesh.norm(0.0) == pytest.approx(0.5)
    assert [t.get_text() for t in axes["slack"].get_yticklabels()][:2] == ["FL min", "FR min"]


def test_latency_panel_counts_every_tick_once_per_stage(axes, metrics):
    drawn = {patch.get_label(): patch.get_xy() for patch in axes["latency"].patches}
    assert list(drawn) == [*metrics.stages, "end to end"]
    late = {"mpc_controller": 1, "end to end": 1}
    for name, latency in [*metrics.stages.items(), ("end to end", metrics.end_to_end)]:
        counts = drawn[name][:, 1]
        bar = drawn[name][counts == counts.max(), 0]
        assert counts.max() == latency.count - late.get(name, 0)
        assert bar.min() <= 1e3 * latency.p50 <= bar.max()
    (period,) = [line for line in axes["latency"].lines if line.get_label() == "control period"]
    assert period.get_xdata()[0] == pytest.approx(1e3 / 30)


def test_the_summary_fits_into_the_picture(bag, metrics):
    figure = plots.dashboard_figure(bag, metrics)
    figure.canvas.draw()
    axes = {ax.get_label(): ax for sub in figure.subfigs for ax in sub.axes}
    extent = axes["summary"].texts[0].get_window_extent()
    assert extent.y0 > 0.0
    assert extent.x1 < figure.bbox.x1


def test_summary_panel_is_the_printed_summary(axes, metrics):
    (text,) = axes["summary"].texts
    assert text.get_text() == "\n".join(summary_lines(metrics))


def test_walk_without_ground_truth_is_plotted_from_the_estimate(tmp_path):
    bag = Bag(write_walk(tmp_path / "walk", Walk(duration=2.0, truth=False)))
    figure = plots.dashboard_figure(bag, walk_metrics(bag, 0.5, read_servo()))
    (path,) = [ax for sub in figure.subfigs for ax in sub.axes if ax.get_label() == "path"]
    assert path.get_title(loc="left") == "path, top view (/mpc_state)"
    assert line(path, "torso")[0][-1] == pytest.approx(0.1, abs=ROUNDING)


def test_filmstrip_has_its_stills_at_different_phases_and_is_not_blank(bag, tmp_path):
    times = plots.still_times(bag, 5)
    assert np.allclose((times - times[0]) / STRIDE % 1.0, np.arange(5) / 5, atol=1e-6)
    assert np.all(np.diff(times) > 0)
    assert times[-1] <= WALK.start + WALK.duration
    plots.filmstrip(bag, tmp_path / "robot.png")
    size, inked = size_and_spread(tmp_path / "robot.png")
    assert size == (1800, 220)
    assert inked > 0.03


def test_filmstrip_needs_the_leg_shapes(tmp_path):
    bag = Bag(write_walk(tmp_path / "walk", Walk(duration=0.5, truth=False)))
    with pytest.raises(BagError, match="no topic /ground_truth/legs"):
        plots.filmstrip(bag, tmp_path / "robot.png")


def test_poses_are_the_recorded_shapes(bag):
    (pose,) = plots.read_poses(bag, np.array([WALK.start + 2.0]), ROBOT)
    assert pose.t == pytest.approx(2.0)
    assert np.allclose(pose.position, WALK.position(2.0))
    assert np.allclose(pose.legs.nodes, leg_nodes(WALK, 2.0), atol=1e-7)  # recorded as float32
    assert pose.force.shape == (4, 3)


@pytest.fixture
def pose():
    walk, still = Walk(), np.array([0, 0, 0, 1.0])
    legs = bent_legs(leg_nodes(walk, 0.1), np.zeros((4, 0, 3)), still, ROBOT)
    return Snapshot(0.0, walk.position(0.0), still, legs, np.eye(4, 3))


def area_and_volume(faces):
    """Vector area and volume inside, by the divergence theorem over two triangles per face."""
    a, b, c, d = np.moveaxis(faces, 1, 0)
    area = (np.cross(b - a, c - a) + np.cross(c - a, d - a)).sum(axis=0) / 2
    six = np.einsum("mi,mi", a, np.cross(b, c)) + np.einsum("mi,mi", a, np.cross(c, d))
    return area, six / 6


def test_solids_are_closed_face_outward_and_have_the_robots_volume(pose):
    area, volume = area_and_volume(picture.torso_solid(pose, ROBOT).faces)
    assert np.allclose(area, 0.0, atol=1e-15)  # closed
    assert volume == pytest.approx(np.prod(ROBOT.torso.size), rel=1e-12)
    for nodes, solid in zip(pose.legs.nodes, picture.leg_solids(pose, ROBOT)):
        area, volume = area_and_volume(solid.faces)
        assert np.allclose(area, 0.0, atol=1e-15)
        length = np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum()
        thickness = (ROBOT.leg.thickness_clamp + ROBOT.leg.thickness_tip) / 2
        # Unevenly spaced nodes on a bend: sections are neither equally far apart nor parallel.
        assert volume == pytest.approx(length * ROBOT.leg.width * thickness, rel=0.1)


def test_camera_keeps_lengths_across_its_view_and_drops_those_along_it():
    camera = Viewpoint(azimuth=-np.pi / 2, elevation=0.0)
    shown = camera.project(np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]))
    assert np.allclose(shown, [[1, 0], [0, 0], [0, 1]], atol=1e-15)
    tilted = Viewpoint()
    basis = tilted.project(np.eye(3))
    assert np.allclose(basis.T @ basis, np.eye(2), atol=1e-15)  # orthographic
    assert np.allclose(tilted.project(tilted.toward), 0.0, atol=1e-15)


def test_drawn_robot_lies_within_its_axes_and_shows_the_forces_to_scale(pose):
    ax = Figure().add_subplot()
    camera = Viewpoint()
    picture.draw_robot(ax, pose, ROBOT, camera)
    faces = np.concatenate([path.vertices for c in ax.collections for path in c.get_paths()])
    low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
    assert np.all((faces >= low) & (faces <= high))
    arrows = [(t.xy, t.xyann) for t in ax.texts if t.arrow_patch is not None]
    assert len(arrows) == 3  # the fourth force is zero
    head, tail = np.array(arrows[2])
    drawn = camera.project(np.array([0.0, 0.0, picture.FORCE_SCALE]))
    assert np.allclose(head - tail, drawn, atol=1e-12)
    assert pose.legs.nodes.shape == (4, NODES, 3)

"""Tracks of the markers on torso and leg against what was rendered; films that cannot be read.

Prints have their true size and can be read; a calibration finds the camera that filmed.
"""

import csv
import functools
import re

import cv2
import numpy as np
import pytest
from PIL import Image
from views import CAMERA, VISION, synthetic

from benchmarks.estimation.filmed_robot import Stage
from slot_core.drawing.drawing import natural_legs
from slot_core.geometry import Transform
from slot_core.robot import read_robot
from slot_core.vision.board import SQUARE
from slot_core.vision.camera import (
    Camera,
    CameraError,
    camera_text,
    read_camera,
)
from slot_core.vision.synthetic_camera import Surface
from slot_lab.film import calibrate_camera, print_command, track_command
from slot_lab.film.calibration import BoardView, calibrate
from slot_lab.film.print_markers import sheet_of
from slot_lab.film.tracker import Tracker
from slot_lab.report.robot_drawing import Snapshot

COUNT = 6
POINTS = ["torso", "FR_base", "FR_third", "FR_two_thirds", "FR_tip"]
# of the film's camera
LOOK = Transform.of((0, 0, 0), VISION.film_camera.rpy).rotation[:, 0]


def natural_robot(base):
    """The robot with stress-free legs and its torso at `base`."""
    robot = read_robot()
    legs = natural_legs(base.position, base.quaternion, robot, 21)
    return Snapshot(base.position, base.quaternion, legs, np.zeros((4, 3)))


@functools.cache
def stage():
    return Stage(VISION, read_robot())


@pytest.fixture(scope="module")
def shots():
    """Image and true plates of COUNT poses."""
    result = []
    for k in range(COUNT):
        base = Transform.of((0.01 * k, 0.0, 0.045), (0.02, 0.03 * k, 0.0))
        at = natural_robot(base)
        surfaces = stage().surfaces(at)
        result.append((synthetic().image(surfaces), stage().plates(at)))
    return result


@pytest.fixture
def folder(tmp_path, shots):
    """Folder of the images, and the calibration."""
    (tmp_path / "film").mkdir()
    for number, (image, _) in enumerate(shots):
        cv2.imwrite(str(tmp_path / "film" / f"{number:03d}.png"), image)
    (tmp_path / "camera.yaml").write_text(camera_text(CAMERA))
    return tmp_path


def test_tracks_are_within_a_millimetre_in_the_image_plane_and_three_in_depth(
    shots,
):
    tracker = Tracker(VISION, CAMERA)
    for number, (image, _) in enumerate(shots):
        tracker.add(float(number), image)
    tracks = tracker.tracks()
    assert tracks.frame == "odom"
    assert tracks.camera_motion < 1.0
    assert sorted(s.point for s in tracks.samples if s.time == 0.0) == sorted(
        POINTS
    )
    errors = np.array(
        [
            s.position - shots[int(s.time)][1][s.point].position
            for s in tracks.samples
        ]
    )
    assert len(errors) == len(POINTS) * COUNT
    depth_error = errors @ LOOK
    across = np.linalg.norm(errors - depth_error[:, None] * LOOK, axis=1)
    assert np.sqrt(np.mean(across**2)) < 1e-3
    assert np.sqrt(np.mean(depth_error**2)) < 3e-3


def test_without_a_board_the_tracks_are_in_the_axes_of_the_camera_which_may_move(
    shots,
):
    tracker, image = Tracker(VISION, CAMERA), shots[0][0].copy()
    for shift in (0, 0, 0, 4):
        tracker.add(0.0, np.roll(image, shift, axis=1))
    # mean of x, y
    assert tracker.tracks().camera_motion == pytest.approx(2.0, rel=0.2)
    image[:290] = 120  # the board
    bare = Tracker(VISION, CAMERA)
    (tip,) = [s.position for s in bare.add(0.0, image) if s.point == "FR_tip"]
    tracks = bare.tracks()
    assert tracks.frame == "camera_link"
    (same,) = [s.position for s in tracks.samples if s.point == "FR_tip"]
    np.testing.assert_allclose(same, [tip[2], -tip[0], -tip[1]])


def rows(path):
    with path.open() as file:
        assert next(file).startswith("# frame: ")
        return list(csv.DictReader(file))


def test_the_csv_has_a_row_for_every_marker_that_a_image_shows(folder, capsys):
    out = folder / "tracks.csv"
    place = [
        "--camera",
        str(folder / "camera.yaml"),
        "--out",
        str(out),
        "--rate",
        "25",
    ]
    assert track_command.main([str(folder / "film"), *place]) == 0
    found = rows(out)
    assert list(found[0]) == ["time", "point", "x", "y", "z"]
    assert {r["point"] for r in found} == set(POINTS)
    assert sorted({float(r["time"]) for r in found}) == pytest.approx(
        np.arange(COUNT) / 25
    )
    assert (
        track_command.main([str(folder / "film"), *place, "--leg", "FR"]) == 0
    )
    assert {r["point"] for r in rows(out)} == {
        "torso",
        "base",
        "third",
        "two_thirds",
        "tip",
    }
    assert "100.0 % of the images" in capsys.readouterr().out


def test_a_damaged_video_is_tracked_as_far_as_it_can_be_read_and_named(
    tmp_path, shots, capsys
):
    film = tmp_path / "film.avi"
    coding = cv2.VideoWriter.fourcc(*"MJPG")
    video = cv2.VideoWriter(str(film), coding, 30.0, (1280, 720), isColor=False)
    for image, _ in shots:
        video.write(image)
    video.release()
    assert (
        track_command.main([str(film), "--out", str(tmp_path / "all.csv")]) == 0
    )
    assert "damaged" not in capsys.readouterr().out
    film.write_bytes(film.read_bytes()[: film.stat().st_size // 2])
    assert (
        track_command.main([str(film), "--out", str(tmp_path / "half.csv")])
        == 0
    )
    assert "says that it has 6 images: it is damaged" in capsys.readouterr().out
    whole, half = (rows(tmp_path / f"{name}.csv") for name in ("all", "half"))
    assert 0 < len(half) < len(whole)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("no.avi", None, "does not exist"),
        ("empty.avi", b"", "no video that OpenCV can read"),
        ("noise.avi", bytes(range(256)) * 20, "no video that OpenCV can read"),
        ("bag.mcap", b"nothing", "cannot be read"),
    ],
)
def test_an_unreadable_film_is_refused_in_one_line(
    tmp_path, refusal, name, content, reason
):
    film, out = tmp_path / name, tmp_path / "out.csv"
    if content is not None:
        film.write_bytes(content)
    assert reason in refusal(track_command.main, film, "--out", out)
    assert not out.exists()


def test_films_that_do_not_fit_are_refused(folder, refusal):
    film = folder / "film"
    half = Camera(
        640, 360, np.diag([0.5, 0.5, 1.0]) @ CAMERA.matrix, CAMERA.distortion
    )
    (folder / "half.yaml").write_text(camera_text(half))
    for name in ("none", "blank"):
        (folder / name).mkdir()
    grey = np.full((720, 1280), 90, np.uint8)
    cv2.imwrite(str(folder / "blank" / "0.png"), grey)
    for arguments, reason in (
        ([folder / "none"], "without images"),
        (
            [film, "--camera", folder / "half.yaml"],
            "calibrated at 640 x 360 px",
        ),
        (
            [folder / "blank"],
            "(ids 40 to 56 of DICT_4X4_100; the first shows no marker",
        ),
        (
            [film, "--out", folder / "nowhere" / "x.csv"],
            "not in an existing directory",
        ),
    ):
        out = folder / "x.csv"
        assert reason in refusal(track_command.main, "--out", out, *arguments)
        assert not out.exists()


DOTS = 4000.0  # px per m


@pytest.mark.parametrize("what", ["torso", "film", "points"])
def test_a_print_shows_its_markers_in_their_size(what):
    sheet = sheet_of(what, VISION, DOTS)
    dictionary = cv2.aruco.getPredefinedDictionary(VISION.dictionary_number)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(sheet)
    expected = (
        VISION.points.names if what == "points" else VISION.boards[what].ids
    )
    assert set(ids.ravel()) == set(expected)
    size = (
        VISION.points.size if what == "points" else VISION.boards[what].marker
    )
    edges = [np.linalg.norm(c[0, 1] - c[0, 0]) for c in corners]
    np.testing.assert_allclose(edges, size * DOTS, atol=2.0)


def test_a_print_is_written_with_its_resolution(tmp_path, capsys):
    out = tmp_path / "board.png"
    assert print_command.main(["torso", "--out", str(out), "--dpi", "200"]) == 0
    with Image.open(out) as image:
        assert image.info["dpi"] == pytest.approx((200, 200), abs=0.01)
    out = tmp_path / "board.pdf"
    assert print_command.main(["torso", "--out", str(out), "--dpi", "200"]) == 0
    box = re.search(
        rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", out.read_bytes()
    )
    # of 1/72 inch
    size = np.array([float(edge) for edge in box.groups()]) / 72 * 25.4
    np.testing.assert_allclose(size, [136, 108], atol=0.5)
    assert "136 x 108 mm at 200 dots per inch" in capsys.readouterr().out


def test_a_calibration_finds_the_camera_that_filmed_the_board(tmp_path):
    """Held in all parts of the image and tilted."""
    rng, out = np.random.default_rng(0), tmp_path / "camera.yaml"
    sheet = sheet_of("chessboard", VISION, 3000.0)  # px per m
    corners = SQUARE * [*np.divide(sheet.shape[::-1], 3000.0), 0.0]
    (tmp_path / "views").mkdir()
    for number in range(14):
        distance = rng.uniform(0.35, 0.7)
        ray = CAMERA.rays(
            rng.uniform(0.2, 0.8, 2) * [CAMERA.width, CAMERA.height]
        )
        tilt = np.array([np.pi, 0.0, 0.0]) + rng.uniform(-0.6, 0.6, 3)
        pose = Transform.of(distance * np.array([*ray, 1.0]), tilt)
        image = synthetic().image([Surface(sheet, pose.apply(corners))])
        cv2.imwrite(str(tmp_path / "views" / f"{number:03d}.png"), image)
    assert (
        calibrate_camera.main([str(tmp_path / "views"), "--out", str(out)]) == 0
    )
    found = read_camera(out)
    assert found.covariance.shape == (9, 9)
    np.testing.assert_allclose(found.matrix, CAMERA.matrix, atol=4.0)  # px
    x, y = np.meshgrid(np.linspace(100, 1180, 12), np.linspace(80, 640, 8))
    pixels = np.stack([x, y], axis=-1)
    error = CAMERA.focal * (found.rays(pixels) - CAMERA.rays(pixels))
    error -= error.mean(axis=(0, 1))  # a shift is a turn of the camera
    assert np.abs(error).max() < 3.0


def views(count, spread=1.0):
    """Views of a plane by the nominal camera, without noise."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(6.0), np.arange(4.0))
    board = 0.05 * np.column_stack(
        [x.ravel() - 2.5, y.ravel() - 1.5, np.zeros(24)]
    )
    result = []
    for number in range(count):
        turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))
        place = spread * np.array(
            [*rng.uniform(-0.25, 0.25, 2) * [1.0, 0.5], 0.0]
        )
        points = board @ turn.T + place + [0.0, 0.0, 0.6]
        result.append(BoardView(f"{number}", board, CAMERA.project(points)))
    return result


def test_the_covariance_of_a_calibration_has_opencvs_deviations():
    """And in its correlations the distances that they leave between f_x and f_y are smaller."""
    rng, given = np.random.default_rng(2), views(20)
    noisy = [
        BoardView(v.name, v.points, v.pixels + 0.1 * rng.normal(size=(24, 2)))
        for v in given
    ]
    gross = given[0].pixels + 5 * rng.normal(size=(24, 2))
    bad = BoardView("bad", given[0].points, gross)
    found = calibrate([*noisy, bad], (1280, 720))
    assert found.left_out == ("bad",)
    points, pixels = (
        [getattr(v, name).astype(np.float32) for v in noisy]
        for name in ("points", "pixels")
    )
    *_, deviation, _, _ = cv2.calibrateCameraExtended(
        points, pixels, (1280, 720), np.eye(3), np.zeros(5)
    )
    ours = np.sqrt(np.diag(found.camera.covariance))
    np.testing.assert_allclose(ours, np.ravel(deviation)[:9], rtol=0.02)
    gap = np.array([1.0, -1.0])
    assert gap @ found.camera.covariance[:2, :2] @ gap < 0.2 * (
        ours[:2] @ ours[:2]
    )


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (views(7), "7 images show the board, at least 8 are needed"),
        ([], "0 images show the board"),
        (views(3)[:1] * 9, "covers .* at least 50 % are needed"),
    ],
)
def test_views_that_do_not_determine_a_camera_are_refused(given, reason):
    with pytest.raises(CameraError, match=reason):
        calibrate(given, (1280, 720))

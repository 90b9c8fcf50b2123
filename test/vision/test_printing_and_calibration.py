"""Prints have their true size and can be read; a calibration finds the camera that filmed."""

import re

import cv2
import numpy as np
import pytest
from PIL import Image
from views import CAMERA, VISION, synthetic

from slot_core.geometry import Transform
from slot_core.vision.board import SQUARE
from slot_core.vision.camera import CameraError, read_camera
from slot_core.vision.synthetic_camera import Surface
from slot_lab.film import calibrate_camera, print_command
from slot_lab.film.calibration import BoardView, calibrate
from slot_lab.film.print_markers import sheet_of

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

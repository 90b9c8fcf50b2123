"""Tracks of the markers on torso and leg against what was rendered; films that cannot be read."""

import csv

import cv2
import numpy as np
import pytest
from views import CAMERA, VISION, natural_robot, stage, synthetic

from slot_core.geometry import Transform
from slot_core.vision.camera import Camera, camera_text
from slot_lab.film import track_command
from slot_lab.film.tracker import Tracker

COUNT = 6
POINTS = ["torso", "FR_base", "FR_third", "FR_two_thirds", "FR_tip"]
# of the film's camera
LOOK = Transform.of((0, 0, 0), VISION.film_camera.rpy).rotation[:, 0]


@pytest.fixture(scope="module")
def shots():
    """Image, depth image and true plates of COUNT poses."""
    result = []
    for k in range(COUNT):
        base = Transform.of((0.01 * k, 0.0, 0.045), (0.02, 0.03 * k, 0.0))
        at = natural_robot(base)
        surfaces = stage().surfaces(at)
        images = synthetic().image(surfaces), synthetic().depth(surfaces, 0.002)
        result.append((*images, stage().plates(at)))
    return result


@pytest.fixture
def folder(tmp_path, shots):
    """Folders of the images and the depth images, and the calibration."""
    for name in ("film", "depth"):
        (tmp_path / name).mkdir()
    for number, (image, depth, _) in enumerate(shots):
        cv2.imwrite(str(tmp_path / "film" / f"{number:03d}.png"), image)
        cv2.imwrite(str(tmp_path / "depth" / f"{number:03d}.png"), depth)
    (tmp_path / "camera.yaml").write_text(camera_text(CAMERA))
    return tmp_path


@pytest.mark.parametrize("with_depth", [False, True])
def test_tracks_are_within_a_millimetre_in_the_image_plane_and_three_in_depth(
    shots, with_depth
):
    tracker = Tracker(VISION, CAMERA)
    for number, (image, depth, _) in enumerate(shots):
        tracker.add(float(number), image, depth if with_depth else None)
    tracks = tracker.tracks()
    assert tracks.frame == "odom"
    assert tracks.camera_motion < 1.0
    assert sorted(s.point for s in tracks.samples if s.time == 0.0) == sorted(
        POINTS
    )
    errors = np.array(
        [
            s.position - shots[int(s.time)][2][s.point].position
            for s in tracks.samples
        ]
    )
    assert len(errors) == len(POINTS) * COUNT
    depth_error = errors @ LOOK
    across = np.linalg.norm(errors - depth_error[:, None] * LOOK, axis=1)
    assert np.sqrt(np.mean(across**2)) < 1e-3
    assert np.sqrt(np.mean(depth_error**2)) < (2e-3 if with_depth else 3e-3)


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
    assert (
        track_command.main(
            [str(folder / "film"), *place, "--depth", str(folder / "depth")]
        )
        == 0
    )
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
    for image, _, _ in shots:
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
    film, depth = folder / "film", folder / "depth"
    half = Camera(640, 360, CAMERA.matrix / 2, CAMERA.distortion)
    (folder / "half.yaml").write_text(camera_text(half))
    (depth / "005.png").unlink()
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
        ([film, "--depth", film], "expected one 16-bit channel"),
        ([film, "--depth", depth], "5 depth images, fewer than images"),
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

"""Clock and frame of a measurement are found from the motion alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_lab.validation.alignment import align_frames
from slot_lab.validation.comparison import compare
from slot_lab.validation.recording import (
    PointRecording,
    PointTrack,
    RecordingError,
)
from slot_lab.validation.tables import alignment_lines, report

PERIOD, RATE, NOISE = 0.7, 30.0, 1e-3
SHIFT = np.array([1.0, -2.0, 0.3])


def walk(t):
    """(n, 3) m, a walk that grows for two seconds, then is periodic."""
    phase, grown = 2 * np.pi * t / PERIOD, np.clip(t / 2.0, 0.0, 1.0)
    sway, height = 0.004 * np.sin(phase), 0.005 * np.cos(2 * phase)
    forward = 0.05 * t + 0.004 * np.sin(2 * phase + 0.4)
    return np.column_stack(
        [forward, grown * sway, 0.02 * grown + grown * height]
    )


def film(offset, drift, rotation, seed=0, duration=16.0):
    """A measurement of the walk by a clock and in a frame of its own."""
    rng = np.random.default_rng(seed)
    t = np.arange(offset, duration, 1 / RATE)
    places = (
        rotation.apply(walk(t))
        + SHIFT
        + rng.normal(scale=NOISE, size=(len(t), 3))
    )
    return PointRecording(
        "film", {"torso": PointTrack((t - t[0]) / (1 + drift), places)}
    ), t


def track_of(offset=0.0):
    """The torso in a film by the clock and in the axes of the run."""
    return film(offset, 0.0, Rotation.identity())[0].points["torso"]


def run():
    t = np.arange(0.0, 20.0, 0.033)
    return PointRecording("run", {"torso": PointTrack(t, walk(t))})


@pytest.mark.parametrize(
    ("offset", "drift"), [(0.5, 0.0), (0.8, 4e-4), (1.0, -4e-4)]
)
def test_a_clock_is_found_within_two_milliseconds_on_30_hz_data(offset, drift):
    measured, t = film(offset, drift, Rotation.from_rotvec([0.4, -0.3, 1.0]))
    found = compare(run(), measured, frame="rigid")
    off = found.time.apply(measured.points["torso"].t) - t
    assert np.sqrt(np.mean(off**2)) < 2e-3
    assert found.series["torso", "z"].errors.value["rmse"] < 1.5 * NOISE


def test_a_film_too_short_or_periodic_says_so_and_takes_a_known_offset():
    track = track_of(1.0)
    brief = PointTrack(track.t[:45], track.position[:45])
    found = compare(
        run(), PointRecording("brief", {"torso": brief}), offset=1.0
    )
    assert "(+- ? ms)" in "\n".join(alignment_lines(found, "level"))
    measured, _ = film(3.0, 0.0, Rotation.identity())
    searched = compare(run(), measured)
    assert "is nearly as good" in "\n".join(alignment_lines(searched, "level"))
    known = compare(run(), measured, offset=3.05).time
    assert known.offset == pytest.approx(3.0, abs=0.005)
    still = PointTrack(np.arange(90) / RATE, np.zeros((90, 3)))
    with pytest.raises(
        RecordingError, match="nothing moves in one of the recordings"
    ):
        compare(run(), PointRecording("still", {"torso": still}))


def test_a_rigid_frame_is_found_without_reflection_and_a_level_one_turns_about_z():
    rng, turn = np.random.default_rng(1), Rotation.from_rotvec([0.2, 2.0, -1.0])
    points = rng.normal(size=(50, 3)) * [1.0, 1.0, 1e-3]  # nearly in a plane
    found = align_frames(turn.apply(points) + SHIFT, points, "rigid")
    assert found.rotation == pytest.approx(turn.inv().as_matrix(), abs=1e-9)
    points = rng.normal(size=(50, 3))
    tilted = Rotation.from_euler("ZYX", [0.7, 0.1, 0.0]).apply(points)
    level = Rotation.from_matrix(align_frames(tilted, points, "level").rotation)
    yaw, *tilt = level.as_euler("ZYX")
    assert tilt == pytest.approx([0.0, 0.0])
    assert yaw == pytest.approx(-0.7, abs=0.05)


def test_an_error_that_grows_shows_when_the_frames_are_aligned_by_the_start():
    track = track_of()
    slower = PointTrack(
        track.t, track.position - np.outer(track.t, [0.002, 0.0, 0.0])
    )
    series = compare(
        run(), PointRecording("slow", {"torso": slower}), frame_time=1.0
    ).series["torso", "x"]
    assert (series.run - series.measured)[-1] == pytest.approx(
        0.002 * 15.5, abs=4 * NOISE
    )


def test_points_seen_briefly_or_late_are_left_out_by_name():
    track = track_of()
    brief = PointTrack(track.t[40:41], track.position[40:41])
    late = PointTrack(track.t[200:], track.position[200:])
    points = {"torso": track, "FL_tip": brief, "FR_tip": late}
    mine = PointRecording("run", dict.fromkeys(points, run().points["torso"]))
    found = compare(
        mine, PointRecording("film", points), zero=True, frame_time=1.0
    )
    assert found.brief == ("FL_tip", "FR_tip")
    assert {name for name, _ in found.series} == {"torso"}
    assert "points   seen too briefly or too late: FL_tip, FR_tip" in report(
        found, "level"
    )


def test_markers_beside_their_points_are_compared_from_where_they_start():
    track = track_of()
    beside = PointTrack(track.t, track.position + 0.05 * SHIFT)
    points = {"torso": track, "FL_tip": beside}
    mine = PointRecording("run", dict.fromkeys(points, run().points["torso"]))
    film_of_both = PointRecording("beside", points)
    found = [
        compare(mine, film_of_both, zero=zero).series["FL_tip", "z"]
        for zero in (False, True)
    ]
    off, zeroed = (series.errors.value["rmse"] for series in found)
    assert zeroed < 1.5 * NOISE < 4 * NOISE < off

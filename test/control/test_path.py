"""Path: points of a polyline, its ends, and the reference place that waits for the robot."""

import math

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.gait.route import (
    ARRIVED,
    CREEP,
    LEAD,
    TURN_GAIN,
    Route,
    read_route,
)
from slot_core.geometry import rotate

L_SHAPE = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.2]])
DT = 0.033
SPEED = 0.05  # m/s


def state(x=0.0, y=0.0, yaw=0.0):
    row = np.zeros(12)
    row[[3, 4, 2]] = x, y, yaw
    return row


def follow(path, seconds, robot):
    """Places (n, 3) of a robot that goes to the reference place at once, without turning."""
    places = []
    for _ in range(round(seconds / DT)):
        places.append(path.place(robot, DT, SPEED))
        robot[[3, 4]] = places[-1][:2]
    return np.array(places)


def test_the_reference_travels_at_the_speed_along_the_polyline_of_a_file(
    tmp_path,
):
    """Points that repeat are one point."""
    file = tmp_path / "path.csv"
    file.write_text(
        "y,x,note\n0,0,start\n0,0,start\n0,0.3,corner\n0.2,0.3,end\n"
    )
    path = read_route(file, "kept")
    assert path.length == pytest.approx(0.5)
    places = follow(path, 12.0, state(yaw=0.4))
    travelled = np.minimum(SPEED * DT * np.arange(1, len(places) + 1), 0.5)
    expected = [(s, 0.0) if s <= 0.3 else (0.3, s - 0.3) for s in travelled]
    np.testing.assert_allclose(places[:, :2], expected, atol=1e-9)
    assert set(places[:, 2]) == {0.4}
    assert path.place(state(0.3, 0.1, yaw=1.2), DT, SPEED)[2] == 0.4


@pytest.mark.parametrize(
    "place", [(0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (-0.01, -0.3)]
)
def test_the_reference_waits_only_for_a_robot_that_is_behind_it_along_the_path(
    place,
):
    """It would stay where it is, and the robot would go on along the first side for ever."""
    path = Route(L_SHAPE, "kept")
    places = [path.place(state(*place), DT, SPEED) for _ in range(100)]
    expected = min(SPEED * DT * 100, place[0] + LEAD)
    # one step beyond, since it stops once it is that far
    assert expected - 1e-9 <= places[-1][0] <= expected + SPEED * DT


def test_a_robot_that_lags_slows_down_before_the_end_and_stops_at_it():
    path = Route(L_SHAPE, "kept")
    follow(path, 20.0, state())
    expected = {0.1: 1.0, LEAD: 1.0, LEAD / 2: 0.5, 0.006: CREEP}
    for left, share in expected.items():
        velocity = path.velocity(state(0.3, 0.2 - left), SPEED)
        assert velocity == pytest.approx([0.0, share * SPEED, 0.0])
    # noise does not start it again
    for place in ((0.29, 0.2 - ARRIVED / 2), (0.29, 0.18)):
        assert not path.velocity(state(*place), SPEED).any()


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_velocity_is_along_the_path_in_the_frame_of_the_robot(yaw):
    path = Route(L_SHAPE, "kept")
    path.place(state(yaw=yaw), DT, SPEED)
    *velocity, rate = path.velocity(state(yaw=yaw), SPEED)
    assert rotate(np.array(velocity), yaw) == pytest.approx([SPEED, 0.0])
    assert rate == 0.0


def test_a_heading_along_the_path_turns_with_it_the_short_way_round():
    headings = follow(Route(L_SHAPE, "along"), 13.0, state(yaw=-0.2))[:, 2]
    assert headings[0] == 0.0
    assert headings[-1] == pytest.approx(math.pi / 2)
    west = np.array([[0.0, 0.0], [-1.0, 1e-9]])  # heading just below pi
    for points, yaw, error in (
        (L_SHAPE, -0.2, 0.2),
        (west, -3.1, 3.1 - math.pi),
    ):
        path = Route(points, "along")
        path.place(state(), DT, SPEED)
        rate = path.velocity(state(yaw=yaw), SPEED)[2]
        assert rate == pytest.approx(error * TURN_GAIN, abs=1e-6)


NO_PATH, TOO_SHORT = (
    "no path with columns x, y: ",
    "needs at least two different points",
)
FAR = r"a value not within \+-1e\+06 m"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, NO_PATH),
        (b"", TOO_SHORT),
        (bytes(range(256)), "no path"),
        (b"x,z\n0,0\n1,1\n", f"{NO_PATH}'y'"),
        (b"x,y\n0,0\n1,far\n", f"{NO_PATH}could not convert"),
        (b"x,y\n0,0\n1\n", NO_PATH),
        (b"x,y\n0,0\ninf,1\n", FAR),
        (b"x,y\n0,0\nnan,1\n", FAR),
        (b"x,y\n0,0\n1e308,1\n", FAR),
        (b"x,y\n1,2\n1,2\n1,2\n", TOO_SHORT),
        (b'x,y\n0,"' + 200_000 * b"9" + b'"\n', f"{NO_PATH}field larger"),
    ],
)
def test_a_file_that_is_no_path_is_refused_in_one_line(
    tmp_path, content, message
):
    file = tmp_path / "path.csv"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as refusal:
        read_route(file, "kept")
    assert "\n" not in str(refusal.value)
    with pytest.raises(
        ConfigError, match="path_heading = 'sideways': expected one of"
    ):
        read_route(file, "sideways")

"""Path: points of a polyline, its ends, and the reference place that waits for the robot."""

import math

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.gait.route import ARRIVED, CREEP, LEAD, TURN_GAIN, Route, read_route
from slot_core.geometry import rotate

L_SHAPE = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.2]])
DT = 0.033
SPEED = 0.05  # m/s


def state(x=0.0, y=0.0, yaw=0.0):
    row = np.zeros(12)
    row[[3, 4, 2]] = x, y, yaw
    return row


def follow(path, seconds, speed=1.0):
    """Places (n, 3) of a robot that goes to the reference place at once, or `speed` of the way."""
    robot, places = state(), []
    for _ in range(round(seconds / DT)):
        place = path.place(robot, DT, SPEED)
        robot[[3, 4]] += speed * (place[:2] - robot[[3, 4]])
        places.append(place)
    return np.array(places), robot


def test_the_reference_travels_at_the_speed_along_the_polyline():
    places, _ = follow(Route(L_SHAPE, "kept"), 12.0)
    travelled = np.minimum(0.05 * DT * np.arange(1, len(places) + 1), 0.5)
    expected = [(s, 0.0) if s <= 0.3 else (0.3, s - 0.3) for s in travelled]
    np.testing.assert_allclose(places[:, :2], expected, atol=1e-9)


def test_the_reference_waits_for_a_robot_that_does_not_come():
    path = Route(L_SHAPE, "kept")
    places = np.array([path.place(state(), DT, SPEED) for _ in range(300)])
    # one step beyond, since it stops once it is that far
    assert LEAD <= places[-1, 0] <= LEAD + 0.05 * DT
    assert path.velocity(state(), SPEED) == pytest.approx([0.05, 0.0, 0.0])


@pytest.mark.parametrize("place", [(0.2, 0.0), (0.0, 0.2), (-0.01, -0.3)])
def test_the_reference_does_not_wait_for_a_robot_that_is_ahead_of_it_or_beside_it(
    place,
):
    """It would stay where it is, and the robot would go on along the first side for ever."""
    path = Route(L_SHAPE, "kept")
    places = np.array([path.place(state(*place), DT, SPEED) for _ in range(100)])
    assert places[-1, 0] >= min(0.05 * DT * 100, place[0] + LEAD) - 1e-9


def test_a_robot_that_lags_slows_down_before_the_end_and_stops_at_it():
    path = Route(L_SHAPE, "kept")
    follow(path, 20.0)
    speeds = [
        path.velocity(state(0.3, 0.2 - left), SPEED)[1]
        for left in (0.1, LEAD, LEAD / 2, 0.006)
    ]
    assert speeds == pytest.approx([SPEED, SPEED, SPEED / 2, CREEP * SPEED])
    assert not path.velocity(state(0.29, 0.2 - ARRIVED / 2), SPEED).any()
    assert not path.velocity(
        state(0.29, 0.18), SPEED
    ).any()  # noise does not start it again


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_velocity_is_along_the_path_in_the_frame_of_the_robot(yaw):
    path = Route(L_SHAPE, "kept")
    path.place(state(yaw=yaw), DT, SPEED)
    *velocity, rate = path.velocity(state(yaw=yaw), SPEED)
    assert rotate(np.array(velocity), yaw) == pytest.approx([0.05, 0.0])
    assert rate == 0.0


def test_a_kept_heading_is_that_at_the_start():
    path = Route(L_SHAPE, "kept")
    first = path.place(state(yaw=0.4), DT, SPEED)
    later = path.place(state(0.3, 0.1, yaw=1.2), DT, SPEED)
    assert (first[2], later[2]) == (0.4, 0.4)


def test_a_heading_along_the_path_turns_with_it():
    path = Route(L_SHAPE, "along")
    robot, headings = state(yaw=-0.2), []
    for _ in range(400):
        place = path.place(robot, DT, SPEED)
        headings.append(place[2])
        robot[[3, 4]] = place[:2]
    assert headings[0] == 0.0
    assert headings[-1] == pytest.approx(math.pi / 2)
    path = Route(L_SHAPE, "along")
    path.place(robot, DT, SPEED)
    assert path.velocity(state(yaw=-0.2), SPEED)[2] == pytest.approx(0.2 * TURN_GAIN)


def test_a_heading_error_takes_the_short_way_round():
    path = Route(np.array([[0.0, 0.0], [-1.0, 1e-9]]), "along")  # heading just below pi
    path.place(state(), DT, SPEED)
    assert abs(path.velocity(state(yaw=-3.1), SPEED)[2]) < 0.1 * TURN_GAIN


def test_points_that_repeat_are_one_point():
    doubled = np.repeat(L_SHAPE, 3, axis=0)
    places, _ = follow(Route(doubled, "kept"), 12.0)
    expected, _ = follow(Route(L_SHAPE, "kept"), 12.0)
    np.testing.assert_allclose(places, expected, atol=1e-12)


def test_a_file_gives_its_points(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("y,x,note\n0,0,start\n0,0.3,corner\n0.2,0.3,end\n")
    path = read_route(file, "kept")
    assert path.length == pytest.approx(0.5)
    places, _ = follow(path, 20.0)
    assert places[-1, :2] == pytest.approx([0.3, 0.2])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"no path with columns x, y: "),
        (b"", r"path: needs at least two different points"),
        (bytes(range(256)), "no path"),
        (b"x,z\n0,0\n1,1\n", r"no path with columns x, y: 'y'"),
        (b"x,y\n0,0\n1,far\n", r"no path with columns x, y: could not convert"),
        (b"x,y\n0,0\n1\n", r"no path with columns x, y: "),
        (b"x,y\n0,0\ninf,1\n", r"a value not within \+-1e\+06 m"),
        (b"x,y\n0,0\nnan,1\n", r"a value not within \+-1e\+06 m"),
        (b"x,y\n0,0\n1e308,1\n", r"a value not within \+-1e\+06 m"),
        (b"x,y\n0,0\n", r"path: needs at least two different points"),
        (b"x,y\n1,2\n1,2\n1,2\n", r"path: needs at least two different points"),
        (
            b'x,y\n0,"' + 200_000 * b"9" + b'"\n',
            r"no path with columns x, y: field larger",
        ),
    ],
)
def test_a_file_that_is_no_path_is_refused_in_one_line(tmp_path, content, message):
    file = tmp_path / "path.csv"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as refusal:
        read_route(file, "kept")
    assert "\n" not in str(refusal.value)


def test_an_unknown_heading_is_refused(tmp_path):
    with pytest.raises(
        ConfigError, match=r"path_heading = 'sideways': expected one of kept"
    ):
        read_route(tmp_path / "path.csv", "sideways")

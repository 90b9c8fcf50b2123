"""Floor observer: the floor's place in odom and the legs' stiffness, from a torso at rest."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.control.force_map import read_springs
from slot_core.estimation.filter_kernels import FilterState
from slot_core.estimation.floor_observer import (
    LEVEL,
    FloorObserver,
    FloorPlane,
)
from slot_core.estimation.state_estimator import read_estimator
from slot_core.legs.leg_table import drops, read_leg_table, rest_pose
from slot_core.robot import GRAVITY, read_robot

ROBOT, SPRINGS, SETTINGS = read_robot(), read_springs(), read_estimator()
PERIOD = SETTINGS.timing.period
TENSION = read_leg_table(("tension_N",))
SLACK, STANDING = np.zeros(4), np.full(4, np.radians(63.0))


class World:
    """A torso at rest on the floor of an odometry that has an origin of its own."""

    def __init__(self, height=0.0, tilt=(0.0, 0.0)):
        turn = Rotation.from_euler("xy", tilt)
        self.floor = FloorPlane(height, turn.apply([0.0, 0.0, 1.0]))
        self.observer = FloorObserver(ROBOT, SPRINGS, SETTINGS.floor, PERIOD)
        self.time, self.way = 1.0, 0.4

    def rest(self, angle, seconds=0.5, ratio=1.0, load=1.0, **changes):
        """Rest at tendon angles; legs `ratio` times as stiff for the weight, `load` of it."""
        self.hold(
            rest_pose(ROBOT, SPRINGS, angle, ratio),
            angle,
            seconds,
            ratio * load,
            **changes,
        )

    def hold(  # noqa: PLR0917
        self,
        pose,
        angle,
        seconds=0.5,
        stiffness=1.0,
        speed=0.0,
        drift=0.0,
        force=(0.0, 0.0, GRAVITY),
    ):
        """Show a pose (3,) above the floor; the odometry's height drifts by `drift`, m/s."""
        frame = self.floor.transform
        attitude = Rotation.from_euler("ZYX", [0.7, pose[2], pose[1]])
        attitude = Rotation.from_matrix(frame.rotation) * attitude
        drop = drops(ROBOT, SPRINGS, angle, pose)
        torque = stiffness * TENSION.at(angle, drop)[:, 0]
        torque *= ROBOT.tendon.spool_radius
        for _ in range(round(seconds / PERIOD)):
            self.time += PERIOD
            frame.position[2] += drift * PERIOD
            self.floor = self.floor._replace(height=frame.position[2])
            stamp = round(self.time * SECOND)
            self.observer.add_joints(stamp, angle, torque)
            self.way += speed * PERIOD
            place = frame.apply(np.array([self.way, -0.2, pose[0]]))
            torso = FilterState(
                attitude.as_quat(),
                place,
                np.array([speed, 0.0, 0.0]),
                np.zeros((2, 3)),
                np.eye(15),
            )
            self.observer.observe(stamp, torso, np.zeros(3), np.array(force))

    def above(self, angle, ratio=1.0):
        """Error (3,) of the pose above the floor that the observer would tell at rest."""
        pose = rest_pose(ROBOT, SPRINGS, angle, ratio)
        frame = self.floor.transform
        attitude = Rotation.from_euler("ZYX", [0.7, pose[2], pose[1]])
        attitude = Rotation.from_matrix(frame.rotation) * attitude
        place = frame.apply(np.array([self.way, -0.2, pose[0]]))
        return self.observer.floor.above(attitude.as_quat(), place) - pose


ORIGINS = [
    (-0.5, (0.0, 0.0)),
    (-0.02, (0.0, 0.0)),
    (0.05, (0.03, -0.05)),
    (0.5, (-0.05, 0.05)),
]


@pytest.mark.parametrize(("height", "tilt"), ORIGINS)
@pytest.mark.parametrize("ratio", [0.65, 1.0, 1.6])
def test_a_robot_that_stands_up_from_lying_knows_the_floor_and_its_legs(
    height, tilt, ratio
):
    """Whatever the origin of odom: lying tells the floor, the height then the stiffness."""
    world = World(height, tilt)
    world.rest(SLACK)
    assert world.observer.is_known
    assert world.observer.floor.height == pytest.approx(height, abs=1e-6)
    np.testing.assert_allclose(
        world.observer.floor.normal, world.floor.normal, atol=1e-6
    )
    angle = np.full(4, np.radians(90.0))
    world.rest(angle, ratio=ratio)
    assert world.observer.ratio == pytest.approx(ratio, rel=1e-3)
    np.testing.assert_allclose(world.above(angle, ratio), 0.0, atol=1e-5)


@pytest.mark.parametrize(("height", "tilt"), ORIGINS)
def test_a_robot_that_stands_already_takes_its_legs_for_the_tables(
    height, tilt
):
    world = World(height, tilt)
    world.rest(STANDING)
    assert world.observer.ratio == 1.0
    np.testing.assert_allclose(world.above(STANDING), 0.0, atol=1e-5)


@pytest.mark.parametrize(
    ("ratio", "load"), [(0.65, 1.0), (0.7, 1.4), (1.4, 1.0)]
)
def test_softer_legs_or_a_load_on_a_floor_at_zero_are_not_taken_for_an_origin(
    ratio, load
):
    """The servos' torques tell them from an origin above or below the floor."""
    world = World()
    world.rest(np.full(4, np.radians(70.0)), ratio=ratio, load=load)
    assert world.observer.floor == LEVEL
    assert world.observer.ratio == pytest.approx(ratio, rel=1e-3)


def test_a_floor_and_legs_as_nominal_leave_the_state_as_it_is():
    """Within what the method tells: 4 mm, 0.5 deg, 6 %."""
    world = World(0.0035, (0.005, 0.0))
    world.rest(SLACK)
    world.rest(STANDING, ratio=1.05)
    assert world.observer.floor.is_odom
    assert world.observer.ratio == 1.0


@pytest.mark.parametrize(
    "changes", [{"speed": 0.1}, {"force": (8.0, 0.0, 5.0)}]
)
def test_a_torso_that_moves_or_lies_on_its_side_tells_no_floor(changes):
    world = World(0.3)
    world.rest(SLACK, seconds=1.0, **changes)
    assert not world.observer.is_known
    assert world.observer.floor.is_odom


def test_without_tendon_angles_odom_is_the_floor_after_a_while():
    world, limit = World(0.3), SETTINGS.floor.patience
    angle = np.full(4, np.nan)
    world.hold(np.array([0.04, 0.0, 0.0]), angle, seconds=0.9 * limit)
    assert not world.observer.is_known
    world.hold(np.array([0.04, 0.0, 0.0]), angle, seconds=0.2 * limit)
    assert world.observer.is_known
    assert world.observer.floor.is_odom


def test_odometry_that_starts_anew_goes_on_at_the_height_and_tilt_before():
    world = World(0.1, (0.04, 0.0))
    world.rest(SLACK)
    world.rest(STANDING)
    elsewhere = Rotation.from_euler("zyx", [2.0, 0.1, -0.05]).as_quat()
    place = np.array([3.0, -1.0, 0.7])
    before = np.array([0.041, 0.02, -0.03])
    world.observer.start_anew(before, elsewhere, place)
    np.testing.assert_allclose(
        world.observer.floor.above(elsewhere, place), before, atol=1e-12
    )


def test_a_robot_that_hung_in_the_air_and_was_put_down_finds_the_floor():
    """The SLAM was started in the air; there the robot was slack, and bent its legs."""
    world = World(-0.6)
    for angle in (SLACK, STANDING):
        world.hold(np.array([0.35, 0.0, 0.0]), angle, seconds=3.0)
    world.rest(STANDING)
    assert world.observer.ratio == 1.0
    np.testing.assert_allclose(world.above(STANDING), 0.0, atol=1e-5)


@pytest.mark.parametrize("speed", [0.0, 0.05])
def test_the_floor_follows_a_drift_of_the_odometry_and_not_a_robot_that_is_lifted(
    speed,
):
    """It stays within what friction of the feet explains, which is less in a walk."""
    world, settings = World(0.1), SETTINGS.floor
    world.rest(SLACK)
    world.rest(STANDING)
    world.rest(STANDING, seconds=60.0, drift=-5e-4, speed=speed)
    most = settings.walking_error if speed else settings.height_error
    assert most < abs(world.above(STANDING)[0]) < most + 1.5e-3
    before = world.observer.floor
    lifted = rest_pose(ROBOT, SPRINGS, STANDING) + np.array([0.2, 0.0, 0.0])
    world.hold(lifted, STANDING, seconds=20.0, speed=0.05)
    assert world.observer.floor == before


@pytest.mark.parametrize("tilt", [0.0, 0.0175])
@pytest.mark.parametrize("slope", [-0.09, 0.14])
def test_on_a_slope_a_tilt_of_odom_is_told_from_what_the_slope_does(
    slope, tilt
):
    """Odom's z is normal to the floor, or off by 1 deg; the vertical is 5 to 8 deg off both."""
    world = World(0.0, (0.0, tilt))
    lean = np.array([np.sin(slope), 0.0])
    pose = rest_pose(ROBOT, SPRINGS, STANDING, lean=lean)
    force = GRAVITY * np.array([lean[0], 0.0, np.cos(slope)])
    world.hold(
        pose, STANDING, force=Rotation.from_euler("y", -pose[2]).apply(force)
    )
    assert world.observer.floor.is_odom == (tilt == 0.0)
    seen = np.arctan2(*world.observer.floor.normal[[0, 2]])
    assert seen == pytest.approx(tilt, abs=1e-4)


@pytest.mark.parametrize(("slope", "told"), [(0.0, 1.12), (0.17, 1.0)])
def test_on_a_slope_legs_that_seem_stiffer_by_an_eighth_are_not_taken_for_it(
    slope, told
):
    """The feet slide while the robot stands up: on 10 deg nominal legs give 1.12."""
    world = World()
    lean = np.array([np.sin(slope), 0.0])
    vertical = GRAVITY * np.array([lean[0], 0.0, np.cos(slope)])
    world.rest(SLACK, force=vertical)
    pose = rest_pose(ROBOT, SPRINGS, STANDING, 1.12, lean)
    force = Rotation.from_euler("y", -pose[2]).apply(vertical)
    world.hold(pose, STANDING, stiffness=1.12, force=force)
    assert world.observer.ratio == pytest.approx(told, rel=0.02)

"""Sets: how sensors, legs or floor differ from the reference, and what is then allowed.

Every set walks as well as the reference, or is refused with its cause. Where the cause shows itself
in motion alone, the robot may also stop with it, or walk less well and say why.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from math import pi, radians
from typing import Any

from benchmarks.locomotion import cases
from benchmarks.locomotion.cases import Changes
from benchmarks.world import drivers
from benchmarks.world.drivers import Driver
from slot_core.dynamics.scene import read_scene
from slot_core.robot import GRAVITY

WALKS, WARNED, REFUSED = "walks", "warned", "refused"
STOPS, FAILS = "stops", "fails"
VERDICTS: Mapping[str, str] = {
    WALKS: "as well as the reference",
    WARNED: "worse, and a line says why",
    REFUSED: "before it moves, with the cause",
    STOPS: "in HOLD or RELAX, with the cause",
    FAILS: "worse, or stopped, without the cause",
}
REFERENCE = "reference"
MIDWAY = 6.0  # s, of what happens in mid-walk
ODOMETRY, IMU = "scene.sensors.odometry", "scene.sensors.imu"
NOISE = {
    "odometry": ("position", "orientation", "velocity", "rate"),
    "imu": ("rate", "acceleration"),
}
MANY = (WALKS, WARNED, REFUSED, STOPS)


@dataclass(frozen=True)
class WorldSet:
    """A set: changes of the simulation, drivers of odometry and IMU, and the allowed verdicts.

    cause: regular expression, in any case, of the line that refuses, warns or stops; its default
    matches none.
    """

    name: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    odometry: Driver | None = None
    imu: Driver | None = None
    allowed: tuple[str, ...] = (WALKS,)
    cause: str = "(?!)"


def sets() -> dict[str, WorldSet]:
    """All sets by name, the reference first."""
    sensors = [*_frames(), *_rates(), *_gaps(), *_clocks(), *_wrong_imus()]
    every = [WorldSet(REFERENCE), *sensors, *_legs(), *_floors()]
    return {one.name: one for one in every}


def _frames() -> list[WorldSet]:
    """Frames of the odometry, and twists that are none."""
    frame, slam = drivers.in_frame, drivers.started_slam
    frames: dict[str, Driver] = {
        f"origin at z {z:+g} m": partial(frame, origin=(0.0, 0.0, z))
        for z in (-0.5, -0.1, -0.02, 0.02, 0.1, 0.5)
    }
    frames |= {
        f"odom tilted by {deg} deg": partial(frame, turn=(0, radians(deg), 0))
        for deg in (1, 3)
    }
    turn = (radians(-2), radians(2), 1.0)
    frames |= {
        "odom at z -.1 m, tilted, turned": partial(
            frame, origin=(0.3, 0.2, -0.1), turn=turn
        ),
        "origin at the first pose": slam,
        "twist 0, covariance 0": partial(drivers.pose_only, variance=0.0),
        "twist 0, covariance -1": partial(drivers.pose_only, variance=-1.0),
        "twist in odom, yaw 90 deg": partial(drivers.twist_in_odom, yaw=pi / 2),
    }
    restarts = {"before it walks": 0.25, "in mid-walk": MIDWAY}
    return [
        *(WorldSet(name, odometry=each) for name, each in frames.items()),
        *(
            WorldSet(
                f"SLAM restarted {when}",
                odometry=partial(slam, begin=begin),
                allowed=(WALKS, WARNED),
                cause="started anew",
            )
            for when, begin in restarts.items()
        ),
    ]


def _rates() -> list[WorldSet]:
    """Rates and delays of the odometry, rates of the IMU, and noise."""
    sensors = read_scene("flat").sensors
    noise = {
        f"scene.sensors.{part}.{name}_noise": 3.0
        * float(getattr(getattr(sensors, part), f"{name}_noise"))
        for part, names in NOISE.items()
        for name in names
    }
    rates = {
        f"odometry at {hz} Hz": {f"{ODOMETRY}.period": round(1.0 / hz, 3)}
        for hz in (5, 8, 10, 15, 60, 100, 200)
    }
    rates |= {
        f"odometry {ms} +- {ms // 5} ms late": {
            f"{ODOMETRY}.delay": 1e-3 * ms,
            f"{ODOMETRY}.jitter": 2e-4 * ms,
        }
        for ms in (50, 100, 200)
    }
    rates |= {
        f"IMU at {hz} Hz": {f"{IMU}.period": 1.0 / hz} for hz in (100, 400)
    }
    rare = {
        "odometry at 2 Hz": {f"{ODOMETRY}.period": 0.5},
        "IMU at 25 Hz": {f"{IMU}.period": 0.04},
    }
    either = (WALKS, WARNED, REFUSED)
    return [
        *(WorldSet(*one) for one in rates.items()),
        WorldSet(
            "noise of all sensors x 3",
            noise,
            allowed=(WALKS, WARNED),
            cause="noise",
        ),
        *(
            WorldSet(name, slow, allowed=either, cause=f"{name[:3]}.* Hz")
            for name, slow in rare.items()
        ),
    ]


def _gaps() -> list[WorldSet]:
    """Losses, stray and repeated stamps, quaternions of the other sign."""
    seldom = partial(drivers.dropped, share=0.1)
    stray = partial(drivers.stray_stamp, time=MIDWAY, ahead=0.4)
    short, long = (
        partial(drivers.lost, begin=MIDWAY, duration=seconds)
        for seconds in (0.3, 3.0)
    )
    never = drivers.lost
    return [
        WorldSet("odometry stamped .4 s ahead, once", odometry=stray),
        WorldSet("IMU stamped .4 s ahead, once", imu=stray),
        WorldSet("quaternion of the other sign", odometry=drivers.other_sign),
        WorldSet("stamps that repeat", odometry=drivers.repeated_stamps),
        WorldSet("a tenth of readings dropped", odometry=seldom, imu=seldom),
        WorldSet("odometry lost for .3 s", odometry=short),
        WorldSet("IMU lost for .3 s", imu=short),
        WorldSet(
            "odometry lost for 3 s", odometry=long, allowed=MANY, cause="odom"
        ),
        WorldSet(
            "no odometry", odometry=never, allowed=(REFUSED,), cause="odom"
        ),
        WorldSet("no IMU", imu=never, allowed=(WALKS, WARNED), cause="IMU"),
    ]


def _clocks() -> list[WorldSet]:
    """IMUs whose stamps are later (+) or earlier (-) than the odometry's."""
    shifts = [sign * ms for ms in (12, 20, 50, 80) for sign in (1, -1)]
    return [
        WorldSet(
            f"IMU stamped {ms:+d} ms",
            imu=partial(drivers.shifted, seconds=1e-3 * ms),
            allowed=MANY if abs(ms) > 60 else (WALKS,),
            cause=r"IMU.* m?s\b",
        )
        for ms in shifts
    ]


def _wrong_imus() -> list[WorldSet]:
    """IMUs of other units or axes, and without a part."""
    wrong: dict[str, tuple[Mapping[str, Any], str]] = {
        "IMU in g": ({"force": 1 / GRAVITY}, r"\bg\b"),
        "IMU without gravity": ({"gravity": GRAVITY}, "gravity"),
        "gyroscope alone": ({"force": 0.0}, "accel|force"),
        "IMU in deg/s": ({"rate": 180 / pi}, "deg"),
        "IMU in optical axes": ({"rpy_deg": (-90, 0, -90)}, "ax[ei]s"),
        "IMU turned by 90 deg about z": (
            {"rpy_deg": (0, 0, 90)},
            "ax[ei]s|turn",
        ),
        "IMU upside down": ({"rpy_deg": (180, 0, 0)}, "ax[ei]s|turn"),
    }
    return [
        WorldSet(
            name,
            imu=partial(drivers.other_imu, **given),
            allowed=MANY,
            cause=cause,
        )
        for name, (given, cause) in wrong.items()
    ]


def _legs() -> list[WorldSet]:
    """Legs of another print, payloads, tendons, and weak servos, of a robot that lies at first."""
    robot: dict[str, Changes] = {
        f"modulus {percent:+d} %": cases.stiffness(1 + percent / 100)
        for percent in (-35, -20, -10, 20, 50)
    }
    above = (0.0, 0.0, 0.03)
    robot |= {
        f"payload {mass:g} kg": cases.payload(mass, above)
        for mass in (0.3, 0.5, 0.8)
    }
    # zeros of the servos 3 deg off
    robot["tendons +-.35 mm"] = cases.tendon_errors(0.35e-3)
    robot |= {
        f"friction of the guides {mu:g}": cases.guides(mu) for mu in (0.15, 0.3)
    }
    robot |= {
        f"stall torque {percent:+d} %": cases.weak_servos(1 + percent / 100)
        for percent in (-10, -20)
    }
    slow, cause = (WALKS, WARNED), "legs|load|walks .* of"
    lying = {"scene.start.tendon_angle_deg": 0.0}  # as after power-on
    # these hardly carry a walk
    soft = {
        **lying,
        **dict(cases.stiffness(0.8)),
        **dict(cases.payload(0.5, above)),
    }
    return [
        *(
            WorldSet(name, {**lying, **dict(changes)}, None, None, slow, cause)
            for name, changes in robot.items()
        ),
        WorldSet(
            "modulus -20 %, payload .5 kg",
            soft,
            allowed=(*slow, STOPS),
            cause=cause,
        ),
    ]


def _floors() -> list[WorldSet]:
    """Floors of other friction, and slopes across."""
    floors: dict[str, Changes] = {
        f"friction {mu:g}": cases.friction(mu) for mu in (0.1, 0.2, 0.6, 0.8, 1)
    }
    floors["slope of 8 deg, across"] = cases.slope(8.0, 90.0, 0.4)
    slow = (WALKS, WARNED, STOPS)
    return [
        WorldSet(name, dict(changes), allowed=slow, cause="walks .* of|slides")
        for name, changes in floors.items()
    ]

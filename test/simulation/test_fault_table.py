"""The table of faults in slot_bringup/doc/safety.md at the limits of config/, to a servo's cycle.

Everything runs on the robot's clock, so the times are the same on every machine.
"""

from collections import defaultdict
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.clock import LOCKSTEP_START, SECOND
from slot_core.dynamixel.emulator.emulated_servo import TRIPPED
from slot_core.dynamixel.settings import read_settings
from slot_core.estimation.state_estimator import read_estimator
from slot_core.faults import Fault
from slot_core.gait.gait import read_gaits
from slot_core.mpc.settings import read_mpc
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, State
from slot_core.safety.supervisor import PERIOD
from slot_core.simulation.plant import CYCLE
from slot_core.simulation.readings import ImuReading, OdometryReading
from slot_core.simulation.simulated_servos import BusServos
from slot_core.simulation.supervised_loop import SupervisedLoop

PAGE = Path(__file__).parents[2] / "slot_bringup" / "doc" / "safety.md"
BEGIN = 1.0  # s since the start, of the fault; the robot walks since 0.34 s
ANGLE_MAX = read_robot().tendon.angle_max  # rad
SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
# s, of the controller and, at which it ticks, of the IMU
TICK, SAMPLE = 0.033, 0.005
STRIDE = read_gaits().strides["walk"].period
WAIT = read_estimator().timing.odometry_wait
NO_ODOMETRY = WAIT + (SETTINGS.estimate.coast_cycles + 1) * TICK
CONTROLLER = ("state_estimator", "mpc_controller", "force_mapper")
BOTH = ("sim", "fake_bus")


class FaultyLoop(SupervisedLoop):
    """A walk with a fault at BEGIN, which changes what the loop passes on.

    changes: functions by the type of a reading, and of the angles of a "command".
    """

    def __init__(self, hardware):
        super().__init__("flat", "walk", None, 0, hardware=hardware)
        self.first = {}  # s since the fault, of an event
        self.changes = defaultdict(lambda: lambda value: value)
        self.estop = {}  # sources of the e-stop by name: whether it is pressed
        self.clock_offset = 0  # ns, of the computer's clock

    def since(self, stamp):
        """Time since the fault, s."""
        return round((stamp - LOCKSTEP_START) / SECOND - BEGIN, 9)

    def react(self, fault, last, limit):
        """Walk, let `fault` happen, and run until the event `last` or for `limit` s.

        Events are states of the robot, actions of the servos, slewed commands, torque off, and
        servos that their own watchdog has stopped. `first` has the first time of each.
        """
        list(self.run(BEGIN))
        assert self.report.state is State.WALKING
        # after the cycle of the servos
        self.plant.timeline.every(CYCLE, self._watch)
        fault(self)
        for report in self.run(limit):
            imu = any(w.startswith("no usable IMU") for w in report.warnings)
            self._note({report.state.name: True, "warned": imu})
            if last in self.first:
                return

    def _watch(self):
        health, powered = self.servos.report().health, ()
        events = {self.servos.action.name: True}
        if isinstance(self.servos, BusServos):
            powered = self.plant.emulated.powered()
            servos = self.plant.emulated.bus.servos
            stopped = [s.memory["bus_watchdog"] == TRIPPED for s in servos]
            events["servos stopped"] = all(stopped)
        elif health is not None:
            powered = health.torque
        events["torque off"] = not any(powered)
        if health is not None and health.action is Action.PASS:
            events["slewed"] = health.slewed.any()
        self._note(events)
        return []

    def _note(self, events):
        for event, happens in events.items():
            if happens:
                self.first.setdefault(event, self.since(self.plant.now))

    def receive(self, reading):
        if (changed := self.changes[type(reading)](reading)) is not None:
            super().receive(changed)

    def control(self, tick):
        angle = self.changes["command"](tick.command.angle)
        command = replace(tick.command, angle=angle)
        super().control(replace(tick, command=command))

    def supervise(self, report):
        for source, pressed in self.estop.items():
            receive = partial(
                self.supervisor.receive_estop, source=source, pressed=pressed
            )
            self.ticked.add("e-stop", report.stamp, receive)
        stamp = report.stamp + self.clock_offset
        return super().supervise(replace(report, stamp=stamp))


def changed(change, *kinds):
    """A fault that changes readings of these types, or each "command"."""
    return lambda loop: loop.changes.update(dict.fromkeys(kinds, change))


def nowhere(odometry):
    return replace(odometry, position=np.full(3, np.nan))


def lost_again_and_again(loop):
    """No usable odometry for a second, with half a second in between."""

    def spoilt(odometry):
        bad = loop.since(odometry.stamp) % 1.5 < 1.0
        return nowhere(odometry) if bad else odometry

    changed(spoilt, OdometryReading)(loop)


def tilt(axis, loop):
    """Let both sensors turn by 0.75 rad at 3 rad/s, as a robot that tips over."""
    unit = np.eye(3)["xyz".index(axis)]

    def tilted(reading):
        angle = 3.0 * loop.since(reading.stamp)
        turn = Rotation.from_rotvec(np.clip(angle, 0.0, 0.75) * unit)
        vectors = {
            name: turn.inv().apply(getattr(reading, name))
            for name in ("velocity", "angular_velocity", "specific_force")
            if hasattr(reading, name)
        }
        if 0.0 < angle < 0.75:
            vectors["angular_velocity"] += 3.0 * unit
        if hasattr(reading, "quaternion"):
            after = Rotation.from_quat(reading.quaternion) * turn
            vectors["quaternion"] = after.as_quat()
        return replace(reading, **vectors)

    changed(tilted, OdometryReading, ImuReading)(loop)


def spoil_problem(loop):
    scheduler = loop.loop.controller.scheduler
    step = scheduler.step

    def invalid(*arguments):
        preview = step(*arguments)
        return replace(preview, friction=np.nan * preview.friction)

    scheduler.step = invalid


def jump_command(loop):
    ends = iter(np.tile([0.0, ANGLE_MAX], 1000))
    changed(lambda _: np.full(4, next(ends)), "command")(loop)


def inject(kind, value=0.0):
    """A fault of the simulated robot, at leg FL."""
    fault = Fault(kind, "FL", 0.0, 0.0, value)
    return lambda loop: loop.plant.faults.inject(fault)


def within(limit):
    """Bounds (s) of an event with a limit from the cause on: a step of the supervisor later."""
    return 0.0, limit + SAMPLE + PERIOD + CYCLE


def after(limit):
    """Bounds (s) of an event with a limit from the last message on, and no sooner."""
    return limit - TICK - SAMPLE, limit + SAMPLE + PERIOD + CYCLE


LOST = {"HOLD": after(TIMING.command_hold), "RELAX": after(TIMING.command_lost)}
ERROR = ("RELAX", {"RELAX": within(0.0)}, ("fake_bus",))
NO_DRIVER = {
    "servos stopped": after(read_settings().servo.watchdog),
    "RELAX": after(TIMING.servo_silent),
}
IMU_LOST = {"warned": within(SETTINGS.estimate.imu_silence + 2 * TICK)}

# Row of the table: fault, last event, bounds of its events (s), hardware.
ROWS = {
    "a node of the controller dead": (
        lambda loop: loop.running.difference_update(CONTROLLER),
        "torque off",
        LOST,
        BOTH,
    ),
    "odometry lost": (
        changed(lambda _: None, OdometryReading),
        "torque off",
        {
            "HOLD": after(NO_ODOMETRY),
            "RELAX": after(NO_ODOMETRY + TIMING.hold_max),
        },
        ("sim",),
    ),
    "command not finite": (
        changed(lambda angle: [*angle[:3], np.nan], "command"),
        "torque off",
        {"HOLD": within(TICK), "RELAX": after(TIMING.command_lost)},
        ("sim",),
    ),
    "command out of range": (
        changed(lambda angle: [*angle[:3], ANGLE_MAX + 0.1], "command"),
        "HOLD",
        {"HOLD": within(TICK)},
        BOTH,
    ),
    "command too fast": (
        jump_command,
        "slewed",
        {"slewed": within(2 * TICK)},
        ("sim",),
    ),
    "supervisor dead": (
        lambda loop: loop.running.remove("supervisor"),
        "torque off",
        LOST,
        BOTH,
    ),
    "no usable estimate": (
        changed(nowhere, OdometryReading),
        "HOLD",
        {"HOLD": after(NO_ODOMETRY)},
        ("sim",),
    ),
    "no usable estimate, again and again": (
        lost_again_and_again,
        "torque off",
        {
            "HOLD": after(NO_ODOMETRY),
            "RELAX": after(1.5 * TIMING.holds_max + NO_ODOMETRY),
        },
        ("sim",),
    ),
    "no solution of the MPC": (
        spoil_problem,
        "HOLD",
        {"HOLD": after((read_mpc().fallback.cycles + 1) * TICK)},
        ("sim",),
    ),
    "tendon 5 mm longer": (
        inject("tendon_slack", 5e-3),
        "HOLD",
        {"HOLD": within(2 * STRIDE)},
        ("sim",),
    ),
    "tendon broken": (
        inject("tendon_broken"),
        "torque off",
        {"HOLD": within(STRIDE), "RELAX": within(STRIDE + TIMING.hold_max)},
        ("sim",),
    ),
    "walk without motion": (
        lambda loop: setattr(loop.plant, "command", lambda *_: None),
        "HOLD",
        {"HOLD": within(SETTINGS.motion.window + 5 * TICK)},
        ("sim",),
    ),
    # it walks on
    "IMU lost": (
        changed(lambda _: None, ImuReading),
        "HOLD",
        IMU_LOST,
        ("sim",),
    ),
    "IMU not finite": (
        changed(
            lambda i: replace(i, specific_force=np.full(3, np.nan)), ImuReading
        ),
        "warned",
        IMU_LOST,
        ("sim",),
    ),
    "clock jumps": (
        lambda loop: setattr(loop, "clock_offset", 600_000_000),
        "HOLD",
        {"HOLD": within(0.0)},
        ("sim",),
    ),
    "roll too large": (
        partial(tilt, "x"),
        "torque off",
        {"RELAX": within(6 * TICK)},
        ("sim",),
    ),
    "pitch too large": (
        partial(tilt, "y"),
        "RELAX",
        {"RELAX": within(6 * TICK)},
        ("sim",),
    ),
    "servo silent": (
        inject("silent"),
        "FAULT",
        {"RELAX": after(TIMING.servo_silent)},
        ("fake_bus",),
    ),
    "servo: overload": (
        inject("overload"),
        "torque off",
        {"RELAX": within(0.0)},
        ("fake_bus",),
    ),
    "servo: overheating": (
        inject("overheating", 90.0),
        *ERROR,
    ),
    "servo: input voltage": (
        inject("undervoltage", 8.0),
        *ERROR,
    ),
    "adapter unplugged": (
        inject("unplugged"),
        "RELAX",
        NO_DRIVER,
        ("fake_bus",),
    ),
    "driver killed": (
        lambda loop: setattr(loop.servos, "end", "killed"),
        "RELAX",
        NO_DRIVER,
        ("fake_bus",),
    ),
    "e-stop pressed at one of two sources": (
        lambda loop: loop.estop.update(button=True),
        "torque off",
        {"ESTOP": within(0.0)},
        BOTH,
    ),
    "one of two sources of the e-stop lost": (
        lambda loop: loop.estop.pop("terminal"),
        "torque off",
        {"ESTOP": after(TIMING.estop)},
        ("sim",),
    ),
}
CASES = [
    (row, hardware) for row, entry in ROWS.items() for hardware in entry[3]
]
EVENTS = (
    "slewed",
    "warned",
    "HOLD",
    "servos stopped",
    "RELAX",
    "ESTOP",
    "torque off",
)


def measured(loop):
    """The events in their order, as in the page."""
    found = sorted(
        (time, event) for event, time in loop.first.items() if event in EVENTS
    )
    return ", ".join(f"{event} {time:.2f} s" for time, event in found)


def page_rows():
    """The page's figures by row and hardware."""
    text = (
        PAGE.read_text()
        .partition("| at 1 s of a walk |")[2]
        .partition("\n\n")[0]
    )
    rows = [line.strip("| ").split(" | ") for line in text.splitlines()[2:]]
    return {
        (row[0], hardware): cell
        for row in rows
        for hardware, cell in zip(("sim", "fake_bus"), row[1:])
        if cell.strip("- ")
    }


@pytest.mark.parametrize(("row", "hardware"), CASES)
def test_a_fault_of_a_walking_robot_ends_as_the_table_says_at_the_time_it_says(
    row, hardware
):
    fault, last, bounds, _ = ROWS[row]
    loop, figures = FaultyLoop(hardware), page_rows()
    assert set(figures) == set(CASES)
    if "of two sources" in row:
        loop.estop = {"button": False, "terminal": False}
    loop.react(fault, last, 8.0)
    assert measured(loop) == figures[row, hardware]
    for event, (low, high) in bounds.items():
        assert low < loop.first[event] <= high, event
    if row == "IMU lost":
        assert loop.report.state is State.WALKING
        # measured: 0.048 m/s of the commanded 0.05
        assert loop.plant.robot.position[0] > 0.35


@pytest.mark.parametrize(
    ("scene", "velocity", "changes"),
    [
        ("slope10", 0.03, {}),  # its feet slide
        ("flat", 0.005, {}),
        ("flat", 0.05, {"scene.payload.mass": 2.0}),  # its belly drags
    ],
)
def test_a_walk_that_moves_a_little_is_not_held_for_it(
    scene, velocity, changes
):
    loop = SupervisedLoop(
        scene, "walk", np.array([velocity, 0, 0]), 0, changes=changes
    )
    assert State.HOLD not in {report.state for report in loop.run(10.0)}

"""The table of faults in slot_bringup/doc/safety.md at the limits of config/, to a servo's cycle.

Everything runs on the robot's clock, so the times are the same on every machine.
"""

from pathlib import Path

import numpy as np
import pytest
from faulty_loop import ANGLE_MAX, FaultyLoop

from slot_core.dynamixel.settings import read_settings
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.mpc.settings import read_mpc
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_core.safety.supervisor import PERIOD
from slot_core.simulation.plant import CYCLE
from slot_core.simulation.supervised_loop import SupervisedLoop

PAGE = Path(__file__).parents[2] / "slot_bringup" / "doc" / "safety.md"
SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
# s, of the controller and, at which it ticks, of the IMU
TICK, SAMPLE = 0.033, 0.005
STRIDE = read_gaits().strides["walk"].period
WAIT = read_estimator().timing.odometry_wait
NO_ODOMETRY = WAIT + (SETTINGS.estimate.coast_cycles + 1) * TICK
CONTROLLER = ("state_estimator", "mpc_controller", "force_mapper")
BOTH = ("sim", "fake_bus")


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
        lambda loop: loop.kill(*CONTROLLER),
        "torque off",
        LOST,
        BOTH,
    ),
    "odometry lost": (
        FaultyLoop.lose_odometry,
        "torque off",
        {
            "HOLD": after(NO_ODOMETRY),
            "RELAX": after(NO_ODOMETRY + TIMING.hold_max),
        },
        ("sim",),
    ),
    "command not finite": (
        lambda loop: loop.spoil_command(np.nan),
        "torque off",
        {"HOLD": within(TICK), "RELAX": after(TIMING.command_lost)},
        ("sim",),
    ),
    "command out of range": (
        lambda loop: loop.spoil_command(ANGLE_MAX + 0.1),
        "HOLD",
        {"HOLD": within(TICK)},
        BOTH,
    ),
    "command too fast": (
        FaultyLoop.jump_command,
        "slewed",
        {"slewed": within(2 * TICK)},
        ("sim",),
    ),
    "supervisor dead": (
        lambda loop: loop.kill("supervisor"),
        "torque off",
        LOST,
        BOTH,
    ),
    "no usable estimate": (
        FaultyLoop.spoil_odometry,
        "HOLD",
        {"HOLD": after(NO_ODOMETRY)},
        ("sim",),
    ),
    "no usable estimate, again and again": (
        FaultyLoop.spoil_odometry_again_and_again,
        "torque off",
        {
            "HOLD": after(NO_ODOMETRY),
            "RELAX": after(1.5 * TIMING.holds_max + NO_ODOMETRY),
        },
        ("sim",),
    ),
    "no solution of the MPC": (
        FaultyLoop.spoil_problem,
        "HOLD",
        {"HOLD": after((read_mpc().fallback.cycles + 1) * TICK)},
        ("sim",),
    ),
    "tendon 5 mm longer": (
        lambda loop: loop.inject("tendon_slack", 5e-3),
        "HOLD",
        {"HOLD": within(2 * STRIDE)},
        ("sim",),
    ),
    "tendon broken": (
        lambda loop: loop.inject("tendon_broken"),
        "torque off",
        {"HOLD": within(STRIDE), "RELAX": within(STRIDE + TIMING.hold_max)},
        ("sim",),
    ),
    "walk without motion": (
        FaultyLoop.jam,
        "HOLD",
        {"HOLD": within(SETTINGS.motion.window + 5 * TICK)},
        ("sim",),
    ),
    # it walks on
    "IMU lost": (
        FaultyLoop.lose_imu,
        "HOLD",
        IMU_LOST,
        ("sim",),
    ),
    "IMU not finite": (FaultyLoop.spoil_imu, "warned", IMU_LOST, ("sim",)),
    "clock jumps": (
        FaultyLoop.jump_clock,
        "HOLD",
        {"HOLD": within(0.0)},
        ("sim",),
    ),
    "roll too large": (
        lambda loop: loop.tilt("x"),
        "torque off",
        {"RELAX": within(6 * TICK)},
        ("sim",),
    ),
    "pitch too large": (
        lambda loop: loop.tilt("y"),
        "RELAX",
        {"RELAX": within(6 * TICK)},
        ("sim",),
    ),
    "servo silent": (
        lambda loop: loop.inject("silent"),
        "FAULT",
        {"RELAX": after(TIMING.servo_silent)},
        ("fake_bus",),
    ),
    "servo: overload": (
        lambda loop: loop.inject("overload"),
        "torque off",
        {"RELAX": within(0.0)},
        ("fake_bus",),
    ),
    "servo: overheating": (
        lambda loop: loop.inject("overheating", 90.0),
        *ERROR,
    ),
    "servo: input voltage": (
        lambda loop: loop.inject("undervoltage", 8.0),
        *ERROR,
    ),
    "adapter unplugged": (
        lambda loop: loop.inject("unplugged"),
        "RELAX",
        NO_DRIVER,
        ("fake_bus",),
    ),
    "driver killed": (FaultyLoop.end_driver, "RELAX", NO_DRIVER, ("fake_bus",)),
    "e-stop pressed at one of two sources": (
        FaultyLoop.press_estop,
        "torque off",
        {"ESTOP": within(0.0)},
        BOTH,
    ),
    "one of two sources of the e-stop lost": (
        FaultyLoop.lose_estop,
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


def test_a_hold_ends_a_fifth_of_a_second_after_its_reason_and_the_robot_walks_on():
    loop = FaultyLoop("sim")
    loop.react(lambda loop: loop.spoil_command(np.nan), "HOLD", 1.0)
    loop.change_command = lambda angle: angle
    begin = loop.plant.now
    walks = next(r for r in loop.run(1.0) if r.state is State.WALKING)
    taken = (walks.since - begin) * 1e-9
    assert TIMING.recovery < taken <= TIMING.recovery + TICK + 2 * PERIOD

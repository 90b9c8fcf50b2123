"""The servo bus: rate, step responses of both control loops, registers of another tool, age of a command.

The servos are emulated behind a pseudo-terminal in a separate process, with the transmission time
of the bytes at 1 Mbaud. The rate is the median cycle's, because
other processes share the machine. Step responses run in the emulated servos' time. Another tool has left
the least or the largest value in a register of servo FL: it is named and mended by `prepare`, or the step
is as without it.
"""

import contextlib
import itertools
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import (
    Attempts,
    Outcome,
    Progress,
    Row,
    at_least,
    at_most,
    cpu_ratio,
    cpu_time,
)
from benchmarks.servo import age
from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.checks import expected
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import TABLE
from slot_core.robot import LEGS, read_robot
from slot_core.servos.servo_bus import RefusedError
from slot_core.simulation.plant import CYCLE
from slot_core.simulation.rod_robot import RodRobot

STEP = (0.5, 1.5)  # rad
# with another value of the first two a servo does not answer; the driver sets the third
ADDRESSING = ("id", "baud_rate", "torque_enable")
# of a cycle of emulated servos over ten steps of 1 ms of the robot
CYCLES, CYCLE_RATIO = 50, 6.0
LOADS = (0.0, 0.3)  # N m on the tendon's angle
STYLES = {
    "position": ("C0", "servo's own loop"),
    "pwm": ("C1", "loop on the host, PWM mode"),
}


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run all parts; plots: servo_step.png and servo_age.png in `out`."""
    progress("bus cycles")
    cycles = [*cycle_rows(200 if quick else 2000), emulation_row()]
    fast, plain = (row["rate_hz"] for row in cycles[:2])
    # Four answers in one packet: fewer bytes on the line.
    rate = at_least(
        "rate with fast sync read over that without", fast / plain, 1.0
    )
    progress("step responses")
    steps = list(step_rows(out / "servo_step.png"))
    progress("registers of another tool")
    registers = list(register_rows())
    changed = max(row["step_changed_deg"] for row in registers)
    ages, attempts = {}, Attempts()
    for nodes in age.NODES:
        progress(name := f"age of a command, in real time, nodes {nodes}")
        found = attempts.run(name, age.walk, 6.0 if quick else 60.0, nodes)
        if found is not None:
            ages[nodes] = found
    age.draw(ages, out / "servo_age.png")
    aged = [age.row(found, nodes) for nodes, found in ages.items()]
    return [*cycles, *steps, *registers, *aged, *attempts.rows], [
        rate,
        at_most(
            "cycle of emulated servos over the robot's steps meanwhile",
            cycles[-1]["over_robot"],
            CYCLE_RATIO,
        ),
        at_most(
            "step changed by a register of another tool", changed, 0.0, "deg"
        ),
        *age.checks(aged),
        *attempts.checks,
    ]


def cycle_rows(count: int) -> Iterator[Row]:
    """Bus cycles without pauses, with and without fast sync read, and with an adapter's latency."""
    for fast, latency in ((True, 0.0), (False, 0.0), (True, 0.001)):
        changes = {} if fast else {"servo.fast_from_firmware": 256}
        with emulated(changes, latency) as driver:
            driver.activate()
            start = time.monotonic()
            found = [driver.cycle() for _ in range(count)]
            duration = time.monotonic() - start
            driver.torque_off()
        median, p99 = np.quantile(
            [cycle.duration for cycle in found], (0.5, 0.99)
        )
        yield {
            "kind": "cycle",
            "fast_sync_read": fast,
            "usb_latency_ms": 1e3 * latency,
            "rate_hz": 1.0 / median,
            "mean_rate_hz": count / duration,
            "p50_ms": 1e3 * median,
            "p99_ms": 1e3 * p99,
            "incomplete": sum(not cycle.complete for cycle in found),
        }


def emulation_row() -> Row:
    """CPU time of a bus cycle of four emulated servos in one process, and over that of the robot."""
    servos, driver = resting("position")
    driver.configure()
    driver.activate()
    robot = RodRobot(read_robot(), read_scene("flat"), read_servo())

    def cycles() -> None:
        for _ in range(CYCLES):
            driver.command([STEP[0]] * len(LEGS))
            driver.cycle()
            servos.advance(CYCLE)

    return {
        "kind": "emulated cycle",
        "ms": 1e3 * cpu_time(cycles, 5) / CYCLES,
        "over_robot": cpu_ratio(
            cycles, lambda: robot.advance(10 * CYCLES, robot.tendon_angle), 5
        ),
    }


def step_rows(path: Path) -> Iterator[Row]:
    """Responses to a step, and their plot: sampled every 10 ms, without and with load, N m."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    for (control, (colour, name)), load in itertools.product(
        STYLES.items(), LOADS
    ):
        trace = step_response(control, load)
        yield {
            "kind": "step",
            "control": control,
            "load": load,
            **measures(trace),
        }
        times, style = (
            1e3 * CYCLE * np.arange(len(trace)),
            "--" if load else "-",
        )
        axes.plot(
            times, trace, style, color=colour, label=f"{name}, {load:g} N m"
        )
    axes.set(xlabel="time, ms", ylabel="tendon angle, rad", xlim=(0.0, 600.0))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def register_rows() -> Iterator[Row]:
    """Whether the driver names a register, and the change of the step response with it or once mended."""
    sound = step_response("position", 0.0)
    left = (
        register
        for register in TABLE.values()
        if register.writable and register.name not in ADDRESSING
    )
    for register in left:
        for value in (register.low, register.high):
            servos, driver = resting("position")
            servos.bus.servos[0].memory[register.name] = value
            reasons: list[str] = []
            try:
                driver.configure()
            except RefusedError as error:
                reasons = error.reasons
                # as scripts/servos prepare does
                for name, wanted in expected(
                    servos.settings, driver.joints[0]
                ).items():
                    driver.bus.write_verified(driver.joints[0].id, name, wanted)
                driver.configure()
            trace = stepped(servos, driver, 0.0)
            yield {
                "kind": "register",
                "register": register.name,
                "value": value,
                "named": any(
                    f"{register.name} is {value}," in r for r in reasons
                ),
                "step_changed_deg": math.degrees(
                    np.abs(np.subtract(trace, sound)).max()
                ),
            }


def step_response(control: str, load: float) -> list[float]:
    """Angles after a step, rad; `load`: torque on the tendon angles, N m."""
    servos, driver = resting(control)
    driver.configure()
    return stepped(servos, driver, load)


def resting(control: str) -> tuple[EmulatedDynamixels, Driver]:
    """Servos at the begin of a step, and a driver of them that is not configured yet."""
    settings = config.replace(read_settings(), {"control": control})
    servos = EmulatedDynamixels(settings, read_emulator(), STEP[:1] * 4)
    return servos, servos.connect(lambda: servos.bus.time)


def stepped(
    servos: EmulatedDynamixels, driver: Driver, load: float
) -> list[float]:
    """Angles of servo FL, rad, after a step that a configured driver commands."""
    driver.activate()
    for goal in STEP:
        trace: list[float] = []
        for _ in range(round(1.5 / CYCLE)):
            driver.command([goal] * 4)
            trace.append(driver.cycle().readings[0].angle)  # type: ignore[union-attr]
            servos.advance(CYCLE, (load,) * 4)
    driver.torque_off()
    return trace


def measures(trace: list[float]) -> dict[str, float]:
    """Rise time (10 to 90 %), overshoot and steady-state error of a response to STEP."""
    share = (np.array(trace) - trace[0]) / (STEP[1] - trace[0])
    return {
        "rise_ms": 1e3
        * (CYCLE * (int(np.argmax(share > 0.9)) - int(np.argmax(share > 0.1)))),
        "overshoot_deg": math.degrees(max(max(trace) - STEP[1], 0.0)),
        "error_deg": math.degrees(STEP[1] - float(np.mean(trace[-20:]))),
    }


@contextlib.contextmanager
def emulated(changes: dict[str, Any], latency: float) -> Iterator[Driver]:
    """A configured driver on servos that are emulated in a separate process."""
    settings = config.replace(read_settings(), changes)
    with tempfile.TemporaryDirectory() as directory:
        command = [
            *(sys.executable, "-m", "slot_bringup.servos", "emulate"),
            *("--link", f"{directory}/servos"),
            *("--usb-latency", str(latency)),
        ]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            name, bus = process.stdout.readline().strip(), settings.bus
            driver = Driver(SerialPort(name, bus.baud, bus.timeout), settings)
            assert len(driver.configure()) == len(LEGS)
            yield driver
        finally:
            process.terminate()
            process.wait(10)

"""The whole loop on simulated time with the faults of slot_bringup/doc/safety.md."""

import dataclasses
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.clock import LOCKSTEP_START, SECOND
from slot_core.dynamixel.emulator.emulated_servo import TRIPPED
from slot_core.faults import Fault
from slot_core.robot import read_robot
from slot_core.safety.states import Action, State
from slot_core.simulation.plant import CYCLE
from slot_core.simulation.readings import ImuReading, OdometryReading
from slot_core.simulation.simulated_servos import BusServos
from slot_core.simulation.supervised_loop import SupervisedLoop

ANGLE_MAX = read_robot().tendon.angle_max  # rad
BEGIN = 1.0  # s since the start, of the fault; the robot walks since 0.34 s


class FaultyLoop(SupervisedLoop):
    """A walk, with dead nodes and bad inputs."""

    def __init__(self, hardware="sim", scene="flat", seed=0):
        super().__init__(scene, "walk", None, seed, hardware=hardware)
        self.first = {}  # s since the fault, of an event
        self.change_odometry = self.change_command = self.change_imu = (
            lambda value: value
        )
        self.estop = {}  # sources of the e-stop by name: whether it is pressed
        self.clock_offset = 0  # ns, of the computer's clock

    def react(self, fault, last, limit, begin=BEGIN):
        """Walk for `begin` s, let `fault` happen, and run until the event `last` or for `limit` s.

        Events are states of the robot, actions of the servos, slewed commands, torque off, and
        servos that their own watchdog has stopped. `first` has the first time of each.
        """
        self._fault_at = begin
        list(self.run(begin))
        assert self.report.state is State.WALKING
        # after the cycle of the servos
        self.plant.timeline.every(CYCLE, self._watch)
        fault(self)
        for report in self.run(limit):
            self._note(report.state.name)
            if any(
                line.startswith("no usable IMU") for line in report.warnings
            ):
                self._note("warned")
            if last in self.first:
                return

    def _watch(self):
        self._note(self.servos.action.name)
        health = self.servos.report().health
        if isinstance(self.servos, BusServos):
            powered = self.plant.emulated.powered()
            servos = self.plant.emulated.bus.servos
            if all(servo.memory["bus_watchdog"] == TRIPPED for servo in servos):
                self._note("servos stopped")
        else:
            powered = health.torque
        if not any(powered):
            self._note("torque off")
        if (
            health is not None
            and health.slewed.any()
            and health.action is Action.PASS
        ):
            self._note("slewed")
        return []

    def _note(self, event):
        since = (self.plant.now - LOCKSTEP_START) / SECOND - self._fault_at
        self.first.setdefault(event, round(since, 9))

    # faults

    def kill(self, *nodes):
        self.running -= {*nodes}

    def end_driver(self):
        self.servos.end = "killed"

    def inject(self, kind, value=0.0, leg="FL"):
        self.plant.faults.inject(Fault(kind, leg, 0.0, 0.0, value))

    def lose_odometry(self):
        self.change_odometry = lambda o: None

    def spoil_odometry(self):
        self.change_odometry = lambda o: dataclasses.replace(
            o, position=np.full(3, np.nan)
        )

    def spoil_odometry_again_and_again(self):
        """For a second, with half a second in between."""
        begin = self.plant.now

        def spoilt(odometry):
            bad = (odometry.stamp - begin) % (1.5 * SECOND) < SECOND
            change = {"position": np.full(3, np.nan)} if bad else {}
            return dataclasses.replace(odometry, **change)

        self.change_odometry = spoilt

    def lose_imu(self):
        self.change_imu = lambda i: None

    def spoil_imu(self):
        self.change_imu = lambda i: dataclasses.replace(
            i, specific_force=np.full(3, np.nan)
        )

    def jam(self):
        self.plant.command = lambda *_: None

    def tilt(self, axis):
        """Let both sensors turn by 0.75 rad at 3 rad/s, as a robot that tips over."""
        unit = np.eye(3)["xyz".index(axis)]
        begin = self.plant.now

        def tilted(reading):
            angle = 3.0 * (reading.stamp - begin) / SECOND
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
            return dataclasses.replace(reading, **vectors)

        self.change_odometry = self.change_imu = tilted

    def spoil_problem(self):
        step = self.loop.controller.scheduler.step

        def invalid(*arguments):
            preview = step(*arguments)
            return dataclasses.replace(
                preview, friction=np.full_like(preview.friction, np.nan)
            )

        self.loop.controller.scheduler.step = invalid

    def spoil_command(self, value):
        self.change_command = lambda angle: np.array([*angle[:3], value])

    def jump_command(self):
        ends = iter(np.tile([0.0, ANGLE_MAX], 1000))
        self.change_command = lambda _: np.full(4, next(ends))

    def press_estop(self):
        """Press the e-stop at one source; another one goes on saying that it is not."""
        self.estop["button"] = True

    def lose_estop(self):
        self.estop.pop("terminal")

    def jump_clock(self):
        self.clock_offset = 600_000_000

    # the loop

    def receive(self, reading):
        if isinstance(reading, OdometryReading):
            reading = self.change_odometry(reading)
        if isinstance(reading, ImuReading):
            reading = self.change_imu(reading)
        if reading is not None:
            super().receive(reading)

    def control(self, tick):
        angle = self.change_command(tick.command.angle)
        command = dataclasses.replace(tick.command, angle=angle)
        super().control(dataclasses.replace(tick, command=command))

    def supervise(self, report):
        for source, pressed in self.estop.items():
            receive = partial(
                self.supervisor.receive_estop, source=source, pressed=pressed
            )
            self.ticked.add("e-stop", report.stamp, receive)
        shifted = dataclasses.replace(
            report, stamp=report.stamp + self.clock_offset
        )
        return super().supervise(shifted)

"""The four servos of the robot: checked, switched on without motion, moved, switched off.

    configure  the servos are those expected and set up as they must be; else RefusedError says why
    activate   goals := present positions, then torque on; every write is read back
    command    tendon angles asked for (rad); a vector with a wrong value is rejected as a whole
    cycle      one exchange with all servos: goals out, positions, velocities and loads in
    torque_off confirmed by reading back; never raises

Nothing is invented: a servo that did not answer has no reading. All times come from `clock`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from slot_core import config
from slot_core.clock import Clock
from slot_core.dynamixel.bus import Answer, Bus
from slot_core.dynamixel.checks import ServoInfo, examine, expected, hardware_errors
from slot_core.dynamixel.errors import PortError, RefusedError, ServoError
from slot_core.dynamixel.host_pid import HostPid
from slot_core.dynamixel.joints import Joint, joints
from slot_core.dynamixel.port import SerialPort, check_latency
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.dynamixel.state import Cycle, Health, ServoReading, TorqueOff, Verdict
from slot_core.dynamixel.table import LOAD_FULL, VOLTAGE_UNIT, Mode
from slot_core.robot import LEGS, Array

TORQUE_OFF_ATTEMPTS = 3
LONGEST_STEP = 0.05  # s: the goals move no further at once, however late a cycle is
# One of these is read from one servo in every cycle; no two have the same length.
SLOW = (
    ("torque_enable", "led"),
    ("status_return_level", "hardware_error_status"),
    ("bus_watchdog", "bus_watchdog"),
    ("present_input_voltage", "backup_ready"),
)
FAST = ("present_load", "present_position")


class Driver:
    """Driver of four servos on an open or closed port."""

    def __init__(
        self, port: SerialPort, settings: DynamixelSettings, clock: Clock = time.monotonic
    ) -> None:
        self.settings = settings
        self.joints: tuple[Joint, ...] = joints(settings.joints)
        self.bus = Bus(port, settings.bus, {joint.id: joint.name for joint in self.joints})
        self.active = False
        self.health = tuple(Health(joint.leg, joint.id) for joint in self.joints)
        self.clock, self._port = clock, port
        self._fast = False
        self._pid = HostPid(settings.host_pid)
        self._wanted: Array = np.zeros(len(LEGS))  # rad, of the tendons
        self._goal: Array = np.zeros(len(LEGS))  # what has been sent
        self._unused: Array = np.zeros(len(LEGS))  # s in which the goals might have moved
        self._last: float | None = None
        self._turn = 0

    def configure(self) -> tuple[ServoInfo, ...]:
        """Open the port and check every servo; raises PortError, RefusedError (all reasons)."""
        self.active = False
        check_latency(self._port.port_name, self.settings.bus.latency_limit)
        self._port.open()
        found = [examine(self.bus, self.settings, joint) for joint in self.joints]
        infos = tuple(info for info, _ in found if info is not None)
        if reasons := [reason for _, reasons in found for reason in reasons]:
            self._port.close()
            raise RefusedError(reasons)
        now = self.clock()
        self.health = tuple(replace(health, last_answer=now) for health in self.health)
        oldest = min(info.firmware for info in infos)
        self._fast = oldest >= self.settings.servo.fast_from_firmware
        return infos

    def activate(self) -> None:
        """Torque on where the servos stand, without motion; else all off and RefusedError."""
        if self.active:
            raise RefusedError(["activate: torque is on already"])
        try:
            self._prepare()
            for index, joint in enumerate(self.joints):
                self.bus.confirm(joint.id, "torque_enable", 1)
                self._set_health(index, replace(self.health[index], torque=True))
        except RefusedError:
            self.torque_off()
            raise
        except ServoError as error:
            self.torque_off()
            raise RefusedError([str(error)]) from error
        self.active = True

    def command(self, angles: Sequence[float] | Array) -> Verdict:
        """Ask for tendon angles (4,), rad. One wrong value rejects all: the last stay in force."""
        wanted = np.asarray(angles, dtype=float)
        if wanted.shape != (len(LEGS),):
            return Verdict(False, f"{wanted.size} angles, expected {len(LEGS)}")
        if not self.active:
            return Verdict(False, "torque is off")
        for joint, angle in zip(self.joints, wanted):
            if not joint.low <= angle <= joint.high:  # NaN neither
                return Verdict(
                    False,
                    f"{joint.leg}: {angle:.4g} rad outside [{joint.low:.4g}, {joint.high:.4g}]",
                )
        self._wanted = wanted.copy()
        return Verdict(True)

    def goals(self) -> Array:
        """Tendon angles (4,) that have been sent, rad."""
        return self._goal.copy()

    def hold(self) -> None:
        """Stay at what was sent last."""
        self._wanted = self._goal.copy()

    def cycle(self) -> Cycle:
        """One exchange with all servos; raises PortError where the port has gone."""
        start = self.clock()
        h = 0.0 if self._last is None else max(start - self._last, 0.0)
        self._last = start
        slewed = self._slew(h)
        if self.settings.mode is Mode.PWM:
            readings = self._read()
            duty = self._regulate(readings, h)
            written = self.clock()
        else:
            self._write_positions()
            written = self.clock()
            readings, duty = self._read(), None
        self._look_around(readings)
        end = self.clock()
        return Cycle(end, end - start, written, readings, tuple(map(bool, slewed)), duty)

    def relax(self, duration: float, period: float, sleep: Callable[[float], None]) -> TorqueOff:
        """Slacken the tendons within `duration` s, then torque off, whatever happens; blocks."""
        try:
            self._slacken(duration, period, sleep)
        except ServoError:
            return self.torque_off()
        except BaseException:  # an interrupt too must not leave torque on
            self.torque_off()
            raise
        return self.torque_off()

    def _slacken(self, duration: float, period: float, sleep: Callable[[float], None]) -> None:
        start, begin = self._goal.copy(), self.clock()
        end = np.minimum(start, [joint.low for joint in self.joints])
        while self.active and (share := (self.clock() - begin) / duration) < 1.0:
            self._wanted = start + share * (end - start)
            self.cycle()
            sleep(period)

    def torque_off(self) -> TorqueOff:
        """Switch all torque off and read it back; never raises."""
        self.active = False
        self._pid.reset()
        with contextlib.suppress(ServoError):  # all at once, before one that is silent takes time
            self.bus.sync_write("torque_enable", {joint.id: 0 for joint in self.joints})
        reasons = [self._confirm_off(index, joint) for index, joint in enumerate(self.joints)]
        return TorqueOff(
            tuple(not reason for reason in reasons), tuple(reason for reason in reasons if reason)
        )

    def reboot(self, leg: str) -> None:
        """Restart a servo, as after a hardware error; raises ServoError, also while active."""
        if self.active:
            raise RefusedError(["reboot: torque is on; switch it off first"])
        self.bus.reboot(self.joints[LEGS.index(leg)].id)

    def set_zero(self, leg: str, zero_deg: float) -> None:
        """Let a leg be relaxed at an angle of its servo (deg), whose own limits move with it.

        Raises ConfigError where the angle is out of bounds, ServoError where torque is on.
        """
        if self.active:
            raise RefusedError(["set_zero: torque is on; switch it off first"])
        index = LEGS.index(leg)
        zeros = list(self.settings.joints.zero_deg)
        zeros[index] = zero_deg
        self.settings = config.replace(self.settings, {"joints.zero_deg": tuple(zeros)})
        self.joints = joints(self.settings.joints)
        joint = self.joints[index]
        for register in ("min_position_limit", "max_position_limit"):
            self.bus.confirm(joint.id, register, expected(self.settings, joint)[register])

    def close(self) -> None:
        """Close the port; torque stays as it is."""
        self._port.close()

    def silent_for(self, leg: str) -> float:
        """Time since a servo answered last, s; infinite if it never has."""
        last = self.health[LEGS.index(leg)].last_answer
        return np.inf if last is None else self.clock() - last

    def faults(self) -> list[str]:
        """What is wrong with the servos, in words."""
        return [fault for health in self.health for fault in health.faults(self.active)]

    def _prepare(self) -> None:
        """Everything before torque on; the goals become the present positions."""
        reasons: list[str] = []
        self._pid.reset()
        self._last = None
        for index, joint in enumerate(self.joints):
            error = self.bus.read(joint.id, "hardware_error_status")["hardware_error_status"]
            if error:
                reasons.append(f"{joint.name}: hardware error: {hardware_errors(error)}; reboot it")
                continue
            self.bus.confirm(joint.id, "torque_enable", 0)
            self.bus.confirm(joint.id, "bus_watchdog", 0)  # a tripped one refuses goals
            reasons += self._stand_still(index, joint)
        if reasons:
            raise RefusedError(reasons)
        self._wanted = self._goal.copy()

    def _stand_still(self, index: int, joint: Joint) -> list[str]:
        """Goal := present position, gains and profile; what speaks against it."""
        present = self.bus.read(joint.id, "present_position")["present_position"]
        low, high = joint.limits()
        if not low <= present <= high:
            return [
                f"{joint.name}: stands at {present} counts, outside its limits [{low}, {high}];"
                " turn it back by hand, or zero it"
            ]
        self._goal[index] = joint.tendon(present)
        # Armed before torque is on: it watches from the first moment.
        self.bus.confirm(joint.id, "bus_watchdog", self.settings.servo.watchdog_code())
        if self.settings.mode is Mode.PWM:
            self.bus.confirm(joint.id, "goal_pwm", 0)
            return []
        gains = self.settings.gains
        for register, value in (
            ("profile_acceleration", 0),
            ("profile_velocity", 0),
            ("feedforward_2nd_gain", 0),
            ("feedforward_1st_gain", 0),
            ("position_p_gain", gains.p),
            ("position_i_gain", gains.i),
            ("position_d_gain", gains.d),
            ("goal_position", present),
        ):
            self.bus.confirm(joint.id, register, value)
        return []

    def _slew(self, h: float) -> npt.NDArray[np.bool_]:
        """Move the goals towards what is wanted, within the speed limit; which were held back.

        Time in which they rested counts, else a command soon after a cycle would wait for the next.
        """
        limit = self.settings.joints.speed_limit
        self._unused = np.minimum(self._unused + h, LONGEST_STEP)
        step, reach = self._wanted - self._goal, limit * self._unused
        slewed = np.abs(step) > reach
        self._goal = np.where(slewed, self._goal + np.clip(step, -reach, reach), self._wanted)
        self._unused = np.where(slewed, 0.0, self._unused - np.abs(step) / limit)
        return slewed

    def _write_positions(self) -> None:
        if self.active:
            goals = zip(self.joints, self._goal)
            self.bus.sync_write(
                "goal_position", {joint.id: joint.counts(goal) for joint, goal in goals}
            )

    def _regulate(self, readings: tuple[ServoReading | None, ...], h: float) -> Array:
        if not self.active or h == 0.0:
            return self._pid.duty.copy()
        angle = np.array([np.nan if r is None else r.angle for r in readings])
        speed = np.array([np.nan if r is None else r.rate for r in readings])
        duty = self._pid.step(self._goal, angle, speed, h)
        pwm = {joint.id: joint.pwm(share) for joint, share in zip(self.joints, duty)}
        self.bus.sync_write("goal_pwm", pwm)
        return duty

    def _read(self) -> tuple[ServoReading | None, ...]:
        answers = self.bus.sync_read((joint.id for joint in self.joints), *FAST, self._fast)
        return tuple(
            self._reading(joint, answers[joint.id]) if joint.id in answers else None
            for joint in self.joints
        )

    def _reading(self, joint: Joint, answer: Answer) -> ServoReading:
        values = answer.values
        return ServoReading(
            time=self.clock(),
            angle=joint.tendon(values["present_position"]),
            rate=joint.tendon_rate(values["present_velocity"]),
            load=joint.direction * values["present_load"] / LOAD_FULL,
            alert=answer.alert,
        )

    def _look_around(self, readings: tuple[ServoReading | None, ...]) -> None:
        """Note what the cycle has shown; read one more thing from one servo."""
        turn, self._turn = self._turn, self._turn + 1
        for index, reading in enumerate(readings):
            self._note(index, reading)
            if reading is not None and reading.alert:
                self._read_slow(index, SLOW[1])
        index = turn % len(LEGS)
        if readings[index] is not None:
            self._read_slow(index, SLOW[turn // len(LEGS) % len(SLOW)])

    def _note(self, index: int, reading: ServoReading | None) -> None:
        quality = self.bus.quality.get(self.joints[index].id)
        rate = 0.0 if quality is None else quality.error_rate
        health = replace(self.health[index], error_rate=rate)
        if reading is not None:
            health = replace(health, last_answer=reading.time)
        self._set_health(index, health)

    def _read_slow(self, index: int, item: tuple[str, str]) -> None:
        try:
            values = self.bus.read(self.joints[index].id, *item)
        except PortError:
            raise
        except ServoError:
            return  # counted by the bus; what is known stays as it was
        health = self.health[index]
        if "torque_enable" in values:
            health = replace(health, torque=bool(values["torque_enable"]))
        if "hardware_error_status" in values:
            health = replace(health, hardware_error=values["hardware_error_status"])
        if "bus_watchdog" in values:
            health = replace(health, watchdog=values["bus_watchdog"])
        if "present_temperature" in values:
            health = replace(
                health,
                temperature=float(values["present_temperature"]),
                voltage=values["present_input_voltage"] * VOLTAGE_UNIT,
            )
        self._set_health(index, health)

    def _set_health(self, index: int, health: Health) -> None:
        self.health = (*self.health[:index], health, *self.health[index + 1 :])

    def _confirm_off(self, index: int, joint: Joint) -> str:
        """Torque off; why it is not confirmed, or nothing."""
        reason = ""
        for _ in range(TORQUE_OFF_ATTEMPTS):
            try:
                self.bus.confirm(joint.id, "torque_enable", 0)
            except ServoError as error:
                reason = str(error)
                continue
            self._set_health(index, replace(self.health[index], torque=False))
            with contextlib.suppress(ServoError):  # it does not matter with torque off
                self.bus.write(joint.id, "bus_watchdog", 0)
            return ""
        return reason

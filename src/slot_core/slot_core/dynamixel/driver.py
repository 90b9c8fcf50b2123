"""Driver of four Dynamixel servos, which implements `ServoBus` and `ServoMaintenance`.

Model, firmware and EEPROM of every servo are checked; every write outside a cycle is read back.
Raises also CommunicationError and InstructionError of `bus.py`, which are ServoErrors.

Position control on the host: PID whose output is the servos' PWM duty.

    duty = k_p e + I - k_d w,   e = goal - angle,   dI/dt = k_i e

w is the measured speed through a first-order low-pass filter; the derivative acts on it and not on
e, so that a step of the goal causes no kick. The duty is limited to +-duty_limit and its change to
duty_rate. The integral is held while the duty is at one of these limits and e would drive it
further (anti-windup by clamping: Astrom and Hagglund, Advanced PID Control, 2006, section 3.5).
Four legs at once; angles in rad, time in s, duty 1: full voltage.
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.clock import Clock
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.checks import (
    ServoInfo,
    examine,
    expected,
    measure_zero,
    prepare_torque,
    write_zero,
)
from slot_core.dynamixel.port import SerialPort, check_latency
from slot_core.dynamixel.settings import (
    DynamixelSettings,
    HostPidSettings,
    Joint,
    joints,
)
from slot_core.dynamixel.table import LOAD_FULL, VOLTAGE_UNIT, Mode
from slot_core.robot import LEGS
from slot_core.servos.servo_bus import (
    BusFacts,
    Cycle,
    PortError,
    RefusedError,
    ServoError,
    ServoReading,
    ServoStatus,
    TorqueOff,
)


class HostPid:
    """PID of the four legs, with its state."""

    def __init__(self, settings: HostPidSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Set integral, filtered speed and duty to 0."""
        self.integral: Array = np.zeros(len(LEGS))
        self.duty: Array = np.zeros(len(LEGS))
        self._speed: Array = np.zeros(len(LEGS))
        self._missing: Array = np.zeros(len(LEGS))

    def step(self, goal: Array, angle: Array, speed: Array, h: float) -> Array:
        """Duty (4,) for the next h s from goal (rad), angle (rad) and speed (rad/s), each (4,).

        NaN in angle or speed: no reading. A leg without a reading keeps its duty for `blind_time`,
        then its duty is 0. Raises ValueError unless h is positive.
        """
        if h <= 0:
            raise ValueError(f"h = {h}: expected a positive time")
        s, valid = self._settings, np.isfinite(angle) & np.isfinite(speed)
        self._missing = np.where(valid, 0.0, self._missing + h)
        error = np.where(valid, goal - angle, 0.0)
        weight = h / (s.filter_time + h)
        self._speed += np.where(valid, weight * (speed - self._speed), 0.0)
        integral = self.integral + s.i * h * error
        unlimited = s.p * error + integral - s.d * self._speed
        low = np.maximum(self.duty - s.duty_rate * h, -s.duty_limit)
        high = np.minimum(self.duty + s.duty_rate * h, s.duty_limit)
        limited = np.clip(unlimited, low, high)
        winding = (unlimited - limited) * error > 0.0
        self.integral = np.where(winding | ~valid, self.integral, integral)
        held = np.where(self._missing <= s.blind_time, self.duty, 0.0)
        self.duty = np.where(valid, limited, held)
        return self.duty.copy()


TORQUE_OFF_ATTEMPTS = 3
# One of these is read from one servo in every cycle; no two have the same length.
SLOW = (
    ("torque_enable", "led"),
    ("status_return_level", "hardware_error_status"),
    ("bus_watchdog", "bus_watchdog"),
    ("present_input_voltage", "backup_ready"),
)
FAST = ("present_load", "present_position")
HEALTH: dict[str, tuple[str, Callable[[int], object]]] = {
    "torque_enable": ("torque", bool),
    "hardware_error_status": ("hardware_error", int),
    "bus_watchdog": ("stopped", lambda code: code < 0),
    "present_temperature": ("temperature", float),
    "present_input_voltage": ("voltage", lambda units: units * VOLTAGE_UNIT),
}
"""Field of the health and its value, by register."""


class Driver:
    """Driver of four servos on an open or closed port."""

    def __init__(
        self,
        port: SerialPort,
        settings: DynamixelSettings,
        clock: Clock = time.monotonic,
    ) -> None:
        self.settings = settings
        self.joints: tuple[Joint, ...] = joints(settings.joints)
        self.bus = Bus(
            port, settings.bus, {joint.id: joint.name for joint in self.joints}
        )
        self.facts = BusFacts(
            "dynamixel",
            port.port_name,
            self.joints[0].low,
            self.joints[0].high,
            settings.servo.watchdog,
        )
        self.active = False
        self.health = tuple(
            ServoStatus(joint.leg, joint.id) for joint in self.joints
        )
        self.clock, self._port = clock, port
        self._fast = False
        # ids whose last answer had a hardware error
        self._alerts: set[int] = set()
        self._pid = HostPid(settings.host_pid)
        self._goal: Array = np.zeros(len(LEGS))  # rad, of the tendons
        self._last: float | None = None
        self._turn = 0

    def configure(self) -> tuple[str, ...]:
        """Open the port and check every servo; switches off torque where it refuses."""
        self.active = False
        check_latency(self._port.port_name, self.settings.bus.latency_limit)
        self._port.open()
        found = [
            examine(self.bus, self.settings, joint) for joint in self.joints
        ]
        infos: list[ServoInfo] = [info for info, _ in found if info is not None]
        if reasons := [reason for _, reasons in found for reason in reasons]:
            self.torque_off()
            self._port.close()
            raise RefusedError(reasons)
        now = self.clock()
        self.health = tuple(
            replace(health, last_answer=now) for health in self.health
        )
        self._fast = (
            min(info.firmware for info in infos)
            >= self.settings.servo.fast_from_firmware
        )
        return tuple(
            f"{info.leg} id {info.id} v{info.firmware}" for info in infos
        )

    def activate(self) -> None:
        """Torque on at the present positions, without motion; else torque off and RefusedError."""
        if self.active:
            raise RefusedError(["activate: torque is on already"])
        try:
            self._prepare()
            for index, joint in enumerate(self.joints):
                self.bus.write_verified(joint.id, "torque_enable", 1)
                self._change_health(index, torque=True)
        except ServoError as error:
            self.torque_off()
            if isinstance(error, RefusedError):
                raise
            raise RefusedError([str(error)]) from error
        self.active = True

    def command(self, angles: Sequence[float] | Array) -> None:
        """Set the goals: tendon angles (4,), rad; raises ValueError and keeps the last goals."""
        goal = np.asarray(angles, dtype=float)
        if goal.shape != (len(LEGS),):
            raise ValueError(f"{goal.size} angles, expected {len(LEGS)}")
        if not self.active:
            raise ValueError("torque is off")
        for joint, angle in zip(self.joints, goal):
            if not joint.low <= angle <= joint.high:  # also true for NaN
                raise ValueError(
                    f"{joint.leg}: {angle:.4g} rad outside [{joint.low:.4g}, {joint.high:.4g}]"
                )
        self._goal = goal.copy()

    def goals(self) -> Array:
        """Goals (4,), tendon angles, rad."""
        return self._goal.copy()

    def cycle(self) -> Cycle:
        """One exchange with all servos; raises PortError if the port has disappeared."""
        # an interrupt may have left an exchange unfinished
        self._port.is_using = False
        start = self.clock()
        h = 0.0 if self._last is None else max(start - self._last, 0.0)
        self._last = start
        if self.settings.mode is Mode.PWM:
            readings = self._read()
            self._regulate(readings, h)
            written = self.clock()
        else:
            if self.active:
                self.bus.sync_write(
                    "goal_position",
                    {
                        joint.id: joint.counts(goal)
                        for joint, goal in zip(self.joints, self._goal)
                    },
                )
            written = self.clock()
            readings = self._read()
        self._update_health(readings)
        return Cycle(self.clock() - start, written, readings)

    def torque_off(self) -> TorqueOff:
        """Switch all torque off and read it back; never raises."""
        self.active = self._port.is_using = False
        self._pid.reset()
        # all at once first: a silent servo delays the others
        with contextlib.suppress(ServoError):
            self.bus.sync_write(
                "torque_enable", {joint.id: 0 for joint in self.joints}
            )
        reasons = [
            self._confirm_off(index, joint)
            for index, joint in enumerate(self.joints)
        ]
        return TorqueOff(
            tuple(not reason for reason in reasons),
            tuple(reason for reason in reasons if reason),
        )

    def reboot(self, leg: str) -> None:
        """Restart a servo, as after a hardware error; raises ServoError, also while active."""
        self._require_off("reboot")
        self.bus.reboot(self.joints[LEGS.index(leg)].id)

    def zero(self, leg: str, sleep: Callable[[float], None]) -> str:
        """Set the zero of a leg to its present angle at rest, now and in `dynamixel.yaml`.

        Raises ConfigError, OSError and ServoError, also where torque is on.
        """
        self._require_off("zero")
        angle = measure_zero(self.bus, self.joints[LEGS.index(leg)], sleep)
        file = write_zero(leg, angle)
        self.set_zero(leg, angle)
        return f"zero of {leg} at {angle:.2f} deg, written to {file}"

    def set_zero(self, leg: str, zero_deg: float) -> None:
        """Set the servo angle (deg) at which a leg's tendon is relaxed; the servo's limits follow.

        Raises ConfigError where angle or limits are out of bounds, ServoError where torque is on.
        """
        self._require_off("set_zero")
        index = LEGS.index(leg)
        zeros = list(self.settings.joints.zero_deg)
        zeros[index] = zero_deg
        settings = config.replace(self.settings, {"joints.zero_deg": zeros})
        self.joints, self.settings = joints(settings.joints), settings
        joint = self.joints[index]
        for register in ("min_position_limit", "max_position_limit"):
            self.bus.write_verified(
                joint.id, register, expected(self.settings, joint)[register]
            )

    def close(self) -> None:
        """Close the port; torque stays as it is."""
        self._port.close()

    def _require_off(self, action: str) -> None:
        if self.active:
            raise RefusedError([f"{action}: torque is on; switch it off first"])

    def _prepare(self) -> None:
        """Do everything that comes before torque on; the goals become the present positions."""
        reasons: list[str] = []
        self._pid.reset()
        self._last = None
        for index, joint in enumerate(self.joints):
            try:
                present = prepare_torque(self.bus, self.settings, joint)
                self._goal[index] = joint.tendon(present)
            except RefusedError as error:
                reasons += error.reasons
        if reasons:
            raise RefusedError(reasons)

    def _regulate(
        self, readings: tuple[ServoReading | None, ...], h: float
    ) -> None:
        """Write the duty of the host PID."""
        if not self.active or h == 0.0:
            return
        angle, speed = np.array(
            [
                (np.nan, np.nan) if r is None else (r.angle, r.rate)
                for r in readings
            ]
        ).T
        duty = self._pid.step(self._goal, angle, speed, h)
        self.bus.sync_write(
            "goal_pwm",
            {
                joint.id: joint.pwm(share)
                for joint, share in zip(self.joints, duty)
            },
        )

    def _read(self) -> tuple[ServoReading | None, ...]:
        answers = self.bus.sync_read(
            (joint.id for joint in self.joints), *FAST, self._fast
        )
        self._alerts = {
            identity for identity, answer in answers.items() if answer.alert
        }
        return tuple(
            ServoReading(
                time=self.clock(),
                angle=joint.tendon(answer.values["present_position"]),
                rate=joint.tendon_rate(answer.values["present_velocity"]),
                load=joint.direction
                * answer.values["present_load"]
                / LOAD_FULL,
            )
            if (answer := answers.get(joint.id))
            else None
            for joint in self.joints
        )

    def _update_health(self, readings: tuple[ServoReading | None, ...]) -> None:
        """Update the health from the cycle; read one slow register span from one servo."""
        turn, self._turn = self._turn, self._turn + 1
        for index, reading in enumerate(readings):
            identity = self.joints[index].id
            self._change_health(index, error_rate=self.bus.error_rate(identity))
            if reading is not None:
                self._change_health(index, last_answer=reading.time)
            if identity in self._alerts:
                self._read_slow(index, SLOW[1])
        index = turn % len(LEGS)
        if readings[index] is not None:
            self._read_slow(index, SLOW[turn // len(LEGS) % len(SLOW)])

    def _read_slow(self, index: int, item: tuple[str, str]) -> None:
        try:
            values = self.bus.read(self.joints[index].id, *item)
        except PortError:
            raise
        except ServoError:
            return  # counted by the bus; the last values stay
        found = [
            (*HEALTH[name], value)
            for name, value in values.items()
            if name in HEALTH
        ]
        self._change_health(
            index, **{field: convert(value) for field, convert, value in found}
        )

    def _change_health(self, index: int, **changes: Any) -> None:
        self.health = (
            *self.health[:index],
            replace(self.health[index], **changes),
            *self.health[index + 1 :],
        )

    def _confirm_off(self, index: int, joint: Joint) -> str:
        """Switch torque off and read it back; returns why it is not confirmed, or ""."""
        reason = ""
        for _ in range(TORQUE_OFF_ATTEMPTS):
            try:
                self.bus.write_verified(joint.id, "torque_enable", 0)
            except ServoError as error:
                reason = str(error)
                continue
            self._change_health(index, torque=False)
            # without effect once torque is off
            with contextlib.suppress(ServoError):
                self.bus.write(joint.id, "bus_watchdog", 0)
            return ""
        return reason

"""A walk that is held in mid-stride: the emulated servos' loads, and how the robot goes on."""

import dataclasses

import numpy as np
import pytest

from slot_core.control.policy import Status
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.gait.gait import read_gaits
from slot_core.safety.states import State
from slot_core.simulation.plant import CYCLE
from slot_core.simulation.supervised_loop import SupervisedLoop

SERVO = read_emulator().servo
PERIOD = read_gaits().strides["walk"].period


class HeldLoop(SupervisedLoop):
    """A walk on emulated servos, held while the supervisor believes that the MPC has stopped."""

    stopped = False

    def control(self, tick):
        if self.stopped:
            plan = dataclasses.replace(tick.plan, status=Status.STOPPED)
            tick = dataclasses.replace(tick, plan=plan)
        super().control(tick)

    def observe(self, seconds):
        """Loads (n, 4), shares of stall, each cycle; tilts (n,), deg; states, every 20 ms."""
        loads, tilts, states = [], [], []

        def load():
            shafts = [s.shaft for s in self.plant.emulated.bus.servos]
            loads.append([abs(s.torque) / s.motor.stall for s in shafts])
            return []

        self.plant.timeline.every(CYCLE, load)
        for report in self.run(seconds):
            tilts.append(np.degrees(np.abs(self.plant.robot.rpy[:2])).max())
            states.append(report.state)
        return np.array(loads), np.array(tilts), states


# Phases at which one servo or more overloaded within a second while the goals stayed.
@pytest.mark.parametrize(
    ("scene", "payload", "eighth", "seed"),
    [
        ("flat", 0.0, 2, 0),
        ("flat", 0.0, 6, 1),
        ("slope10", 0.0, 2, 2),
        ("slope10", 0.0, 6, 3),
        ("flat", 0.8, 2, 4),
        ("flat", 0.8, 6, 5),
        ("low_battery", 0.0, 0, 6),
        ("low_battery", 0.0, 4, 7),
    ],
)
def test_a_hold_in_mid_stride_overloads_no_servo_and_the_robot_walks_on(
    scene, payload, eighth, seed
):
    changes = {"scene.payload.mass": payload} if payload else {}
    loop = HeldLoop(
        scene, "walk", None, seed, hardware="fake_bus", changes=changes
    )
    list(loop.run(2.0 + eighth / 8 * PERIOD))
    loop.stopped = True
    loads, tilts, states = loop.observe(1.5)
    assert states[-1] is State.HOLD
    high = np.cumsum(loads > SERVO.overload_share, axis=0)[-1] * CYCLE
    assert (high < 0.5 * SERVO.overload_time).all()
    assert loads[-50:].max() < 0.9 * SERVO.overload_share
    assert tilts.max() < 10.0
    assert tilts[-1] < 2.0
    loop.stopped = False
    _, tilts, states = loop.observe(2.0)
    assert states[-1] is State.WALKING
    assert tilts.max() < 10.0

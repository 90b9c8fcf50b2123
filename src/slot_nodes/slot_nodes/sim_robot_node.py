"""The simulated robot: `/desired_joint_angles` in, sensors and ground truth out.

In real time the plant follows the ROS clock, and its servos obey `/robot_state` as real ones do; a
servo without torque lets its tendon unwind as fast as it turns. In lockstep there is no supervisor
and the plant carries the clock: it stops at every odometry reading until the command with that
reading's stamp has come, and publishes `/clock`. Either way the robot stands frozen: silent until
it is recorded, where it is to be, and at rest until the first command that passes. So no run
depends on the order of discovery.

A fault comes from the scene, or by the service `~/inject`. A simulation that is lost ends the node;
its state is written to a file.

With `bus` set, the commands come over an emulated bus of servos behind a pseudo-terminal of that
name. The robot is then silent until all servos are under torque, and it outlasts its driver, so
that the driver can switch them off.
"""

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import IntegerRange
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool

from slot_core.bags import decode
from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import ServoSettings, read_servo
from slot_core.dynamics.simulated_robot import Divergence
from slot_core.dynamixel.settings import read_settings
from slot_core.emulator.emulated_bus import read_emulator
from slot_core.emulator.pseudo_terminal import PseudoTerminal
from slot_core.robot import LEGS, Array, read_robot
from slot_core.safety.command_gate import Action
from slot_core.safety.command_watchdog import CommandWatchdog, Word
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import JointReading, Plant, Reading, TrueState
from slot_core.simulation.sensors import ImuReading, OdometryReading
from slot_msgs.msg import LegStates, RobotState
from slot_nodes import fault_service, inputs, messages, qos, runtime

LOCKSTEP_START = 1_000_000_000  # ns; a stamp of zero means "no time" in ROS
WAIT_PERIOD = 0.1  # s, between the readings of the frozen robot in lockstep
REAL_TIME_PERIOD = 0.002  # s, between looks at the clock
CATCH_UP = 20_000_000  # ns of simulation per callback at most, so that commands get through
BUS_CATCH_UP = 4_000_000  # ns, so that the servos' time does not run away from their driver's
RECORDER = "recorder"
RECORDER_KNOWN = 5.0  # s after which a topic that it is not known to record is not recorded
LAG_WARNING = 100_000_000  # ns behind real time
OUTLAST = 3.0  # s for the driver to switch the servos off
BUS_SILENCE = 0.3  # s after which the driver has ended
THREAD_SWITCH = 5e-4  # s: how long the simulation keeps the bus from answering


class SimRobotNode(Node):
    """Publishes what the plant's sensors read; passes commands to its servos."""

    def __init__(self) -> None:
        super().__init__("sim_robot")
        self._lockstep = runtime.declare(self, "lockstep", False, "advance only on a command")
        seeds = [IntegerRange(from_value=0, to_value=2**63 - 1)]
        seed = runtime.declare(self, "seed", 0, "of the sensor noise", integer_range=seeds)
        scene = runtime.declare(self, "scene", "flat", "a file of config/scene")
        self._records = runtime.declare(
            self, "wait_for_recording", False, "be silent until /recording"
        )
        self._recorded_since: float | None = None  # s, monotonic
        dump = runtime.declare(
            self, "dump", "", "where the state of a lost simulation goes; none: working directory"
        )
        self._keep_state = partial(fault_service.keep_state, dump, scene)
        link = runtime.declare(self, "bus", "", "port of emulated servos; none: servo.yaml's")
        settings = runtime.declare_settings(self, read_scene(scene), "scene.")
        servo = runtime.declare_settings(self, read_servo(), "servo.")
        self.get_logger().info("preparing; a first start compiles the dynamics, about 10 s")
        try:
            self._plant = self._make_plant(settings, servo, seed, bool(link))
        except Divergence as error:
            self._give_up(error)
        self._terminal: PseudoTerminal | None = None
        self._frozen = True
        self._told = 0  # last time published on /clock, ns
        self._awaited = LOCKSTEP_START  # stamp of the odometry whose command lets the plant go on
        self._create_publishers()
        fault_service.serve(self, self._plant)
        self._watchdog = self._make_watchdog()
        self._torque = True
        inputs.subscribe(self, JointState, "desired_joint_angles", self._on_command, qos.CONTROL)
        self.create_subscription(Bool, "recording", self._on_recording, qos.CONTROL)
        waiting = WAIT_PERIOD if self._lockstep else settings.sensors.odometry.period
        self._timer = runtime.wall_timer(self, waiting, self._publish_frozen)
        if link:  # at last: what has come before would keep its servos from answering
            self._terminal = self._open_bus(Path(link))

    def _make_plant(self, scene: Scene, servo: ServoSettings, seed: int, bus: bool) -> Plant:
        rng = np.random.default_rng(seed)
        if not bus:
            return Plant(read_robot(), scene, servo, rng)
        if self._lockstep:
            raise ConfigError("sim_robot: servos on a bus move in real time: no lockstep with them")
        settings, emulator = read_settings(), read_emulator()
        return BusPlant(read_robot(), scene, servo, rng, settings=settings, emulator=emulator)

    def _open_bus(self, link: Path) -> PseudoTerminal:
        """Let the emulated servos answer at `link`; raises ConfigError where something else is."""
        assert isinstance(self._plant, BusPlant)
        if link.exists() and Path("/dev/pts") not in link.resolve().parents:
            raise ConfigError(f"sim_robot: bus = {link}: exists already")
        sys.setswitchinterval(THREAD_SWITCH)
        return PseudoTerminal(self._plant.legs.bus, link)

    def _make_watchdog(self) -> CommandWatchdog | None:
        """What guards simulated servos in real time: those on a bus have their driver."""
        if self._lockstep or isinstance(self._plant, BusPlant):
            return None
        settings = read_supervisor()
        self._clock_jump = settings.timing.clock_jump
        watchdog = CommandWatchdog(settings, read_robot().tendon.angle_max)
        watchdog.engage(self._plant.simulator.tendon_angle)
        inputs.subscribe(self, RobotState, "robot_state", self._on_robot_state, qos.STATE)
        return watchdog

    def _create_publishers(self) -> None:
        self._clock_topic = self.create_publisher(ClockMessage, "/clock", qos.CLOCK)
        self._outputs: dict[type, tuple[Publisher, Callable[..., Any]]] = {
            ImuReading: (self.create_publisher(Imu, "imu", qos.SENSOR), messages.imu_to_msg),
            JointReading: (
                self.create_publisher(JointState, "joint_states", qos.SENSOR),
                messages.joints_to_msg,
            ),
            OdometryReading: (
                self.create_publisher(Odometry, "odom", qos.SENSOR),
                messages.odometry_to_msg,
            ),
        }
        self._truth = self.create_publisher(Odometry, "ground_truth/odom", qos.SENSOR)
        self._legs = self.create_publisher(LegStates, "ground_truth/legs", qos.SENSOR)

    def _publish_frozen(self) -> None:
        """Report the robot at rest until a command shows that the whole graph is there."""
        if self._records and self._recorded_since is None:
            return
        if not (self._is_powered() and self._is_matched()):
            return
        stamp = LOCKSTEP_START if self._lockstep else self.get_clock().now().nanoseconds
        for reading in self._plant.present(stamp):
            self._publish(reading)

    def _is_powered(self) -> bool:
        """Whether the servos are under torque."""
        return not isinstance(self._plant, BusPlant) or len(self._plant.powered()) == len(LEGS)

    def _is_free(self) -> bool:
        """Whether the servos follow commands, so that time may begin."""
        if self._watchdog is None:
            return self._is_powered()
        self._watchdog.step(time.monotonic_ns())
        return self._watchdog.action is Action.PASS

    def _is_matched(self) -> bool:
        """Whether every subscriber that is known will hear what is published now.

        The recorder has to be known: that it records may be heard before it is.
        """
        publishers = [publisher for publisher, _ in self._outputs.values()]
        late = self._recorded_since and time.monotonic() - self._recorded_since > RECORDER_KNOWN
        for publisher in (*publishers, self._truth, self._legs):
            readers = self.get_subscriptions_info_by_topic(publisher.topic_name)
            if publisher.get_subscription_count() < len(readers):
                return False
            if self._records and not late and RECORDER not in {r.node_name for r in readers}:
                return False
        return True

    def _on_recording(self, message: Bool) -> None:
        self._recorded_since = time.monotonic()

    def _on_robot_state(self, message: RobotState) -> None:
        _, state, action, reason = decode.robot_state(message)
        assert self._watchdog is not None
        self._watchdog.permit(Word(time.monotonic_ns(), action, state is State.WALKING, reason))

    def _on_command(self, message: JointState) -> None:
        stamp, angle = decode.joint_angles(message)
        if self._watchdog is None:
            self._plant.command(angle)
        else:
            self._offer(self._watchdog, stamp, angle)
        if self._frozen and self._is_free():
            self._start()
        if self._lockstep and stamp == self._awaited:
            self._advance_one_tick()

    def _offer(self, watchdog: CommandWatchdog, stamp: int, angle: Array) -> None:
        """Raises ValueError for what the simulated servos must not follow."""
        inputs.require_present(stamp, self.get_clock().now().nanoseconds, self._clock_jump)
        if fault := watchdog.offer(time.monotonic_ns(), angle):
            raise ValueError(fault)

    def _obey(self, watchdog: CommandWatchdog) -> None:
        """Give the simulated servos what the watchdog lets through."""
        before, gated = watchdog.action, watchdog.step(time.monotonic_ns())
        if gated.torque and not self._torque:
            watchdog.engage(self._plant.simulator.tendon_angle)
            gated = watchdog.step(time.monotonic_ns())
        self._torque = gated.torque
        self._plant.command(gated.angle if gated.torque else np.zeros(len(LEGS)))
        if watchdog.action is not before:
            self.get_logger().info(f"{watchdog.action.name} {watchdog.reason}".strip())

    def _start(self) -> None:
        self._frozen = False
        self.destroy_timer(self._timer)
        if self._lockstep:
            self._plant.start(LOCKSTEP_START)
        else:
            self._plant.start(self.get_clock().now().nanoseconds)
            self._timer = runtime.wall_timer(self, REAL_TIME_PERIOD, self._follow_clock)

    def _advance_one_tick(self) -> None:
        for reading in self._guarded(self._plant.advance_to_odometry()):
            self._publish(reading)
        self._awaited = reading.stamp

    def _follow_clock(self) -> None:
        """Advance the plant to the present, in bounded portions."""
        if self._watchdog is not None:
            self._obey(self._watchdog)
        now = self.get_clock().now().nanoseconds
        if now - self._plant.now > LAG_WARNING:
            lag = (now - self._plant.now) * 1e-9
            self.get_logger().warning(
                f"simulation is {lag:.2f} s behind real time (limit {LAG_WARNING * 1e-9} s)",
                throttle_duration_sec=1.0,
            )
        until = min(now, self._plant.now + (BUS_CATCH_UP if self._terminal else CATCH_UP))
        for reading in self._guarded(self._plant.advance(until)):
            self._publish(reading)

    def _guarded(self, readings: Iterator[Reading]) -> Iterator[Reading]:
        """End the node with one line when the simulation diverges: no invented motion."""
        try:
            yield from readings
        except Divergence as error:
            self._give_up(error)

    def _give_up(self, error: Divergence) -> NoReturn:
        self._frozen = True  # while the driver switches off
        self.get_logger().fatal(f"simulation stopped: {error}; {self._keep_state(error)}")
        raise SystemExit(1) from None

    def destroy_node(self) -> None:
        """Let the driver switch off before its bus goes."""
        if self._terminal is not None:
            self._outlast_driver(self._terminal)
            self._terminal.close()
        super().destroy_node()

    def _outlast_driver(self, terminal: PseudoTerminal) -> None:
        assert isinstance(self._plant, BusPlant)
        last = time.monotonic()
        end = last + OUTLAST
        while terminal.silence < BUS_SILENCE and last < end:
            time.sleep(REAL_TIME_PERIOD)
            now = time.monotonic()
            if not self._frozen:
                for _ in self._plant.advance(self._plant.now + round((now - last) * 1e9)):
                    pass  # nobody listens any more
            last = now
        left = ", ".join(self._plant.powered())
        runtime.last_logger(self).info(f"servos left under torque: {left or 'none'}")

    def _publish(self, reading: Reading) -> None:
        if self._lockstep and self._told != self._plant.now:
            self._told = self._plant.now
            self._clock_topic.publish(ClockMessage(clock=messages.ns_to_stamp(self._told)))
        if isinstance(reading, TrueState):
            self._truth.publish(messages.odometry_to_msg(reading.odometry))
            self._legs.publish(messages.legs_to_msg(reading))
        else:
            publisher, encode = self._outputs[type(reading)]
            publisher.publish(encode(reading))


def main() -> None:
    """Entry point of the node."""
    runtime.run(SimRobotNode)

"""The simulated robot: `/desired_joint_angles` in, sensors and ground truth out.

Two parameters choose its clock (`simulation/clocks.py`) and its servos
(`simulation/simulated_servos.py`):

    parameter      clock      servos
    none           real time  direct: they obey `/robot_state` and report on `/servo_health`
    bus            real time  emulated, on a pseudo-terminal of that name
    lockstep       lockstep   direct, on the robot's clock
    lockstep, bus  lockstep   emulated, behind the driver, which then runs in this node

The robot starts frozen. It publishes nothing until its servos are powered (in lockstep: have their
limits) and, with `wait_for_recording`, the recorder is ready; then it publishes readings at rest
until its servos follow the first command, on a bus until the driver moves one of them; in lockstep
until the first command and the supervisor's first state. So no run depends on the order of
discovery. At its end the node switches emulated servos off, or waits for the driver to do so.

Faults are planned in the scene or injected by the service `~/inject`. If the simulation diverges,
the node writes its state to a file and ends.
"""

import time
from collections.abc import Callable, Iterable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, Imu, JointState
from std_msgs.msg import Bool

from slot_core.clock import to_seconds
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.estimation.state_estimator import read_estimator
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.refusal import DivergenceError
from slot_core.robot import read_robot
from slot_core.safety.states import Action
from slot_core.servos.registry import read_brand
from slot_core.servos.servo_bus import JointReading, RefusedError
from slot_core.simulation.clocks import (
    PATIENCE,
    Answer,
    BusClock,
    LockstepClock,
    RealTimeClock,
)
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.readings import (
    ImageReading,
    ImuReading,
    OdometryReading,
    Reading,
    StampedHealth,
    TrueState,
)
from slot_core.simulation.simulated_servos import (
    BusServos,
    DirectServos,
    SimulatedServos,
    make_servos,
)
from slot_msgs.msg import LegStates, RobotState, ServoHealth, ServoLimits
from slot_msgs.srv import InjectFault
from slot_nodes import diagnostics, inputs, messages, qos, runtime
from slot_nodes.pace import Speed
from slot_nodes.process import intra_process

FROZEN_PERIOD = 0.1  # s, between two readings of the frozen robot in lockstep
REAL_TIME_PERIOD = 0.002  # s, between two advances of the simulation
PORTION = 20_000_000  # ns, longest simulation per callback, so that commands are taken between
BUS_PORTION = 4_000_000  # ns, so that the time of the servos stays close to that of the driver
RECORDER = "recorder"
IMAGES = "camera/image_raw"  # not recorded
# s; a subscriber that is not matched then misses the first readings
MATCH_TIMEOUT = 5.0
# s, between two lines that say what the first readings wait for
WAIT_REPORT = 5.0
LAG_WARNING = 100_000_000  # ns behind real time
PACE_WINDOW = 1.0  # s


class SimRobotNode(Node):
    """Publishes the readings of the simulated robot; passes commands to its servos."""

    def __init__(self) -> None:
        super().__init__("sim_robot")
        self._lockstep = runtime.declare(
            self, "lockstep", False, "advance only on an answer"
        )
        seed = runtime.declare(
            self, "seed", 0, "of the sensor noise", between=(0, 2**63 - 1)
        )
        scene = runtime.declare(self, "scene", "flat", "a file of config/scene")
        self._waits_for_recorder = runtime.declare(
            self,
            "wait_for_recording",
            False,
            "publish nothing before /recording",
        )
        self._is_recording = False
        self._matching_since: float | None = None  # s, monotonic
        self._dump = runtime.declare(
            self,
            "dump",
            "",
            "directory for the state of a diverged simulation; empty: working directory",
        )
        self._scene = scene
        link = runtime.declare(
            self,
            "bus",
            "",
            "port of emulated servos, in lockstep without one; empty: servos of servo.yaml",
        )
        settings = runtime.declare_settings(self, read_scene(scene), "scene.")
        servo = runtime.declare_settings(
            self, read_servo(settings.parameters), "servo."
        )
        self.get_logger().info(
            "preparing; a first start compiles the dynamics, about 10 s"
        )
        try:
            robot, rng = (
                read_robot(settings.parameters),
                np.random.default_rng(seed),
            )
            emulate = read_brand().emulate if link else None
            self._plant = RobotSimulator(robot, settings, servo, rng, emulate)
        except DivergenceError as error:
            self._end_diverged(error)
        self._frozen = True
        self._published_clock = 0  # last time on /clock, ns
        self._speed = Speed(PACE_WINDOW)
        self._action: Action | None = None  # of the servos, as last logged
        self._create_publishers()
        self.create_service(InjectFault, "~/inject", self._on_inject)
        self.create_subscription(
            Bool, "recording", self._on_recording, qos.STATE
        )
        period = (
            FROZEN_PERIOD
            if self._lockstep
            else settings.sensors.odometry.period
        )
        self._timer = runtime.wall_timer(self, period, self._publish_at_rest)
        self._servos = self._make_servos(link)
        self._tick = runtime.declare(
            self,
            "tick",
            read_estimator().timing.period,
            "time between two commands in lockstep, as of state_estimator [s]",
        )
        self._time = self._make_clock()

    def _make_clock(self) -> LockstepClock | RealTimeClock:
        if self._lockstep:
            return LockstepClock(self._plant, self._servos, self._tick)
        if self._plant.emulated is not None:
            return BusClock(self._plant, self._plant.emulated, BUS_PORTION)
        return RealTimeClock(self._plant, PORTION)

    def _make_servos(self, link: str) -> SimulatedServos:
        """Create the servos; last, because those on a bus must not wait for the preparation."""
        try:
            servos = make_servos(self._plant, self._lockstep, Path(link))
        except RefusedError as error:
            raise ConfigError(f"sim_robot: servos refused: {error}") from None
        if isinstance(servos, BusServos) and not self._lockstep:
            return servos  # the driver takes commands, obeys the supervisor and reports
        if isinstance(servos, DirectServos) and not self._lockstep:
            self._health = diagnostics.HealthReport(self, servos)
        on_state = partial(self._on_robot_state, servos)

        on_limits = partial(inputs.take_limits, self, servos.watchdog)
        inputs.subscribe(
            self,
            JointState,
            "desired_joint_angles",
            self._on_command,
            qos.CONTROL,
        )
        inputs.subscribe(self, RobotState, "robot_state", on_state, qos.STATE)
        inputs.subscribe(
            self, ServoLimits, "servo_limits", on_limits, qos.STATE
        )
        return servos

    def _create_publishers(self) -> None:
        self._clock_topic = intra_process.publisher(
            self.create_publisher(Clock, "clock", qos.CLOCK)
        )
        made = partial(runtime.publisher, self)
        # by the kind of a reading: topic, value of decode.py, message
        self._outputs: dict[
            type, tuple[Any, Callable[..., Any], Callable[..., Any]]
        ] = {
            ImuReading: (
                made(Imu, "imu", qos.SENSOR),
                lambda r: (r.stamp, r.angular_velocity, r.specific_force),
                messages.imu_to_msg,
            ),
            JointReading: (
                made(JointState, "joint_states", qos.SENSOR),
                lambda r: (r.stamp, r.angle, r.torque),
                messages.joints_to_msg,
            ),
        }
        if self._lockstep:
            self._outputs[StampedHealth] = (
                made(ServoHealth, "servo_health", qos.SENSOR),
                lambda report: (report.stamp, report.health),
                lambda report: messages.health_to_msg(
                    report.stamp, report.health
                ),
            )
        self._clock_template = messages.CdrTemplate(messages.clock_to_msg)
        self._templates: dict[type, messages.CdrTemplate] = {
            kind: messages.CdrTemplate(lambda *v, k=kind, m=make: m(k(*v)), *n)
            for kind, make, n in (
                (ImuReading, messages.imu_to_msg, (3, 3)),
                (JointReading, messages.joints_to_msg, (4, 4, 4)),
                (OdometryReading, messages.odometry_to_msg, (3, 4, 3, 3)),
            )
        }
        self._camera_info = None
        if self._plant.camera is None:
            self._outputs[OdometryReading] = (
                made(Odometry, "odom", qos.SENSOR),
                messages.odometry_value,
                messages.odometry_to_msg,
            )
        else:
            self._outputs[ImageReading] = (
                made(Image, IMAGES, qos.IMAGE),
                lambda _: None,
                messages.image_to_msg,
            )
            self._camera_info = made(
                CameraInfo, "camera/camera_info", qos.IMAGE
            )
        self._truth = made(Odometry, "ground_truth/odom", qos.SENSOR)
        self._legs = made(LegStates, "ground_truth/legs", qos.SENSOR)

    def _publish_at_rest(self) -> None:
        """Publish readings at rest; called until the robot's time starts.

        In real time it starts too if torque goes off before, so that the tendons unwind.
        """
        if not self._lockstep:
            self._step_servos()
            if self._servos.moving:
                self._start()
                return
        if missing := self._missing():
            self.get_logger().info(
                f"waiting for {missing}",
                throttle_duration_sec=WAIT_REPORT,
                skip_first=True,
            )
        elif isinstance(self._time, LockstepClock):
            self._publish_all(self._time.at_rest())
        else:
            self._publish_all(self._plant.readings_at_rest(self._now()))

    def _missing(self) -> str:
        """Condition for which the first readings wait, or ""."""
        if self._waits_for_recorder and not self._is_recording:
            return "the recorder"
        if not self._servos.powered:
            return "the servos: torque on, or the limits of the supervisor"
        now = time.monotonic()
        self._matching_since = self._matching_since or now
        return (
            ""
            if now - self._matching_since > MATCH_TIMEOUT
            else self._unmatched()
        )

    def _unmatched(self) -> str:
        """A topic with a discovered subscriber that would not receive the next message, or "".

        The recorder has to be among the subscribers: /recording may arrive before its discovery. A
        topic without it after `MATCH_TIMEOUT` is not recorded; a foreign subscriber of another
        quality of service is never matched.
        """
        publishers = [publisher for publisher, *_ in self._outputs.values()]
        for publisher in (*publishers, self._truth, self._legs):
            readers = self.get_subscriptions_info_by_topic(publisher.topic_name)
            if (matched := publisher.get_subscription_count()) < len(readers):
                return f"{matched} of {len(readers)} subscribers to {publisher.topic_name}"
            recorded = self._waits_for_recorder and not (
                publisher.record or publisher.topic_name.endswith(IMAGES)
            )
            if recorded and RECORDER not in {r.node_name for r in readers}:
                return f"the recorder at {publisher.topic_name}"
        return ""

    def _on_recording(self, message: Bool) -> None:
        self._is_recording = True

    def _on_robot_state(
        self, servos: SimulatedServos, message: RobotState
    ) -> None:
        permission = decode.permission(message, self._servo_time())
        try:
            inputs.require_supervisor(
                self, message, self._now(), servos.watchdog
            )
            servos.permit(permission)
        finally:
            self._continue(Answer.STATE, decode.stamp(message))

    def _on_command(self, message: JointState) -> None:
        stamp, angle, rate = decode.joint_command(message)
        try:
            inputs.require_sole_publisher(
                self, "desired_joint_angles", self._servos.watchdog.relax
            )
            inputs.require_present(
                stamp, self._now(), self._servos.watchdog.clock_jump
            )
            self._servos.offer(self._servo_time(), stamp, angle, rate)
        finally:
            self._continue(Answer.COMMAND, stamp)
        if self._frozen and not self._lockstep:
            self._servos.step(time.monotonic_ns())
            if self._servos.moving:
                self._start()

    def _continue(self, kind: Answer, stamp: int) -> None:
        """In lockstep advance if this is the awaited answer; the first two start the clock."""
        if isinstance(self._time, LockstepClock):
            self._publish_all(self._time.advance_on_answer(kind, stamp))
            if self._frozen and self._time.running:
                self._frozen = False
                self.destroy_timer(self._timer)

    def _start(self) -> None:
        """Start the robot's time, in real time."""
        self._frozen = False
        self.destroy_timer(self._timer)
        self._plant.start(self._now())
        self._timer = runtime.wall_timer(
            self, REAL_TIME_PERIOD, self._advance_to_present
        )

    def _advance_to_present(self) -> None:
        """Advance the simulation towards the present."""
        self._step_servos()
        now = self._now()
        assert isinstance(self._time, RealTimeClock)
        self._speed.add(to_seconds(now), to_seconds(self._plant.now))
        if (lag := now - self._plant.now) > LAG_WARNING:
            share = 100 * self._speed.until(to_seconds(now))
            self.get_logger().warning(
                f"simulation is {to_seconds(lag):.2f} s behind real time, at {share:.0f} % of it"
                f" (limit {to_seconds(LAG_WARNING)} s): use lockstep, or fewer processes",
                throttle_duration_sec=1.0,
            )
        self._publish_all(self._time.advance_to(now))
        if isinstance(self._time, BusClock) and self._time.waited:
            self.get_logger().warning(
                f"the driver is late: the robot's time waits, at most {to_seconds(PATIENCE):g} s",
                throttle_duration_sec=1.0,
            )

    def _step_servos(self) -> None:
        """Update the commands of the servos; publish their health and log changes of the action."""
        servos = self._servos
        servos.step(time.monotonic_ns())
        if isinstance(servos, DirectServos):
            self._health.publish_health(self._now())
            self._log_action(servos.action, servos.watchdog.reason)

    def _log_action(self, action: Action, reason: str) -> None:
        if action is not self._action:
            self.get_logger().info(f"{action.name} {reason}".strip())
        self._action = action

    def _publish_all(self, readings: Iterable[Reading]) -> None:
        """Publish readings; on divergence of the simulation end the node with one line."""
        try:
            for reading in readings:
                self._publish(reading)
        except DivergenceError as error:
            self._end_diverged(error)

    def _end_diverged(self, error: DivergenceError) -> NoReturn:
        # time stops while the driver switches the servos off
        self._frozen = True
        self.get_logger().fatal(f"{error}; {self._save_state(error)}")
        raise SystemExit(1) from None

    def _save_state(self, divergence: DivergenceError) -> str:
        """Write the state of a diverged simulation; return a line with its path or the error."""
        path = Path(
            self._dump, f"lost_{datetime.now():%Y%m%d_%H%M%S}.npz"
        ).absolute()
        try:
            divergence.save(path, self._scene)
        except OSError as error:
            return f"its state could not be written: {error}"
        return f"its state is in {path}"

    def _on_inject(
        self, request: InjectFault.Request, response: InjectFault.Response
    ) -> InjectFault.Response:
        faults = self._plant.faults
        try:
            if request.clear:
                faults.clear(request.kind, request.leg)
            else:
                faults.inject(decode.fault(request))
        except ValueError as error:
            response.message = str(error)
            return response
        done = "cleared" if request.clear else "injected"
        self.get_logger().warning(
            f"fault {done}: {request.kind} at {request.leg}"
        )
        response.success = True
        return response

    def close(self) -> None:
        """Switch emulated servos off, or wait for the driver to do so."""
        left = self._servos.close(running=not self._frozen)
        if self._plant.emulated is not None:
            runtime.last_logger(self).info(
                f"servos left under torque: {left or 'none'}"
            )

    def _publish(self, reading: Reading) -> None:
        if self._lockstep and self._published_clock != self._plant.now:
            self._published_clock = self._plant.now
            self._clock_topic.publish(
                Carried(
                    self._plant.now,
                    None,
                    partial(messages.clock_to_msg, self._plant.now),
                    partial(self._clock_template, self._plant.now),
                )
            )
        if isinstance(reading, StampedHealth):
            if reading.health is None:
                assert isinstance(self._servos, BusServos)
                self.get_logger().fatal(
                    f"{self._servos.end}; their bus watchdogs stop the servos"
                )
                raise SystemExit(1)
            self._log_action(reading.health.action, reading.health.reason)
        if isinstance(reading, TrueState):
            exact, make = reading.odometry, messages.odometry_to_msg
            for publisher, *made in (
                (self._truth, partial(make, exact), self._encoder(exact)),
                (self._legs, partial(messages.legs_to_msg, reading)),
            ):
                publisher.publish(Carried(reading.stamp, None, *made))
        else:
            if self._camera_info is not None and isinstance(
                reading, ImageReading
            ):
                assert self._plant.camera is not None
                self._camera_info.publish(
                    messages.camera_to_msg(reading.stamp, self._plant.camera)
                )
            publisher, value, encode = self._outputs[type(reading)]
            publisher.publish(
                Carried(
                    reading.stamp,
                    value(reading),
                    partial(encode, reading),
                    self._encoder(reading),
                )
            )

    def _encoder(self, reading: Reading) -> Callable[[], bytes] | None:
        """Quick way to the CDR bytes of a reading's message; None: lost odometry, and other kinds."""
        is_lost = (
            isinstance(reading, OdometryReading)
            and not reading.quaternion.any()
        )
        template = self._templates.get(type(reading))
        if template is None or is_lost:
            return None
        return partial(template, *vars(reading).values())

    def _now(self) -> int:
        """Time of the messages' clock, ns; in lockstep this robot's own."""
        return (
            self._plant.now
            if self._lockstep
            else self.get_clock().now().nanoseconds
        )

    def _servo_time(self) -> int:
        """Time of a clock that never goes back, ns."""
        return self._plant.now if self._lockstep else time.monotonic_ns()

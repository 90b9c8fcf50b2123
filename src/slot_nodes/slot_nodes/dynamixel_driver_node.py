"""The servos on their bus: `/desired_joint_angles` in, `/joint_states` and `/diagnostics` out.

    configure    open the port, check every servo
    activate     torque on where the servos stand, then a bus cycle every period
    deactivate   slacken the tendons, torque off, read back
    cleanup      close the port

However the process ends, but by SIGKILL, it first does what deactivate does; that needs no ROS
context. The lifecycle is walked by itself with `autostart`; a refusal is then the end, exit code 1.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from slot_core import decode
from slot_core.config import ConfigError
from slot_core.control.supervisor_settings import read_supervisor
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.errors import PortError, ServoError
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import LEGS, DynamixelSettings, read_settings
from slot_core.dynamixel.state import Cycle
from slot_core.robot import read_robot
from slot_core.servo_session import ServoSession, measured
from slot_nodes import diagnostics, inputs, messages, qos, runtime

LOOK_PERIOD = 0.1  # s, between looks at whether the port is there
DIAGNOSTICS_PERIOD = 1.0  # s
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class DynamixelDriverNode(LifecycleNode):
    """Runs one bus cycle per period and publishes what it measured."""

    def __init__(self) -> None:
        super().__init__("dynamixel_driver")
        if self.get_parameter("use_sim_time").value:
            raise ConfigError("dynamixel_driver: servos move in real time: no lockstep with them")
        settings = runtime.declare_settings(self, read_settings())
        rates = [FloatingPointRange(from_value=20.0, to_value=500.0)]
        rate = runtime.declare(self, "rate", 100.0, "bus cycles [Hz]", floating_point_range=rates)
        waits = [FloatingPointRange(from_value=0.0, to_value=3600.0)]
        self._patience = runtime.declare(
            self, "wait_for_port", 60.0, "how long [s]", floating_point_range=waits
        )
        autostart = runtime.declare(self, "autostart", True, "configure and activate at start")
        self._port = settings.bus.port
        self._session = make_session(settings, 1.0 / rate)
        joints = self._session.driver.joints
        stall = read_servo().stall_torque
        self._stall = np.array([abs(joint.tendon_torque(stall)) for joint in joints])
        self._open = False
        self._refusal, self._starting = "", False
        self._cycle: Cycle | None = None
        self._timer: Timer | None = None
        self._create_outputs()
        inputs.subscribe(self, JointState, "desired_joint_angles", self._on_command, qos.CONTROL)
        if autostart:
            self._end_of_wait = time.monotonic() + self._patience
            self._starter = runtime.wall_timer(self, LOOK_PERIOD, self._start_by_itself)

    def _create_outputs(self) -> None:
        self._joints = self.create_publisher(JointState, "joint_states", qos.SENSOR)
        self._health = self.create_publisher(DiagnosticArray, "/diagnostics", qos.SENSOR)
        runtime.wall_timer(self, DIAGNOSTICS_PERIOD, self._publish_health)
        self.create_service(SetBool, "~/torque", self._on_torque)
        for leg in LEGS:
            self.create_service(Trigger, f"~/reboot_{leg.lower()}", self._reboot(leg))

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the port and check every servo."""
        try:
            infos = self._session.driver.configure()
        except ServoError as error:
            self._session.driver.close()
            return self._refuse(f"servos refused: {error}")
        self._open = True
        firmware = ", ".join(f"{info.leg} id {info.id} v{info.firmware}" for info in infos)
        self.get_logger().info(f"servos on {self._port}: {firmware}")
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Torque on, without motion."""
        try:
            self._session.start()
        except ServoError as error:
            return self._refuse(f"torque refused: {error}")
        self.get_logger().info("torque on")
        self._timer = runtime.wall_timer(self, self._session.period, self._step)
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Slack, torque off; an error where a servo has not confirmed it."""
        self._end_cycles()
        return SUCCESS if self._stop() else TransitionCallbackReturn.ERROR

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the port."""
        self._end_cycles()
        self._close()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """All of it."""
        self._end_cycles()
        if self._open:
            self._stop()
        self._close()
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Back to the beginning, from where it may be configured again."""
        return self.on_shutdown(state)

    def destroy_node(self) -> None:
        """Torque off before anything else goes."""
        if self._open:
            self._stop()
        self._close()
        super().destroy_node()

    def _start_by_itself(self) -> None:
        """Walk the lifecycle once the port is there, or has been awaited for long enough."""
        if not Path(self._port).exists() and time.monotonic() < self._end_of_wait:
            self.get_logger().info(f"waiting for {self._port}", throttle_duration_sec=5.0)
            return
        self.destroy_timer(self._starter)
        self._starting = True
        if self.trigger_configure() == SUCCESS:
            if self.trigger_activate() == SUCCESS:
                self._starting = False
                return
            self.trigger_cleanup()
        self.get_logger().fatal(self._refusal)
        raise SystemExit(1)

    def _on_command(self, message: JointState) -> None:
        _, angle = decode.joint_angles(message)
        if fault := self._session.offer(time.monotonic_ns(), angle):
            raise ValueError(fault)

    def _step(self) -> None:
        before = self._session.action
        try:
            self._cycle = self._session.step(time.monotonic_ns())
        except PortError as error:
            self._close()
            self.get_logger().fatal(f"{error}; their bus watchdogs stop the servos")
            raise SystemExit(1) from None
        if self._session.action is not before:
            self.get_logger().info(f"{self._session.action.name} {self._session.reason}".strip())
        stamp = self.get_clock().now().nanoseconds
        reading = measured(stamp, self._cycle, self._stall)
        if reading is not None:
            self._joints.publish(messages.joints_to_msg(reading))

    def _publish_health(self) -> None:
        pace = self._session.pace(time.monotonic_ns())
        stamp = self.get_clock().now().nanoseconds
        self._health.publish(diagnostics.to_msg(stamp, self._session, pace, self._cycle))

    def _on_torque(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if self._timer is None:
            response.success, response.message = False, "not active"
        elif request.data:
            response.success, response.message = self._try(self._session.start, "torque on")
        else:
            self._session.relax("torque switched off by the operator")
            response.success, response.message = True, "slackening, then torque off"
        return response

    def _reboot(self, leg: str) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def reboot(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            driver = self._session.driver
            response.success, response.message = self._try(
                lambda: driver.reboot(leg), f"servo {leg} restarts"
            )
            return response

        return reboot

    def _try(self, action: Callable[[], None], done: str) -> tuple[bool, str]:
        """Whether it was done, and the words for either case."""
        try:
            action()
        except ServoError as error:
            return False, str(error)
        return True, done

    def _refuse(self, reason: str) -> TransitionCallbackReturn:
        self._refusal = reason
        if not self._starting:  # then it is said once, at the end
            self.get_logger().error(reason)
        return FAILURE

    def _end_cycles(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _stop(self) -> bool:
        """Slack and torque off; whether every servo has confirmed it."""
        off = self._session.stop()
        if off.complete:
            runtime.last_logger(self).info("torque off, confirmed by every servo")
        else:
            runtime.last_logger(self).error("torque NOT off: " + "; ".join(off.reasons))
        return off.complete

    def _close(self) -> None:
        self._open = False
        self._session.driver.close()


def make_session(settings: DynamixelSettings, period: float) -> ServoSession:
    """Driver and gate; raises ConfigError where the settings contradict each other."""
    port = SerialPort(settings.bus.port, settings.bus.baud, settings.bus.timeout)
    try:
        driver = Driver(port, settings)
    except ValueError as error:
        raise ConfigError(f"dynamixel.yaml: {error}") from None
    return ServoSession(driver, read_supervisor(), read_robot().tendon.angle_max, period)


def main() -> None:
    """Entry point of the node."""
    runtime.run(DynamixelDriverNode)

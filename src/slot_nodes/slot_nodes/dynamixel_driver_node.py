"""Driver node of the servos of any brand: commands and permissions in, joints and health out.

    configure    open the port, check every servo, torque off; then a bus cycle every period
    activate     torque on at the present angles of the servos
    deactivate   slacken the tendons, torque off, read back
    cleanup      close the port

With `autostart` the node configures itself, and ends with exit code 1 if that is refused.
`/robot_state` activates it by HOLD or PASS and deactivates it by OFF. The supervisor sends its
limits on `/servo_limits`. At every end of the process except SIGKILL the node first deactivates,
which needs no ROS context. The brand is that of `config/servo_bus.yaml`; the node, its topics and
its services have kept the name of the first one, by which operators and recordings know them.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import (
    LifecycleNode,
    LifecycleState,
    TransitionCallbackReturn,
)
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from slot_core.config import ConfigError
from slot_core.dynamics.servo import read_servo
from slot_core.messages import decode
from slot_core.robot import LEGS, read_robot
from slot_core.safety.states import Action
from slot_core.servos.registry import read_brand
from slot_core.servos.servo_bus import (
    Cycle,
    PortError,
    RefusedError,
    ServoError,
    ServoMaintenance,
)
from slot_core.servos.session import ServoSession
from slot_msgs.msg import RobotState, ServoLimits
from slot_nodes import diagnostics, inputs, messages, qos, runtime

PORT_PERIOD = 0.1  # s, between two checks for the port
DIAGNOSTICS_PERIOD = 1.0  # s
SUCCESS, FAILURE = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
)


class DynamixelDriverNode(LifecycleNode):
    """Runs one bus cycle per period and publishes its measurements."""

    def __init__(self) -> None:
        super().__init__("dynamixel_driver")
        if self.get_parameter("use_sim_time").value:
            raise ConfigError(
                "dynamixel_driver: servos move in real time: no lockstep with them"
            )
        brand = read_brand()
        settings = runtime.declare_settings(self, brand.read_settings())
        rate = runtime.declare(
            self, "rate", 100.0, "bus cycles [Hz]", between=(20.0, 500.0)
        )
        self._port_timeout = runtime.declare(
            self,
            "wait_for_port",
            60.0,
            "time to wait for the port [s]",
            between=(0.0, 3600.0),
        )
        self._autostart = runtime.declare(
            self, "autostart", True, "configure at start"
        )
        self._session = ServoSession(
            brand.make_bus(settings),
            read_robot().tendon.angle_max,
            1.0 / rate,
            time.sleep,
        )
        self._port = self._session.bus.facts.port
        self._servo = read_servo()
        self._open = self._active = False
        self._refusal = ""
        self._cycle: Cycle | None = None
        self._timer: Timer | None = None
        self._create_outputs()
        self._answer_invalid_transitions()
        inputs.subscribe(
            self,
            JointState,
            "desired_joint_angles",
            self._on_command,
            qos.CONTROL,
        )
        inputs.subscribe(
            self, RobotState, "robot_state", self._on_robot_state, qos.STATE
        )
        on_limits = partial(inputs.take_limits, self, self._session.watchdog)
        inputs.subscribe(
            self, ServoLimits, "servo_limits", on_limits, qos.STATE
        )
        self._port_deadline = time.monotonic() + self._port_timeout
        self._autostart_timer = runtime.wall_timer(
            self, PORT_PERIOD, self._configure_when_port_exists
        )
        if not self._autostart:
            self._autostart_timer.cancel()

    def _create_outputs(self) -> None:
        self._joints = runtime.publisher(
            self, JointState, "joint_states", qos.SENSOR
        )
        self._health = diagnostics.HealthReport(self, self._session)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "diagnostics", qos.SENSOR
        )
        runtime.wall_timer(self, DIAGNOSTICS_PERIOD, self._publish_diagnostics)
        self.create_service(SetBool, "~/torque", self._on_torque)
        for leg in LEGS:
            name = leg.lower()
            self._create_servo_service(
                f"~/reboot_{name}", partial(self._reboot, leg)
            )
            self._create_servo_service(
                f"~/zero_{name}", partial(self._zero, leg)
            )

    def _answer_invalid_transitions(self) -> None:
        """Answer a transition that the state does not have; with rclpy 7.1 the node would end."""
        change = self._service_change_state.callback

        def serve(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> Any:
            try:
                return change(request, response)
            except RuntimeError as error:  # an RCLError
                self.get_logger().error(
                    f"transition {request.transition.id} refused: {error}"
                )
                response.success = False
                return response

        self._service_change_state.callback = serve

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the port and check every servo."""
        try:
            servos = self._session.configure()
        except Exception as error:  # rclpy would discard one of the brand
            self._session.bus.close()
            return self._refuse("servos refused", error)
        self._open = True
        self.get_logger().info(f"servos on {self._port}: {', '.join(servos)}")
        self._timer = runtime.wall_timer(self, self._session.period, self._step)
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Switch torque on at the present angles."""
        try:
            self._session.start()
        except Exception as error:
            return self._refuse("torque refused", error)
        self._active = True
        self.get_logger().info("torque on")
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Slacken the tendons, torque off; ERROR if a servo has not confirmed it."""
        self._active = False
        return SUCCESS if self._stop() else TransitionCallbackReturn.ERROR

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the port."""
        self._stop_cycles()
        self._close()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Slacken the tendons, torque off, close the port."""
        self._active = False
        self._autostart_timer.cancel()
        self._stop_cycles()
        if self._open:
            self._stop()
        self._close()
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Shut down to unconfigured; with `autostart` configure again."""
        self.on_shutdown(state)
        if self._autostart:
            self._autostart_timer.reset()
        return SUCCESS

    def close(self) -> None:
        """Slacken the tendons, torque off, close the port."""
        if self._open:
            self._stop()
        self._close()

    def _configure_when_port_exists(self) -> None:
        """Configure when the port exists, or after `wait_for_port`.

        A refusal of the first attempt ends the node; after an error the attempt is repeated.
        """
        if (
            not Path(self._port).exists()
            and time.monotonic() < self._port_deadline
        ):
            self.get_logger().info(
                f"waiting for {self._port}", throttle_duration_sec=5.0
            )
            return
        if self.trigger_configure() == SUCCESS:
            self._autostart_timer.cancel()
        elif self._cycle is None:
            self.get_logger().fatal(self._refusal)
            raise SystemExit(1)

    def _on_command(self, message: JointState) -> None:
        watchdog = self._session.watchdog
        inputs.require_sole_publisher(
            self, "desired_joint_angles", watchdog.relax
        )
        stamp, angle, rate = decode.joint_command(message)
        if watchdog.limits is None:
            return  # torque is off until the supervisor has sent them
        inputs.require_present(
            stamp, self.get_clock().now().nanoseconds, watchdog.clock_jump
        )
        if fault := self._session.offer(
            time.monotonic_ns(), stamp, angle, rate
        ):
            raise ValueError(fault)
        if self._timer is not None:
            self._step()  # before the timer is due

    def _on_robot_state(self, message: RobotState) -> None:
        inputs.require_supervisor(
            self,
            message,
            self.get_clock().now().nanoseconds,
            self._session.watchdog,
        )
        permission = decode.permission(message, time.monotonic_ns())
        self._session.permit(permission)
        if permission.action is Action.OFF and self._active:
            self.trigger_deactivate()
        elif (
            self._timer
            and not self._active
            and self._session.may_start(permission)
        ):
            self.trigger_activate()

    def _step(self) -> None:
        before = self._session.action
        try:
            self._cycle = cycle = self._session.step(time.monotonic_ns())
        except PortError as error:
            self._close()
            self.get_logger().fatal(
                f"{error}; their bus watchdogs stop the servos"
            )
            raise SystemExit(1) from None
        if self._session.action is not before:
            self.get_logger().info(
                f"{self._session.action.name} {self._session.reason}".strip()
            )
        self._publish(cycle)
        if self._active and not self._session.bus.active:
            self.trigger_deactivate()

    def _publish(self, cycle: Cycle) -> None:
        stamp = self.get_clock().now().nanoseconds
        reading = cycle.joints(
            stamp, self._servo.tendon_stall(self._session.voltage)
        )
        if reading is not None:
            self._joints.publish(messages.joints_to_msg(reading))
        self._health.publish_health(stamp)

    def _publish_diagnostics(self) -> None:
        pace = self._session.pace(time.monotonic_ns())
        stamp = self.get_clock().now().nanoseconds
        self._diagnostics.publish(
            diagnostics.of_servos(stamp, self._session, pace, self._cycle)
        )

    def _on_torque(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        if not request.data:
            self._session.watchdog.relax("torque switched off by the operator")
            response.success, response.message = (
                True,
                "slackening, then torque off",
            )
        elif self._timer is None or self._active:
            response.message = (
                "torque is on already" if self._active else "not configured"
            )
        else:
            response.success = self.trigger_activate() == SUCCESS
            response.message = (
                "torque on" if response.success else self._refusal
            )
        return response

    def _create_servo_service(
        self, name: str, action: Callable[[], str]
    ) -> None:
        """Create a service that acts on one servo with torque off; `action` returns the answer."""

        def serve(
            _: Trigger.Request, response: Trigger.Response
        ) -> Trigger.Response:
            try:
                if self._timer is None or self._session.bus.active:
                    raise RefusedError(
                        ["needs a configured driver, torque off"]
                    )
                response.success, response.message = True, action()
            except (ServoError, ConfigError, OSError) as error:
                response.success, response.message = False, str(error)
            return response

        self.create_service(Trigger, name, serve)

    def _maintenance(self) -> ServoMaintenance:
        """The bus, if it can; else raises RefusedError."""
        bus = self._session.bus
        if not isinstance(bus, ServoMaintenance):
            raise RefusedError(
                [f"servos of {bus.facts.brand} have no such service"]
            )
        return bus

    def _reboot(self, leg: str) -> str:
        self._maintenance().reboot(leg)
        return f"servo {leg} restarts"

    def _zero(self, leg: str) -> str:
        return self._maintenance().zero(leg, time.sleep)

    def _refuse(self, what: str, error: Exception) -> TransitionCallbackReturn:
        self._refusal = (
            f"{what}: {error if isinstance(error, ServoError) else repr(error)}"
        )
        # else it is logged when the node ends
        if self._cycle is not None or not self._autostart:
            self.get_logger().error(self._refusal, throttle_duration_sec=5.0)
        # of an error of the brand's code ERROR, which switches torque off
        return (
            FAILURE
            if isinstance(error, ServoError)
            else TransitionCallbackReturn.ERROR
        )

    def _stop_cycles(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _stop(self) -> bool:
        """Slacken the tendons, torque off; return whether every servo has confirmed it."""
        off = self._session.stop()
        if off.complete:
            runtime.last_logger(self).info(
                "torque off, confirmed by every servo"
            )
        else:
            runtime.last_logger(self).error(
                "torque NOT off: " + "; ".join(off.reasons)
            )
        return off.complete

    def _close(self) -> None:
        self._open = False
        self._session.bus.close()

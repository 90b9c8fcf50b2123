"""The supervisor: inputs from the whole graph, `/robot_state` out, requests as services.

The driver of the servos, real or simulated, obeys `/robot_state` and the limits on `/servo_limits`;
it subscribes to the commands itself. On entering WALKING the supervisor requests the gait from the
gait scheduler, on entering any other state but HOLD it requests standing.
"""

from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from slot_core.bags import decode
from slot_core.control.gait import STAND, read_gaits
from slot_core.control.state_estimator import Estimate, Validity
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.start_up import StartUp
from slot_core.safety.states import RELEASED, State
from slot_core.safety.supervisor import PERIOD, Report, Request, Supervisor
from slot_core.safety.tendon_watch import read_tendon_watch
from slot_msgs.msg import GroundReactionForces, MpcState, RobotState, ServoHealth, ServoLimits
from slot_msgs.srv import SetGait
from slot_nodes import inputs, messages, qos, runtime


class SupervisorNode(Node):
    """Runs the supervisor at 50 Hz, and at once on urgent inputs, and publishes its state."""

    def __init__(self) -> None:
        super().__init__("supervisor")
        robot, settings = read_robot(), runtime.declare_settings(self, read_supervisor())
        self._supervisor = Supervisor(robot, settings, read_tendon_watch(robot, settings.tendon))
        self._walk = self._declare_gait()
        autostart = runtime.declare(self, "autostart", False, "stand up and walk without requests")
        self._start_up = StartUp(*self._start_up_requests() if autostart else ())
        self._published: Report | None = None
        self._state = runtime.publisher(self, RobotState, "robot_state", qos.STATE)
        self._limits = self.create_publisher(ServoLimits, "servo_limits", qos.STATE)
        self._limits.publish(messages.limits_to_msg(settings.servo_limits))
        self._set_gait = self.create_client(SetGait, "set_gait")
        self._wanted: SetGait.Request | None = None  # gait to request once its service is there
        self._subscribe_to_controller()
        self._subscribe_to_robot()
        for request in Request:
            serve = partial(self._on_request, request)
            self.create_service(Trigger, f"~/{request.name.lower()}", serve)
        runtime.wall_timer(self, PERIOD, self._step)

    def _declare_gait(self) -> SetGait.Request:
        """Declare gait and velocity of WALKING; raises ConfigError if they do not fit."""
        gaits = read_gaits()
        gait = runtime.declare(self, "gait", STAND, "gait of WALKING, a file of config/gait")
        v_x = runtime.declare(
            self, "v_x", gaits.find(gait).cruise, "forward velocity of WALKING [m/s]"
        )
        v_y = runtime.declare(self, "v_y", 0.0, "lateral velocity of WALKING [m/s]")
        gaits.require_velocity(gait, np.array([v_x, v_y, 0.0]))
        self._supervisor.receive_gait(self._now(), gaits.find(gait).period)
        return messages.gait_request(gait, v_x, v_y)

    def _start_up_requests(self) -> list[Request]:
        walks = self._walk.gait != STAND
        return [Request.READY, Request.STAND, *[Request.WALK][:walks]]

    def _subscribe_to_controller(self) -> None:
        """Subscribe to the controller; a missing gait preview shows as missing forces."""
        inputs.subscribe(self, MpcState, "mpc_state", self._on_state, qos.CONTROL)
        inputs.subscribe(
            self, GroundReactionForces, "ground_reaction_forces", self._on_forces, qos.CONTROL
        )
        inputs.subscribe(self, JointState, "desired_joint_angles", self._on_command, qos.CONTROL)

    def _subscribe_to_robot(self) -> None:
        inputs.subscribe(self, JointState, "joint_states", self._on_joints, qos.SENSOR)
        inputs.subscribe(self, ServoHealth, "servo_health", self._on_health, qos.SENSOR)
        inputs.subscribe(self, Bool, "estop", self._on_estop, qos.SENSOR)

    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

    def _on_state(self, message: MpcState) -> None:
        now = self._now()
        stamp, state, validity = decode.state(message)
        covariance = np.array(message.covariance).reshape(12, 12)
        self._supervisor.receive_heartbeat(now, "state_estimator")
        self._supervisor.receive_estimate(
            now, Estimate(stamp, state, covariance, Validity(validity))
        )

    def _on_forces(self, message: GroundReactionForces) -> None:
        self._supervisor.receive_heartbeat(self._now(), "mpc_controller")
        self._supervisor.receive_mpc(self._now(), message.status, message.fallback_cycles)

    def _on_command(self, message: JointState) -> None:
        self._supervisor.receive_heartbeat(self._now(), "force_mapper")
        if fault := self._supervisor.receive_command(self._now(), *decode.joint_angles(message)):
            self._step()
            raise ValueError(fault)

    def _on_joints(self, message: JointState) -> None:
        self._supervisor.receive_joints(self._now(), *decode.joint_loads(message))

    def _on_health(self, message: ServoHealth) -> None:
        self._supervisor.receive_health(self._now(), *decode.servo_health(message))

    def _on_estop(self, message: Bool) -> None:
        self._supervisor.receive_estop(self._now(), message.data)
        if message.data:
            self._step()

    def _on_request(
        self, request: Request, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        response.message = self._supervisor.request(self._now(), request)
        response.success = not response.message
        self._step()
        return response

    def _step(self) -> None:
        now = self._now()
        if waiting := self._start_up.request_next(self._supervisor, now):
            self.get_logger().info(waiting, throttle_duration_sec=5.0, skip_first=True)
        report, last = self._supervisor.step(now), self._published
        self._published = report
        if last is None or (report.state, report.since) != (last.state, last.since):
            self._report_transition(report)
        self._state.publish(messages.robot_state_to_msg(now, report))
        if self._wanted is not None and self._set_gait.service_is_ready():
            self._set_gait.call_async(self._wanted)
            self._wanted = None

    def _report_transition(self, report: Report) -> None:
        """Log a transition and set the gait to request in the new state.

        A robot that resumes after HOLD keeps the gait and the velocity that were requested last.
        """
        line = f"{report.state.name}: {report.reason}"
        if report.state in (State.HOLD, *RELEASED):
            self.get_logger().warning(line)
        else:
            self.get_logger().info(line)
        if not report.keeps_gait:
            walking = report.state is State.WALKING
            self._wanted = self._walk if walking else messages.gait_request(STAND, 0.0, 0.0)


def main() -> None:
    """Entry point of the node."""
    runtime.run(SupervisorNode)

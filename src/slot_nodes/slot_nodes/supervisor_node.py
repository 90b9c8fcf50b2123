"""The supervisor: inputs from the whole graph, `/robot_state` out, requests as services.

It also sums up the graph on `/diagnostics`: its conditions, the controller, the disturbances.

The driver of the servos, real or simulated, obeys `/robot_state` and the limits on `/servo_limits`;
it subscribes to the commands itself. On entering WALKING the supervisor requests the gait from the
gait scheduler, on entering any other state but HOLD it requests standing. It also tells the gait
scheduler whether the servos follow the commands.

With the parameter `lockstep` it steps on every report of the servos, once it has all messages that
precede it, at the report's stamp (safety/ticked_supervisor.py). The state is the answer for which
the simulated robot waits; it is published when the gait scheduler has the gait that goes with it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from slot_core.clock import LOCKSTEP_START
from slot_core.gait.gait import STAND, read_gaits
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import RELEASED, Request, State
from slot_core.safety.supervisor import PERIOD, Report, Supervisor
from slot_core.safety.tendon_watch import read_tendon_watch
from slot_core.safety.ticked_supervisor import (
    LockstepInputs,
    StartUp,
    TickedSupervisor,
)
from slot_core.safety.watchdog import ServoHealth as Health
from slot_msgs.msg import (
    EmergencyStop,
    MpcState,
    RobotState,
    ServoHealth,
    ServoLimits,
    TendonPlan,
)
from slot_msgs.srv import ForgetSource, SetGait
from slot_nodes import inputs, messages, qos, runtime
from slot_nodes.diagnostics import SupervisorDiagnostics

ESTOP_TYPE = "slot_msgs/msg/EmergencyStop"
LIMITS_PERIOD = 1.0  # s, between two messages with the limits of the servos
NODES_PERIOD = 1.0  # s, between two looks at which nodes are there
# topics that one node alone publishes, beside those that the servos' node looks at
SOLE = ("mpc_state", "gait_preview", "tendon_plan", "servo_health")
# one topic of each node
CONTROLLER = ("gait_preview", "tendon_plan", "desired_joint_angles")


class SupervisorNode(Node):
    """Runs the supervisor at 50 Hz, and at once on urgent inputs, and publishes its state."""

    def __init__(self) -> None:
        super().__init__("supervisor")
        robot, settings = (
            read_robot(),
            runtime.declare_settings(self, read_supervisor()),
        )
        self._supervisor = Supervisor(
            robot, settings, read_tendon_watch(robot, settings.tendon)
        )
        help_text = "step on the servos' reports, at their stamps"
        self._lockstep = runtime.declare(self, "lockstep", False, help_text)
        # ns, in lockstep the stamp of the last report
        self._stepped = LOCKSTEP_START - 1
        self._walk = self._declare_gait()
        autostart = runtime.declare(
            self, "autostart", False, "stand up and walk without requests"
        )
        walk = [Request.WALK] * (self._walk.gait != STAND)
        steps = [Request.READY, Request.STAND, *walk] if autostart else []
        self._start_up = StartUp(*steps)
        self._ticked = TickedSupervisor(self._supervisor, self._start_up)
        self._gathered = LockstepInputs()
        self._last: Report | None = None
        self._state = runtime.publisher(
            self, RobotState, "robot_state", qos.STATE
        )
        self._diagnostics = SupervisorDiagnostics(self, robot.mass)
        self._limits = self.create_publisher(
            ServoLimits, "servo_limits", qos.STATE
        )
        self._servo_limits = messages.limits_to_msg(settings.servo_limits)
        self._send_limits()
        runtime.wall_timer(self, LIMITS_PERIOD, self._send_limits)
        runtime.wall_timer(self, NODES_PERIOD, self._look_for_nodes)
        self._scheduler: dict[str, Client] = {
            "gait": self.create_client(SetGait, "set_gait"),
            "followed": self.create_client(SetBool, "gait_scheduler/followed"),
        }
        self._wanted: dict[
            str, Any
        ] = {}  # requests to make once their services are there
        self._answers: list[Future] = []  # that are awaited
        # in lockstep, report to step on
        self._awaited: tuple[int, Health] | None = None
        self._unsent: Report | None = None  # in lockstep, until it is published
        self._polled = inputs.PassiveSubscriptions(self)  # at each step
        self._polled.wake_on_message(self._lockstep)
        self._hears_controller = False
        if self._lockstep:
            self._subscribe_to_controller()
        self._subscribe_to_robot()
        for request in Request:
            self.create_service(
                Trigger,
                f"~/{request.name.lower()}",
                partial(self._on_request, request),
            )
        self.create_service(ForgetSource, "~/forget", self._on_forget)
        if not self._lockstep:
            runtime.wall_timer(
                self, settings.timing.estop / 2, self._press_unheard
            )
        runtime.wall_timer(
            self, PERIOD, self._send if self._lockstep else self._step
        )

    def _send_limits(self) -> None:
        """Publish the limits; repeated, since servos that have missed them accept no command."""
        self._limits.publish(self._servo_limits)

    def _look_for_nodes(self) -> None:
        """Look which nodes of this namespace are there, and who publishes what they obey."""
        here, present = (
            self.get_namespace(),
            self.get_node_names_and_namespaces(),
        )
        lines = (inputs.second_publisher(self, topic) for topic in SOLE)
        self._supervisor.receive_nodes(
            (name for name, space in present if space == here),
            next(filter(None, lines), ""),
        )

    def _declare_gait(self) -> SetGait.Request:
        """Declare gait and velocity of WALKING; raises ConfigError if they do not fit."""
        gaits = read_gaits()
        gait = runtime.declare(
            self, "gait", STAND, "gait of WALKING, a file of config/gait"
        )
        v_x = runtime.declare(
            self,
            "v_x",
            gaits.find(gait).cruise,
            "forward velocity of WALKING [m/s]",
        )
        v_y = runtime.declare(
            self, "v_y", 0.0, "lateral velocity of WALKING [m/s]"
        )
        turn = runtime.declare(
            self, "yaw_rate", 0.0, "yaw rate of WALKING [rad/s]"
        )
        gaits.require_velocity(gait, np.array([v_x, v_y, turn]))
        return messages.gait_request(gait, v_x, v_y, turn)

    def _subscribe_to_controller(self) -> None:
        """Subscribe to the controller; a silent gait scheduler shows as missing plans.

        In real time when all its nodes publish. A publisher writes to its subscribers in the order
        in which it has found them, and the supervisor, which starts faster, would be the first:
        that took 0.9 of 8 ms from odometry to command.
        """
        self._hears_controller = True
        self._polled.subscribe(
            MpcState, "mpc_state", self._on_state, qos.CONTROL
        )
        self._polled.subscribe(
            TendonPlan, "tendon_plan", self._on_plan, qos.CONTROL
        )
        inputs.subscribe(
            self,
            JointState,
            "desired_joint_angles",
            self._on_command,
            qos.CONTROL,
        )

    def _subscribe_to_robot(self) -> None:
        self._joints = self._polled.subscribe(
            JointState, "joint_states", self._on_joints, qos.SENSOR
        )
        inputs.subscribe(
            self, ServoHealth, "servo_health", self._on_health, qos.SENSOR
        )
        inputs.subscribe(
            self, EmergencyStop, "estop", self._on_estop, qos.SENSOR
        )

    def _now(self) -> int:
        """Time of the messages' clock, ns; in lockstep the time of the last step."""
        return (
            self._stepped
            if self._lockstep
            else self.get_clock().now().nanoseconds
        )

    def _take(
        self, source: str, stamp: int, take: Callable[..., Any], *given: Any
    ) -> Any:
        """Take an input now, or in lockstep at its step; returns the result of `take`."""
        if not self._lockstep:
            return take(self._now(), *given)
        self._gathered.add(source, stamp, lambda now: take(now, *given))
        if source != "joints":
            self._step_on_report()
        return None

    def _on_state(self, message: MpcState) -> None:
        estimate = decode.estimate(message)
        self._take(
            "state_estimator",
            estimate.stamp,
            self._supervisor.receive_estimate,
            estimate,
        )

    def _on_plan(self, message: TendonPlan) -> None:
        self._take(
            "mpc_controller", decode.stamp(message), self._receive_plan, message
        )

    def _receive_plan(self, now: int, plan: TendonPlan) -> None:
        self._diagnostics.plan = plan
        self._supervisor.receive_mpc(
            now, plan.status, plan.fallback_cycles, plan.period, plan.velocity
        )

    def _on_command(self, message: JointState) -> None:
        stamp, angle, rate = decode.joint_command(message)
        if fault := self._take(
            "force_mapper",
            stamp,
            self._supervisor.receive_command,
            stamp,
            angle,
            rate,
        ):
            self._step()
            raise ValueError(fault)

    def _on_joints(self, message: JointState) -> None:
        stamp, angle, torque = decode.joint_loads(message)
        self._take(
            "joints",
            stamp,
            self._supervisor.receive_joints,
            stamp,
            angle,
            torque,
        )

    def _on_health(self, message: ServoHealth) -> None:
        stamp, health = decode.servo_health(message)
        if not self._lockstep:
            self._supervisor.receive_health(self._now(), stamp, health)
        elif stamp > self._stepped:  # those at rest are repeated
            self._awaited = stamp, health
            self._step_on_report()

    def _on_estop(self, message: EmergencyStop) -> None:
        """Take the e-stop; in lockstep no released source is missed: it sends in real time."""
        source, pressed, leaving = decode.emergency_stop(message)
        leaving = leaving or self._lockstep
        self._supervisor.receive_estop(
            self._now(), source, pressed, leaving=leaving
        )
        if pressed:
            self._step()

    def _press_unheard(self) -> None:
        """Count a publisher of the e-stop with another type, which is not heard, as pressed."""
        for endpoint in self.get_publishers_info_by_topic("estop"):
            if endpoint.topic_type != ESTOP_TYPE:
                self._supervisor.receive_estop(
                    self._now(),
                    f"a publisher of {endpoint.topic_type}",
                    pressed=True,
                )

    def _on_forget(
        self, request: ForgetSource.Request, response: ForgetSource.Response
    ) -> ForgetSource.Response:
        response.message = self._supervisor.forget_estop(
            self._now(), request.source
        )
        response.success = not response.message
        return response

    def _on_request(
        self, request: Request, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        response.message = self._supervisor.request(self._now(), request)
        response.success = not response.message
        self._step()
        return response

    def _step(self) -> None:
        """Step and publish the state; in lockstep do nothing, since the reports lead to steps."""
        if self._lockstep:
            return
        if not self._hears_controller and all(
            map(self.count_publishers, CONTROLLER)
        ):
            self._subscribe_to_controller()
        self._polled.take()
        now = self._now()
        if waiting := self._start_up.request_next(self._supervisor, now):
            self.get_logger().info(
                waiting, throttle_duration_sec=5.0, skip_first=True
            )
        report = self._diagnostics.with_remark(self._supervisor.step(now))
        self._note(report)
        self._publish(now, report)
        self._make_requests()

    def _step_on_report(self) -> None:
        """In lockstep step on the awaited report once all messages before it have arrived."""
        if self._awaited is None:
            return
        stamp, health = self._awaited
        inputs.process_received(self._joints)  # published before the report
        if not self._gathered.are_complete(health):
            return
        self._awaited, self._stepped = None, stamp
        self._gathered.pass_to(self._ticked, health)
        self._unsent = self._diagnostics.with_remark(
            self._ticked.step(stamp, health)
        )
        self._note(self._unsent)
        self._send()

    def _send(self) -> None:
        """In lockstep publish the state when the gait scheduler has the gait that goes with it."""
        if self._unsent is None:
            return
        self._make_requests()
        if not (self._wanted or self._answers):
            report, self._unsent = self._unsent, None
            self._publish(self._stepped, report)

    def _publish(self, stamp: int, report: Report) -> None:
        """Publish the state of the robot at `stamp`, ns."""
        self._state.publish(
            Carried(
                stamp,
                report,
                partial(messages.robot_state_to_msg, stamp, report),
                state=int(report.state),
                action=decode.ACTION_NUMBERS.index(report.action),
                followed=report.followed,
                reason=report.reason,
            )
        )

    def _make_requests(self) -> None:
        """Call the gait scheduler's services for the wanted gait, as far as they are there."""
        for answer in self._answers:
            if answer.done() and not answer.result().success:
                self.get_logger().error(
                    f"gait_scheduler refuses: {answer.result().message}"
                )
        self._answers = [
            answer for answer in self._answers if not answer.done()
        ]
        for name in [
            name
            for name in self._wanted
            if self._scheduler[name].service_is_ready()
        ]:
            self._answers.append(
                self._scheduler[name].call_async(self._wanted.pop(name))
            )

    def _note(self, report: Report) -> None:
        """Compare a report with the last one, for a transition and whether the servos follow."""
        last, self._last = self._last, report
        self._diagnostics.publish(self._now(), report)
        if last is None or report.followed != last.followed:
            self._wanted["followed"] = SetBool.Request(data=report.followed)
        if last is None or (report.state, report.since) != (
            last.state,
            last.since,
        ):
            self._report_transition(report)

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
            self._wanted["gait"] = (
                self._walk
                if walking
                else messages.gait_request(STAND, 0.0, 0.0, 0.0)
            )

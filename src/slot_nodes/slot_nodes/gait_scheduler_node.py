"""`/mpc_state`, `/cmd_vel`, `/body_pose` and the service `set_gait` to the preview of the gait."""

from dataclasses import replace
from functools import partial

from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.node import Node
from std_srvs.srv import SetBool

from slot_core.config import ConfigError
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import STAND, read_gaits
from slot_core.gait.gait_scheduler import GaitScheduler
from slot_core.gait.route import KEPT, read_route
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.robot import read_robot
from slot_msgs.msg import GaitPreview, MpcState
from slot_msgs.srv import SetGait
from slot_nodes import inputs, messages, qos, runtime, stage_record

# s, between two looks for publishers of /cmd_vel of the other type
SEARCH_PERIOD = 1.0


class GaitSchedulerNode(Node):
    """Runs the gait scheduler; publishes a preview for every state, with its stamp."""

    def __init__(self) -> None:
        super().__init__("gait_scheduler")
        settings = runtime.declare_settings(self, read_gaits())
        file = runtime.declare(
            self, "path", "", "CSV with columns x, y in odom [m] to follow"
        )
        heading = runtime.declare(
            self, "path_heading", KEPT, "heading on the path: kept or along"
        )
        path = read_route(file, heading) if file else None
        self._scheduler = GaitScheduler(
            settings, read_robot(), read_springs(), STAND, None, path
        )
        self._record = stage_record.Recorder(self, self._scheduler)
        self._preview = runtime.publisher(
            self, GaitPreview, "gait_preview", qos.CONTROL
        )
        stamped = runtime.declare(
            self,
            "stamped_cmd_vel",
            True,
            "type of /cmd_vel: TwistStamped, else Twist as of Nav2 and teleop without options",
        )
        # one line on publishers of /cmd_vel of the other type
        self._wrong_type = ""
        kind = TwistStamped if stamped else Twist
        inputs.subscribe(
            self,
            kind,
            "cmd_vel",
            self._on_velocity,
            qos.SENSOR,
            overridable=True,
        )
        runtime.wall_timer(
            self, SEARCH_PERIOD, partial(self._look_for_wrong_type, stamped)
        )
        inputs.subscribe(
            self,
            PoseStamped,
            "body_pose",
            self._on_pose,
            qos.SENSOR,
            overridable=True,
        )
        self.create_service(SetGait, "set_gait", self._on_gait)
        self.create_service(SetBool, "~/followed", self._on_followed)
        inputs.subscribe(
            self, MpcState, "mpc_state", self._on_state, qos.CONTROL
        )

    def _on_state(self, message: MpcState) -> None:
        estimate = decode.estimate(message)
        inputs.require_finite("state", estimate.state)
        preview = self._scheduler.step(
            estimate.time, estimate.state, estimate.leg_stiffness
        )
        preview = replace(
            preview,
            stamp=estimate.stamp,
            remark=preview.remark or self._wrong_type,
        )
        self._preview.publish(
            Carried(
                preview.stamp,
                preview,
                partial(messages.preview_to_msg, preview),
            )
        )
        self._record.put(estimate.stamp)

    def _look_for_wrong_type(self, stamped: bool) -> None:
        """Find publishers of /cmd_vel whose messages do not arrive, since their type is another."""
        wrong, change = (
            ("Twist", "false") if stamped else ("TwistStamped", "true")
        )
        found = self.get_publishers_info_by_topic("cmd_vel")
        nodes = [
            info.node_name
            for info in found
            if info.topic_type.endswith(f"/{wrong}")
        ]
        before, self._wrong_type = self._wrong_type, ""
        if nodes:
            wanted = f"start with stamped_cmd_vel {change}"
            self._wrong_type = (
                f"cmd_vel of {nodes[0]} is not heard, a {wrong}: {wanted}"
            )
        if self._wrong_type not in ("", before):
            self.get_logger().warning(self._wrong_type)

    def _on_velocity(self, message: TwistStamped | Twist) -> None:
        """Set the velocity; a zero stamp, as of a plain `ros2 topic pub`, stands for now."""
        stamp, velocity = decode.velocity(message)
        stamp = stamp or self.get_clock().now().nanoseconds
        self._scheduler.set_velocity(stamp, velocity)

    def _on_pose(self, message: PoseStamped) -> None:
        """Set height, roll and pitch of the torso; place and yaw of the pose are not used."""
        self._scheduler.set_pose(decode.body_pose(message))

    def _on_gait(
        self, request: SetGait.Request, response: SetGait.Response
    ) -> SetGait.Response:
        try:
            self._scheduler.request(
                request.gait, decode.vector(request.velocity)
            )
            response.success = True
        except ConfigError as error:
            response.message = str(error)
        return response

    def _on_followed(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        """Take from the supervisor whether the servos follow the commands."""
        self._scheduler.set_followed(request.data)
        response.success = True
        return response

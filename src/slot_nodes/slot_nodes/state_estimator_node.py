"""`/odom`, `/imu`, `/joint_states` to `/mpc_state`, `/odometry/filtered`, `/tf`, `/tf_static`."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from tf2_msgs.msg import TFMessage

from slot_core.clock import to_seconds
from slot_core.control.force_map import read_springs
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.inertial_filter import NO_ODOMETRY
from slot_core.estimation.state_estimator import read_estimator
from slot_core.estimation.unaided_estimator import make_estimator
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.robot import read_robot
from slot_msgs.msg import MpcState, StageRecord
from slot_nodes import diagnostics, inputs, messages, qos, runtime, stage_record
from slot_nodes.process import intra_process


class StateEstimatorNode(Node):
    """Runs the filter: a state for every tick of the controller, and one for every IMU sample.

    The ticks are the states on `/mpc_state`; `/odometry/filtered` has the rate of the IMU.
    """

    def __init__(self) -> None:
        super().__init__("state_estimator")
        settings = runtime.declare_settings(self, read_estimator())
        self._estimator = make_estimator(settings, read_robot(), read_springs())
        self._record = stage_record.Recorder(self, self._estimator)
        self._state = runtime.publisher(
            self, MpcState, "mpc_state", qos.CONTROL
        )
        self._tf = runtime.publisher(self, TFMessage, "tf", qos.SENSOR)
        self._filtered = runtime.publisher(
            self, Odometry, "odometry/filtered", qos.SENSOR
        )
        mounts = runtime.publisher(self, TFMessage, "tf_static", qos.STATE)
        mounts.publish(
            messages.mounts_to_tf(settings.mounts.imu, settings.mounts.camera)
        )
        self._diagnostics = diagnostics.DiagnosticReport(self)
        self._afterwards = intra_process.afterwards()
        profile = inputs.sensor_profile(self, qos.SENSOR)
        blind = settings.odometry.source == NO_ODOMETRY
        self._odometry = (
            None
            if blind
            else inputs.subscribe(
                self, Odometry, "odom", self._on_odometry, profile
            )
        )
        self._joints = inputs.PassiveSubscriptions(self)
        # without an IMU they lead to the ticks
        real_time = not self.get_parameter("use_sim_time").value
        self._joints.wake_on_message(blind and real_time)
        self._joints.subscribe(
            JointState, "joint_states", self._on_joints, qos.SENSOR
        )
        inputs.subscribe(self, Imu, "imu", self._on_imu, profile)

    def _on_imu(self, message: Imu) -> None:
        """Take a sample, after the readings that arrived before it: it may lead to a tick."""
        self._joints.take()
        inputs.process_received(self._odometry)
        reading = decode.imu(message)
        self._record.take(StageRecord.IMU, reading[0])
        self._estimator.add_imu(*reading)
        self._publish()
        # skipped without subscribers: it costs more than the filter
        if self._filtered.get_subscription_count() and (
            present := self._estimator.present()
        ):
            self._filtered.publish(messages.estimate_to_odometry(present))

    def _on_odometry(self, message: Odometry) -> None:
        reading = decode.torso_odometry(message)
        self._joints.take()
        self._record.take(StageRecord.ODOMETRY, reading[0])
        self._estimator.add_odometry(*reading)
        self._publish()

    def _on_joints(self, message: JointState) -> None:
        reading = decode.joint_loads(message)
        self._record.take(StageRecord.JOINTS, reading[0])
        self._estimator.add_joints(*reading)
        self._publish()

    def _publish(self) -> None:
        while (estimate := self._estimator.poll()) is not None:
            self._state.publish(
                Carried(
                    estimate.stamp,
                    estimate,
                    partial(messages.state_to_msg, estimate),
                )
            )
            self._record.put(estimate.stamp)
            self._afterwards(partial(self._publish_rest, estimate))
            if estimate.validity != Validity.VALID:
                line = f"state at {to_seconds(estimate.stamp):.3f} s: {estimate.validity.name}"
                self.get_logger().warning(
                    f"{line} {estimate.message}".strip(),
                    throttle_duration_sec=1.0,
                )

    def _publish_rest(self, estimate: Estimate) -> None:
        """Publish the outputs for which no command waits."""
        self._tf.publish(
            Carried(
                estimate.time, None, partial(messages.state_to_tf, estimate)
            )
        )
        self._diagnostics.publish(
            estimate.stamp, partial(self._describe, estimate)
        )

    def _describe(self, estimate: Estimate) -> DiagnosticArray:
        return diagnostics.array(
            estimate.stamp,
            [diagnostics.of_estimator(estimate, self._estimator.incline)],
        )

"""Driver without the rest of the graph: its start, and a stand-in for supervisor and controller."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from slot_core.messages import decode
from slot_core.safety.states import Action, State
from slot_msgs.msg import RobotState, ServoLimits
from slot_nodes import messages, qos

DRIVER = "dynamixel_driver"


class StubSupervisor:
    """Sends the limits once, and a permission and a command every 20 ms unless they are None."""

    def __init__(self, rig):
        self.permission, self.angle = None, None
        self._rig = rig
        self._states = rig.publisher(RobotState, "robot_state", qos.STATE)
        self._limits = rig.publisher(ServoLimits, "servo_limits", qos.STATE)
        self._limits.publish(
            messages.limits_to_msg(rig.supervisor_settings().servo_limits)
        )
        self._commands = rig.publisher(
            JointState, "desired_joint_angles", qos.CONTROL
        )
        self._timer = rig.every(0.02, self._send)

    def _send(self):
        now = self._rig.now()
        if (permission := self.permission) is not None:
            action = decode.ACTION_NUMBERS.index(permission)
            state = RobotState(
                state=State.WALKING, action=action, reason="requested"
            )
            state.followed = permission is Action.PASS
            state.header.stamp = messages.ns_to_stamp(now)
            self._states.publish(state)
        if (angle := self.angle) is not None:
            self._commands.publish(
                messages.command_to_msg(now, np.full(4, angle), np.zeros(4))
            )

    def close(self):
        self._timer.cancel()
        for made in (self._states, self._limits, self._commands):
            self._rig.node.destroy_publisher(made)

    def move_to(self, angle):
        """Move all tendons to an angle, rad; again if a busy machine has caused a RELAX."""
        self.angle = angle
        self._rig.wait_for(lambda: self._rig.messages["/servo_health"])
        self._rig.wait_for(
            lambda: self._permit() is Action.PASS and self._arrived()
        )

    def _permit(self):
        """Send the permission that leads from the driver's action to PASS; returns the action."""
        action = decode.ACTION_NUMBERS[self._rig.last("/servo_health").action]
        following = {Action.OFF: Action.HOLD, Action.RELAX: Action.OFF}
        self.permission = following.get(action, Action.PASS)
        return action

    def _arrived(self):
        """Whether the tendons are at the angle, within the servos' droop under load."""
        return np.allclose(
            self._rig.last("/joint_states").position, self.angle, atol=0.2
        )


@pytest.fixture
def stub(rig):
    """Permissions, limits and commands for a driver."""
    made = StubSupervisor(rig)
    yield made
    made.close()


def start_driver(rig, **options):
    """Start a driver, and wait until it is configured."""
    begin = rig.now()
    rig.start(DRIVER, **options)
    rig.wait_for(
        lambda: rig.since("/joint_states", begin), what="no joint states"
    )


def powered(rig, since):
    """Wait for a health report since a time with every torque on."""
    rig.wait_for(
        lambda: any(all(m.torque) for m in rig.since("/servo_health", since))
    )

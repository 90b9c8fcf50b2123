"""Supervisor and controller in one, for a driver without a graph."""

import numpy as np
from sensor_msgs.msg import JointState

from slot_core.bags import decode
from slot_core.safety.command_gate import Action
from slot_core.safety.states import State
from slot_msgs.msg import RobotState, ServoLimits
from slot_nodes import messages, qos


class Boss:
    """Supervisor and controller in one: repeats a permission and a command every 20 ms."""

    def __init__(self, rig):
        self.permission, self.angle = None, None
        self.commanded = self.permitted = 0  # ns, before the last of each
        self._rig = rig
        self._states = rig.node.create_publisher(RobotState, "robot_state", qos.STATE)
        self._limits = rig.node.create_publisher(ServoLimits, "servo_limits", qos.STATE)
        self._limits.publish(messages.limits_to_msg(rig.supervisor().servo_limits))
        self._commands = rig.node.create_publisher(JointState, "desired_joint_angles", qos.CONTROL)
        self._timer = rig.node.create_timer(0.02, self._tick)

    def _tick(self):
        now = self._rig.now()
        if (permission := self.permission) is not None:
            self.permitted = now
            action = decode.ACTION_NUMBERS.index(permission)
            state = RobotState(state=State.WALKING, action=action, reason="requested")
            state.header.stamp = messages.ns_to_stamp(now)
            self._states.publish(state)
        if (angle := self.angle) is not None:
            self.commanded = now
            self._commands.publish(messages.command_to_msg(now, np.full(4, angle)))

    def close(self):
        self._rig.node.destroy_timer(self._timer)
        self._rig.node.destroy_publisher(self._states)
        self._rig.node.destroy_publisher(self._limits)
        self._rig.node.destroy_publisher(self._commands)

    def fall_silent(self, what):
        """Stop sending the "command" or else the permission; returns the time before the last."""
        if what == "command":
            self.angle = None
            return self.commanded
        self.permission = None
        return self.permitted

    def lead(self, angle):
        """Have all tendons follow to an angle; again where a busy machine lets the driver down."""
        self.angle = angle
        self._rig.wait_for(lambda: self._rig.heard["/servo_health"])
        self._rig.wait_for(lambda: self._advance() is Action.PASS and self._is_there())

    def _advance(self):
        action = decode.ACTION_NUMBERS[self._rig.last("/servo_health").action]
        way = {Action.OFF: Action.HOLD, Action.RELAX: Action.OFF}
        self.permission = way.get(action, Action.PASS)
        return action

    def _is_there(self):
        """Within what the load on a servo costs."""
        return np.allclose(self._rig.last("/joint_states").position, self.angle, atol=0.2)

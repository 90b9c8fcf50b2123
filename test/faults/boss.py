"""Supervisor and controller in one, for a driver without a graph."""

import numpy as np
from sensor_msgs.msg import JointState

from slot_core.bags import decode
from slot_core.safety.command_gate import Action
from slot_core.safety.states import State
from slot_msgs.msg import RobotState
from slot_nodes import messages, qos


class Boss:
    """Supervisor and controller in one: repeats a word and a command every 20 ms."""

    def __init__(self, rig):
        self.word, self.angle = None, None
        self.commanded = self.spoken = 0  # ns, before the last of each
        self._rig = rig
        self._words = rig.node.create_publisher(RobotState, "robot_state", qos.STATE)
        self._commands = rig.node.create_publisher(JointState, "desired_joint_angles", qos.CONTROL)
        self._timer = rig.node.create_timer(0.02, self._tick)

    def _tick(self):
        now = self._rig.now()
        if (word := self.word) is not None:
            self.spoken = now
            action = decode.ACTIONS.index(word)
            told = RobotState(state=State.WALKING, action=action, reason="the boss says so")
            told.header.stamp = messages.ns_to_stamp(now)
            self._words.publish(told)
        if (angle := self.angle) is not None:
            self.commanded = now
            self._commands.publish(messages.command_to_msg(now, np.full(4, angle)))

    def close(self):
        self._rig.node.destroy_timer(self._timer)
        self._rig.node.destroy_publisher(self._words)
        self._rig.node.destroy_publisher(self._commands)

    def fall_silent(self, what):
        """Say no more of "command" or else of the word; returns the time before the last."""
        if what == "command":
            self.angle = None
            return self.commanded
        self.word = None
        return self.spoken

    def lead(self, angle):
        """Have all tendons follow to an angle; again where a busy machine lets the driver down."""
        self.angle = angle
        self._rig.wait_for(lambda: self._rig.heard["/servo_health"])
        self._rig.wait_for(lambda: self._urge() is Action.PASS and self._is_there())

    def _urge(self):
        action = decode.ACTIONS[self._rig.last("/servo_health").action]
        way = {Action.OFF: Action.HOLD, Action.RELAX: Action.OFF}
        self.word = way.get(action, Action.PASS)
        return action

    def _is_there(self):
        """Within what the load on a servo costs."""
        return np.allclose(self._rig.last("/joint_states").position, self.angle, atol=0.2)

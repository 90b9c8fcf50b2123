"""A running graph as the page drives it: its newest messages, its topics and services."""

from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from slot_bringup.playing.robot_display import TOPICS, Named
from slot_bringup.steering import SteeringPublisher
from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.gait.gait import STAND, Posture, read_gaits
from slot_core.messages import decode
from slot_core.recording.record_settings import read_record_settings
from slot_core.safety.states import (
    LATCHED,
    TO_RISE,
    TO_STAND,
    TO_WALK,
    Request,
    State,
    no_change,
)
from slot_msgs.msg import GaitPreview
from slot_msgs.srv import InjectFault, SetGait
from slot_nodes import messages, qos

TRIES = 6  # of a request that is refused: torque and the first estimate take a moment
WAIT = 12  # states, some 0.5 s, between two tries


class GraphRobot:
    """Drives a running graph; `said` is what it answered last, or why it could not be asked."""

    def __init__(self, node: Node) -> None:
        self.said = ""
        self._node, self._steering, self._gaits = (
            node,
            SteeringPublisher(node),
            read_gaits(),
        )
        self._new: dict[str, Any] = {}  # since the last frame, by topic
        self._preview: GaitPreview | None = None
        self.gait = STAND  # wanted last
        self._state: State | None = None  # of the supervisor, the last
        self._to: dict[
            State, Request
        ] = {}  # requests that lead to what is wanted
        self._asked: State | None = None  # in which the last of them was made
        # tries that are left, and states until the next
        self._tries = self._wait = 0
        kinds = {
            **{_name(request): Trigger for request in Request},
            "set_gait": SetGait,
            "sim_robot/inject": InjectFault,
        }
        self._clients = {
            name: node.create_client(kind, name) for name, kind in kinds.items()
        }
        for name, topic in read_record_settings().topics.items():
            if name in TOPICS:
                node.create_subscription(
                    messages.message_class(topic.type),
                    name.removeprefix("/"),
                    partial(self._new_message, name),
                    qos.best_effort(qos.recorded(topic, 1)),
                )

    def found(self) -> bool:
        """Whether the supervisor has been heard."""
        return "/robot_state" in self._new

    def walks(self) -> bool:
        """Whether a gait has been heard; it is wanted from now on."""
        if preview := self._new.get("/gait_preview"):
            self.gait = preview.requested
        return preview is not None

    def frame(self) -> list[Named]:
        """The newest message of every topic since the last frame; goes on with what is wanted.

        Raises ValueError for an invalid message.
        """
        new, self._new = self._new, {}
        self._preview = new.get("/gait_preview", self._preview)
        if (state := new.get("/robot_state")) is not None:
            self._steering.repeat(state, self._preview, lasts=True)
            self._state = decode.robot_state(state)[1]
            self._next_request(self._state)
        return list(new.items())

    def set_gait(self, gait: str) -> None:
        """Stand or walk in a gait."""
        self.gait = gait
        self._call("set_gait", SetGait.Request(gait=gait))
        stands = isinstance(self._gaits.find(gait), Posture)
        self._pursue(TO_STAND if stands else TO_WALK)

    def set_velocity(self, velocity: Array) -> None:
        """Go at v_x, v_y m/s, yaw rate rad/s, (3,); raises ConfigError where nothing answers."""
        self.said = self._steering.steer(self._commanded(), velocity)

    def set_pose(self, pose: Array | None) -> None:
        """Take a height m, roll, pitch rad, (3,), or the gait's own; raises ConfigError."""
        if pose is None:
            self._call(
                "set_gait", SetGait.Request(gait=self._commanded().requested)
            )
        else:
            self._steering.lean(self._commanded(), np.array(pose))

    def stand_up(self) -> None:
        """Rise from the floor and stand, never walk; raises ConfigError in ESTOP and FAULT."""
        if self._state in LATCHED:
            raise ConfigError(no_change(Request.STAND, self._state))
        self.gait = STAND
        self._pursue(TO_RISE | TO_STAND)

    def request(self, request: Request) -> None:
        """Make a request to the supervisor."""
        self._to = {}
        self._call(_name(request), Trigger.Request())

    def inject(
        self, kind: str, leg: str, value: float, duration: float, clear: bool
    ) -> None:
        """Inject a fault into the simulated robot, or clear it."""
        self._call(
            "sim_robot/inject",
            InjectFault.Request(
                kind=kind, leg=leg, value=value, duration=duration, clear=clear
            ),
        )

    def _pursue(self, requests: dict[State, Request]) -> None:
        self._to, self._asked = requests, None

    def _commanded(self) -> GaitPreview:
        if self._preview is None:
            raise ConfigError("no gait_scheduler answers")
        return self._preview

    def _new_message(self, name: str, message: Any) -> None:
        self._new[name] = message

    def _next_request(self, state: State) -> None:
        """Make the request that leads on from a state; without one the way has ended."""
        if state is self._asked:
            self._wait -= 1
            if self._wait != 0:  # nor is below: then nothing was refused
                return
        else:
            self._tries, self._wait = TRIES, 0
        self._asked, request = state, self._to.get(state)
        if request is None:
            self._to = {}
        else:
            self._call(_name(request), Trigger.Request(), tries=self._tries)

    def _call(self, name: str, request: Any, tries: int = 1) -> None:
        """Call a service, whose request may be made a number of times if it is refused."""
        client = self._clients[name]
        if not client.service_is_ready():
            self.said, self._to = f"{name}: nothing answers", {}
            return
        client.call_async(request).add_done_callback(
            partial(self._answered, tries - 1)
        )

    def _answered(self, tries: int, answer: Future) -> None:
        """Make a refused request again after a while, if tries are left."""
        self.said = answer.result().message
        if not answer.result().success:
            self._tries, self._wait = tries, WAIT
            if not tries:
                self._to = {}


def _name(request: Request) -> str:
    return f"supervisor/{request.name.lower()}"

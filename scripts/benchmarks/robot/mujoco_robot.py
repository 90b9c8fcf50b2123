"""The robot in MuJoCo: an independent engine with another contact law, for comparison.

A leg is a chain of rigid links, one for each segment of the rod. At node i are a hinge in the leg's
plane and one sideways, with the rod's bending stiffness and natural shape. The link behind it turns
about itself with the twist of its segment, G J / h, and stretches with E A / l.
Each joint has the damping time of the material, a link the masses of its segment. The figures come
from `slot_core.dynamics.rod`; equations of motion, integration and contact are the engine's.

The hinges of a node turn one after the other, so the second one's axis is turned by the first. The
sideways hinge is alternately the second, in the frame of the link behind, and the first, in that of
the link before. With one order at all nodes the sideways deflection would have an error of first
order in the links' length, and so with the twist at nodes, as the rod has it.

The tendon is an actuator on the combination of hinges and slides that lengthens it. Its tension
T = max(0, k (l - l_cmd) + c d(l - l_cmd)/dt) follows `slot_core.dynamics.rod`. The servo is the
pid of `slot_core.dynamics.servo` with the friction of the tendon's guide, in NumPy.

A contact is held by the acceleration -b v - k r of its points: k = 1 / (HOLD REACH)^2 and
b = 2 / (HOLD REACH) belong to critical damping. 1 - HOLD is the share of the acceleration without
the contact that is let through: the softness of normal forces. Along the floor it is divided by
`TANGENTIAL`; sticking points creep by what is left.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.dynamics.model import Model, build_model
from slot_core.dynamics.rod import sections
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import Servo, ServoSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.refusal import DivergenceError
from slot_core.robot import LEGS, RobotParameters

POINT = 1e-6  # m, radius of the spheres that stand for contact points
CORNERS = 8  # of the torso
FLOOR, TOUCHING = 1, 2  # bits: points touch the floor, not each other
STEP = 2e-4  # s
# s, time constant of a contact; the engine wants two steps at least
REACH = 2e-3
HOLD, TANGENTIAL = 0.95, 100.0


class MujocoMotion(NamedTuple):
    """Motion of the torso, see `RobotState`."""

    position: Array
    rotation: Array
    velocity: Array
    rate: Array
    specific_force: Array


class MujocoLinks(NamedTuple):
    """Links of a leg, one for each segment."""

    mass: Array  # (n,) kg
    centre: Array  # (n,) m from the joint, along the link
    inertia: Array  # (n, 3) kg m^2 about the centre and the link, its width and its thickness
    torsion: Array  # (n,) N m/rad


def links(robot: RobotParameters, model: Model) -> MujocoLinks:
    """Links with the kinetic energy of the rod's segments, and their twist.

    A segment has masses a, b at its nodes and the coupling mu: about its centre, across the link,
    the inertia is a b l^2 / (a + b) - mu l^2. A section's own inertia about its width and its
    thickness, which the rod neglects, is added: the engine refuses a link without it.
    """
    rod, leg = model.rod, robot.leg
    step, fraction = np.diff(rod.arc), rod.arc / rod.arc[-1]
    line = sections(leg, fraction).mass
    begin, end = (
        step / 6 * (2 * line[:-1] + line[1:]),
        step / 6 * (line[:-1] + 2 * line[1:]),
    )
    mass, square = begin + end, rod.rest_length**2
    across = begin * end / mass * square - rod.coupling * square
    wide, thick = (
        leg.width**2,
        leg.thickness((fraction[:-1] + fraction[1:]) / 2) ** 2,
    )
    flat, upright = (
        rod.spin * thick / (wide + thick),
        rod.spin * wide / (wide + thick),
    )
    inertia = np.column_stack([rod.spin, across + flat, across + upright])
    return MujocoLinks(
        mass,
        end / mass * rod.rest_length,
        inertia,
        sections(leg, (fraction[:-1] + fraction[1:]) / 2).torsion / step,
    )


def build(robot: RobotParameters, model: Model, step: float) -> mujoco.MjModel:
    """The robot on its floor, with a time step, s.

    `implicitfast` is Euler's method, semi-implicit in positions and implicit in damping: springs
    with a damping time of more than half a step are stable however stiff they are.
    """
    shape, spec = links(robot, model), mujoco.MjSpec()
    option = spec.option
    option.timestep, option.gravity = step, model.gravity
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = TANGENTIAL
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        pos=[0, 0, -POINT],
        contype=FLOOR,
        conaffinity=TOUCHING,
    )
    torso = spec.worldbody.add_body(
        name="torso",
        mass=model.torso.mass,
        inertia=np.diag(model.torso.inertia),
        explicitinertial=True,
    )
    torso.add_freejoint()
    for corner in model.torso.corners:
        add_point(torso, corner, model.floor.corner_friction)
    for leg in range(4):
        add_leg(torso, leg, robot, model, shape)
        add_tendon(spec, leg, model)
    return spec.compile()


def add_leg(
    torso: Any,
    leg: int,
    robot: RobotParameters,
    model: Model,
    shape: MujocoLinks,
) -> None:
    """Add leg 0 .. 3: links from the clamp outward, each with its joints and its end's points."""
    length, body, place = model.rod.rest_length, torso, robot.clamps[leg]
    turn = Rotation.from_euler("z", robot.azimuth[leg])
    for k in range(len(length)):
        turn = turn * Rotation.from_euler("y", -model.rod.rest_angle[k])
        body = body.add_body(
            name=f"{LEGS[leg]}{k}",
            pos=place,
            quat=turn.as_quat(scalar_first=True),
            mass=shape.mass[k],
            ipos=[shape.centre[k], 0, 0],
            inertia=shape.inertia[k],
            explicitinertial=True,
        )
        add_joints(body, k, model, shape.torsion[k])
        for side in (-0.5, 0.5):
            add_point(
                body,
                [length[k], side * robot.leg.contact_width, 0],
                model.friction[0, leg],
            )
        place, turn = [length[k], 0, 0], Rotation.identity()


def add_joints(body: Any, k: int, model: Model, torsion: float) -> None:
    """Add the joints of link k: positive in the plane is upward, as the rod's turning angle."""
    rod, hinge = model.rod, mujoco.mjtJoint.mjJNT_HINGE
    before = Rotation.from_euler("y", rod.rest_angle[k]).apply([0.0, 0.0, 1.0])
    joints = [
        ("turn", hinge, (0, -1, 0), rod.bending[k]),
        ("side", hinge, before if k % 2 else (0, 0, 1), rod.lateral[k]),
    ]
    joints = joints[::-1] if k % 2 else joints
    joints.append(("twist", hinge, (1, 0, 0), torsion))
    joints.append(
        ("along", mujoco.mjtJoint.mjJNT_SLIDE, (1, 0, 0), rod.axial[k])
    )
    for kind, form, axis, stiffness in joints:
        body.add_joint(
            name=f"{body.name}{kind}",
            type=form,
            axis=axis,
            stiffness=stiffness,
            damping=stiffness * rod.damping_time,
        )


def add_point(body: Any, place: Any, friction: float) -> None:
    """Add a point (3,), m, that touches the floor.

    Its priority makes the contact's softness and friction the point's; else they are means with
    the floor's.
    """
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[POINT, 0, 0],
        pos=place,
        mass=0,
        contype=TOUCHING,
        conaffinity=FLOOR,
        friction=[friction, 0, 0],
        condim=3,
        priority=1,
        solref=[REACH, 1.0],
        solimp=[HOLD, HOLD, 1e-3, 0.5, 2],
    )


def add_tendon(spec: Any, leg: int, model: Model) -> None:
    """Add the tendon of leg 0 .. 3 and what pulls it: force k (control - l) - c dl/dt <= 0."""
    tendon, cable = spec.add_tendon(name=LEGS[leg]), model.tendon
    for k, (around, along) in enumerate(zip(cable.around, cable.along)):
        if around:
            tendon.wrap_joint(f"{LEGS[leg]}{k}turn", around)
        if along:
            tendon.wrap_joint(f"{LEGS[leg]}{k}along", along)
    spec.add_actuator(
        name=LEGS[leg],
        target=LEGS[leg],
        trntype=mujoco.mjtTrn.mjTRN_TENDON,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        gainprm=[cable.stiffness] + 9 * [0],
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        biasprm=[0, -cable.stiffness, -cable.damping] + 7 * [0],
        forcelimited=True,
        forcerange=[-1e4, 0],
    )


def motor_speed(
    law: Servo, speed: Array, error: Array, torque: Array, h: float
) -> Array:
    """Speed of the motors (4,) after h (s), rad/s, by the pid without its integral.

    error: commanded less measured angle, rad; torque: load by the tendons, N m. The friction of
    their guides adds to it while a spool winds and lessens it while it releases; between the two a
    spool stands still. As in `slot_core.dynamics.servo`.
    """
    duty = np.clip(law.proportional * error - law.derivative * speed, -1.0, 1.0)
    loads = torque * law.friction, torque / law.friction
    winding, releasing = (
        speed
        + (law.speed * (duty - law.speed_loss * load) - speed)
        * h
        / (law.motor_time + h)
        for load in loads
    )
    return np.maximum(winding, 0.0) + np.minimum(releasing, 0.0)


class MujocoRobot(SimulatedRobot):
    """The robot in MuJoCo with the interface of the project's; settles as that does.

    Raises ValueError for a servo other than the pid without integral and backlash. Payload, damaged
    tendons and uneven floors are not modelled.
    """

    def __init__(
        self,
        robot: RobotParameters,
        scene: Scene,
        servo: ServoSettings,
        step: float = STEP,
    ) -> None:
        self.parameters, self.scene = robot, scene
        model = build_model(robot, scene, servo)
        self._law, self._radius = model.servo, model.tendon.spool_radius
        if not self._law.pid or self._law.integral or self._law.play:
            raise ValueError(
                "the servo in MuJoCo is the pid without integral and backlash"
            )
        # m, of a tendon at tendon angle zero
        self._slack = model.tendon.relaxed
        self._slack -= float(model.tendon.around @ model.rod.rest_angle)
        self._delay = model.tendon.damping / model.tendon.stiffness  # s
        self._model = build(robot, model, step)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[2] = scene.start.height
        self._angle, self._speed = np.zeros(4), np.zeros(4)
        self._tip_force = np.zeros((4, 3))
        self._acceleration = -self._model.opt.gravity  # m/s^2, beyond gravity
        mujoco.mj_forward(self._model, self._data)
        self._settle()

    def advance(self, steps: int, command: Array) -> None:
        """See SimulatedRobot; `steps` count the scene's solver steps."""
        command, h, data = (
            self.checked(command),
            self._model.opt.timestep,
            self._data,
        )
        last = 1 + np.arange(1, 5) * ((self._model.nbody - 2) // 4)
        arm = self.nodes[:, -1] - data.xipos[last]
        data.xfrc_applied[last, :3] = self._tip_force
        data.xfrc_applied[last, 3:] = np.cross(arm, self._tip_force)
        last_steps = round(self.scene.solver.step / h)
        for left in range(steps * last_steps, 0, -1):
            if left == last_steps:
                before = data.qvel[:3].copy()
            torque = -self._radius * data.actuator_force
            error = command - self._angle
            self._speed = motor_speed(self._law, self._speed, error, torque, h)
            self._angle = self._angle + h * self._speed
            ahead = self._angle + self._delay * self._speed
            data.ctrl[:] = self._slack - self._radius * ahead
            mujoco.mj_step(self._model, data)
        if steps:
            change = (data.qvel[:3] - before) / self.scene.solver.step
            self._acceleration = change - self._model.opt.gravity
        self.steps += steps
        # the engine has started anew
        if any(warning.number for warning in data.warning):
            raise DivergenceError(
                f"MuJoCo's simulation diverged before {self.time:.3f} s"
            )

    def push(self, force: Array, moment: Array) -> None:
        """See SimulatedRobot."""
        self._data.xfrc_applied[1] += [*force, *moment]

    def pull_tip(self, leg: int, force: Array) -> None:
        """Add a force (3,), N, odom, at the tip of leg 0 .. 3.

        Its moment about the last link is set anew with every call of `advance`.
        """
        self._tip_force[leg] += force

    @property
    def state(self) -> MujocoMotion:  # type: ignore[override]
        """Motion of the torso; the specific force is the mean over the last step of the scene."""
        place, velocity = self._data.qpos[:7], self._data.qvel[:6]
        turned = Rotation.from_quat(place[3:], scalar_first=True).as_matrix()
        return MujocoMotion(
            place[:3],
            turned,
            velocity[:3],
            velocity[3:],
            turned.T @ self._acceleration,
        )

    @property
    def tendon_angle(self) -> Array:
        """(4,) rad, angle of the spools."""
        return self._angle.copy()

    @property
    def tendon_rate(self) -> Array:
        """(4,) rad/s, over the last step."""
        return self._speed.copy()

    @property
    def tension(self) -> Array:
        """(4,) N, of the tendons in the last step."""
        return -self._data.actuator_force

    @property
    def nodes(self) -> Array:
        """(4, N, 3) m, nodes of the legs in odom, clamp first; between the edges of the links."""
        mujoco.mj_kinematics(self._model, self._data)
        ends = (
            self._data.geom_xpos[1 + CORNERS :]
            .reshape(4, -1, 2, 3)
            .mean(axis=2)
        )
        clamps = self.position + self.parameters.clamps @ self.rotation.T
        return np.concatenate([clamps[:, None], ends], axis=1)

    @property
    def ground_force(self) -> Array:
        """(4, 3) N in odom, force of the floor on each leg in the last step."""
        force, out = np.zeros((4, 3)), np.zeros(6)
        points = (self._model.ngeom - 1 - CORNERS) // 4
        for k, contact in enumerate(self._data.contact):
            mujoco.mj_contactForce(self._model, self._data, k, out)
            leg = (contact.geom2 - 1 - CORNERS) // points
            if leg >= 0:
                force[leg] += contact.frame.reshape(3, 3).T @ out[:3]
        return force

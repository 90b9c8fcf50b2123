"""Rollout MPC: policy in the stride, which simulates the robot (`problem.py`).

A tick has two phases. `step` rolls the plan out from the estimated state, solves the quadratic
programme and searches along its step. `prepare`, called when the command has been sent, moves the
plan on by a stage, lets the nominal robot execute the command, linearises its motion from there and
corrects the disturbances. Where `prepare` has not been called, `step` calls it: the commands are
the same.

Where time runs short (`effort`), `prepare` computes a fifth of the slopes anew, another one in each
tick, and then none: the plan approaches the gait's angles.

A turn in place lies on its belly for a part of the stride, which the nominal robot does not know. On a
level floor its plan is therefore that of `place`, with the wrench carried: the gait's angles, with
the amplitude from the error of the yaw. The observer keeps its disturbances meanwhile.

In a posture the feet stick, and a leg that is released with its foot stuck lifts the torso. As a plan
sees nothing beyond such a dead band, each of its steps pulls, and the torso rises. On a level floor the
nominal robot therefore has less friction in a posture than in a walk (`nominal.posture_friction`).
Once the reference rests and the torso is near it, the plan is that of `posture_feedback.py`. A leg
without a tendon is the nominal robot's affair.

While the servos do not follow, or tendons are to be slack, the plan is the gait's; after a fault it
is tried first whether the next one could be solved. A cycle without a new plan moves the last one on and
lets its deviations from the gait decay; after `limits.cycles` such cycles in a row the status is
STOPPED.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from slot_core.arrays import Array
from slot_core.control.effort import Effort
from slot_core.control.force_map import read_springs
from slot_core.control.policy import (
    GRAVITY_RANGE,
    PlanReport,
    Policy,
    Status,
    TendonPlan,
    Timer,
    fault_of,
    gait_plan,
    make_policy,
    preview_fault,
    state_fault,
    time_fault,
)
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitPreview, first_rate, read_gaits
from slot_core.geometry import wrapped
from slot_core.key_frame import StateParts
from slot_core.matrices import inverse, norm, product
from slot_core.robot import GRAVITY, LEGS, RobotParameters
from slot_core.rollout_mpc.disturbance_observer import (
    PLACE,
    TILTS,
    DisturbanceObserver,
)
from slot_core.rollout_mpc.nominal_robot import NominalRobot, Rollouts
from slot_core.rollout_mpc.posture_feedback import PostureFeedback
from slot_core.rollout_mpc.problem import Linearisation, PlanProblem
from slot_core.rollout_mpc.settings import RolloutMpcSettings, read_rollout_mpc

PARTS = 5  # of the slopes
MISSED_MAX = 5  # stages without an estimate after which the plan begins anew
SHARES = (1.0, 0.3)  # of the step, in the line search
LEAST_SPEED = 0.01  # m/s, of a walk
LEVEL = 0.35  # m/s^2, gravity along a floor of 2 deg
STILL = 1e-4  # m, rad within which a reference rests
# m, rad beyond the nominal robot's motion: the odometry has jumped
JUMP, TURN = 0.05, 0.2


@dataclass(frozen=True)
class _Plan:
    """Plan whose stage 0 is at `time`; K stages follow."""

    time: int  # ns
    start: Array  # state of the nominal robot
    nominal: Array  # (K + 2, 4) rad, of the gait, with the payload
    sag: float  # m, by which the torso sinks since the legs cannot carry more
    deviation: Array  # (K + 1, 4) rad
    # as published: poses and feet at the stages 1 .. K, forces at 0 .. K-1
    motion: Rollouts
    linear: Linearisation | None = None


class RolloutMpc(Policy):
    """Plans tendon angles over the next stride; `step` raises nothing for bad data."""

    STATE = StateParts(
        "stage_time",
        "_model",
        "observer",
        "_posture",
        "_plan",
        "_next",
        "_state",
        "_walks",
        "_stiffness",
        "_missed",
        "_disturbances",
        values=(_Plan, Linearisation, Rollouts, PlanReport),
    )

    def __init__(
        self, robot: RobotParameters, settings: RolloutMpcSettings, timer: Timer
    ):
        """Take the nominal robot; raises ConfigError if the leg table does not cover it."""
        self._robot, self._settings, self._timer = robot, settings, timer
        self._springs = read_springs()
        self._place = make_policy("place", robot, timer)
        x, y, _ = robot.feet.T
        balance = np.array([np.ones(len(LEGS)), y, -x])  # B
        # (4, 3) least forces of the legs for a wrench, B^T (B B^T)^-1
        self._shares = product(balance.T, inverse(product(balance, balance.T)))
        self._begin(read_gaits().dt)

    @staticmethod
    def read_settings(name: str) -> RolloutMpcSettings:
        """`config/rollout_mpc.yaml`; raises ConfigError."""
        return read_rollout_mpc()

    @property
    def stage_time(self) -> float:
        """Time between the stages of a plan, s."""
        return self._dt

    @stage_time.setter
    def stage_time(self, dt: float) -> None:
        if dt != self._dt:
            self._begin(dt)

    def reset(self) -> None:
        """Begin anew, without a plan and without disturbances."""
        self._begin(self._dt)

    def _begin(self, dt: float) -> None:
        """Set up model and problem for stages of dt (s)."""
        self._dt, settings = dt, self._settings
        self._model = NominalRobot(self._robot, settings.nominal, dt)
        self._problem = PlanProblem(settings, self._robot.tendon.angle_max, dt)
        self.observer = DisturbanceObserver(
            self._model, settings.observer, self._problem.scale, dt
        )
        self._posture = PostureFeedback(
            settings.posture, settings.limits, self._shares
        )
        self._plan: _Plan | None = None  # that is executed
        self._next: _Plan | None = None  # a stage later, prepared
        # (12,) that the plan is for; None after a fallback and in a turn in place
        self._state: Array | None = None
        self._walks = False  # whether that is with a velocity
        self._stiffness = np.ones(len(LEGS))  # N/rad, mean over the stages
        self._missed = 0  # consecutive cycles without a new plan
        self._note_disturbances()

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """Plan for the estimate at stage 0 of `preview`."""
        begin, limits = self._timer(), self._settings.limits
        fault = preview_fault(
            preview, self._settings.stages + 2, limits.input_max
        )
        if not fault and preview.dt != self._dt:
            self._begin(preview.dt)
        if not fault and not preview.corrected:
            self._plan = self._next = None
            if self._missed == 0:
                return self._gait_plan(preview)
        if fault := (
            fault
            or state_fault(estimate.state, limits.input_max)
            or fault_of("gravity", estimate.gravity, (3,), *GRAVITY_RANGE)
        ):
            return self._fall_back(Status.REJECTED, fault)
        present = self._plan
        state = np.asarray(estimate.state, dtype=float)
        self._take_stiffness(preview.leg_stiffness)
        if self._settings.nominal.slope:
            self._model.gravity = estimate.gravity
        is_level = norm(self._model.gravity[:2]) < LEVEL
        self._model.in_posture = is_level and not preview.velocity_ahead.any()
        rests = self._rests(state, preview)
        turns = preview.in_place and is_level
        if turns:
            self.observer.forget()
            preview = replace(
                preview, tendon_angle=self._place.step(estimate, preview).angle
            )
        ready = self._ready(estimate.time, state, preview)
        fixed = turns or rests or ready.linear is None
        if rests and not turns:
            ready = self._kept(ready, state, preview)
        elif fixed:
            decayed = limits.decay * ready.deviation
            ready = replace(ready, deviation=decayed)
        plan, rollout, fault = self._improved(ready, state, preview, fixed)
        cause = Status.NOT_SOLVED if fault else Status.LATE
        if fault := fault or time_fault(
            self._timer() - begin, limits.time_budget
        ):
            return self._fall_back(cause, fault)
        self._missed = 0
        if not preview.corrected:
            return self._gait_plan(preview)
        pose, force, foot = (values[0] for values in rollout)
        moved = self._problem.moved(self.observer.taken, float(state[2]))
        pose[:, PLACE] += moved
        foot[..., :2] += moved[:, None, :2]
        # forces at stage 0: as predicted a stage before
        now = force[:1] if present is None else present.motion.force[1:2]
        motion = Rollouts(pose, np.concatenate([now, force[:-1]]), foot)
        linear = plan.linear if self.effort is Effort.SLOPES else None
        self._plan = replace(plan, motion=motion, linear=linear)
        self._next, self._state = None, None if turns else state
        self._walks = norm(preview.velocity_ahead[0, :2]) > LEAST_SPEED
        self._note_disturbances()
        return self._published(self._plan, preview=preview)

    def _take_stiffness(self, ratio: float) -> None:
        """Let the model have legs of another stiffness, which explain a part of F_z, or all.

        Before and after, legs and wrench carry the weight at the present angles:
        w - F_z = kappa F, so F_z' = w - (w - F_z) kappa' / kappa.
        """
        if ratio != self._model.stiffness:
            weight, wrench = self._robot.weight, self.observer.wrench.copy()
            left = (weight - wrench[0]) * (ratio / self._model.stiffness)
            wrench[0] = sorted((0.0, wrench[0], weight - left))[1]
            self.observer.wrench = wrench
            self._model.stiffness = ratio

    def _gait_plan(self, preview: GaitPreview) -> TendonPlan:
        """The gait's angles and forces over as many stages as a plan."""
        plan, stages = gait_plan(preview), self._settings.stages
        return replace(
            plan, angle=plan.angle[:stages], force=plan.force[:stages]
        )

    def prepare(self) -> None:
        """Move the plan on by a stage, linearise its motion and correct the disturbances."""
        plan = self._plan
        if plan is None or self._next is not None:
            return
        self._next = self._moved_on(plan)
        if self.effort is not Effort.GAIT:
            self._next = self._linearised(self._next, plan.linear)
        self._stiffness = self._stiffness_of(
            self._next.nominal[1:-1], plan.motion.pose
        )
        if self._state is not None:
            self.observer.observe(
                plan.start, self._state, self._angles(plan)[0], self._walks
            )

    def _ready(self, time: int, state: Array, preview: GaitPreview) -> _Plan:
        """The plan for the state (12,) at `time` (ns), linearised near it."""
        found = self._found(time, state)
        if found is None:
            self.observer.forget()
            stages = self._settings.stages
            angle, pose = (
                np.asarray(rows, dtype=float)[: stages + 2]
                for rows in (preview.tendon_angle, preview.reference)
            )
            self._stiffness = self._stiffness_of(angle, pose)
            nominal, sag = self._nominal(preview)
            start = self._model.at_rest(state, nominal[0])
            still = np.zeros((stages + 1, len(LEGS)))
            return self._linearised(
                _Plan(time, start, nominal, sag, still, _no_motion(stages))
            )
        self._model.set_wrench(self.observer.wrench, state[2])
        start = self._model.measured(found.start, state)
        nominal, sag = self._nominal(preview)
        return replace(found, time=time, start=start, nominal=nominal, sag=sag)

    def _rests(self, state: Array, preview: GaitPreview) -> bool:
        """Whether the robot keeps a posture by feedback, on four tendons."""
        rows = np.asarray(preview.reference, dtype=float)
        rows = rows[: self._settings.stages + 2, :6]
        still = (np.abs(rows - rows[0]) < STILL).all()
        whole = not any(self._settings.nominal.broken)
        error = state[TILTS] - rows[0, TILTS]
        if (
            still
            and whole
            and not preview.velocity_ahead.any()
            and self._posture.reaches(error, float(state[11]))
        ):
            return True
        self._posture.forget()
        return False

    def _kept(self, plan: _Plan, state: Array, preview: GaitPreview) -> _Plan:
        """The plan with the angles that keep the posture."""
        carried = plan.nominal[0]
        angle = self._posture.angle(
            state[TILTS] - preview.reference[0, TILTS],
            preview.tendon_angle[0],
            carried,
            carried if self._plan is None else self._angles(self._plan)[1],
            self._stiffness,
        )
        return replace(plan, deviation=angle - plan.nominal[:-1])

    def _found(self, time: int, state: Array) -> _Plan | None:
        """The prepared plan at `time`; None if there is none, or if the robot is elsewhere."""
        if self._plan is None:
            return None
        # stages since the first one that follows the present plan
        missed = round(1e-9 * (time - self._plan.time) / self._dt) - 1
        if not 0 <= missed <= MISSED_MAX:
            return None
        self.prepare()
        found = self._next
        assert found is not None
        if missed > 0:
            self.observer.forget()
        for _ in range(missed):
            found = replace(self._moved_on(found), linear=found.linear)
        gap = self._model.place(found.start) - state[PLACE]
        is_near = norm(gap[:2]) < (1 + missed) * JUMP
        return (
            found
            if is_near and abs(wrapped(gap[2])) < (1 + missed) * TURN
            else None
        )

    def _nominal(self, preview: GaitPreview) -> tuple[Array, float]:
        """Angles (K + 2, 4) of the gait, turned on to carry the wrench on the torso, and the sag.

        The torso sags by the mean force that the largest tendon angle does not give.
        """
        gait = np.asarray(preview.tendon_angle, dtype=float)
        angle = gait[: self._settings.stages + 2]
        carried = (
            angle
            - product(self._shares, self.observer.wrench) / self._stiffness
        )
        nominal = np.clip(carried, 0.0, self._robot.tendon.angle_max)
        missing = float(product(carried - nominal, self._stiffness).mean())  # N
        return nominal, missing / self._settings.observer.stiffness[0]

    def _stiffness_of(self, angle: Array, pose: Array) -> Array:
        """Mean stiffness (4,) of the legs, N/rad, at tendon angles (n, 4) and poses (n, >= 6)."""
        height = self._robot.clamp_heights(*pose[:, [5, 0, 1]].T)
        found = self._springs.at(angle, height, self._model.stiffness)
        return np.asarray(found.slope.mean(axis=0))

    def _angles(self, plan: _Plan) -> Array:
        """Tendon angles (K + 1, 4) of a plan."""
        nominal = plan.nominal[:-1]
        return np.clip(nominal + plan.deviation, *self._problem.range(nominal))

    def _moved_on(self, plan: _Plan) -> _Plan:
        """The plan a stage later, where the nominal robot has executed it."""
        return _Plan(
            plan.time + round(self._dt * 1e9),
            self._model.after(plan.start, self._angles(plan)[:2]),
            _shifted(plan.nominal),
            plan.sag,
            _shifted(plan.deviation),
            _no_motion(self._settings.stages),
        )

    def _linearised(
        self, plan: _Plan, last: Linearisation | None = None
    ) -> _Plan:
        """The plan with the slopes of its motion, by finite differences; all but a fifth of `last`."""
        plans, steps = self._problem.varied(self._angles(plan))
        rows = np.arange(len(steps))
        if last is not None:
            rows = rows[round(1e-9 * plan.time / self._dt) % PARTS :: PARTS]
        pose = self._model.roll_out(
            plan.start, plans[np.append(0, 1 + rows)]
        ).pose
        yaw = self._model.place(plan.start)[2]
        slopes = self._problem.errors(pose[1:], pose[0], yaw)
        slopes /= steps[rows, None]
        # no change along diverged ones
        slopes[~np.isfinite(slopes).all(axis=1)] = 0.0
        if last is not None:
            found, slopes = slopes, last.slopes.copy()
            slopes[rows] = found
        return replace(plan, linear=self._problem.linearised(slopes))

    def _improved(
        self, plan: _Plan, state: Array, preview: GaitPreview, fixed: bool
    ) -> tuple[_Plan, Rollouts, str]:
        """The plan after a step of the problem and its rollout, or the fault.

        fixed: without the step, in a turn in place and in a posture that is kept.
        """
        problem, observer, place = self._problem, self.observer, state[PLACE]
        rows, yaw = np.asarray(preview.reference, dtype=float), float(state[2])
        wanted = problem.reference(rows, place, observer.taken, plan.sag)
        before = self._model.roll_out(plan.start, self._angles(plan)[None])
        error = problem.errors(before.pose, wanted, yaw)[0]
        if not np.isfinite(error).all():
            return plan, before, "the rollout diverges"
        if fixed:
            return plan, before, ""
        assert plan.linear is not None
        change = problem.change(
            error, plan.linear, plan.deviation, plan.nominal[:-1]
        )
        if change is None:
            return plan, before, "the quadratic programme is not solved"
        least = problem.cost(error, plan.deviation)
        for share in SHARES:
            tried = replace(plan, deviation=plan.deviation + share * change)
            after = self._model.roll_out(plan.start, self._angles(tried)[None])
            error = problem.errors(after.pose, wanted, yaw)[0]
            if problem.cost(error, tried.deviation) < least:
                return tried, after, ""
        return plan, before, ""

    def _fall_back(self, cause: Status, fault: str) -> TendonPlan:
        """The last plan a stage later, with smaller deviations; nothing without one or too late."""
        self._missed += 1
        limits = self._settings.limits
        if self._plan is None or self._missed > limits.cycles:
            used_up = f"fallback used up after {limits.cycles} cycles"
            why = "no plan yet" if self._plan is None else used_up
            plan = TendonPlan(
                np.zeros((0, len(LEGS))),
                np.zeros(len(LEGS)),
                _no_motion(self._settings.stages).force,
            )
            cause, fault = Status.STOPPED, f"{why}; {fault}"
        else:
            moved = self._moved_on(self._plan)
            self._plan = replace(
                moved,
                deviation=limits.decay * moved.deviation,
                motion=self._plan.motion,
            )
            self._next = self._state = None
            self.observer.forget()
            self._note_disturbances()
            plan = self._published(self._plan)
        message = "; ".join(filter(None, (fault, self.effort)))
        return replace(
            plan, status=cause, message=message, fallback_cycles=self._missed
        )

    def _published(
        self, plan: _Plan, preview: GaitPreview | None = None
    ) -> TendonPlan:
        """The present plan; its preview, if it is new."""
        angle, motion = self._angles(plan), plan.motion
        rate = first_rate(angle, self._dt)
        message, friction = self.effort.value, self._model.friction
        if not message and friction != self._settings.nominal.friction:
            message = f"the floor grips: friction {friction:g} in the model"
        fx, fy, normal = motion.force[0].T
        slack = np.full(len(LEGS), math.nan)
        if preview is not None:
            slack = preview.friction[0] * normal - np.maximum(
                np.abs(fx), np.abs(fy)
            )
        least, largest = self._problem.range(plan.nominal)
        return TendonPlan(
            angle[:-1],
            rate,
            motion.force,
            pose=motion.pose,
            foot=motion.foot,
            status=Status.SOLVED,
            message=message,
            report=replace(
                self._disturbances,
                slack_normal_min=normal,
                slack_friction=slack,
                slack_angle=np.minimum(angle[0] - least, largest - angle[0]),
                slack_rate=self._settings.limits.rate - np.abs(rate),
            ),
        )

    def _note_disturbances(self) -> None:
        """Note the disturbances of the present plan.

        The observer goes on in `prepare`, at a time that does not depend on the messages.
        """
        observer = self.observer
        self._disturbances = PlanReport(
            mass=self._robot.mass - observer.wrench[0] / GRAVITY,
            drift=observer.drift.copy(),
            wrench=observer.wrench.copy(),
        )


def _no_motion(stages: int) -> Rollouts:
    """No prediction: no poses, no places of the feet, and forces of zero."""
    force = np.zeros((stages, len(LEGS), 3))
    return Rollouts(np.zeros((0, 6)), force, force[:0])


def _shifted(rows: Array) -> Array:
    """Rows (n, 4) moved on by a stage; the last one stays."""
    return np.vstack([rows[1:], rows[-1:]])

"""Lanes compared with NumPy, and four legs in lanes with the same equations leg by leg."""

import copy
import dataclasses
import math
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import NumbaError, TypingError

from slot_core import compiled, config
from slot_core.dynamics import integrator
from slot_core.dynamics.algebra import cosine_sine
from slot_core.dynamics.handle import Handle
from slot_core.dynamics.lanes import (
    all_lanes,
    any_lane,
    in_lanes,
    largest,
    like,
    total,
    where,
)
from slot_core.dynamics.model import (
    build_model,
    build_scheme,
    leg_lanes,
    matching_state,
    rest_state,
    work_space,
)
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.spatial.strain import rotation_vector
from slot_core.robot import read_robot

ROBOT, SCENE, SERVO = read_robot(), read_scene("flat"), read_servo()


class Stepper:
    """The kernels of a RodRobot without its checks, legs in lanes or one by one."""

    def __init__(self, in_lanes, robot=ROBOT, servo=SERVO, **changes):
        scene = config.replace(
            SCENE, {k.replace("__", "."): v for k, v in changes.items()}
        )
        self.model = build_model(robot, scene, servo)
        self.state = rest_state(self.model, scene.start.height)
        self.legs, self.work = leg_lanes(self.model, self.state), work_space()
        start = matching_state(self.model)
        scheme = build_scheme(scene.solver, self.model.floor)
        self.machine = Handle(
            (self.model, self.state, self.work, start, self.legs, scheme)
        )
        self.advance = integrator.advance if in_lanes else integrator.advance_one_by_one

    def run(self, command, steps):
        self.legs.command[0] = command
        assert self.advance(self.machine, steps) == (steps, -1)


FEATURES = {
    "bristles": {"floor__friction_law": "bristle"},
    "direction": {
        "floor__friction_varies": "direction",
        "floor__friction_other": [0.1] * 4,
    },
    "phase": {"floor__friction_varies": "phase", "floor__friction_other": [0.1] * 4},
    "map": {"floor__height_map": "uneven.csv"},
    "map with bristles": {
        "floor__height_map": "uneven.csv",
        "floor__friction_law": "bristle",
    },
    "tips": {"floor__contact": "tip"},
    "payload": {"payload__mass": 0.5, "payload__place": [0.02, 0.03, 0.04]},
    "faults": {
        "tendons__slack": [0.0, 2e-3, 0.0, 0.0],
        "tendons__broken": [False, False, True, False],
    },
    "pid": {
        "servo": dataclasses.replace(SERVO, model="pid", integral=5.0, backlash_deg=2.0)
    },
}


@pytest.mark.parametrize("feature", FEATURES)
def test_legs_in_lanes_move_as_legs_one_by_one_with_every_feature(feature):
    """From the start for 0.3 s, tendons pulled and then partly released, each leg differently."""
    lanes, single = (Stepper(which, **FEATURES[feature]) for which in (True, False))
    plain = Stepper(True)
    for degrees in [[90.0, 40.0, 60.0, 75.0]] * 6 + [[30.0, 70.0, 0.0, 75.0]] * 4:
        for stepper in (lanes, single, plain):
            stepper.run(np.radians(degrees), 30)
        np.testing.assert_allclose(
            lanes.state.buffer, single.state.buffer, rtol=1e-6, atol=1e-5
        )
        np.testing.assert_allclose(
            lanes.state.node, single.state.node, rtol=0, atol=1e-7
        )
    assert (
        np.abs(lanes.state.node - plain.state.node).max() > 1e-5
    )  # m: the feature has an effect


def test_legs_in_lanes_halve_the_same_steps_as_legs_one_by_one():
    """An impact at 3 m/s with different tendon angles: contact and large angles in some lanes."""
    changes = {"start__height": 0.06, "solver__correction_limit": 1e-4}
    steppers = [Stepper(in_lanes, **changes) for in_lanes in (True, False)]
    for stepper in steppers:
        stepper.state.node_velocity[:, :, 2] = stepper.state.velocity[2] = -3.0
        stepper.run(np.array([1.9, 0.0, 1.0, 2.0]), 150)
    lanes, single = steppers
    np.testing.assert_allclose(lanes.state.node, single.state.node, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(lanes.work.counter, single.work.counter)
    assert lanes.work.counter[0] > 0


class Pair(NamedTuple):
    """Operands and results of a kernel on lanes, (n, 4)."""

    a: np.ndarray
    out: np.ndarray


def on_lanes(function, count, *rows):
    """(count, 4) results that a function of two Lanes arrays (operands, results) writes."""
    pair = Pair(np.array(rows, dtype=float), np.full((count, 4), 7.0))
    inner = njit(function)

    @njit
    def run(pair):
        view = in_lanes(pair)
        inner(view.a, view.out)

    run(pair)
    return pair.out


A, B = np.array([1.5, -2.0, 0.0, 1e200]), np.array([0.5, 3.0, 2.0, 1e-9])


def test_lanes_compute_as_numpy_does():
    def kernel(v, out):
        a, b = v[0], v[1]
        out[0], out[1], out[2], out[3] = a + b, a - b, a * b, a / b
        out[4], out[5], out[6], out[7] = max(a, b), min(a, b), -a, math.sqrt(b)
        out[8], out[9], out[10], out[11] = (
            2.0 - a,
            3 * b,
            where(a > b, a, b),
            like(4.0, a),
        )
        a -= b
        a /= 2.0
        out[12] = a

    expected = [
        A + B,
        A - B,
        A * B,
        A / B,
        np.maximum(A, B),
        np.minimum(A, B),
        -A,
        np.sqrt(B),
    ]
    expected += [2 - A, 3 * B, np.maximum(A, B), np.full(4, 4.0), (A - B) / 2]
    np.testing.assert_array_equal(on_lanes(kernel, 13, A, B), expected)


def test_sums_maxima_and_mask_reductions_run_over_the_lanes():
    def kernel(v, out):
        out[0], out[1] = total(v[0]), largest(v[0])
        out[2] = 1.0 if any_lane(v[0] > 3.5) else 0.0
        out[3] = 1.0 if all_lanes(v[0] > 3.5) else 0.0
        out[4] = 1.0 if all_lanes(v[0] >= 1.0) else 0.0
        out[5] = 1.0 if any_lane(v[0] < 1.0) else 0.0

    found = on_lanes(kernel, 6, [4.0, 1.0, 3.0, 2.0])
    np.testing.assert_array_equal(found[:, 0], [10.0, 4.0, 1.0, 0.0, 1.0, 0.0])


def test_a_comparison_with_nan_is_false_in_its_lane():
    def kernel(v, out):
        one, none = like(1.0, v[0]), like(0.0, v[0])
        out[0], out[1] = where(v[0] < 1.0, one, none), where(v[0] >= 1.0, one, none)

    found = on_lanes(kernel, 2, [np.nan, 0.0, 1.0, np.inf])
    np.testing.assert_array_equal(found, [[0, 1, 0, 0], [0, 0, 1, 1]])


def test_small_and_large_angles_are_exact_in_the_same_lanes():
    """Series and library function side by side; both are exact to rounding."""

    def kernel(v, out):
        out[0], out[1] = c, s = cosine_sine(v[0])
        one, none = like(1.0, v[0]), like(0.0, v[0])
        fixed = ((one, none, none), (none, one, none), (none, none, one))
        psi, _ = rotation_vector(
            fixed, ((c, none, -s), (none, one, none), (s, none, c))
        )
        out[2], out[3], out[4] = psi

    angles = np.array([0.0, 1e-3, 0.4, -3.0])
    expected = [np.cos(angles), np.sin(angles), 0 * angles, angles, 0 * angles]
    # near 180 deg the cosine's rounding grows by the tangent of half the angle
    np.testing.assert_allclose(
        on_lanes(kernel, 5, angles), expected, rtol=1e-15, atol=1e-16
    )


def test_only_contiguous_arrays_of_numbers_have_lanes():
    with pytest.raises(TypingError, match="last axis of a contiguous array"):
        njit(lambda pair: in_lanes(pair).a[0])(
            Pair(np.zeros((4, 3)).T, np.zeros((3, 4)))
        )


def test_a_handle_cannot_be_copied():
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.deepcopy(Handle((1.0, np.zeros(3))))


def test_a_kernel_that_allocates_does_not_compile():
    with pytest.raises(NumbaError, match="NRT required"):
        compiled.kernel(lambda n: np.zeros(n).size)(3)

"""No check of a benchmark depends on the speed of the machine, but for the goals named as such."""

import pytest

from benchmarks import harness
from benchmarks.graph import benchmark as graph
from benchmarks.mpc import benchmark as mpc
from benchmarks.robot import benchmark as robot
from benchmarks.rod import release
from benchmarks.servo import benchmark as servo
from slot_core.mpc.settings import read_mpc


def rod_checks(slower):
    settings = {*release.GOALS, *(setting for _, setting, _ in release.RIVALS)}
    ours = [
        {
            "simulator": release.OURS, "physics": s.physics.name, "nodes": s.nodes, "h": s.h,
            "theta": 0.5, "iterations": s.iterations, "percent": 0.1,
            "cpu_s": 1e-4 * s.nodes * slower,
        }
        for s in settings
    ]  # fmt: skip
    peers = [{"simulator": p, "percent": 0.1, "cpu_s": 0.5 * slower} for p, *_ in release.RIVALS]
    return release.release_checks([*ours, *peers])


def robot_checks(slower):
    costs = [
        {"kind": "cost", "nodes": n, "us_per_step": n * slower, "real_time": 500 / n / slower,
         "over_rod": 2.3, "over_planar": 2.6}
        for n in robot.COMPARED
    ]  # fmt: skip
    level = {"kind": "level", "level": "standard", "error_mm": 0.2, "us_per_ms": 9.0 * slower}
    memory = [{"kind": "memory", "legs": legs, "MB": 200.0} for legs in ("planar", "spatial")]
    return robot.checks([*costs, level, *memory, {"kind": "flight", "momentum": 0.0}])


def mpc_checks(slower):
    settings = read_mpc("forces")
    errors = {"error_max": 0.0, "hard_error_max": 0.0, "hard_refused": 0, "hard_wrong": 0}
    tolerance = {"tolerance": settings.solver.tolerance_abs}
    rows = [
        {"kind": kind, "solver": solver, "stages": stages, "median_ms": ms * slower, "p99_ms": 9.0}
        | errors
        | tolerance
        for kind, solver, stages, ms in (
            ("solver", "clarabel", 15, 1.0),
            ("horizon", "clarabel", 15, 1.0),
            ("horizon", "clarabel", 60, 4.0),
            ("cvxpy", "cached", 15, 11.0),
            ("cvxpy", "published", 15, 400.0),
        )
    ]
    posture = {"kind": "posture", "median_ms": 1.2 * slower, "error_max_rad": 0.0}
    rows += [posture | {"limited": n, "refused": 0} for n in (0, 20)]
    return mpc.checks(rows, settings)


def servo_checks(slower):
    cycles = [{"rate_hz": rate / slower} for rate in (540.0, 460.0, 300.0)]
    return servo.checks(cycles, [{"crashes": 0, "corruption": 0, "motion": 0.0}])


def graph_checks(slower):
    rows = [
        {"kind": "walk", "repeat": 0, "duration_s": 15.0, "mean_v_x": 0.06, "tilt_max_rad": 0.2,
         "replay_differences": 0},
        {"kind": "walk", "nodes": graph.SEPARATE, "repeat": "median",
         "replay_cpu_s_per_s": 0.09 * slower},
        {"kind": "node", "nodes": graph.COMPOSED, "repeat": 0, "node": graph.ALL_NODES,
         "pss_mb": 500.0},
        {"kind": "node", "nodes": graph.COMPOSED, "repeat": 0, "node": graph.CONTROLLER,
         "pss_mb": 150.0},
        {"kind": "figure", "nodes": graph.FAST, "repeat": "median", "node": graph.CONTROLLER,
         "cpu_percent": 60.0 * slower},
        {"kind": "closed loop", "cpu_s_per_s": 0.08 * slower, "speed": 12.5 / slower},
        {"kind": "cycle", "cpu_ms": 1.2 * slower, "solve_cpu_ms": 0.8 * slower},
    ]  # fmt: skip
    for nodes, faster in ((graph.SEPARATE, 1.0), (graph.COMPOSED, 2.0)):
        which = {"kind": "figure", "nodes": nodes, "repeat": "median"}
        rows += [
            which | {"node": graph.ALL_NODES, "cpu_percent": 80.0 * slower / faster},
            *(which | {"node": n, "cpu_percent": 10.0 * slower} for n in graph.STAGES),
            which | {"node": graph.CONTROLLER, "cpu_percent": 20.0 * slower},
            which | {"stage": graph.END_TO_END, "p50_ms": 7.0 * slower / faster},
            {"kind": "lockstep", "nodes": nodes, "speed": 3.0 / slower * faster},
        ]
    return graph.checks(rows, graph.QUICK)


CHECKS = {
    "graph": graph_checks, "mpc": mpc_checks, "robot": robot_checks, "rod": rod_checks,
    "servo": servo_checks,
}  # fmt: skip


@pytest.mark.parametrize("name", CHECKS)
def test_a_machine_of_a_tenth_of_the_speed_gives_the_same_checks(name):
    here, there = CHECKS[name](1.0), CHECKS[name](10.0)
    assert all(check.holds for check in here)
    assert [check.name for check in there] == [check.name for check in here]
    assert [check.value for check in there] == pytest.approx([check.value for check in here])


def test_a_ratio_of_costs_is_that_of_calls_in_turn_on_a_machine_that_slows_down():
    state = {"time": 0.0, "pace": 1.0}

    def spend(seconds):
        state["time"] += seconds * state["pace"]
        state["pace"] *= 1.001

    def clock():
        return state["time"]

    ratio = harness.cpu_ratio(lambda: spend(6.0), lambda: spend(2.0), 51, clock=clock)
    assert ratio == pytest.approx(3.0, rel=0.01)
    assert state["pace"] > 1.1

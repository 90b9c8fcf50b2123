"""The study of perturbations: plants against other solutions, metrics, samples, their file."""

import importlib.util
import math

import numpy as np
import psutil
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from benchmarks.perturbations import cases, published, rigid_torso, samples
from slot_core.mpc.paper_problem import PaperProblem
from slot_core.mpc.settings import read_mpc, read_paper_mpc
from slot_core.robot import GRAVITY, read_robot
from slot_lab.workers import workers

ROBOT = read_robot()


def series(cost, height=0.04, tilt=0.0):
    time = np.arange(len(cost), dtype=float)
    still = np.ones(len(cost))
    return cases.PerturbedRun(time, np.array(cost), height * still, tilt * still, infeasible=2)


def test_a_cost_settles_after_its_last_rise_if_it_is_small_at_the_end():
    found = cases.metrics(series([4.0, 0.001, 0.5, 0.009, 0.001]))
    assert found["max_cost"] == 4.0
    assert found["mean_cost"] == pytest.approx(4.511 / 5)
    assert found["final_cost"] == 0.001
    assert found["settling_cost_s"] == 3.0
    assert found["infeasible"] == 2
    assert math.isnan(cases.metrics(series([0.0, 0.0, 0.02]))["settling_cost_s"])


@pytest.mark.parametrize(("height", "tilt"), [(0.0421, 0.0), (0.0379, 0.0), (0.04, 0.0101)])
def test_a_torso_off_its_height_or_tilted_has_not_settled(height, tilt):
    assert math.isnan(cases.metrics(series([0.0], height, tilt))["settling_s"])
    assert cases.metrics(series([0.0], 0.0419, 0.0099))["settling_s"] == 0.0


def published_run(change, duration=5.3, **others):
    """A run of the published problem; its peak is over after 5 s."""
    return published.run_published(ROBOT, read_paper_mpc("paper_code"), change, duration, **others)


@pytest.mark.parametrize("name", ["Baseline", "Combined"])
def test_the_published_problem_reaches_the_papers_maximum_costs(name):
    """0.5 % covers the accuracy of SCS, the authors' solver."""
    run = published_run(cases.CASES[name])
    assert run.cost.max() == pytest.approx(cases.TABLE[name][0], rel=5e-3)
    assert run.infeasible == 0


def test_the_perturbation_pitch_is_decided_by_the_raised_forces():
    """With them the maximum cost rises and falls with the angle, without them it does not move."""
    flat, small, paper = (published_run({1: angle}).cost.max() for angle in (0.0, 0.05, 0.1))
    assert small > 1.05 * flat
    assert small > 1.02 * paper
    calm = [published_run({1: angle}, raised=0.0).cost.max() for angle in (0.0, 0.1)]
    assert calm[1] == pytest.approx(calm[0], rel=1e-3)


def test_the_published_problem_costs_nothing_at_the_papers_reference():
    """At the initial state stated in the paper, the cost is that of the inputs alone."""
    problem = PaperProblem(ROBOT, read_paper_mpc("paper_code"))
    problem.set(published.reference(), published.reference(), 0, cases.DT)
    found = problem.solve()
    assert not found.fault
    # 15 x 4 x (5.3 N)^2 x 1e-8 = 1.7e-5, drag and turning beside it
    assert 0.0 <= problem.cost(found.z) < 1e-4


def twisted_state():
    """A state (12,) turned, moving and spinning about all axes."""
    return np.array([0.3, -0.2, 0.5, 0.0, 0.0, 0.2, 2.0, -3.0, 1.0, 0.1, 0.2, 0.3])


def test_the_torso_follows_an_independent_integration():
    """DOP853 on rotation matrices in odom's axes, with lagging forces and fixed feet.

    The error of the fourth-order method is about (4 ms x 4 rad/s)^5 per step; 1e-7 leaves a factor
    of ten.
    """
    body = rigid_torso.body(ROBOT, friction=5.0)
    start, command = np.full((4, 3), 1.0), np.tile([0.5, -0.3, 6.0], (4, 1)) + np.eye(4, 3)
    start[:, 2] = 5.0
    plant = rigid_torso.RigidTorso(body, twisted_state(), start)
    feet, span = plant.place_feet(0.0165), 0.033

    def slope(t, y):
        turn, p, v, spin = y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:18]
        inertia = turn @ body.inertia @ turn.T
        rate = np.linalg.solve(inertia, spin)
        force = command + (start - command) * math.exp(-t / body.lag)
        turning = np.cross(rate, turn, axisb=0, axisc=0)
        moment = np.cross(feet - p, force).sum(axis=0)
        fall = force.sum(axis=0) / body.mass - [0.0, 0.0, GRAVITY]
        return np.concatenate([turning.ravel(), v, fall, moment])

    state = twisted_state()
    turn = Rotation.from_euler("ZYX", state[2::-1]).as_matrix()
    spin = turn @ body.inertia @ turn.T @ state[6:9]
    begin = np.concatenate([turn.ravel(), state[3:6], state[9:12], spin])
    end = solve_ivp(slope, (0.0, span), begin, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    plant.advance(command, span)
    expected = Rotation.from_matrix(end[:9].reshape(3, 3)).as_euler("ZYX")[::-1]
    assert plant.state[:3] == pytest.approx(expected, abs=1e-7)
    assert plant.state[3:6] == pytest.approx(end[9:12], abs=1e-7)
    assert plant.state[9:12] == pytest.approx(end[12:15], abs=1e-7)


def test_a_torso_in_flight_keeps_energy_and_angular_momentum():
    """Without forces; the numerical loss over 1 s is 1e-7 of the values."""
    body = rigid_torso.body(ROBOT, friction=0.4)
    plant = rigid_torso.RigidTorso(body, twisted_state(), np.zeros((4, 3)))

    def conserved():
        parts = (rigid_torso.QUATERNION, rigid_torso.RATE, rigid_torso.VELOCITY)
        turn, rate, v = (plant.y[part] for part in parts)
        spin = body.inertia @ rate
        energy = (rate @ spin + body.mass * v @ v) / 2 + body.mass * GRAVITY * plant.y[2]
        return np.append(Rotation.from_quat(turn).apply(spin), energy)

    before = conserved()
    for _ in range(30):
        plant.advance(np.zeros((4, 3)), 0.033)
    assert conserved() == pytest.approx(before, rel=1e-6, abs=1e-8)


def test_ground_forces_stay_within_friction_and_do_not_pull():
    force = np.array([[3.0, -3.0, 5.0], [0.1, 0.2, 5.0], [1.0, 1.0, -2.0], [0.0, 0.0, 0.0]])
    expected = [[2.0, -2.0, 5.0], [0.1, 0.2, 5.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert rigid_torso.friction_limited(force, 0.4) == pytest.approx(np.array(expected))


@pytest.mark.parametrize(
    ("name", "limit"), [("Roll", 0.5), ("Pitch", 1.0), ("Height", 0.8), ("Combined", 1.0)]
)
def test_the_mpc_on_forces_settles_a_perturbed_torso_with_lag(name, limit):
    run = rigid_torso.run_torso(ROBOT, read_mpc("forces"), cases.CASES[name], duration=2.0)
    assert run.infeasible == 0
    assert cases.metrics(run)["settling_s"] < limit
    assert run.height.max() < 0.045  # overshoot below a sixth of the largest step


def test_a_sample_depends_only_on_its_seed_and_index():
    assert samples.draw("torso", 1, 0.0, 7) == samples.draw("torso", 1, 0.0, 7)
    assert samples.draw("torso", 1, 0.0, 7) != samples.draw("torso", 2, 0.0, 7)
    drawn = samples.draw("torso", 1, 0.0, 7)
    for name, (low, high) in samples.RANGES.items():
        assert low <= getattr(drawn, name) <= high


def test_every_exceeded_limit_is_listed():
    """Level for 4 s, then too low for 1 s; one sample with a tilt of 0.4 rad; never moving."""
    states = np.zeros((round(5.0 / 0.033), 12))
    states[:, 5] = 0.04
    states[-1, :2] = 0.4, 0.0
    states[-round(1.0 / 0.033) :, 5] = 0.015
    found = samples.measure(states, np.array([0.08, 0.0]))
    over = {name for name, value in found.items() if value > samples.LIMITS[name]}
    assert over == {"tilt_max", "sink_max", "height_error", "speed_error"}


def test_the_interval_of_a_rate_is_clopper_and_pearsons():
    """At its lower end 7 failures or more, at its upper end 7 or fewer, have probability 2.5 %."""
    low, high = samples.interval(7, 50)
    assert binom.sf(6, 50, low) == pytest.approx(0.025, abs=1e-9)
    assert binom.cdf(7, 50, high) == pytest.approx(0.025, abs=1e-9)
    assert samples.interval(0, 50)[0] == 0.0
    assert samples.interval(50, 50)[1] == 1.0


def result(index, failed=""):
    drawn = samples.draw("torso", 1, 0.0, index)
    return samples.asdict(drawn) | dict.fromkeys(samples.LIMITS, 0.0) | {"failed": failed}


@pytest.fixture
def record(tmp_path):
    """Opens one file of samples for a revision and the settings of a sample."""

    def opened(revision="abc", *settings):
        return samples.SampleRecord(
            tmp_path / "samples.csv", revision, samples.draw("torso", *(settings or (1, 0.0)), 0)
        )

    return opened


def test_recorded_samples_are_not_run_again(record):
    record().add(result(0))
    record().add(result(2, "tilt_max"))
    again = record()
    assert again.missing(4) == [1, 3]
    assert [row["failed"] for row in again.rows] == ["", "tilt_max"]
    assert again.rows[0]["push"] == samples.draw("torso", 1, 0.0, 0).push


@pytest.mark.parametrize("others", [("abd",), ("abc", 2, 0.0), ("abc", 1, 0.5)])
def test_samples_of_another_revision_or_seed_are_run_again(record, others):
    record().add(result(0))
    assert record(*others).missing(1) == [0]


def test_the_sample_of_an_incomplete_row_is_run_again(record, tmp_path):
    for index in (0, 1):
        record().add(result(index))
    path = tmp_path / "samples.csv"
    path.write_text(path.read_text()[:-5])
    again = record()
    assert again.missing(2) == [1]
    again.add(result(1))
    assert record().missing(2) == []


def test_the_summary_counts_failures_and_gives_their_parameters():
    rows = [result(k, "tilt_max+sink_max" if k < 2 else "") for k in range(5)]
    total, *limits = samples.summary(rows)
    assert (total["samples"], total["failed"], total["rate"]) == (5, 2, 0.4)
    counts = {row["limit"]: row["failed"] for row in limits}
    assert counts["tilt_max"] == counts["sink_max"] == 2
    assert counts["unsolved"] == 0
    pushes = sorted(row["push"] for row in rows[:2])
    assert limits[0]["push"][::2] == pytest.approx(pushes)


@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="scripts/setup --bench not run"
)
def test_two_local_workers_give_the_results_of_one_process(record):
    from benchmarks.perturbations import farm  # noqa: PLC0415

    with workers("", 2) as client:
        own = psutil.Process()
        sockets = [c for p in (own, *own.children(recursive=True)) for c in p.net_connections()]
        listening = {c.laddr.ip for c in sockets if c.status == psutil.CONN_LISTEN}
        assert listening == {"127.0.0.1"}
        rows = farm.run_samples(client, record(), samples.draw("torso", 1, 0.0, 0), 2, print)
    here = {index: samples.run_sample(samples.draw("torso", 1, 0.0, index)) for index in (0, 1)}
    for row in rows:
        assert row["tilt_max"] == here[row["index"]]["tilt_max"]
        assert row["failed"] == here[row["index"]]["failed"]

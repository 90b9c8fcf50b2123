"""Calibration: invalid data, recovery of known parameters, coverage of the intervals, files."""

import dataclasses

import numpy as np
import pytest
import yaml
from scipy import stats
from scipy.integrate import cumulative_trapezoid, quad

from slot_core import config
from slot_core.robot import read_robot
from slot_lab.calibration import experiments, fit
from slot_lab.calibration.calibrate import build_problem
from slot_lab.calibration.command import FREE, main
from slot_lab.calibration.data import COLUMNS, Data, Datum, read_data
from slot_lab.calibration.fit import FitProblem, Parameter, estimate
from slot_lab.calibration.parameter_file import fit_line
from slot_lab.csv_table import TableError
from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED

ROBOT = read_robot()
SETTINGS = experiments.read_settings()
SHIPPED = config.config_dir() / "parameters"
NAN = float("nan")
DEFLECTION = "deflection,0,1,,,1,0.05,0.001"


def datum(kind, value=0.0, sigma=1.0, **conditions):
    places = dict.fromkeys(
        ("theta_deg", "load_N", "height_m", "friction", "place"), NAN
    )
    return Datum(kind, **{**places, **conditions}, value=value, sigma=sigma, line=0)


def deflection(load, theta_deg=0.0, place=1.0, **more):
    return datum("deflection", theta_deg=theta_deg, load_N=load, place=place, **more)


def is_determined(estimate):
    return ~np.isnan(estimate.interval).any(axis=1)


def write(path, *rows):
    path.write_text("\n".join(["# a comment", "", ",".join(COLUMNS), *rows, ""]))
    return path


# --- data


def test_measurements_are_read_with_conditions_and_validity(tmp_path):
    rows = ["force_angle, 90,, 0.1, 0.3,, 2.5, 0.2", DEFLECTION]
    data = read_data(write(tmp_path / "leg.csv", *rows))
    force, deflection = data.rows
    assert force.conditions() == {"theta_deg": 90.0, "height_m": 0.1, "friction": 0.3}
    assert (force.value, force.sigma, force.line, deflection.line) == (2.5, 0.2, 4, 5)
    assert deflection.conditions() == {"theta_deg": 0.0, "load_N": 1.0, "place": 1.0}
    assert data.validity() == {
        "theta_deg": [0.0, 90.0],
        "load_N": [1.0, 1.0],
        "height_m": [0.1, 0.1],
        "friction": [0.3, 0.3],
    }


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (
            "torsion,0,1,,,1,0,1",
            "line 5, kind: 'torsion' is unknown (known: marker_range, ",
        ),
        ("deflection,x,1,,,1,0,1", "line 5, theta_deg: 'x' is not a finite number"),
        ("deflection,0,,,,1,0,1", "line 5, load_N: '' is not a finite number"),
        ("deflection,0,1,,,1,,1", "line 5, value: '' is not a finite number"),
        ("deflection,0,1,,,1,nan,1", "line 5, value: 'nan' is not a finite number"),
        ("deflection,0,1,,,1,0,0", "line 5, sigma: 0 is outside [1e-12, 1e+06]"),
        ("deflection,0,1,,,1.5,0,1", "line 5, place: 1.5 is outside [0, 1]"),
        (
            "deflection,0,1,0.1,,1,0,1",
            "line 5, height_m: '0.1', but deflection has none",
        ),
        ("deflection,0,1,,1,0,1", "line 5: 7 cells, 8 columns"),
    ],
)
def test_an_invalid_row_is_refused_by_line_column_and_reason(tmp_path, row, message):
    path = write(tmp_path / "leg.csv", DEFLECTION, row)
    with pytest.raises(TableError) as refusal:
        read_data(path)
    assert str(refusal.value).startswith(f"{path}, {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no line of column names"),
        (",".join(COLUMNS), "no measurements"),
        ("kind,value\n", "line 1: column theta_deg is missing"),
        (",".join([*COLUMNS, "colour"]), "line 1: column 'colour' is unknown"),
        (",".join([*COLUMNS, "place"]), "line 1: a column is repeated"),
    ],
)
def test_a_file_with_other_columns_or_no_rows_is_refused(tmp_path, text, message):
    (tmp_path / "leg.csv").write_text(text)
    with pytest.raises(TableError, match=message):
        read_data(tmp_path / "leg.csv")


# --- experiments


@pytest.mark.parametrize("place", [0.5, 1.0])
def test_a_small_deflection_matches_beam_theory(place):
    """Castigliano's theorem for the curved, tapered leg with bending and stretch."""
    stiff = config.replace(ROBOT, {"leg.young_modulus": 1e9, "leg.density": 1.0})
    leg, force, fine = stiff.leg, 0.05, dataclasses.replace(SETTINGS, nodes=201)
    slope, length = leg.shape.deriv(), leg.arc_length()
    x = np.linspace(0.0, leg.reach, 4000)
    share = cumulative_trapezoid(np.hypot(1.0, slope(x)), x, initial=0) / length
    at = np.interp(place, share, x)

    def density(z):
        ends = [leg.thickness_clamp, leg.thickness_tip]
        thickness = np.interp(np.interp(z, x, share), [0, 1], ends)
        ds = np.hypot(1.0, slope(z))
        area, sine = leg.width * thickness, slope(z) / ds
        bending = (leg.reach - z) * (at - z) / (area * thickness**2 / 12)
        return force / leg.young_modulus * (bending + sine**2 / area) * ds

    expected = quad(density, 0.0, at)[0]
    found = experiments.predict(stiff, [deflection(force, place=place)], fine)[0]
    # A deflection of 60 um of a leg of 190 mm: the nonlinearity is in the fourth digit.
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_prediction_is_independent_of_the_other_measurements():
    rows = [
        datum("force_angle", theta_deg=100.0, height_m=0.1, friction=0.3),
        deflection(1.0),
        datum("force_angle", theta_deg=80.0, height_m=0.1, friction=0.3),
        deflection(0.5),
        datum("force_angle", theta_deg=80.0, height_m=0.09, friction=0.3),
    ]
    together = experiments.predict(ROBOT, rows, SETTINGS)
    alone = [experiments.predict(ROBOT, [row], SETTINGS)[0] for row in rows]
    # A pull in two parts has other time steps.
    np.testing.assert_allclose(together, alone, rtol=1e-4)


def test_a_tendon_angle_above_the_robots_largest_is_refused():
    reason = r"theta_deg: 120 is above tendon\.angle_max_deg = 116\.28"
    with pytest.raises(TableError, match=reason):
        experiments.predict(ROBOT, [deflection(1.0, theta_deg=120.0)], SETTINGS)


# --- fit


def test_known_parameters_are_recovered_within_their_intervals():
    """Measurements of all kinds from legs of 31 nodes with noise, fitted with legs of 22."""
    truth = {
        "leg.young_modulus": 2.1e7,
        "tendon.offset": 0.0079,
        "tendon.cable_stiffness": 9e4,
        "tendon.slack": 0.0022,
    }
    lift = {"theta_deg": 116.0, "load_N": 6.0, "friction": 0.3}
    rows = [
        datum("marker_range", sigma=1e-3, place=p, **lift) for p in (0.0, 1 / 3, 2 / 3)
    ]
    rows += [
        datum("force_angle", sigma=0.03, theta_deg=t, height_m=0.08, friction=0.2)
        for t in (60.0, 70.0, 80.0, 90.0, 100.0, 110.0)
    ]
    rows += [
        deflection(w, t, sigma=2e-4) for t in (0.0, 90.0) for w in (0.2, 0.5, 1.0, 2.0)
    ]
    quick = dataclasses.replace(SETTINGS, pull_rate_deg=60.0)
    fine = dataclasses.replace(quick, nodes=31)
    exact = experiments.predict(config.replace(ROBOT, truth), rows, fine)
    noise = np.random.default_rng(3).standard_normal(len(rows))
    noisy = [v + row.sigma * e for row, v, e in zip(rows, exact, noise)]
    measured = tuple(dataclasses.replace(row, value=v) for row, v in zip(rows, noisy))
    problem = build_problem(ROBOT, FREE, Data("synthetic", "", measured), quick)
    found = estimate(problem, fit.fit(problem).values)
    true = np.array(list(truth.values()))
    assert is_determined(found).all()
    assert np.all(found.interval[:, 0] < true)
    assert np.all(true < found.interval[:, 1])
    # The intervals are narrow, and the sum of squares is that of the noise (chi-square, 99.8 %).
    assert found.interval[0] == pytest.approx(true[0], rel=0.1)
    assert found.interval[1] == pytest.approx(true[1], rel=0.2)
    low, high = stats.chi2.ppf([0.001, 0.999], found.freedom)
    assert low < found.chi_square < high


def beam_problem(rng):
    """Deflections w F / E + z of a straight cantilever: a logarithmic and a linear parameter."""
    load, per_modulus, sigma = np.linspace(0.2, 2.0, 8), 3e5, 5e-4
    parameters = (Parameter("E", 1e7, 1e5, 1e9), Parameter("z", 0.01, 0.0, 0.02))

    def predict(values):
        return per_modulus * load / values[0] + values[1]

    truth = np.array([2e7, 0.006])
    measured = predict(truth) + sigma * rng.standard_normal(len(load))
    return FitProblem(parameters, predict, measured, np.full(len(load), sigma)), truth


def test_intervals_contain_the_truth_with_their_probability():
    rng, inside = np.random.default_rng(1), []
    for _ in range(400):
        problem, truth = beam_problem(rng)
        interval = estimate(problem, fit.fit(problem).values).interval
        inside.append((interval[:, 0] < truth) & (truth < interval[:, 1]))
    # 400 trials at 95 %: three standard deviations are 3.3 %.
    assert np.mean(inside, axis=0) == pytest.approx(0.95, abs=0.033)


def test_intervals_and_correlation_of_a_linear_model_match_regression():
    rng = np.random.default_rng(2)
    x = np.linspace(0.0, 1.0, 12)
    y = 0.3 + 0.4 * x + 0.01 * rng.standard_normal(12)
    parameters = (Parameter("a", 0.5, 0.0, 1.0), Parameter("b", 0.5, 0.0, 2.0))
    problem = FitProblem(parameters, lambda v: v[0] + v[1] * x, y, np.full(12, 0.02))
    found, line = estimate(problem, fit.fit(problem).values), stats.linregress(x, y)
    half = stats.t.ppf(0.975, 10) * np.array([line.intercept_stderr, line.stderr])
    middle = np.array([line.intercept, line.slope])
    expected = np.column_stack([middle - half, middle + half])
    np.testing.assert_allclose(found.interval, expected, rtol=1e-5)
    # Closed form for a line: -mean(x) / sqrt(mean(x^2)).
    assert found.correlation[0, 1] == pytest.approx(
        -x.mean() / np.sqrt(np.mean(x**2)), abs=1e-5
    )


def test_parameters_without_effect_on_the_data_are_undetermined():
    """With a slack tendon, deflections determine the modulus and no parameter of the tendon."""
    robot = config.replace(ROBOT, {"leg.young_modulus": 2.5e7})
    rows = tuple(
        deflection(load, value=v, sigma=1e-3)
        for load, v in ((0.2, 0.0106), (1.0, 0.044))
    )
    problem = build_problem(robot, FREE, Data("", "", rows), SETTINGS)
    found = estimate(problem, [2.5e7, 8e-3, 1e5, 2e-3])
    assert is_determined(found).tolist() == [True, False, False, False]
    assert np.isnan(found.interval[1:]).all()
    assert np.isfinite(found.interval[0]).all()
    assert np.isinf(found.condition)
    assert np.isnan(found.correlation[0, 1:]).all()


def test_as_many_parameters_as_measurements_leave_no_interval():
    rows = (deflection(0.2, value=0.0106), deflection(1.0, 90.0, value=0.004))
    names = ("leg.young_modulus", "tendon.offset")
    found = estimate(
        build_problem(ROBOT, names, Data("", "", rows), SETTINGS), [2.6e7, 8.5e-3]
    )
    assert found.freedom == 0
    assert np.isnan(found.interval).all()


def test_two_parameters_with_the_same_effect_are_undetermined():
    rows = tuple(
        deflection(load, value=0.04 * load, sigma=1e-3) for load in (0.2, 0.5, 1.0, 2.0)
    )
    names = ("leg.young_modulus", "leg.width")
    light = config.replace(
        ROBOT, {"leg.density": 1.0}
    )  # the leg's weight would separate them
    found = estimate(
        build_problem(light, names, Data("", "", rows), SETTINGS), [2.6e7, 0.02]
    )
    assert not is_determined(found).any()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["leg.colour"], r"leg\.colour is not a number of the robot"),
        (["torso.size"], r"torso\.size is not a number of the robot"),
        (["leg.width", "leg.width"], "named twice"),
    ],
)
def test_a_parameter_that_cannot_be_fitted_is_refused(names, message):
    with pytest.raises(config.ConfigError, match=message):
        fit.parameters_of(ROBOT, names)


def test_a_failed_prediction_is_an_error_at_the_start_and_rejected_in_a_trial():
    def predict(values):
        if values[0] > 0.5:
            raise experiments.PredictionError("too much")
        return np.array([values[0], 2 * values[0]])

    def problem(start):
        free = (Parameter("a", start, 0.0, 1.0),)
        return FitProblem(free, predict, np.array([0.45, 0.9]), np.ones(2))

    found = fit.fit(problem(0.1))
    assert found.converged
    assert found.values == pytest.approx([0.45], abs=1e-6)
    with pytest.raises(fit.FitError, match="no prediction at the start: too much"):
        fit.fit(problem(0.6))


def test_a_fit_that_runs_out_of_trials_reports_it_and_keeps_its_best_point(monkeypatch):
    monkeypatch.setattr(fit, "TRIALS", 2)
    problem, lines = beam_problem(np.random.default_rng(1))[0], []
    found = fit.fit(problem, say=lines.append)
    start = problem.residuals(problem.coordinates([1e7, 0.01]))
    assert not found.converged
    assert found.chi_square < start @ start
    assert lines[0].endswith("stopped after 2 trials")
    assert lines[1].startswith("not well: the best start was stopped")


@pytest.mark.parametrize(
    ("converged", "verdict"),
    [
        ([True, False], ["well: the best start converged"]),
        ([False, True], ["not well: the best start was stopped"]),
        ([True, True], []),
    ],
)
def test_a_fit_says_whether_a_start_that_was_stopped_matters(
    monkeypatch, converged, verdict
):
    """The first start is the better one."""
    results = [
        fit.FitResult(np.ones(2), 1.0 + k, end) for k, end in enumerate(converged)
    ]
    monkeypatch.setattr(fit, "_fit_from", lambda *_: results.pop(0))
    lines = []
    fit.fit(beam_problem(np.random.default_rng(1))[0], starts=2, say=lines.append)
    assert len(lines) == 2 + len(verdict)
    assert all(line.startswith(start) for line, start in zip(lines[2:], verdict))


# --- line


def test_line_matches_linear_regression():
    rng = np.random.default_rng(5)
    theta = np.linspace(60.0, 116.0, 9)
    force = 0.107 * theta - 6.91 + 0.2 * rng.standard_normal(9)
    line, expected = (
        fit_line(theta, force, np.full(9, 0.2)),
        stats.linregress(theta, force),
    )
    factor = stats.t.ppf(0.975, 7)
    assert (line.b, -line.a) == pytest.approx(
        (expected.slope, expected.intercept), rel=1e-9
    )
    assert line.b_half_width == pytest.approx(factor * expected.stderr, rel=1e-9)
    assert line.a_half_width == pytest.approx(
        factor * expected.intercept_stderr, rel=1e-9
    )
    assert line.residuals == pytest.approx(
        expected.slope * theta + expected.intercept - force
    )


def test_a_line_weights_its_samples():
    # A sample with half the sigma has the weight of four.
    theta, force = np.array([60.0, 80.0, 110.0]), np.array([0.1, 1.0, 5.0])
    line = fit_line(theta, force, np.array([1.0, 0.5, 1.0]))
    expected = stats.linregress(
        np.repeat(theta, [1, 4, 1]), np.repeat(force, [1, 4, 1])
    )
    assert (line.b, -line.a) == pytest.approx(
        (expected.slope, expected.intercept), rel=1e-9
    )


def test_two_samples_give_a_line_without_an_interval():
    line = fit_line(np.array([60.0, 110.0]), np.array([0.0, 5.0]), np.ones(2))
    assert (line.a, line.b) == pytest.approx((6.0, 0.1))
    assert np.isnan([line.a_half_width, line.b_half_width]).all()


# --- files and command


@pytest.mark.parametrize("name", ["paper", "calibrated"])
def test_a_shipped_set_matches_its_evaluation(name, tmp_path, capsys):
    shipped = yaml.safe_load((SHIPPED / f"{name}.yaml").read_text())
    out, data = tmp_path / "again.yaml", SHIPPED / shipped["data"]["file"]
    # Four parameters for six figures: chi-square 373 and 14 on two degrees of freedom.
    assert (
        main([str(data), "--start", name, "--evaluate", "--out", str(out)])
        == NOT_EXPLAINED
    )
    assert (
        "verdict: not explained: chi-square" in capsys.readouterr().out.splitlines()[-1]
    )
    again = yaml.safe_load(out.read_text())
    for key in ("values", "data", "validity", "from"):
        assert again[key] == shipped[key]
    for old, new in zip(shipped["residuals"], again["residuals"], strict=True):
        # Rounding differs between processors; with sliding friction the difference does not grow.
        assert new["predicted"] == pytest.approx(
            old["predicted"], abs=0.02 * old["sigma"]
        )
    assert set(again["confidence"]) == set(shipped["values"])


def test_the_command_fits_and_writes_file_and_figure(tmp_path, capsys):
    rows = [
        "deflection,0,0.2,,,1,0.0106,0.001",
        "deflection,0,1,,,1,0.044,0.001",
        "deflection,0,1,,,0.5,0.0092,0.001",
    ]
    path = write(tmp_path / "leg.csv", *rows)
    out, png = tmp_path / "deep" / "own.yaml", tmp_path / "deep" / "own.png"
    code = main(
        [
            str(path),
            "--free",
            "leg.young_modulus",
            "tendon.slack",
            "--out",
            str(out),
            "--plot",
            str(png),
            "--note",
            "by hand",
        ]
    )
    printed = capsys.readouterr()
    assert code == EXPLAINED
    assert printed.out.splitlines()[-1].startswith("verdict: explained: chi-square")
    assert "sum of squares" in printed.err
    content = yaml.safe_load(out.read_text())
    assert content["note"] == "by hand"
    assert set(content["values"]) == set(FREE)
    assert content["confidence"]["tendon.slack"] == "undetermined"
    low, high = content["confidence"]["leg.young_modulus"]
    assert low < content["values"]["leg.young_modulus"] < high
    for name in ("leg.young_modulus", "tendon.slack"):
        assert any(line.startswith(name) for line in printed.out.splitlines())
    assert png.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("low", "high"), [(1e3, 1e8), (1e-3, 0.05), (-0.003, 0.007)])
def test_a_fit_that_ends_at_a_bound_stays_within_it(low, high):
    """exp(log(1000)) is below 1000, and the settings refuse what is outside."""

    def predict(values):
        assert low <= values[0] <= high
        return values * np.ones(3)

    start = (Parameter("p", 0.5 * (low + high), low, high),)
    for beyond, bound in ((low - 1.0, low), (high + 1.0, high)):
        problem = FitProblem(start, predict, np.full(3, beyond), np.ones(3))
        found = fit.fit(problem)
        assert found.values[0] == pytest.approx(bound, rel=1e-3)
        assert low <= found.values[0] <= high
        assert estimate(problem, found.values).at_limit.all()

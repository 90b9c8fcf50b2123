"""The paper's metrics, and their intervals."""

import numpy as np
import pytest

from slot_lab.validation.comparison import errors

T = np.arange(3000) / 100.0


def test_metrics_of_an_offset_and_an_oscillation_are_those_of_the_closed_forms():
    measured = 0.05 * np.sin(2 * np.pi * T)
    value = errors(measured + 0.004 + 0.003 * np.sin(np.pi * T), measured, 100).value
    assert value["rmse"] == pytest.approx(np.hypot(0.004, 0.003 / np.sqrt(2)))
    assert value["mean_error"] == pytest.approx(0.004)
    assert value["nrmse"] == pytest.approx(value["rmse"] / 0.1)
    assert value["error"] == pytest.approx(0.04)
    assert value["accuracy"] == pytest.approx(0.96)


@pytest.mark.parametrize(
    ("rmse", "nrmse", "mean", "error", "accuracy"),
    [
        (5.20, 5.87, 2.23, 2.51, 97.49),
        (5.72, 6.94, 2.87, 3.47, 96.53),
        (4.00, 7.88, 2.32, 4.56, 95.44),
    ],
)
def test_the_papers_table_of_the_single_leg_follows(rmse, nrmse, mean, error, accuracy):
    span = rmse / nrmse * 100
    swing = np.sqrt(2 * (rmse**2 - mean**2))
    measured = span * np.linspace(0.0, 1.0, len(T))
    value = errors(measured + mean + swing * np.sin(2 * np.pi * T), measured, 100).value
    assert value["rmse"] == pytest.approx(rmse, rel=1e-3)
    assert 100 * value["error"] == pytest.approx(error, abs=0.015)  # the table's digits
    assert 100 * value["accuracy"] == pytest.approx(accuracy, abs=0.015)


def test_an_interval_contains_the_truth_in_most_series_and_widens_with_correlation():
    rng, hits, widths = np.random.default_rng(0), 0, []
    for smooth in (1, 20):
        for _ in range(30):
            noise = np.convolve(
                rng.normal(size=900), np.ones(smooth), "valid"
            ) / np.sqrt(smooth)
            low, high = errors(noise, np.zeros(len(noise)), 60).interval["rmse"]
            hits += low <= 1.0 <= high
            widths.append(high - low)
    assert hits >= 48  # of 60; 57 are expected, and blocks of finite length give fewer
    assert np.mean(widths[30:]) > 1.5 * np.mean(widths[:30])


def test_few_blocks_have_no_interval_and_no_range_no_relative_error():
    assert np.isnan(errors(np.ones(50), np.zeros(50), 20).interval["rmse"]).all()
    assert np.isnan(errors(np.ones(50), np.zeros(50), 5).value["accuracy"])


def test_the_interval_of_a_mean_error_near_zero_begins_at_zero():
    noise = np.random.default_rng(0).normal(size=900)
    measured = np.linspace(0.0, 100.0, 900)
    found = errors(measured + noise - noise.mean() + 0.001, measured, 30)
    low, high = found.interval["mean_error"]
    assert low == 0.0
    assert high > found.value["mean_error"]
    assert found.interval["accuracy"][1] == 1.0

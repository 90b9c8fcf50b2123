"""The paper's metrics with their intervals, and the verdict of a comparison."""

import math

import numpy as np
import pytest

from slot_lab.validation.comparison import errors
from slot_lab.verdict import EXPLAINED, NOT_EXPLAINED, Verdict

T = np.arange(3000) / 100.0


def test_metrics_of_an_offset_and_an_oscillation_are_those_of_the_closed_forms():
    measured = 0.05 * np.sin(2 * np.pi * T)
    value = errors(
        measured + 0.004 + 0.003 * np.sin(np.pi * T), measured, 100
    ).value
    assert value["rmse"] == pytest.approx(np.hypot(0.004, 0.003 / np.sqrt(2)))
    assert value["mean_error"] == pytest.approx(0.004)
    assert value["nrmse"] == pytest.approx(value["rmse"] / 0.1)
    assert value["error"] == pytest.approx(0.04)
    assert value["accuracy"] == pytest.approx(0.96)


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
    # of 60; 57 are expected, and blocks of finite length give fewer
    assert hits >= 48
    assert np.mean(widths[30:]) > 1.5 * np.mean(widths[:30])


def test_few_blocks_have_no_interval_and_no_range_no_relative_error():
    assert np.isnan(
        errors(np.ones(50), np.zeros(50), 20).interval["rmse"]
    ).all()
    assert np.isnan(errors(np.ones(50), np.zeros(50), 5).value["accuracy"])


def test_the_interval_of_a_mean_error_near_zero_begins_at_zero():
    noise = np.random.default_rng(0).normal(size=900)
    measured = np.linspace(0.0, 100.0, 900)
    found = errors(
        measured + noise - noise.mean() + 0.001, measured, 30
    ).interval
    assert found["mean_error"][0] == 0.0
    assert found["accuracy"][1] == 1.0


@pytest.mark.parametrize(
    ("given", "code", "said"),
    [
        (
            Verdict(30.0, 20),
            EXPLAINED,
            "explained: chi-square 30 on 20 degrees of",
        ),
        # no chance
        (
            Verdict(2100.0, 1000),
            NOT_EXPLAINED,
            "2.1 each, limit 2",
        ),
        (Verdict(9.0, 2), EXPLAINED, "4.5 each, limit 4.61"),  # 1 % by chance
        (Verdict(math.nan, 10), NOT_EXPLAINED, "nan"),
        (
            Verdict(1.0, 10, ["friction"]),
            NOT_EXPLAINED,
            "at its bound: friction",
        ),
        (Verdict(0.0, 0), NOT_EXPLAINED, "no more data than free parameters"),
    ],
)
def test_a_verdict_is_by_the_residuals_per_degree_of_freedom_and_the_bounds(
    given, code, said
):
    assert given.code == code
    assert said in given.line

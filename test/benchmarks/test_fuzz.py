"""The fuzz finds nothing in a few inputs of each part, and it counts what it has to find."""

import os

import numpy as np
import pytest

from benchmarks.fuzz import benchmark, hostile_files, outcomes
from benchmarks.fuzz.outcomes import Outcomes
from slot_core.refusal import InputError

FEW = {"files": 60, "commands": 55, "bags": 3, "packets": 200}  # calls: test_wrong_arrays.py


@pytest.mark.parametrize("part", FEW)
def test_hostile_input_is_refused_in_one_line(part):
    found = benchmark.tally_of(part, FEW[part])
    assert found.faults == 0, found
    assert found.tried >= FEW[part]
    assert found.refused > 0.1 * found.tried


def _raise(error):
    raise error


def _spin():
    while True:
        pass


@pytest.mark.parametrize(
    ("kind", "call"),
    [
        ("refused", lambda: _raise(InputError("too \x1b[2J long" * 100))),
        ("exceptions", lambda: _raise(KeyError("key"))),
        ("exceptions", lambda: _raise(ValueError("not the project's own"))),
        ("accepted", lambda: None),
        ("hangs", _spin),
    ],
)
def test_the_outcome_of_a_call_is_counted(monkeypatch, kind, call):
    monkeypatch.setattr(outcomes, "HANG", 0.05)
    tally = Outcomes()
    tally.call("call", call, wrong=True)
    assert (tally.tried, getattr(tally, kind)) == (1, 1)
    assert tally.faults == (kind != "refused")


@pytest.mark.parametrize(
    ("kind", "text", "code"),
    [
        ("refused", "scripts/x: no", 2),
        ("accepted", "scripts/x: no", 0),
        ("unprintable", "two\nlines", 2),
        ("unprintable", "\x1b[2J", 2),
        ("long", "x" * 301, 2),
    ],
)
def test_the_outcome_of_a_command_line_is_counted(kind, text, code):
    def main(words):
        print(text)
        raise SystemExit(code)

    tally = Outcomes()
    tally.command("x", main, ["--no"])
    assert (tally.tried, getattr(tally, kind)) == (1, 1)


def test_the_fuzz_detects_a_reader_without_checks(monkeypatch):
    """Without the check of bounds wrong values are used, and a mutated file raises what it may."""
    monkeypatch.setattr("slot_core.config._convert_scalar", lambda value, *_: value)
    monkeypatch.setattr("slot_core.yaml_text._require_plain", lambda text: None)
    found = hostile_files.fuzz(40, np.random.default_rng(1))
    assert found.accepted > 0


def _ended(part, count):
    os._exit(1)


def test_a_part_that_ends_its_process_is_counted(monkeypatch):
    monkeypatch.setattr(benchmark, "tally_of", _ended)
    found = benchmark.apart("files", 1)
    assert (found.exceptions, found.example) == (1, "the process ended")

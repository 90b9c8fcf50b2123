"""The Dynamic Constraint Map of synthetic bags, and of one with older messages."""

import numpy as np
import pytest
from synthetic_walk import WALL, message, write_messages, write_old

from slot_lab.bags.bag import Bag
from slot_lab.bags.topics import PLANS
from slot_lab.report import constraint_map
from slot_lab.report.map_command import main


def write_cycles(path, cycles):
    """A bag of cycles given by their fields, 30 a second."""
    plans = [
        message(PLANS, 10.0 + k / 30, **each) for k, each in enumerate(cycles)
    ]
    return write_messages(
        path, [(WALL + k, PLANS, p) for k, p in enumerate(plans)]
    )


def cycle(friction=1.0, status=0, balance=np.inf):
    return {
        "slack_normal_min": np.full(4, 5.0),
        "slack_normal_max": np.full(4, 7.0),
        "slack_friction": np.array([1.0, 1.0, friction, 1.0]),
        "slack_angle": np.full(4, 0.5),
        "slack_rate": np.full(4, 40.0),
        "slack_total": 28.0,
        "slack_balance": balance,
        "status": status,
    }


@pytest.fixture
def slipping(tmp_path):
    """Sixty cycles; the rear left leg slips in three of them, of which two are not solved."""
    cycles = [cycle() for _ in range(60)]
    cycles[20] = cycle(friction=-0.25)
    cycles[21] = cycle(friction=-0.9e-4, status=1)
    cycles[22] = cycle(friction=-0.125, status=4)
    return write_cycles(tmp_path / "slipping", cycles)


def test_every_constraint_has_a_row_of_slack(slipping):
    found = constraint_map.read_map(Bag(slipping))
    assert len(found.constraints) == 4 * 5 + 2
    slack = dict(zip(found.constraints, found.slack))
    assert slack["RL friction"][20:23] == pytest.approx(
        [-0.25, -0.9e-4, -0.125]
    )
    assert slack["FR largest normal"] == pytest.approx(np.full(60, 7.0))
    assert slack["total support"] == pytest.approx(np.full(60, 28.0))
    # A violation is slack below the solver's tolerance, 1e-4.
    assert found.violated.sum(axis=0)[20:23].tolist() == [1, 0, 1]


def test_a_single_violated_cycle_shows_in_a_long_walk(tmp_path, monkeypatch):
    """Cycles that share a column of the plot show the least slack among them."""
    monkeypatch.setattr(constraint_map, "CAPACITY", 10)
    cycles = [cycle(friction=-0.5 if k == 33 else 1.0) for k in range(95)]
    found = constraint_map.read_map(
        Bag(write_cycles(tmp_path / "long", cycles))
    )
    shown = constraint_map.map_figure(found).axes[0].collections[0].get_array()
    assert shown.shape == (21, 10)
    assert (shown < 0).sum() == 1


def test_fields_missing_from_older_messages_are_listed_and_left_out(tmp_path):
    plan = message(PLANS, 1.0, **cycle())
    found = constraint_map.read_map(
        Bag(write_old(tmp_path / "older", PLANS, plan, "slack_balance"))
    )
    assert "slack_balance" in found.missing
    assert not any("balance" in name for name in found.constraints)


def test_the_command_draws_a_bag_and_its_exit_code_reports_violations(
    tmp_path, slipping, capsys
):
    clean = write_cycles(
        tmp_path / "clean", [cycle(status=int(k == 5)) for k in range(30)]
    )
    assert main([str(clean), "--out", str(tmp_path / "map.png")]) == 0
    assert "NOT_SOLVED 1" in capsys.readouterr().out
    assert (tmp_path / "map.png").exists()
    assert main([str(slipping)]) == 1
    assert (tmp_path / "slipping_constraints.png").exists()
    assert "-0.2500 N" in capsys.readouterr().out
    assert main([str(tmp_path / "nothing")]) == 2

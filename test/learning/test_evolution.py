"""The evolution strategy learns; its networks are those that ONNX runs."""

from types import SimpleNamespace

import numpy as np
import pytest

from slot_core.gait.gait import LEFT_RIGHT

pytest.importorskip("gymnasium", reason="needs scripts/setup --learn")
from slot_lab.learning import task as spaces
from slot_lab.learning.evolution import (
    Evolution,
    Walks,
    learn,
    returns,
    shape_of,
    spread,
)
from slot_lab.learning.task import make_task, mirror_of

TASK = make_task(
    duration=0.4, servos=False, drawn={"scene.floor.friction": (0.2, 0.6)}
)
SMALL = Evolution(
    150, pairs=8, sigma=(0.06, 0.01), rate=(0.04, 0.002), test_every=1
)


def test_it_climbs_a_hill_from_its_antithetic_pairs():
    count = shape_of(TASK).size
    goal = np.random.default_rng(5).standard_normal(count)

    def hill(walks):
        return -((walks.parameters - goal) ** 2).mean(axis=1)

    found = list(learn(TASK, SMALL, hill))
    assert found[-1].test > 0.2 * found[0].test  # both negative
    assert found[-1].test <= -((found[-1].best - goal) ** 2).mean() + 1e-12
    assert found[-1].steps == 150 * 16 * 12


def test_parts_on_workers_return_what_one_process_does():
    client = SimpleNamespace(  # of dask.distributed, in this process
        map=lambda call, items, pure: [call(item) for item in items],
        gather=list,
    )
    parameters = np.random.default_rng(1).standard_normal(
        (5, shape_of(TASK).size)
    )
    walks = Walks(TASK, SMALL, parameters, np.arange(5))
    assert spread(client, 2)(walks) == pytest.approx(returns(walks), abs=1e-12)


def test_the_gait_half_a_stride_later_is_its_mirror_image():
    phase, velocity = np.linspace(0.0, 0.4, 5), np.array([0.05, 0.01, 0.02])
    now = TASK.stride.stride_table(phase, velocity)
    mirrored = spaces.MIRRORED_VELOCITY * velocity
    later = TASK.stride.stride_table(phase + 0.5, mirrored)
    assert later[:, LEFT_RIGHT] == pytest.approx(now[:, :4], abs=1e-9)
    assert later[:, 8:] == pytest.approx(
        spaces.MIRRORED_STATE * now[:, 8:], abs=1e-9
    )


@pytest.mark.parametrize("actions", ["amplitudes", "tendons"])
@pytest.mark.parametrize("servos", [False, True])
def test_a_network_acts_on_the_mirror_image_by_the_mirror_image(
    actions, servos
):
    task, rng = (
        make_task(actions=actions, servos=servos),
        np.random.default_rng(4),
    )
    shape, mirror = shape_of(task), mirror_of(task)
    parameters, seen = (
        rng.standard_normal((5, shape.size)),
        rng.standard_normal((5, task.observed)),
    )
    action = shape.actions(parameters, seen)
    assert np.abs(action - action @ mirror.action).max() > 0.1
    there = shape.actions(parameters, seen @ mirror.seen)
    assert there == pytest.approx(action @ mirror.action, abs=1e-12)

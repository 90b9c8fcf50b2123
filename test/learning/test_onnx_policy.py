"""A learned network as a policy: what it plans, what is refused, the graph that walks with it."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from recorded_run import record

from slot_core.config import ConfigError
from slot_core.control.onnx_policy import GAIT, KIND
from slot_core.control.policy import make_policy, policy_class
from slot_core.control.walk_actions import ANGLE_MAX
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop

for module in ("gymnasium", "onnxruntime"):
    pytest.importorskip(module, reason="needs scripts/setup --learn")
onnx = pytest.importorskip("onnx", reason="needs scripts/setup --learn")
from slot_lab.bags.bag import Bag  # noqa: E402
from slot_lab.bags.check_bag import check_bag  # noqa: E402
from slot_lab.learning.evolution import shape_of  # noqa: E402
from slot_lab.learning.learned_walk import export  # noqa: E402
from slot_lab.learning.network import NetworkShape, write_onnx  # noqa: E402
from slot_lab.learning.task import make_task  # noqa: E402

WALK = {GAIT: "walk", KIND: "amplitudes"}
SHAPE = NetworkShape(20, 3)


def network(folder, shape=SHAPE, about=None, scale=0.3):
    """File of a random network, and its parameters."""
    parameters = scale * np.random.default_rng(3).standard_normal(shape.size)
    write_onnx(
        folder / "net.onnx", shape, parameters, WALK if about is None else about
    )
    return folder / "net.onnx", parameters


@pytest.fixture(scope="module")
def tick():
    """A tick in the middle of a stride."""
    loop = ClosedLoop(
        "flat", "walk", np.array([0.05, 0.0, 0.0]), 1, "gait_alone"
    )
    return list(loop.run(60))[-1]


def test_it_acts_as_the_network_that_was_learned(tmp_path):
    file, parameters = network(tmp_path)
    policy = make_policy(f"onnx:{file}", read_robot())
    for seen in np.random.default_rng(1).standard_normal((5, 1, 20)):
        expected = SHAPE.actions(parameters[None], seen)
        assert policy.act(seen) == pytest.approx(expected, abs=1e-6)


def test_tendon_actions_are_added_to_the_angles_of_every_stage(tmp_path, tick):
    file, _ = network(
        tmp_path, NetworkShape(21, 4), {GAIT: "walk", KIND: "tendons"}
    )
    policy = make_policy(f"onnx:{file}", read_robot())
    change = (
        policy.step(tick.estimate, tick.preview).angle
        - tick.preview.tendon_angle
    )
    assert np.ptp(change, axis=0) == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < np.abs(change).max() <= ANGLE_MAX


@pytest.mark.parametrize("changes", [{"gait": "stand"}, {"corrected": False}])
def test_outside_its_gait_and_while_servos_do_not_follow_it_plans_the_gait(
    tmp_path, tick, changes
):
    policy = make_policy(f"onnx:{network(tmp_path)[0]}", read_robot())
    preview = replace(tick.preview, **changes)
    assert (
        policy.step(tick.estimate, preview).angle == preview.tendon_angle
    ).all()


def test_an_estimate_or_action_that_is_not_finite_gets_the_gait(tmp_path, tick):
    policy = make_policy(f"onnx:{network(tmp_path)[0]}", read_robot())
    lost = replace(tick.estimate, state=np.full(12, np.nan))
    plans = [policy.step(e, tick.preview) for e in (lost, lost, tick.estimate)]
    assert [(p.status.name, p.fallback_cycles) for p in plans] == [
        ("REJECTED", 1),
        ("REJECTED", 2),
        ("SOLVED", 0),
    ]
    assert plans[0].message.startswith("state[0] = nan: outside")
    assert (plans[1].angle == tick.preview.tendon_angle).all()
    assert (plans[2].angle != tick.preview.tendon_angle).any()
    odd = make_policy(
        f"onnx:{network(tmp_path, scale=np.nan)[0]}", read_robot()
    )
    plan = odd.step(tick.estimate, tick.preview)
    assert (plan.status.name, plan.message) == (
        "NOT_SOLVED",
        "action not finite",
    )
    assert (plan.angle == tick.preview.tendon_angle).all()


def refusal_of(file):
    """The line that refuses a network's file."""
    with pytest.raises(ConfigError) as refused:
        policy_class(f"onnx:{file}").read_settings(f"onnx:{file}")
    (line,) = str(refused.value).splitlines()
    return line


@pytest.mark.parametrize(
    ("shape", "about", "named"),
    [
        (SHAPE, {}, "gait '' and actions ''"),
        (SHAPE, WALK | {GAIT: "stand"}, "gait 'stand'"),
        (SHAPE, WALK | {KIND: "legs"}, "actions 'legs'"),
        (NetworkShape(24, 3), WALK, "maps 24 values to 3, expected 20 to 3"),
        (NetworkShape(20, 4), WALK, "maps 20 values to 4, expected 20 to 3"),
    ],
)
def test_a_network_for_something_else_is_refused_in_one_line(
    tmp_path, shape, about, named
):
    file, _ = network(tmp_path, shape, about)
    assert re.search(named, refusal_of(file))


def test_a_file_that_is_no_network_of_one_robot_is_refused_in_one_line(
    tmp_path, monkeypatch
):
    file, _ = network(tmp_path)
    model = onnx.load(file)
    for port in (model.graph.input[0], model.graph.output[0]):
        port.type.tensor_type.shape.dim[0].dim_value = 5
    for content in (
        model.SerializeToString(),
        b"",
        b"no network",
        b"\x08" * 5000,
    ):
        file.write_bytes(content)
        assert "net.onnx" in refusal_of(file)
    file.unlink()
    assert "net.onnx" in refusal_of(file)
    file, _ = network(tmp_path)
    for library in ("onnxruntime", "onnx"):
        monkeypatch.setitem(sys.modules, library, None)
        said = f"{library} is missing; run scripts/setup --learn"
        assert refusal_of(file).endswith(said)


def changed(file, *nodes, **constants):
    """Add nodes and truth values to the network in a file."""
    model = onnx.load(file)
    model.graph.node.extend(nodes)
    model.graph.initializer.extend(
        onnx.numpy_helper.from_array(np.array(value), name)
        for name, value in constants.items()
    )
    onnx.save(model, file)


NOISE = onnx.helper.make_node("RandomNormalLike", ["sum"], ["noise"])
DROPOUT = onnx.helper.make_node("Dropout", ["sum", "", "training"], ["kept"])


def test_a_network_that_draws_at_random_is_refused_by_the_name_of_its_node(
    tmp_path,
):
    file, _ = network(tmp_path)
    changed(file, DROPOUT, training=False)
    policy_class(f"onnx:{file}").read_settings(f"onnx:{file}")
    file, _ = network(tmp_path)
    changed(file, DROPOUT, training=True)
    assert "Dropout in training mode draws at random" in refusal_of(file)
    file, _ = network(tmp_path)
    inside = onnx.helper.make_graph([NOISE], "branch", [], [])
    changed(file, onnx.helper.make_node("If", ["wet"], [], then_branch=inside))
    assert "RandomNormalLike draws at random" in refusal_of(file)


def test_a_policy_that_sees_the_servos_is_not_exported(tmp_path):
    task = make_task(servos=True)
    shape = shape_of(task)
    with pytest.raises(ValueError, match="not given the servos' angles"):
        export(tmp_path / "net.onnx", task, shape, np.zeros(shape.size))
    assert not (tmp_path / "net.onnx").exists()


def test_the_graph_walks_with_a_network_and_its_bag_replays(tmp_path):
    """With its weights in a file of their own, as torch exports them; from the bag alone."""
    file, _ = network(tmp_path)
    inside, data = file.read_bytes(), tmp_path / "net.onnx.data"
    onnx.save(
        onnx.load(file),
        file,
        save_as_external_data=True,
        location=data.name,
        size_threshold=0,
    )
    policy = f"onnx:{file}"
    options = (
        "--lockstep",
        "--composed",
        "--policy",
        policy,
        "--duration",
        "4",
    )
    recorded = Bag(record(tmp_path / "bag", *options))
    data.unlink()
    assert "weights are in net.onnx.data beside it: File" in refusal_of(file)
    file.write_bytes(recorded.origin.files["policy.onnx"])
    assert len(inside) <= file.stat().st_size < len(inside) + 200
    file.unlink()
    compared = {c.topic: c for c in check_bag(recorded, 0.0)}
    assert compared["/tendon_plan"].compared > 100
    assert [c.largest for c in compared.values()] == [0.0] * 4

"""Network of a policy: one hidden layer with tanh, actions by tanh; many of them at once, and ONNX.

The parameters of a network are one vector: weights (n, hidden) and biases of the hidden layer, then
weights (hidden, k) and biases of the actions. With f(s) before the last tanh, and the mirror images
M of observations and N of actions, a symmetric network acts by

    tanh((f(s) + N f(M s)) / 2),

which is a network with a second hidden half, the mirror image of the first: N a(s) = a(M s).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slot_core.arrays import checked
from slot_core.robot import Array

OPSET, IR_VERSION = 17, 8  # of ONNX: from onnxruntime 1.14 on


class Mirror(NamedTuple):
    """Mirror images of observations and of actions, as symmetric matrices."""

    seen: Array  # (n, n)
    action: Array  # (k, k)


class NetworkShape(NamedTuple):
    """Numbers of inputs, of neurons in the hidden layer, and of outputs."""

    inputs: int
    hidden: int  # twice as many in a symmetric network
    outputs: int
    mirror: Mirror | None = None  # of a symmetric network

    @property
    def size(self) -> int:
        """Number of parameters."""
        return (self.inputs + 1) * self.hidden + (self.hidden + 1) * self.outputs

    def layers(self, parameters: Array) -> tuple[Array, Array, Array, Array]:
        """Weights (m, n, hidden), biases, weights (m, hidden, k), biases of parameters (m, p)."""
        p = checked("parameters", parameters, (-1, self.size), finite=False)
        n, hidden, k, _ = self
        ends = np.cumsum([n * hidden, hidden, hidden * k])
        w1, b1, w2, b2 = np.split(p, ends, axis=1)
        w1, w2 = w1.reshape(-1, n, hidden), w2.reshape(-1, hidden, k)
        if self.mirror is None:
            return w1, b1, w2, b2
        seen, action = self.mirror
        w1, b1 = np.concatenate([w1, seen @ w1], axis=2), np.concatenate([b1, b1], axis=1)
        return w1, b1, np.concatenate([w2, w2 @ action], axis=1) / 2, (b2 + b2 @ action) / 2

    def actions(self, parameters: Array, seen: Array) -> Array:
        """Actions (m, k) of m networks at one observation (m, n) each."""
        w1, b1, w2, b2 = self.layers(parameters)
        inner = np.tanh(np.matmul(seen[:, None], w1)[:, 0] + b1)
        return np.tanh(np.matmul(inner[:, None], w2)[:, 0] + b2)

    def first(self, rng: np.random.Generator) -> Array:
        """Parameters (p,) of a network whose actions are zero, with a random hidden layer."""
        found = np.zeros(self.size)
        weights = self.inputs * self.hidden
        found[:weights] = rng.standard_normal(weights) / np.sqrt(self.inputs)
        return found


def write_onnx(
    file: Path, shape: NetworkShape, parameters: Array, about: Mapping[str, str]
) -> None:
    """Write a network (p,) and its metadata; raises OSError."""
    import onnx  # noqa: PLC0415 - not installed with the robot
    from onnx import helper, numpy_helper  # noqa: PLC0415

    names = ("w1", "b1", "w2", "b2")
    layers = [layer[0].astype(np.float32) for layer in shape.layers(parameters[None])]
    kind = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["observation", "w1", "b1"], ["h1"]),
            helper.make_node("Tanh", ["h1"], ["h2"]),
            helper.make_node("Gemm", ["h2", "w2", "b2"], ["a1"]),
            helper.make_node("Tanh", ["a1"], ["action"]),
        ],
        "policy",
        [helper.make_tensor_value_info("observation", kind, [1, shape.inputs])],
        [helper.make_tensor_value_info("action", kind, [1, shape.outputs])],
        [numpy_helper.from_array(layer, name) for name, layer in zip(names, layers)],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = IR_VERSION
    helper.set_model_props(model, dict(about))
    onnx.checker.check_model(model)
    file.write_bytes(model.SerializeToString())

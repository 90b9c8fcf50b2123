"""Network of a policy: one layer, actions by tanh; many of them at once, and ONNX.

The parameters of a network are one vector: weights W (n, k), then biases b (k). With the mirror
images M of observations and N of actions, a symmetric network acts by

    tanh((f(s) + f(M s) N) / 2),  f(s) = s W + b,

which is a network of the same size: a(M s) = a(s) N. That one layer can walk is known from Mania et
al., "Simple random search of static linear policies is competitive for reinforcement learning",
2018; here it was not compared with more layers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, checked

OPSET, IR_VERSION = 17, 8  # of ONNX: from onnxruntime 1.14 on


class Mirror(NamedTuple):
    """Mirror images of observations and of actions, as symmetric matrices."""

    seen: Array  # (n, n)
    action: Array  # (k, k)


class NetworkShape(NamedTuple):
    """Numbers of inputs and outputs."""

    inputs: int
    outputs: int
    mirror: Mirror | None = None  # of a symmetric network

    @property
    def size(self) -> int:
        """Number of parameters."""
        return (self.inputs + 1) * self.outputs

    def layer(self, parameters: Array) -> tuple[Array, Array]:
        """Weights (m, n, k) and biases (m, k) of parameters (m, p)."""
        weights, bias = np.split(
            checked("parameters", parameters, (-1, self.size), finite=False),
            [self.inputs * self.outputs],
            axis=1,
        )
        weights = weights.reshape(-1, self.inputs, self.outputs)
        if self.mirror is None:
            return weights, bias
        seen, action = self.mirror
        return (weights + seen @ weights @ action) / 2, (
            bias + bias @ action
        ) / 2

    def actions(self, parameters: Array, seen: Array) -> Array:
        """Actions (m, k) of m networks at one observation (m, n) each."""
        weights, bias = self.layer(parameters)
        return np.tanh(np.matmul(seen[:, None], weights)[:, 0] + bias)


def write_onnx(
    file: Path, shape: NetworkShape, parameters: Array, about: Mapping[str, str]
) -> None:
    """Write a network (p,) and its metadata; raises OSError."""
    import onnx  # noqa: PLC0415 - not installed with the robot
    from onnx import helper, numpy_helper  # noqa: PLC0415

    weights, bias = (
        values[0].astype(np.float32) for values in shape.layer(parameters[None])
    )
    kind = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [
            helper.make_node(
                "Gemm", ["observation", "weights", "bias"], ["sum"]
            ),
            helper.make_node("Tanh", ["sum"], ["action"]),
        ],
        "policy",
        [helper.make_tensor_value_info("observation", kind, [1, shape.inputs])],
        [helper.make_tensor_value_info("action", kind, [1, shape.outputs])],
        [
            numpy_helper.from_array(weights, "weights"),
            numpy_helper.from_array(bias, "bias"),
        ],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)]
    )
    model.ir_version = IR_VERSION
    helper.set_model_props(model, dict(about))
    onnx.checker.check_model(model)
    file.write_bytes(model.SerializeToString())

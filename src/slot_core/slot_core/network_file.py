"""ONNX files of networks: read with the data file beside them, refused if they draw at random."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from slot_core.command_line import missing
from slot_core.config import ConfigError
from slot_core.refusal import read_bytes

SIZE_MAX = 10_000_000  # bytes of a file
RANDOM = {
    "Bernoulli",
    "Multinomial",
    "RandomNormal",
    "RandomNormalLike",
    "RandomUniform",
    "RandomUniformLike",
}
"""Operators whose output is drawn at random."""


def read_network(file: Path) -> bytes:
    """The network as one file, with the weights of the data files beside it (`model.onnx.data`).

    Raises ConfigError if onnx is not installed, for a file that is no network, for a data file
    that is missing or elsewhere, and for a node that draws at random: its replay would differ.
    """
    with refused(file):
        import onnx  # noqa: PLC0415 - not installed with the robot

        content = read_bytes(file, SIZE_MAX)
        model = onnx.load_model_from_string(content)
        if drawn := _random_node(model):
            raise ConfigError(
                f"policy {file}: {drawn} draws at random, so that a bag would not replay; export"
                " the mean action, in evaluation mode"
            )
        for name in {
            entry.value
            for tensor in model.graph.initializer
            for entry in tensor.external_data
            if entry.key == "location"
        }:
            with refused(f"{file}, whose weights are in {name} beside it"):
                read_bytes(file.parent / name, SIZE_MAX)
            onnx.load_external_data_for_model(model, str(file.parent))
            content = model.SerializeToString()
    return content


def _random_node(model: Any) -> str:
    """The first operator that draws at random; empty: none."""
    still = {
        tensor.name
        for tensor in model.graph.initializer
        if not any(tensor.raw_data) and not any(tensor.int32_data)
    }
    for node in (
        n for part in (model.graph, *model.functions) for n in _nodes(part)
    ):
        if node.op_type in RANDOM:
            return str(node.op_type)
        if node.op_type == "Dropout" and not {"", *still} >= {*node.input[2:]}:
            return "Dropout in training mode"
    return ""


def _nodes(part: Any) -> Iterator[Any]:
    """Nodes of a graph or function, with those of the graphs inside them."""
    for node in part.node:
        yield node
        for attribute in node.attribute:
            for inner in (attribute.g, *attribute.graphs):
                yield from _nodes(inner)


@contextmanager
def refused(policy: object) -> Iterator[None]:
    """Convert exceptions of the libraries, and their absence, to ConfigError."""
    try:
        yield
    except ConfigError:
        raise
    except ModuleNotFoundError as error:
        raise ConfigError(f"policy {policy}: {missing(error.name)}") from None
    except Exception as error:
        line = " ".join(str(error).split())[:200]
        raise ConfigError(
            f"policy {policy}: {type(error).__name__}: {line}"
        ) from None

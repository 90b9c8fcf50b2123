"""ONNX files of networks: read with the data file beside them, refused if they draw at random."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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
    try:
        import onnx  # noqa: PLC0415 - not installed with the robot
    except ModuleNotFoundError:
        raise ConfigError(
            f"policy {file}: onnx is missing; run scripts/setup --learn"
        ) from None
    with refused(file):
        content = read_bytes(file, SIZE_MAX)
        model = onnx.load_model_from_string(content)
        if drawn := _random_node(model):
            raise ConfigError(
                f"policy {file}: {drawn} draws at random, so that a bag would not replay; export"
                " the mean action, in evaluation mode"
            )
        places = {
            entry.value
            for tensor in model.graph.initializer
            for entry in tensor.external_data
            if entry.key == "location"
        }
        for place in places:
            _require_data(file, place)
        if places:
            onnx.load_external_data_for_model(model, str(file.parent))
            content = model.SerializeToString()
    return content


def _require_data(file: Path, place: str) -> None:
    """Raise ConfigError if a data file is not there, is too large or is no regular file."""
    try:
        read_bytes(file.parent / place, SIZE_MAX)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"policy {file}: its weights are in {place}:"
            f" {getattr(error, 'strerror', None) or error}; keep both files in one folder"
        ) from None


def _random_node(model: Any) -> str:
    """The first operator that draws at random; empty: none."""
    still = {
        tensor.name
        for tensor in model.graph.initializer
        if not any(tensor.raw_data) and not any(tensor.int32_data)
    }
    for node in (n for part in (model.graph, *model.functions) for n in _nodes(part)):
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
def refused(file: Path) -> Iterator[None]:
    """Convert exceptions of the libraries to ConfigError."""
    try:
        yield
    except ConfigError:
        raise
    except Exception as error:
        line = " ".join(str(error).split())[:200]
        raise ConfigError(
            f"policy {file}: {type(error).__name__}: {line}"
        ) from None

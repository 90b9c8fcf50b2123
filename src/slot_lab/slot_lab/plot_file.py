"""File of a plot."""

from pathlib import Path

from matplotlib.figure import Figure


def write_plot(figure: Figure, path: Path, dpi: int) -> None:
    """Write a figure, in a directory that is made; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)

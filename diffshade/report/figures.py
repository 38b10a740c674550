"""Figures: one that was drawn becomes a file, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..io.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".pdf", ".svg")
DPI = 110  # of a figure, unless what draws it has another


def write_figure(path: str | Path, figure: Figure) -> None:
    """Write a figure of `draw_comparison`, `lights.draw_calibration`, `lamps.draw_lamp` or `lecture.draw_figure`.

    Args:
        path: The file, .png, .pdf or .svg.
        figure: The figure.

    Raises:
        ValueError: The suffix is another one.
        TypeError: The path is no path.
        OSError: The file cannot be written.
    """
    check_figure(path)
    with replacing(path) as temporary:
        figure.savefig(temporary)


def check_figure(path: str | Path) -> None:
    """Raise ValueError for a path that no figure can be written to, before the figure is drawn."""
    if not isinstance(path, str | Path):
        raise TypeError(
            f"the path comes first, then the figure; got {type(path).__name__}. Give for example 'lamp.png'."
        )
    if Path(path).suffix.lower() not in SUFFIXES:
        raise ValueError(f"a figure is written as {', '.join(SUFFIXES)}; got '{path}'. Give one of these suffixes.")

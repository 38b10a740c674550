"""Pages: the layout of the lecture's figures, in inches from the top left; pictures keep their pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .pictures import SCALE, Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 120
GAP, MARGIN, TITLE, LABEL, SIDE, NOTE = 0.06, 0.2, 0.5, 0.24, 0.95, 0.4  # inches
COLOURS = ("#1f5fa8", "#d1383d", "#2a8f5b", "#e08a1e", "#7b4ba6", "#333333", "#17a2a8")
GREY = "#555555"
SCALED = "Each picture is scaled to its brightest point."


def page(title: str, width: float, height: float, *, note: str = "") -> Figure:
    """Return an empty figure with a title and a note at the bottom."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(width, height), dpi=DPI * SCALE.get())
    figure.text(0.5, 1 - 0.13 / height, title, ha="center", va="top", fontsize=12)
    figure.text(0.5, 0.12 / height, note, ha="center", va="bottom", fontsize=9, color=GREY)
    return figure


def place(figure: Figure, left: float, top: float, width: float, height: float, **more: Any) -> Axes:
    """Return axes with this frame on the page."""
    across, down = figure.get_size_inches()
    return figure.add_axes((left / across, 1 - (top + height) / down, width / across, height / down), **more)


def show(figure: Figure, left: float, top: float, image: Picture, label: str = "") -> Axes:
    """Place a picture, pixel for pixel, with a label above it."""
    height, width = (size / SCALE.get() for size in image.shape[:2])
    axes = place(figure, left, top, width / DPI, height / DPI)
    axes.imshow(image, extent=(-0.5, width - 0.5, height - 0.5, -0.5))  # in pixels of the page
    axes.set_axis_off()
    axes.set_title(label, fontsize=10, pad=4)
    return axes


def grid(
    title: str,
    rows: Sequence[Sequence[Picture]],
    *,
    columns: Sequence[str] = (),
    sides: Sequence[str] = (),
    labels: Sequence[str] = (),
    note: str = "",
) -> Figure:
    """Return pictures of one shape in rows, with a name for each column and row, or for each of the pictures."""
    height, width = (size / DPI / SCALE.get() for size in rows[0][0].shape[:2])
    left, top = SIDE if sides else MARGIN, TITLE + (LABEL if columns or labels else 0.0)
    across, down = width + GAP, height + (LABEL if labels else GAP)
    foot = NOTE if note else MARGIN
    page_width = left + len(rows[0]) * across - GAP + MARGIN
    figure = page(title, page_width, top + (len(rows) - 1) * down + height + foot, note=note)
    for j, row in enumerate(rows):
        for i, image in enumerate(row):
            label = labels[j * len(rows[0]) + i] if labels else columns[i] if columns and j == 0 else ""
            axes = show(figure, left + i * across, top + j * down, image, label)
            if sides and i == 0:
                axes.annotate(
                    sides[j], (0, 0.5), (-6, 0), "axes fraction", "offset points", ha="right", va="center", fontsize=10
                )
    return figure


def draw_curves(axes: Axes, x: Float[np.ndarray, "n"], curves: Mapping[str, np.ndarray]) -> None:
    """Draw curves over x, with a legend."""
    for colour, (name, y) in zip(COLOURS, curves.items(), strict=False):
        axes.plot(x, y, color=colour, label=name, linewidth=1.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9)
    axes.set_xlim(x[0], x[-1])
    axes.legend(fontsize=9, frameon=False)


def name_axes(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Label the axes of a plot."""
    axes.set_xlabel(x, fontsize=10)
    axes.set_ylabel(y, fontsize=10)
    axes.set_title(title, fontsize=10)

"""Mask picture: the outline of a mask that was found, and what each way of looking for the object shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..core.extras import needing
from ..io.encodings import brightened
from .calibration_picture import INCH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..inverse.data.masks import FoundMask


def draw_mask(found: FoundMask) -> Figure:
    """Draw the brightest of the photographs, brightened, with the outline of the mask and of what each way found.

    Args:
        found: The mask.

    Raises:
        ImportError: matplotlib is not installed.
    """
    with needing("figures", "cannot draw a mask"):
        from matplotlib.figure import Figure
    shown = brightened(found.picture)
    rows, columns = shown.shape
    panels = {"mask": found.small, **found.ways}
    figure = Figure(figsize=(INCH * len(panels), INCH * rows / columns + 0.3), dpi=72, layout="constrained")
    axes: Any = figure.subplots(1, len(panels))
    for at, (name, way) in zip(axes, panels.items(), strict=True):
        at.imshow(shown, cmap="gray")
        if way.any() and not way.all():
            at.contour(way, [0.5], colors="tab:red", linewidths=1)
        agrees = name == "mask" or name in found.agreeing
        at.set_title(f"{name}, {way.mean():.0%}" + ("" if agrees else ": left out"), fontsize=12)
        at.set_axis_off()
    return figure

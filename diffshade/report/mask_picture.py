"""Mask picture: the outline of a mask that was found, and what each way of looking for the object shows."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.extras import needing
from ..io.files import replacing
from .calibration_picture import INCH, WHITE

if TYPE_CHECKING:
    from ..inverse.data.masks import FoundMask


def draw_mask(path: Path, found: FoundMask) -> None:
    """Draw the brightest of the photographs, brightened, with the outline of the mask and of what each way found.

    Args:
        path: The .png to write.
        found: The mask.

    Raises:
        OSError: If the picture cannot be written.
        ImportError: matplotlib is not installed.
    """
    with needing("figures", f"cannot draw {path}"):
        from matplotlib.figure import Figure
    shown = np.sqrt(np.clip(found.picture / max(float(np.quantile(found.picture, WHITE)), 1e-12), 0.0, 1.0))
    rows, columns = shown.shape
    panels = {"mask": found.small, **found.ways}
    figure = Figure(figsize=(INCH * len(panels), INCH * rows / columns + 0.3), layout="constrained")
    axes: Any = figure.subplots(1, len(panels))
    for at, (name, way) in zip(axes, panels.items(), strict=True):
        at.imshow(shown, cmap="gray")
        if way.any() and not way.all():
            at.contour(way, [0.5], colors="tab:red", linewidths=1)
        agrees = name == "mask" or name in found.agreeing
        at.set_title(f"{name}, {way.mean():.0%}" + ("" if agrees else ": left out"), fontsize=12)
        at.set_axis_off()
    held = io.BytesIO()
    figure.savefig(held, format="png", dpi=72)
    with replacing(path) as temporary:
        temporary.write_bytes(held.getvalue())

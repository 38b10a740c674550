"""The display: from a radiance to the number that a file holds, and why half of it looks brighter than half."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...io.encodings import srgb_decode, srgb_encode
from .pages import DPI, draw_curves, name_axes, page, place, show
from .pictures import SCALE, Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BACKED = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}
WIDTH, HEIGHT, STRIPE = 220, 120, 2  # pixels of a patch


def half_of_white() -> Figure:
    """Draw the sRGB curve, half of white beside stripes of black and white, and two scales of grey."""
    figure = page("Half of the light of white looks brighter than half: its sRGB value is 0.735", 10.2, 3.75)
    axes = place(figure, 0.75, 0.7, 3.0, 2.5)
    radiance = np.linspace(0.0, 1.0, 401)
    draw_curves(axes, radiance, {"sRGB": srgb_encode(radiance), "the radiance itself": radiance})
    half, middle = float(srgb_encode(np.asarray(0.5))), float(srgb_decode(np.asarray(0.5)))
    for x, y in ((0.5, half), (middle, 0.5)):
        axes.plot([x, x, 0], [0, y, y], ":", color="0.4", linewidth=1)
        axes.text(x + 0.02, y - 0.05, f"({x:.3g}, {y:.3g})", fontsize=9, va="top", bbox=BACKED)
    axes.set_ylim(0, 1)
    name_axes(axes, "radiance", "value in the file")
    left = round(4.3 * DPI) / DPI  # whole pixels, so that stripes stay stripes
    shown = show(figure, left, round(0.8 * DPI) / DPI, _patches(half))
    for i, words in enumerate(("radiance 0.5", "black and white stripes", "value 0.5")):
        shown.text((i + 0.5) * WIDTH, HEIGHT + 14, words, ha="center", va="center", fontsize=9)
    steps = np.linspace(0.0, 1.0, 11)
    for top, values, words in (
        (2.3, srgb_encode(steps), "equal steps of radiance"),
        (3.0, steps, "equal steps of the value: nearly equal to the eye"),
    ):
        scale = show(figure, left, round(top * DPI) / DPI, _scale(values), words)
        scale.set_axis_on()  # its frame, within which white is seen
        scale.set(xticks=[], yticks=[])
    return figure


def _patches(half: float) -> Picture:
    """Return half of white as one grey, as stripes of black and white, and the grey of the value 0.5."""
    stripes = np.arange(HEIGHT) // STRIPE % 2
    columns = [np.full(HEIGHT, half), stripes, np.full(HEIGHT, 0.5)]
    return _grey(np.repeat(np.stack(columns, -1), WIDTH, 1))


def _scale(values: np.ndarray) -> Picture:
    """Return greys side by side."""
    return _grey(np.tile(np.repeat(values, 3 * WIDTH // len(values)), (HEIGHT // 3, 1)))


def _grey(values: Float[np.ndarray, "h w"]) -> Picture:
    return np.kron(values, np.ones((SCALE.get(), SCALE.get())))[..., None] * np.ones(3)

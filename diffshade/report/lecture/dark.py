"""Dark: a figure of a lecture on a dark page, each colour as light as it was dark."""

from __future__ import annotations

from colorsys import hls_to_rgb, rgb_to_hls
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE = "#16181c"
COLOURS = ("color", "facecolor", "edgecolor", "markerfacecolor", "markeredgecolor")


def darken(figure: Figure) -> Figure:
    """Put a figure on a dark page: hues stay, what was dark becomes light; pictures, and what is on them, stay."""
    figure.draw_without_rendering()  # makes the ticks
    for artist in [*figure.texts, *(each for axes in figure.axes for each in _around(axes))]:
        _turn(artist)
    for axes in figure.axes:
        axes.set_facecolor("none")
    figure.set_facecolor(PAGE)
    return figure


def _around(axes: Axes) -> list[Any]:
    """Return what is drawn in axes, but for what is drawn on their picture."""
    from matplotlib.spines import Spine
    from matplotlib.text import Text

    found = [artist for artist in axes.findobj(include_self=False) if artist is not axes.patch]
    if axes.images:
        box = axes.get_window_extent()
        off = [each for each in found if isinstance(each, Text) and not box.contains(*_middle(each))]
        found = [*off, *(each for each in found if isinstance(each, Spine))]
    words = [each for each in found if isinstance(each, Text)]
    parts = [part for each in words for part in (each.get_bbox_patch(), getattr(each, "arrow_patch", None))]
    return [*found, *(part for part in parts if part is not None)]


def _middle(artist: Any) -> np.ndarray:
    return artist.get_window_extent().get_points().mean(0)


def _turn(artist: Any) -> None:
    from matplotlib.colors import to_rgba_array

    names = [name for name in COLOURS if hasattr(artist, f"get_{name}") and hasattr(artist, f"set_{name}")]
    given = [to_rgba_array(getattr(artist, f"get_{name}")()) for name in names]  # all first: a marker's is its line's
    for name, colours in zip(names, given, strict=True):
        turned = [_turned(*colour) for colour in colours]
        if turned:
            getattr(artist, f"set_{name}")(turned if len(turned) > 1 else turned[0])


def _turned(red: float, green: float, blue: float, alpha: float) -> tuple[float, ...]:
    """Return a colour of the same hue, as light as it was dark, but not darker than the page."""
    hue, lightness, saturation = rgb_to_hls(red, green, blue)
    return (*hls_to_rgb(hue, 0.95 - 0.85 * lightness, saturation), alpha)

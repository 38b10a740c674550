"""Comparison: photograph, fit and difference side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..core.extras import needing
from ..inverse.data.views import View
from ..inverse.result import Fit, Prediction
from ..io.encodings import srgb_encode
from .drawn_bands import drawn_bands
from .figures import DPI
from .page.checks import check_titles

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_comparison(fit: Fit, views: Sequence[View] | View, *, titles: Sequence[str] = ()) -> Figure:
    """Draw photograph, fit and difference side by side, one row per view; a notebook displays the figure.

    Photograph and fit are shown with the sRGB curve and one exposure, at which the brightest 0.5 % of the photographs
    are white; of a scene of bands the title says which are shown as red, green and blue. The difference is the mean
    over the channels of fit - photograph, in the photograph's units: blue where the fit is darker, red where it is
    brighter, and white where no sample counts.

    Args:
        fit: The fit.
        views: The views to show.
        titles: A title for each view; by default its index.

    Returns:
        The figure.

    Raises:
        ValueError: If a view does not match the scene, or the number of titles is wrong.
        ImportError: matplotlib is not installed.
    """
    with needing("figures", "cannot draw a comparison"):
        import matplotlib.figure
    views = (views,) if isinstance(views, View) else tuple(views)
    titles = titles or [f"view {i}" for i in range(len(views))]
    check_titles(titles, len(views), "the")
    predictions = [fit.predict(view) for view in views]
    drawn = drawn_bands(fit.scene.bands)
    white = max(map(drawn.white, predictions)) or 1.0
    limit = max(float(np.quantile(np.abs(_signed(p).compressed()), 0.99)) for p in predictions) or 1e-12

    figure = matplotlib.figure.Figure(figsize=(9.6, 3.1 * len(views) + 0.3), dpi=DPI, layout="constrained")
    rows = figure.subplots(len(views), 3, squeeze=False)
    for row, p, title in zip(rows, predictions, titles, strict=True):
        row[0].imshow(_display(drawn.of(p.target), p, white))
        row[1].imshow(_display(drawn.of(p.image), p, white))
        difference = row[2].imshow(_signed(p), cmap="RdBu_r", vmin=-limit, vmax=limit)
        figure.colorbar(difference, ax=row[2], shrink=0.85)
        for axes, name in zip(row, (title, "fit", f"fit - photograph, RMSE {p.rmse:.2g}"), strict=True):
            axes.set_title(name, fontsize=10)
            axes.set_axis_off()
    if drawn.words:
        figure.suptitle(drawn.words, fontsize=9)
    return figure


def _display(image: Float[np.ndarray, "h w c"], p: Prediction, white: float) -> Float[np.ndarray, "h w 3"]:
    """Return linear radiance as sRGB for display; pixels that do not count are white."""
    inside = p.counts.any(-1, keepdims=True)
    shown = srgb_encode(np.clip(np.where(inside, image, white) / white, 0.0, 1.0))
    return np.broadcast_to(shown, (*shown.shape[:2], 3))


def _signed(p: Prediction) -> np.ma.MaskedArray:
    counted = p.counts.sum(-1)
    return np.ma.masked_where(counted == 0, p.difference.sum(-1) / np.maximum(counted, 1))

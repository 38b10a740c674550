"""The figures of a lecture, drawn quickly: their words with their places, and their rendered pictures."""

from unittest import mock

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

import diffshade as ds
from diffshade.core import backend
from diffshade.model import rendering
from diffshade.report.lecture import pictures as pictures_module

QUICK_RENDER = backend.jit_quickly(rendering._image)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """One ray a pixel, compiled without optimisation: faster, and the programs of one test serve the others."""
    monkeypatch.setattr(pictures_module, "RAYS", 1)
    monkeypatch.setattr(rendering, "_render", lambda scene, camera, *_, **__: QUICK_RENDER(scene, camera))  # small ones


def texts(figure):
    """The words that are drawn, and where they are."""
    drawn, renderer = [], FigureCanvasAgg(figure).get_renderer()
    with mock.patch.object(Text, "draw", autospec=True, side_effect=lambda text, _: drawn.append(text)):
        figure.draw(renderer)
    return [
        (text.get_text(), Text.get_window_extent(text, renderer))
        for text in drawn
        if text.get_visible() and text.get_text().strip()
    ]


def pictures(figure):
    """The rendered pictures of a figure, as linear radiance."""
    return [ds.srgb_decode(np.asarray(image.get_array())) for axes in figure.axes for image in axes.get_images()]

"""Writing: maps, put together on one HTML page: a live picture, errors, and photographs beside predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ....core.progress import ReportProgress
from ....diagnosis.prediction_bands import PredictionBands
from ....inverse.data.views import View
from ....inverse.result import Prediction
from ....texels.heights.integration import heights_within
from ....texels.heights.map import HeightMap
from ....texels.maps import TexelMaps
from ....texels.predictions import relative_error
from ....texels.status import OUTSIDE
from ...drawn_bands import drawn_bands
from .. import charts
from ..pictures import build_gallery, evenly
from ..shaders import shader
from ..tables import bands as on_bands
from ..tables import shown
from ..template import as_script, fill
from . import tables
from .layers import Layer, layers_of
from .numbers import Numbers, numbers_of
from .overlays import DARK, LEVELS_OF_STATUS, gradient, overlays_of
from .photographs import as_jpeg, still_of, white_of
from .rounding import picture_off
from .stage import Lighting, stage_of

MOST_PHOTOGRAPHS = 24  # that the live picture is compared with
# Of white: to what a light page rounds what is beyond the model. Nine texels of ten then differ by 1.5 steps of 255.
STEP = 1.0 / 16.0
MOST_PREDICTIONS = 12  # and half as many of both in a light page
EACH = ("Each of these photographs", "those above, from 0")  # title and axis of a chart of all of them or some
SHADERS = ("decode", "relief", "shadow", "median", "beyond", "maps", "present")
STYLES = ("page.css", "maps/maps.css")
SCRIPTS = (
    "webgl.js",
    "page.js",
    "maps/textures.js",
    "maps/picture.js",
    "maps/dome.js",
    "maps/view.js",
    "maps/page.js",
)


@dataclass(frozen=True, eq=False)
class PagePhotographs:
    """The photographs of a page: those of the fit, then those that were left out, with the name of each."""

    fitted: tuple[View, ...]
    left_out: tuple[View, ...]
    titles: tuple[str, ...]

    @property
    def every(self) -> tuple[View, ...]:
        """All of them."""
        return self.fitted + self.left_out

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each; by default its index."""
        return self.titles or tuple(f"photograph {i}" for i in range(len(self.every)))

    def some(self, most: int) -> list[int]:
        """Return the indices of at most so many of the fitted, evenly spread, and as many of those left out."""
        return evenly(len(self.fitted), most) + [len(self.fitted) + i for i in evenly(len(self.left_out), most)]

    def predicted(self, most: int) -> list[int]:
        """Return the indices of at most so many beside predictions: those left out, where there are any."""
        return [i for i in self.some(most) if not self.left_out or i >= len(self.fitted)]


class PageForm(NamedTuple):
    """What the user of a page wants."""

    title: str
    """Empty: how many texels the object has."""
    full: bool
    """Whether numbers are kept as finely as fits, rather than so that the page is light."""
    embed: bool
    """Whether it has the picture and its dial alone."""

    def of(self, most: int) -> int:
        """Return how many of some pictures the page has at most."""
        return most if self.full else most // 2


def write_maps_page(
    path: Path,
    maps: TexelMaps,
    photographs: PagePhotographs,
    heights: HeightMap | None,
    bands: PredictionBands | None,
    form: PageForm,
    report_progress: ReportProgress,
) -> None:
    """Write the page; see `write_report`."""
    if heights is None and "normal" in maps.values:
        report_progress("heights")
        inside, errors = maps.status != OUTSIDE, maps.errors["normal"]
        heights = heights_within(maps.values["normal"], maps.camera, inside, errors, report_progress)
    report_progress("numbers")
    numbers, white = numbers_of(maps, heights), white_of(maps, photographs.every)
    lightings = _lightings(maps, photographs)
    stage = stage_of(maps, lightings, white, numbers.factor)
    brightness = _brightness(stage["views"])
    # the page opens with the first view that is not brighter than most: white is that of the median
    first = int(np.argmax(brightness <= np.median(brightness)))
    layers, planes = layers_of(numbers, None if form.full else STEP / (float(np.median(brightness)) or 1.0))
    beside = [] if form.embed else photographs.some(form.of(MOST_PHOTOGRAPHS))
    _name(stage["views"], photographs, beside)
    report_progress("predictions")
    names, predictions, off = _predicted(maps, photographs, bands, form)
    overlays = overlays_of(numbers, layers)
    report_progress("writing")
    page = fill(
        "maps/maps.html",
        STYLES,
        SCRIPTS,
        title=form.title or f"An object of {int((maps.status != OUTSIDE).sum()):,} texels",
        embed=form.embed,
        still=still_of(maps, lightings[first].lit, lightings[first].exposure, white),
        lead=tables.lead(maps),
        facts=tables.facts(maps, len(photographs.fitted), len(photographs.left_out), off),
        view_groups=[
            (group, [(i, view["name"]) for i, view in enumerate(stage["views"]) if view["held_out"] == left_out])
            for group, left_out in (("left out of the fit", True), ("used by the fit", False))
        ],
        shadows=(
            ("photographed", "as photographed, between lights", maps.unexplained is not None),
            ("none", "none: the model alone", True),
            ("cast", "cast by the heights", numbers.height is not None),
        ),
        shiny=bool((numbers.k_s[numbers.inside] > DARK).any()),
        overlays=overlays,
        gradient=["#" + bytes(colour.tolist()).hex() for colour in gradient()],
        remarks=tables.remarks(stage),
        table=shown(maps.columns),
        notes=[str(note) for note in (*maps.notes, *(() if heights is None else heights.notes))],
        gallery=build_gallery(predictions, names, drawn_bands(())) if names else None,
        seen=not photographs.left_out,
        bands=None if bands is None else on_bands(bands, predictions),
        charts=[charts.errors_of_each(off, names, "relative error", *EACH)] if names else [],
        factor=numbers.factor,
        packed=tables.packed(numbers, layers, picture_off(maps, numbers, layers, white)),
        scene=as_script({"first": first, **_scene(numbers, layers, planes, stage, overlays)}),
        shaders={name: shader(f"maps/{name}.glsl", stage["lobes"], stage["laws"]) for name in SHADERS},
        files={f"{name}-{k}": file for name, of in planes.items() for k, file in enumerate(of)}
        | {f"photograph-{i}": as_jpeg(photographs.every[i], white) for i in beside},
    )
    path.write_text(page, encoding="utf-8")


def _predicted(
    maps: TexelMaps, photographs: PagePhotographs, bands: PredictionBands | None, form: PageForm
) -> tuple[list[str], list[Prediction], Float[np.ndarray, " n"]]:
    """Return the names of some photographs, what the maps predict of them, and the relative errors of that."""
    which = [] if form.embed else photographs.predicted(form.of(MOST_PREDICTIONS))
    found = [(bands or maps).predict(photographs.every[i]) for i in which]
    off = [relative_error(p, float(photographs.every[i].black)) for i, p in zip(which, found, strict=True)]
    return [photographs.names[i] for i in which], found, np.array(off)


def _lightings(maps: TexelMaps, photographs: PagePhotographs) -> list[Lighting]:
    """Return the lights of each photograph; without photographs, each of the scene's lights alone."""
    if not photographs.every:
        return [Lighting((i,), 1.0, 0.0) for i in range(len(maps.scene.lights))]
    return [Lighting(view.lit, float(view.exposure), float(view.black)) for view in photographs.every]


def _brightness(views: Sequence[dict[str, Any]]) -> Float[np.ndarray, " views"]:
    """Return what a reflectance of 1 that faces each view's light shows, 1 being white."""
    return np.array([view["gain"] * max(view["arriving"]) for view in views])


def _name(views: list[dict[str, Any]], photographs: PagePhotographs, shown: Sequence[int]) -> None:
    """Add to the lights of the stage which photograph they are those of, and whether it is shown."""
    names = photographs.names or [f"light {i}" for i in range(len(views))]
    for i, (view, name) in enumerate(zip(views, names, strict=True)):
        left_out = bool(photographs.left_out) and i >= len(photographs.fitted)
        view |= {"name": name, "held_out": left_out, "photograph": i in shown}


def _scene(
    numbers: Numbers,
    layers: Sequence[Layer],
    planes: Mapping[str, Sequence[str]],
    stage: Mapping[str, Any],
    overlays: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return what the page's scripts know of its layers, ready for JSON."""
    height, own = layers[0].channels[2], numbers.own[numbers.inside]
    return {
        **{name: of for name, of in stage.items() if name not in ("lobes", "laws")},
        "layers": [{**layer.about(), "planes": len(planes[layer.name])} for layer in layers],
        "heights": None if numbers.height is None else [height.low, height.high],
        "own": own[0].tolist() if (own == own[0]).all() else None,  # the same for all texels, or a layer
        "first_power": numbers.first_power,
        "shapes": numbers.shapes,
        "colours": gradient().tolist(),
        "status": [{"colour": colour} for colour, _ in LEVELS_OF_STATUS],
        "overlays": overlays,
    }

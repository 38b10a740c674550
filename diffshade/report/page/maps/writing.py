"""Writing: maps, put together on one HTML page: a live picture, errors, and photographs beside predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....core.progress import ReportProgress
from ....diagnosis.prediction_bands import PredictionBands
from ....inverse.data.views import View
from ....texels.heights.integration import heights_within
from ....texels.heights.map import HeightMap
from ....texels.maps import TexelMaps
from ....texels.predictions import relative_error
from ....texels.status import OUTSIDE
from ...drawn_bands import drawn_bands
from .. import charts
from ..pictures import build_gallery
from ..shaders import shader
from ..tables import bands as on_bands
from ..tables import shown
from ..template import as_script, fill
from . import tables
from .layers import Layer, layers_of
from .numbers import Numbers, numbers_of
from .overlays import DARK, LEVELS_OF_STATUS, gradient, overlays_of
from .photographs import as_jpeg, white_of
from .stage import Lighting, stage_of

MOST_PHOTOGRAPHS = 24  # that the live picture is compared with
MOST_PREDICTIONS = 12
SHADERS = ("decode", "relief", "shadow", "beyond", "maps", "present")
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
        return _spread(len(self.fitted), most) + [len(self.fitted) + i for i in _spread(len(self.left_out), most)]

    def predicted(self) -> list[int]:
        """Return the indices of those beside predictions: those left out, where there are any."""
        return [i for i in self.some(MOST_PREDICTIONS) if not self.left_out or i >= len(self.fitted)]


def write_maps_page(
    path: Path,
    maps: TexelMaps,
    photographs: PagePhotographs,
    heights: HeightMap | None,
    bands: PredictionBands | None,
    report_progress: ReportProgress,
) -> None:
    """Write the page; see `write_report`."""
    if heights is None and "normal" in maps.values:
        report_progress("heights")
        inside, errors = maps.status != OUTSIDE, maps.errors["normal"]
        heights = heights_within(maps.values["normal"], maps.camera, inside, errors, report_progress)
    report_progress("numbers")
    numbers = numbers_of(maps, heights)
    layers, planes = layers_of(numbers)
    report_progress("predictions")
    white = white_of(maps, photographs.every)
    stage = stage_of(maps, _lightings(maps, photographs), white, numbers.factor)
    _name(stage["views"], photographs)
    predicted = photographs.predicted()
    names = [photographs.names[i] for i in predicted]
    predictions = [(bands or maps).predict(photographs.every[i]) for i in predicted]
    off = np.array(
        [relative_error(p, float(photographs.every[i].black)) for i, p in zip(predicted, predictions, strict=True)]
    )
    overlays = overlays_of(numbers, layers)
    report_progress("writing")
    page = fill(
        "maps/maps.html",
        STYLES,
        SCRIPTS,
        title=f"An object of {int((maps.status != OUTSIDE).sum()):,} texels",
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
        gallery=build_gallery(predictions, names, drawn_bands(())) if predictions else None,
        seen=not photographs.left_out,
        bands=None if bands is None else on_bands(bands, predictions),
        charts=[charts.errors_of_each(off, names, "relative error", "Each photograph")] if predictions else [],
        factor=numbers.factor,
        packed=tables.packed(numbers, layers),
        scene=as_script(_scene(numbers, layers, planes, stage, overlays)),
        shaders={name: shader(f"maps/{name}.glsl", stage["lobes"], stage["laws"]) for name in SHADERS},
        files={f"{name}-{k}": file for name, of in planes.items() for k, file in enumerate(of)}
        | {f"photograph-{i}": as_jpeg(photographs.every[i], white) for i in photographs.some(MOST_PHOTOGRAPHS)},
    )
    path.write_text(page, encoding="utf-8")


def _lightings(maps: TexelMaps, photographs: PagePhotographs) -> list[Lighting]:
    """Return the lights of each photograph; without photographs, each of the scene's lights alone."""
    if not photographs.every:
        return [Lighting((i,), 1.0, 0.0) for i in range(len(maps.scene.lights))]
    return [Lighting(view.lit, float(view.exposure), float(view.black)) for view in photographs.every]


def _name(views: list[dict[str, Any]], photographs: PagePhotographs) -> None:
    """Add to the lights of the stage which photograph they are those of."""
    names = photographs.names or [f"light {i}" for i in range(len(views))]
    shown = photographs.some(MOST_PHOTOGRAPHS)
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


def _spread(number: int, most: int) -> list[int]:
    """Return the indices of a list, or as many of them as are shown, evenly spread."""
    return sorted({int(i) for i in np.rint(np.linspace(0, number - 1, min(number, most)))}) if number else []

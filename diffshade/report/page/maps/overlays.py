"""Overlays: what can be laid over the picture of the maps, each with a legend in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ....texels.status import STATUS
from ..colours import LOW_TO_HIGH, colours_of
from .layers import ERRORS, UNKNOWN_ERROR, Layer
from .numbers import Numbers

NONE, NORMALS, COLOUR, LEVELS, NUMBER = range(5)  # as `maps.glsl` has them
DARK = 1e-6  # a coefficient that is nowhere larger has no overlay
BRIGHT = 98.0  # percent of the values that a colour's overlay holds without clipping
LEVELS_OF_STATUS = (  # colour, and what the status says of a texel
    ((0, 0, 0), "no photograph shows the object there"),
    ((46, 139, 105), "everything that was free is known"),
    ((127, 179, 213), "everything but the highlight is known"),
    ((226, 164, 62), "the photographs cannot separate its numbers, or a normal has a large error"),
    ((122, 98, 166), "too few lights reach it"),
    ((196, 62, 52), "the fit did not converge"),
)
UNITS = {
    "k_d": "of the light that arrives",
    "k_s": "of the light that arrives",
    "n_s": "of the exponent",
    "normal": "degrees",
    "height": "scene units",
    "residual": "units of the photographs, or of their noise where that was given",
}


def gradient() -> UInt8[np.ndarray, "steps 3"]:
    """Return the colours of numbers, from low to high."""
    return colours_of(LOW_TO_HIGH, 64)


def overlays_of(numbers: Numbers, layers: Sequence[Layer]) -> list[dict[str, Any]]:
    """Return the overlays, ready for JSON and for the page's legends."""
    return [*_of_values(numbers), _of_status(numbers), *_of_errors(numbers, {layer.name: layer for layer in layers})]


def _of_values(numbers: Numbers) -> Iterator[dict[str, Any]]:
    inside = numbers.inside
    yield _overlay("normals", NORMALS, "Red grows to the right, green upwards, blue towards the camera; grey is 0.")
    for name, words in (("k_d", "diffuse reflection"), ("k_s", "specular reflection")):
        white = float(np.percentile(getattr(numbers, name)[inside], BRIGHT))
        if white >= DARK:
            said = f"The share of the light that arrives; white is {white:.3g}."
            yield _overlay(f"{name}, {words}", COLOUR, said, of=name, low=0.0, high=white)
    n_s = numbers.n_s[inside & (numbers.n_s > 0.0)]
    if n_s.size and np.ptp(n_s) > 0.0:
        low, high = (float(end) for end in np.percentile(n_s, (1.0, 99.0)))
        scale = {"low": low, "high": max(high, 1.01 * low), "logarithmic": True, "ends": (f"{low:.3g}", f"{high:.3g}")}
        said = "Higher is sharper; the scale is logarithmic."
        yield _overlay("n_s, specular exponent", NUMBER, said, of="k_d", pick=3, **scale)
    if numbers.height is not None:
        low, high = (float(end) for end in np.percentile(numbers.height[inside], (0.5, 99.5)))
        ends = tuple(f"{end:.3g}".replace("-", "−") for end in (low, high))
        scale = {"low": low, "high": high if high > low else low + 1.0, "ends": ends}
        said = "Towards the camera, scene units, relative to the mean."
        yield _overlay("heights", NUMBER, said, of="geometry", pick=3, **scale)


def _of_status(numbers: Numbers) -> dict[str, Any]:
    share = np.bincount(numbers.status[numbers.inside], minlength=len(STATUS)) / max(numbers.inside.sum(), 1)
    levels = [
        {"name": name, "fill": "#" + bytes(colour).hex(), "words": words, "share": f"{100 * part:.1f}\u202f%"}
        for name, (colour, words), part in zip(STATUS, LEVELS_OF_STATUS, share, strict=True)
        if part > 0.0
    ]
    return _overlay("status", LEVELS, "What the fit says of each texel.", levels=levels)


def _of_errors(numbers: Numbers, layers: Mapping[str, Layer]) -> Iterator[dict[str, Any]]:
    for i, names in enumerate(ERRORS):
        for k, name in enumerate(names):
            if name not in numbers.errors:
                continue
            layer = layers[f"errors{i}"]
            channel = layer.channels[k]
            residual = name == "residual"
            what = "residual" if residual else f"error of {'the ' if name in ('normal', 'height') else ''}{name}"
            truth = "The true value is within it 68 % of the time"
            meaning = "Root mean square over the photographs" if residual else truth
            yield _overlay(
                what,
                NUMBER,
                f"{meaning}; {UNITS.get(name, f'those of {name}')}. The scale is logarithmic"
                f"{'' if residual else '; a grey grid marks where nothing is known'}.",
                of=f"errors{i}",
                pick=k,
                low=channel.low,
                high=channel.high,
                unknown=UNKNOWN_ERROR,
                coarser=layer.coarser,
                ends=(f"{channel.low:.2g}", f"{channel.high:.2g}"),
            )


def _overlay(name: str, kind: int, words: str, *, pick: int | None = None, **more: Any) -> dict[str, Any]:
    found = {"name": name, "kind": kind, "words": words, "ends": (), "levels": (), **more}
    return found if pick is None else {**found, "pick": [float(k == pick) for k in range(4)]}

"""Drawn bands: which bands of a scene pictures show as red, green and blue, and the words that say so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from ..inverse.result import Prediction
from ..model.bands import of_channels, wavelength
from ..model.scenes import Scene

PRIMARIES = (611.0, 549.0, 464.0)  # nm: the dominant wavelengths of the primaries of sRGB (IEC 61966-2-1)
NEAR = 50.0  # nm: a band farther from a primary than this is another colour
COLOURS = ("red", "green", "blue")
SPREAD = (1 / 6, 1 / 2, 5 / 6)  # where the three drawn bands are among others than those of sight


@dataclass(frozen=True)
class DrawnBands:
    """The channels that are drawn as red, green and blue."""

    channels: tuple[int, int, int]
    words: str
    """A sentence for people; empty for a scene of red, green and blue."""

    def of(self, image: Shaped[np.ndarray, "h w c"]) -> Shaped[np.ndarray, "h w _"]:
        """Return what is drawn of an image: red, green and blue; an image of a scene without bands as it is."""
        return image[..., list(self.channels)] if self.words else image

    def white(self, p: Prediction) -> float:
        """Return the level that all but the brightest .5 % of the samples drawn of a photograph stay below."""
        counts = self.of(p.counts)
        return float(np.quantile(self.of(p.target)[counts], 0.995)) if counts.any() else 0.0

    def scene(self, scene: Scene) -> Scene:
        """Return what is drawn of a scene: one of red, green and blue."""
        return of_channels(scene, self.channels) if self.words else scene


def drawn_bands(bands: tuple[str, ...]) -> DrawnBands:
    """Choose the bands to draw.

    Of wavelengths they are those nearest to the primaries of sRGB, where each is within 50 nm of its own; otherwise one
    of the longest, the middle and the shortest third, the longest as red. Bands with names are drawn as their names
    say, or one of each third in their order. Each keeps its brightness beside the others.
    """
    if not bands:
        return DrawnBands((0, 1, 2), "")
    if len(bands) == 1:
        return DrawnBands((0, 0, 0), f"Pictures show the band {bands[0]} in grey.")
    nm = [wavelength(band) for band in bands]
    lengths = [length for length in nm if length is not None]
    if len(lengths) == len(bands):
        nearest = [int(np.argmin(np.abs(np.array(lengths) - primary))) for primary in PRIMARIES]
        seen = all(abs(lengths[i] - primary) <= NEAR for i, primary in zip(nearest, PRIMARIES, strict=True))
        if seen and len(set(nearest)) == 3:
            return _said(bands, nearest, "near the colours that an eye sees")
        order = np.argsort(lengths, kind="stable")[::-1]
    else:
        named = [[i for i, band in enumerate(bands) if band.lower() in (colour, colour[0])] for colour in COLOURS]
        if all(named):
            return _said(bands, [of[0] for of in named], "as their names say")
        order = np.arange(len(bands))
    return _said(bands, [int(order[int(at * len(bands))]) for at in SPREAD], "false colours")


def _said(bands: tuple[str, ...], chosen: list[int], what: str) -> DrawnBands:
    red, green, blue = chosen
    shown = [f"{bands[red]} as red", f"{bands[green]} as green"]
    shown = [*shown, f"{bands[blue]} as blue"] if green != blue else [shown[0], f"{bands[green]} as green and blue"]
    some = "both bands" if len(bands) == 2 else "the three bands" if len(bands) == 3 else f"3 of the {len(bands)} bands"
    return DrawnBands((red, green, blue), f"Pictures show {some}, {', '.join(shown)}: {what}.")

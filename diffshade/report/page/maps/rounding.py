"""Rounding: how far the page's picture, of numbers rounded to steps, is from the maps' own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ....core.thresholds import FEW
from ....io.encodings import srgb_encode
from ....texels.maps import TexelMaps
from ....texels.status import OUTSIDE
from .layers import Layer, unfolded
from .numbers import Numbers


def picture_off(maps: TexelMaps, numbers: Numbers, layers: Sequence[Layer], white: float) -> str | None:
    """Return by how many steps of 255 most texels of a picture differ from `maps.shade`, under a few of the lights.

    None where the page's texels are not those of the maps.
    """
    if numbers.factor > 1 or any(layer.coarser > 1 for layer in layers if layer.name.startswith("beyond")):
        return None
    kept = {layer.name: layer.numbers for layer in layers}
    rounded = {"k_d": kept["k_d"], "k_s": kept["k_s"], "normal": unfolded(kept["geometry"][..., :2])}
    values = {
        name: rounded[name][..., : value.shape[-1]] if name in rounded else value for name, value in maps.values.items()
    }
    beyond = maps.unexplained
    if beyond is not None:
        parts = [kept[name] for name in kept if name.startswith("beyond")]
        each = np.zeros_like(beyond.parts).reshape(*maps.status.shape, -1, len(beyond.interpolation.given[0]))
        each[..., : len(parts)] = np.stack(parts, -1)[..., : each.shape[2], :]
        beyond = beyond._replace(parts=each.reshape(beyond.parts.shape))
    page, inside, off = dataclasses.replace(maps, values=values, unexplained=beyond), maps.status != OUTSIDE, []
    every = range(len(maps.scene.lights))
    for i in every[:: -(-len(every) // FEW)]:
        drawn, own = (srgb_encode(np.clip(of.shade(lit=i)[inside] / white, 0.0, 1.0)) for of in (page, maps))
        off.append(255.0 * np.abs(drawn - own))
    nine, most = np.quantile(np.concatenate(off), (0.9, 0.99))
    return f"{nine:.1f} steps of 255 at 90 % of the texels, {most:.1f} at 99 %"

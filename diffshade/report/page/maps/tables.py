"""Tables: what the page says of the maps, as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ....texels.maps import TexelMaps
from ....texels.status import OUTSIDE
from ..tables import PageTable
from .layers import Layer, thinned, unfolded
from .numbers import Numbers


def lead(maps: TexelMaps) -> str:
    """Return a sentence on how much is known."""
    inside = int((maps.status != OUTSIDE).sum())
    known, determined = int(maps.known.sum()), int(maps.determined.sum())
    shares = [f"{100 * part / inside:.0f}\u202f%" for part in (known, determined)]
    highlight = f", the highlight too at {shares[1]}" if determined else ", the highlight at none"
    return f"Colour and normal are known at {shares[0]} of its texels{highlight}. Every number has an error."


def facts(maps: TexelMaps, fitted: int, left_out: int, off: Float[np.ndarray, " n"]) -> list[tuple[str, str]]:
    """Return the figures at the top, with names; `off` are the relative errors of predictions."""
    height, width = maps.status.shape
    found = [("pixels", f"{width} × {height}")]
    if fitted:
        found.append(("photographs", f"{fitted} + {left_out} left out" if left_out else f"{fitted}"))
    if "normal" in maps.errors and maps.known.any():
        error = np.median(maps.errors["normal"][maps.status != OUTSIDE])  # of all texels: those known flatter
        found.append(("error of the normals", f"{error:.2g}°" if np.isfinite(error) else "unknown at most texels"))
    if left_out:
        found.append(("photographs left out, off by", f"{100 * np.nanmedian(off):.2g}\u202f%"))
    return found


def remarks(stage: dict[str, Any]) -> list[str]:
    """Return what the live picture lacks."""
    missing = [view["name"] for view in stage["views"] if not view["complete"]]
    return [f"The live picture has a light at infinity in place of those of {', '.join(missing)}."] if missing else []


def packed(numbers: Numbers, layers: Sequence[Layer], off_by: str | None) -> PageTable:
    """Return how finely each number is kept, and by how much the picture differs."""
    inside, rows = numbers.inside, []
    for layer in layers:
        kept, bits = layer.numbers, layer.channels[0].bits
        if layer.name == "geometry":
            off = np.linalg.norm(unfolded(kept[..., :2]) - numbers.normal, axis=-1)[inside].max()
            rows.append(("normal", f"2 × {bits}", f"{np.rad2deg(off):.2g}°"))
            if numbers.height is not None:
                rows.append(("height", f"{bits}", f"{np.abs(kept[..., 2] - numbers.height)[inside].max():.2g}"))
        elif layer.name in ("k_d", "k_s"):
            rows.append((layer.name, f"3 × {bits}", f"{np.abs(kept - getattr(numbers, layer.name))[inside].max():.2g}"))
        elif layer.name == "index":
            off = np.abs(kept[..., 0] / np.maximum(numbers.n_s, 1e-12) - 1.0)[inside & (numbers.n_s > 0.0)]
            rows.append(("n_s", f"{bits}", f"{100 * off.max(initial=0.0):.2g} %"))
    if numbers.beyond is not None:
        parts = [layer for layer in layers if layer.name.startswith("beyond")]
        bits = f"{len(parts)} of {numbers.beyond.shape[-1]} parts, 3 × {parts[0].channels[0].bits}"
        rows.append(("light beyond the model", bits, _off_beyond(numbers, parts)))
    if off_by is not None:
        rows.append(("picture", "", off_by))
    return PageTable(("number", "bits", "largest difference from the maps"), tuple(rows), ())


def _off_beyond(numbers: Numbers, parts: Sequence[Layer]) -> str:
    """Return the largest difference of a part, relative to its largest number."""
    assert numbers.beyond is not None
    step = parts[0].coarser
    kept, inside = thinned(numbers.beyond, step), thinned(numbers.inside, step)
    off = [np.abs(part.numbers - kept[..., k])[inside].max() / part.channels[0].high for k, part in enumerate(parts)]
    coarse = f"; one for {step} × {step} texels" if step > 1 else ""
    return f"{100 * max(off):.2g} % of the largest{coarse}"

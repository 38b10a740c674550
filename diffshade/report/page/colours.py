"""Colours of numbers: two maps of matplotlib's at evenly spaced numbers, between which they are straight."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

# from low to high: viridis (Smith and van der Walt 2015); from negative to positive: RdBu of ColorBrewer, reversed
LOW_TO_HIGH = (
    "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 "
    "fde725"
)
BELOW_TO_ABOVE = "053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f"


def colours_of(which: str, count: int) -> UInt8[np.ndarray, "count 3"]:
    """Return so many colours of a map, evenly spaced from its first to its last."""
    known = np.array([list(bytes.fromhex(colour)) for colour in which.split()])
    at, places = np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(known))
    return np.rint(np.stack([np.interp(at, places, channel) for channel in known.T], -1)).astype(np.uint8)

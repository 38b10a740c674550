"""Masks: which pixels count, from arrays of any type by one rule."""

from __future__ import annotations

import os
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from .arrays import numbers
from .fields import Array, is_concrete

Mask = Bool[np.ndarray, "h w"]
MOST = 2.0  # of a mask of floats: resampling overshoots 1 by less, and bytes as floats pass it
PLAIN_MODES = ("1", "L", "LA", "RGB", "RGBA", "F", "I", "I;16")  # of Pillow, whose numbers are levels


def as_mask(mask: Any, name: str = "mask") -> Bool[Array, "..."]:
    """Return a mask as booleans, True where pixels count, by the rule that `read_mask` has for files.

    Booleans stay what they are. Whole numbers that are all 0 or 1 are False and True; other unsigned ones are True
    from half of their type's range up (128 of 255), floats from .5. Of a last axis of channels, alpha counts, or, where
    it is opaque everywhere or there is none, the mean colour.

    Args:
        mask: An array or an image of Pillow, (H, W) or (H, W, C) with C from 1 to 4.
        name: What it is, for messages.

    Returns:
        The mask, (H, W); an array of another shape keeps it, for the caller to refuse. A JAX array of booleans or
        floats stays one.

    Raises:
        TypeError: It is no array of real numbers, such as a path, or whole numbers that are traced.
        ValueError: Its values are not those of a mask.
    """
    if isinstance(mask, str | os.PathLike):
        raise TypeError(f"{name} must be an array; got the path {os.fspath(mask)!r}. Read it with ds.read_mask(path).")
    mode = mask.mode if hasattr(mask, "getbands") else "L"  # a memory map has a mode too
    if mode not in PLAIN_MODES:
        raise TypeError(
            f"{name} must hold levels; got an image of Pillow of the mode {mode!r}. Convert it with image.convert('L')."
        )
    array = numbers(name, mask)
    half = _half(array, name)
    if array.dtype.kind in "iu":
        array = np.asarray(array)
    if array.ndim == 3 and array.shape[2] in (2, 4):
        alpha = array[..., -1] >= half
        array = array[..., :-1]
        if not is_concrete(alpha):
            return jnp.where(alpha.all(), array.mean(-1) >= half, alpha)
        if not alpha.all():
            return alpha
    if array.ndim == 3 and array.shape[2] in (1, 3):
        return array.mean(-1) >= half
    return array if array.dtype == bool else array >= half


def _half(array: Any, name: str) -> float:
    """Return the level from which an array counts; refuse values that no mask has."""
    floats = jnp.issubdtype(array.dtype, jnp.floating)
    if array.dtype == bool or array.size == 0 or (floats and not is_concrete(array)):
        return 0.5
    if not is_concrete(array):
        raise TypeError(
            f"{name} must be booleans or floats in jax.grad, jit or vmap; got {array.dtype}. Make it boolean outside."
        )
    if floats and not (finite := np.isfinite(array)).all():
        first = tuple(int(i) for i in np.argwhere(~finite)[0])
        at = " at row {}, column {}".format(*first) if array.ndim > 1 else ""
        raise ValueError(f"{name} must be finite; got {array[first]}{at}. Give 0 or 1.")
    low, high = array.min(), array.max()
    if floats and high > MOST:
        raise ValueError(
            f"{name} of {array.dtype} must be between 0 and 1; got {float(high):g}. Divide it by its full range, or "
            "give booleans."
        )
    if floats or (low >= 0 and high <= 1):
        return 0.5
    top = jnp.iinfo(array.dtype).max
    if array.dtype.kind != "u" or high <= top // 2:
        unsigned = f", or reach half of the range of {array.dtype}, {top // 2 + 1}" * (array.dtype.kind == "u")
        raise ValueError(
            f"{name} of {array.dtype} must be 0 and 1{unsigned}; got {low} to {high}. Give booleans, for example "
            "array > 0."
        )
    return top / 2

"""Array-likes: arrays of other libraries as NumPy's, and what they carry besides their numbers."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclasses.dataclass(frozen=True)
class Loaded:
    """Stands for an array-like that carries more than numbers, for a check that knows the field's name to refuse."""

    said: str


def is_number(dtype: Any) -> bool:
    """Whether arrays of a type hold real numbers; NumPy does not say it of bfloat16 and its like, JAX does."""
    known = np.issubdtype(dtype, np.number) or jnp.issubdtype(dtype, np.number)
    return bool(known) and not np.issubdtype(dtype, np.complexfloating)


def plain(value: Any) -> np.ndarray:
    """Return an array-like as a NumPy array of its own type, without what NumPy would drop in silence.

    Labels (pandas, xarray) are dropped: values count by their position.

    Raises:
        TypeError: A value is masked, or in a unit; the end of a sentence that begins with a name.
        ValueError: Its rows have different lengths.
    """
    if said := _load_of(value):
        raise TypeError(f"must be plain numbers; got {said}")
    return np.asarray(getattr(value, "magnitude", value))  # pint warns where it is asked for an array


def check_load(name: str, value: Any) -> None:
    """Refuse an array-like of which a value is masked, or in a unit."""
    if said := _load_of(value):
        raise TypeError(f"{name} must be plain numbers; got {said}")


def check_no_bytes(name: str, value: Any) -> None:
    """Refuse the bytes of an image file, which are not the numbers that they stand for."""
    if (said := bytes_in(value)) and np.ndim(value) > 1:
        raise TypeError(f"{name} {said}")


def bytes_in(value: Any) -> str:
    """Return what is wrong with the bytes of an image file: the end of a sentence that begins with a name; or empty."""
    try:
        kind = value.dtype if isinstance(value, jax.Array) else plain(value).dtype
    except (TypeError, ValueError):  # no plain numbers, which is refused elsewhere
        return ""
    if kind not in (np.uint8, np.uint16):
        return ""
    return (
        f"must hold the numbers themselves; got whole numbers of {kind}. Read the file with read_image, or divide by "
        f"{np.iinfo(kind).max}."
    )


def _load_of(value: Any) -> str:
    """Return what an array-like carries besides its numbers, and the remedy; empty where it is nothing."""
    if isinstance(value, list | tuple):
        return next((said for item in value if (said := _load_of(item))), "")
    if isinstance(value, np.ma.MaskedArray):
        hidden = np.ma.count_masked(value)
        return (
            f"a masked array in which {hidden} of {value.size} values are masked. Give array.filled(number), or "
            "array.data, with mask=~array.mask where a mask can be given."
        ) * bool(hidden)
    unit = f"{getattr(value, 'unit', getattr(value, 'units', ''))}"  # of astropy; of pint, unyt and xarray
    if unit in ("", "1", "dimensionless"):
        return ""
    return f"numbers in the unit {unit}. Give the numbers alone (.value, .magnitude), in the scene's units."


def numbers(name: str, value: Any) -> Any:
    """Return the real numbers of an array-like, of their own type: a JAX array as it is, else a NumPy array.

    Args:
        name: What they are, for messages.
        value: The array-like.

    Raises:
        TypeError: They are no real numbers, or carry more than numbers.
    """
    array = value if isinstance(value, jax.Array) else named_plain(name, value)
    if array.dtype != bool and not is_number(array.dtype):
        raise TypeError(
            f"{name} must be an array of real numbers; got {type(value).__name__} of {array.dtype}. Give a NumPy array."
        )
    return array


def named_plain(name: str, value: Any) -> np.ndarray:
    """Return what `plain` does; raise one TypeError that begins with a name."""
    try:
        return plain(value)
    except TypeError as error:
        raise TypeError(f"{name} {error}") from None
    except ValueError:
        raise TypeError(f"{name} must be an array of numbers; got rows of different lengths. Correct it.") from None


def float64_of(name: str, value: Any) -> np.ndarray:
    """Return the real numbers of an array-like as NumPy float64; raise as `numbers` does."""
    return np.asarray(numbers(name, value), np.float64)

"""Bands: scenes of other channels than red, green and blue, such as 31 samples of the spectrum.

No band acts on another. A scene of several bands is therefore as many grey scenes, over which JAX vectorises: what does
not depend on the band, such as where rays meet surfaces, cosines and their powers, is computed once. Scenes of three
channels do not come here.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import (
    MOST_BANDS,
    WIDTHS,
    Array,
    Numbers,
    as_coefficient,
    as_colour,
    as_exponent,
    as_surround,
    is_concrete,
)
from ..core.words import count
from .vectors import Vec3

RGB, XYZ = ("r", "g", "b"), ("x", "y", "z")
CONVERTERS = (as_colour, as_surround, as_coefficient, as_exponent)
T = TypeVar("T")
Path = tuple[str | int, ...]


def as_bands(bands: int | Numbers | Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of bands, from how many they are, their wavelengths in nm, or their names; () for RGB.

    Raises:
        ValueError: There are no bands, or more than `MOST_BANDS`; a wavelength is not above 0; a name is used
            twice, is that of an axis, or has a space, comma, slash or equals sign in it.
        TypeError: They are neither a number, nor numbers or names.
    """
    if bands is None or (isinstance(bands, tuple) and not bands):
        return ()
    if isinstance(bands, int | np.integer) and not isinstance(bands, bool):
        names = tuple(f"band{i + 1}" for i in range(min(bands, MOST_BANDS + 1)))
    else:
        each = list(bands) if np.ndim(bands) == 1 else []  # pyright: ignore[reportArgumentType]
        words = all(isinstance(band, str) for band in each)
        numbers = all(isinstance(band, int | float | np.number) and not isinstance(band, bool) for band in each)
        if not each or not (words or numbers):
            raise TypeError(
                f"Scene.bands must be a number of bands, their wavelengths in nm, or their names; got {bands!r}. Give "
                "for example np.arange(400, 701, 10)."
            )
        if numbers and not (np.isfinite(each).all() and np.min(each) > 0):
            raise ValueError(f"Scene.bands must be wavelengths above 0 nm; got {np.min(each):g}. Give nanometres.")
        names = tuple(band if words else f"{band:.10g}nm" for band in each)
    if not 1 <= len(names) <= MOST_BANDS:
        raise ValueError(
            f"Scene.bands must be 1 to {MOST_BANDS} bands; got {bands if np.ndim(bands) == 0 else len(names)}. Take "
            "every other one, or means of several."
        )
    for name in names:
        if names.count(name) > 1 or not name or any(letter in name for letter in " ,=/") or name in XYZ:
            raise ValueError(
                f"Scene.bands must have different names, without spaces, commas, '=' or '/', and not x, y or z; got "
                f"{name!r}. Rename it."
            )
    return names


def colours(tree: Any, path: Path = ()) -> Iterator[tuple[Path, Array]]:
    """Yield every colour of a tree of modules, with its channels last: where it is, and its numbers.

    A number that is the same in all channels, such as most n_s, is none.
    """
    if isinstance(tree, tuple):
        for i, item in enumerate(tree):
            yield from colours(item, (*path, i))
    elif isinstance(tree, eqx.Module):
        for name, is_colour in _fields(type(tree)):
            value = getattr(tree, name)
            if isinstance(value, eqx.Module | tuple):
                yield from colours(value, (*path, name))
            elif is_colour and np.ndim(value) and not (name == "n_s" and np.shape(value)[-1] == 1):
                yield (*path, name), value


@functools.cache
def _fields(cls: type) -> tuple[tuple[str, bool], ...]:
    """Return the fields of a class that may hold colours, and whether each is one."""
    of = [field for field in dataclasses.fields(cls) if not field.metadata.get("static")]
    return tuple((f.name, f.metadata.get("converter") in CONVERTERS or "colour" in f.metadata) for f in of)


def _at(tree: Any, path: Path) -> Any:
    for part in path:
        tree = tree[part] if isinstance(part, int) else getattr(tree, part)
    return tree


def _with(tree: T, paths: Sequence[Path], values: Sequence[Any]) -> T:
    """Return a tree with other colours at some places."""
    return eqx.tree_at(lambda of: [_at(of, path) for path in paths], tree, list(values)) if paths else tree


def widened(tree: T, bands: int) -> T:
    """Return a tree with every grey, a colour of three equal numbers, as one of as many bands."""
    places = list(colours(tree))
    return _with(tree, [path for path, _ in places], [of_bands(value, bands) for _, value in places])


def wavelength(band: str) -> float | None:
    """Return the wavelength that a band is named by, nm; None for one with another name."""
    found = re.fullmatch(r"(\d+\.?\d*)nm", band)
    return float(found[1]) if found else None


def of_bands(colour: Any, bands: int) -> Any:
    """Return a colour as one of as many bands where it is grey, else as it is."""
    if np.shape(colour)[-1:] != (3,) or not is_concrete(colour):
        return colour
    numbers = np.asarray(colour)
    return colour[..., :1].repeat(bands, -1) if (numbers == numbers[..., :1]).all() else colour


def of_channels(scene: T, channels: Sequence[int]) -> T:
    """Return the scene of red, green and blue that three channels of a scene of bands make."""
    places = list(colours(scene))
    three = _with(scene, [path for path, _ in places], [value[..., list(channels)] for _, value in places])
    return dataclasses.replace(three, bands=())  # pyright: ignore[reportArgumentType]


def check_widths(tree: Any, bands: tuple[str, ...]) -> None:
    """Refuse a colour of another number of channels than the scene's."""
    wanted = len(bands) or 3
    for path, value in colours(tree):
        if (got := np.shape(value)[-1]) != wanted and got in WIDTHS:  # others are refused by their own module
            name = ".".join(map(str, path))
            if not bands:
                raise ValueError(
                    f"{name} has {got} numbers, but a scene without bands has red, green and blue. Give one number "
                    f"(grey) or three (R, G, B), or Scene(..., bands={got}) or their wavelengths in nm."
                )
            remedy = f"Give one number (grey) or {wanted}"
            if not is_concrete(value) and got == 3:  # whether a traced colour is grey cannot be seen
                remedy = f"Within jax.grad or jit, multiply one number by np.ones({wanted})"
            raise ValueError(
                f"{name} has {got} numbers, but the scene has {count(wanted, 'band')}, {bands[0]} to {bands[-1]}. "
                f"{remedy}."
            )


def in_bands(trace: Callable[[T], Vec3], scene: T, *, axis: int = 0) -> Float[Array, "..."]:
    """Return what is traced of a scene, band by band.

    Args:
        trace: A function of a grey scene, of which the first of three equal channels is returned.
        scene: The scene, whose colours have their bands last.
        axis: The axis of the result along which the bands are.
    """
    places = list(colours(scene))
    paths = [path for path, _ in places]

    def of_band(values: list[Array]) -> Array:
        greys = [jnp.broadcast_to(value[..., None], (*value.shape, 3)) for value in values]
        return trace(_with(scene, paths, greys)).x

    return jax.vmap(of_band, -1, axis)([jnp.asarray(value) for _, value in places])


def refuse_bands(what: str, bands: Sequence[str], instead: str) -> None:
    """Refuse a scene of other than three channels where something knows red, green and blue alone."""
    if len(bands) not in (0, 3):
        raise ValueError(
            f"{what} knows red, green and blue; this scene has {count(len(bands), 'band')}, {bands[0]} to {bands[-1]}. "
            f"{instead}"
        )


def check_rgb(name: str, tree: Any) -> None:
    """Refuse a material or light of bands where colours are red, green and blue."""
    for path, value in colours(tree):
        if (got := np.shape(value)[-1]) != 3 and got in WIDTHS:
            raise ValueError(
                f"{name} must have colours of red, green and blue here; its {'.'.join(map(str, path))} has {got} "
                "numbers. Choose three of them, or convert them to RGB."
            )

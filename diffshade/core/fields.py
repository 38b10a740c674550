"""Fields: arguments as typed become NumPy float64 arrays of one shape, and are checked under their names."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import ArrayLike, Float

from .arrays import Loaded, bytes_in, is_number, plain
from .words import with_article

if TYPE_CHECKING:
    Array: TypeAlias = np.ndarray | jax.Array
else:  # where no axis is left NumPy returns a scalar in place of an array
    Array: TypeAlias = np.ndarray | np.generic | jax.Array
Scalar: TypeAlias = Float[Array, ""]
Colour: TypeAlias = Float[Array, "_"]  # red, green and blue, or the bands of a scene
Vector: TypeAlias = Float[Array, "3"]
Pair: TypeAlias = Float[Array, "2"]
Exponent: TypeAlias = Float[Array, ""] | Float[Array, "_"]
# A Colour (for n_s an Exponent), an array of these over the pixels, a pattern (patterns.py), or None; Any, so that a
# type checker takes it for what one knows it is.
Coefficient: TypeAlias = Any
Numbers: TypeAlias = ArrayLike | Sequence[Any]  # what people type


def as_array(value: Numbers) -> Any:
    """Keep a JAX array; make anything else NumPy float64.

    `jnp.asarray` would round 0.1 to float32, keep 40 an integer that `grad` refuses, and start a backend. What is no
    array of numbers is handed on as it is, for the check, which knows the field's name, to refuse.
    """
    if isinstance(value, jax.Array):
        return value if jnp.issubdtype(value.dtype, jnp.floating) else value.astype(float)
    try:
        array = plain(value)
    except TypeError as error:
        return Loaded(f"{error}")
    except ValueError:  # rows of different lengths
        return value
    # a copy: a caller's later edits must not reach a frozen scene
    return array.astype(np.float64) if array.dtype.kind in "biuf" or is_number(array.dtype) else value


def as_float64(leaf: object) -> np.ndarray:
    """Make a leaf of a module a NumPy array: of float64, but a mask stays one."""
    array = np.asarray(leaf)
    return array if array.dtype == bool else array.astype(np.float64)


def as_scalar(value: Numbers | None) -> Any:
    """Make one number; None, where it stands for one that is left out, stays what it is."""
    return value if value is None else as_array(value)


def as_pair(value: Numbers | None) -> Any:
    """Make two numbers, a column and a row; None stays what it is."""
    return value if value is None else as_array(value)


def as_vector(value: Numbers) -> Any:
    """Make three numbers, x, y and z."""
    return as_array(value)


def as_exponent(value: Numbers | Checked) -> Any:
    """Make one number for all channels, or three, one a channel; or these for each pixel, along a last axis."""
    if isinstance(value, Checked):
        return value
    if (said := bytes_in(value)) and np.ndim(value) > 1:  # a single whole number is an exponent
        return Loaded(said)
    array = as_array(value)
    return array[..., None] if getattr(array, "ndim", 0) == 2 else array


def as_colour(value: Numbers | None) -> Any:
    """Make a colour; a single number means grey. None, where it means no such term, stays what it is."""
    if value is None:
        return value
    if said := bytes_in(value):
        return Loaded(said)
    colour = as_array(value)
    if getattr(colour, "shape", None) in ((), (1,)) and is_number(colour.dtype):
        return colour * np.ones(3) if isinstance(colour, np.ndarray) else colour.reshape(()).repeat(3)
    return colour


def as_surround(value: Numbers) -> Any:
    """Make a scene's own colour, which the scene has made one of its channels before."""
    return as_array(value)


def as_coefficient(value: Numbers | Checked | None) -> Any:
    """Make a colour, or a colour for each pixel; a pattern stays one, and None, where it means no such term, too."""
    if value is None or isinstance(value, Checked):
        return value
    if bytes_in(value):
        return as_colour(value)
    array = as_array(value)
    if getattr(array, "ndim", 0) == 2:
        array = array[..., None]
    if getattr(array, "ndim", 0) == 3 and array.shape[2] == 1:
        return array.repeat(3, -1)
    return as_colour(array)


def as_normals(value: Numbers | Checked | None) -> Any:
    """Make a unit vector for each pixel; a pattern stays one, and None, where it means the surface's own, too."""
    return value if value is None or isinstance(value, Checked) else as_array(value)


RGB, MOST_BANDS = 3, 40
WIDTHS = (RGB, 1, 2, *range(RGB + 1, MOST_BANDS + 1))  # of R, G, B, of one band, or of the bands of a scene
_COLOURS = tuple((width,) for width in WIDTHS)
_MAPS = "an array (H, W) or (H, W, 3) over the pixels"
_KINDS: dict[Any, tuple[tuple[tuple[int, ...], ...], str, str]] = {
    as_scalar: (((),), "a number", "Give one number."),
    as_pair: (((2,),), "a pair of numbers", "Give two numbers (column, row)."),
    as_vector: (((3,),), "a vector of 3 numbers", "Give three numbers (x, y, z)."),
    as_colour: (_COLOURS, "a colour of 1 or 3 numbers", "Give one number (grey) or three (R, G, B)."),
    as_surround: (_COLOURS, "a colour of 1 or 3 numbers", "Give one number (grey) or three (R, G, B)."),
    as_coefficient: (_COLOURS, "a colour of 1 or 3 numbers", f"Give one number (grey), three (R, G, B), or {_MAPS}."),
    as_exponent: (
        ((), *(of for of in _COLOURS if of != (1,))),
        "1 or 3 numbers",
        f"Give one number, three (R, G, B), or {_MAPS}.",
    ),
    as_normals: ((), "an array (H, W, 3)", "Give a unit vector for each pixel."),
}
_MAPPED = tuple((RGB, width) for width in WIDTHS)
_OVER_PIXELS = {as_coefficient: _MAPPED, as_exponent: _MAPPED, as_normals: ((3, 3),)}


def is_over_pixels(value: Any) -> bool:
    """Whether a value of a material is an array over the pixels."""
    return isinstance(value, Array) and np.ndim(value) > 1


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What a fit knows of a field whose numbers can be free; it stands in the field's metadata, by `parameter`."""

    role: str = ""
    """"reflection", "transmission", "exponent", "attenuation", "amplitude" (of an attenuation, which the intensity
    stands for), "light", "camera", "position", "direction", "edge", "index", "factor" (of two numbers, no field);
    empty where only the number is known."""
    linear: bool = False
    """Whether the image is linear in it together with all others of which this is said."""
    logarithmic: bool = False
    """Whether it is solved for as its logarithm: its error is proportional to it."""
    start: float | None = None
    """The value before any search; None for the scene's."""
    fit_range: tuple[float, float] | None = None
    """The range in a fit, where it is narrower than the field's."""
    gauge: int = 0
    """The sign of its change along a scale gauge: 1 for reflection and attenuation, -1 for light, 0 for neither.

    k x 2 with I / 2 changes no pixel, nor does k x 2 with an attenuation x 2, by which light is divided.
    """
    by_own_name: bool = False
    """Whether only its own name frees it, and not that of what holds it: most scenes do without."""
    search: tuple[float, ...] = ()
    """Values that the search tries, in this order, where the image is not linear in it; empty for none."""
    reach: float = 0.0
    """How far the first step of an approach from coarse to fine may go (`start_search.approach`); 0 for none."""


def parameter(
    role: str = "", *, lower: float | int | None = None, upper: float | int | None = None, **of_fit: Any
) -> dict[str, Any]:
    """Return the metadata of a field that can be free.

    Args:
        role: What it is; see `Parameter`. A direction must not be the zero vector.
        lower: The least value; None for no bound.
        upper: The largest value; None for no bound.
        of_fit: Other fields of `Parameter`.
    """
    ends = {name: end for name, end in (("lower", lower), ("upper", upper)) if end is not None}
    return {**ends, "nonzero": role == "direction", "parameter": Parameter(role, **of_fit)}


def parameter_of(field: dataclasses.Field) -> Parameter:
    """Return what a fit knows of a field."""
    return field.metadata.get("parameter", Parameter())


class Checked(eqx.Module):
    """A module whose fields are checked when it is made, and again by `check`.

    A field says its range in its metadata: `lower` and `upper`, or `above` and `below` where an end is not in it; and
    `nonzero` for a vector other than zero. Tracers pass: inside `jit` and `grad` there is nothing to look at.
    """

    def __check_init__(self) -> None:
        for field in dataclasses.fields(self):
            kind = _KINDS.get(field.metadata.get("converter"))
            value = getattr(self, field.name)
            left_out = value is None and field.default is None
            if kind is None or left_out:
                continue
            name = f"{type(self).__name__}.{field.name}"
            if isinstance(value, Checked) and field.metadata["converter"] in _OVER_PIXELS:
                for inner in (f for f in dataclasses.fields(value) if f.metadata.get("converter") is as_colour):
                    _check_field(f"{name}.{inner.name}", getattr(value, inner.name), kind, field.metadata)
            else:
                over = _OVER_PIXELS.get(field.metadata["converter"], ())
                _check_field(name, value, kind, field.metadata, over)
        type(self).check_together(self)  # `self.check_together` would make a module of the bound method

    def check_together(self) -> None:
        """Check what no single field can tell, after each field for itself; classes say what."""

    def __repr__(self) -> str:
        """Return numbers and colours as one would type them; of larger arrays, and within `jit`, the shape alone."""
        return eqx.tree_pformat(jax.tree.map(_as_typed, self))


def _as_typed(value: Any) -> Any:
    """Return a number as a float, and numbers in a row as a tuple, with the digits that their type holds."""
    if np.ndim(value) > 1 or np.size(value) > MOST_BANDS or not is_concrete(value):
        return value
    numbers = np.asarray(value)
    if numbers.dtype == np.float32:
        numbers = np.array([float(str(one)) for one in numbers.ravel()]).reshape(numbers.shape)
    return numbers.item() if numbers.ndim == 0 else tuple(numbers.tolist())


def is_concrete(*values: Any) -> bool:
    """Whether every value holds numbers that can be looked at now: none is a tracer."""
    return not any(isinstance(v, Tracer) for v in values)


def _check_field(
    name: str, value: Any, kind: tuple, metadata: Mapping[str, Any], over_pixels: Sequence[tuple[int, int]] = ()
) -> None:
    shapes, noun, remedy = kind
    if isinstance(value, Tracer):
        return
    if isinstance(value, Loaded):
        raise TypeError(f"{name} {value.said}")
    # a plain number too: arithmetic on the leaves of a scene makes NumPy's and Python's scalars
    if not isinstance(value, Array | np.number | int | float) or not is_number(np.asarray(value).dtype):
        raise TypeError(f"{name} must be {noun}; got {in_short(value)}. {remedy}")
    shape = np.shape(value)
    mapped = any((len(shape), *shape[-1:]) == of for of in over_pixels)
    if len(shape) == 1 and shape[0] > MOST_BANDS and (MOST_BANDS,) in shapes:
        raise ValueError(
            f"{name} must have at most {MOST_BANDS} bands; got {shape[0]}. Take every other one, or means of several."
        )
    if shape not in shapes and not mapped:
        raise ValueError(f"{name} must be {noun}; got shape {shape}. {remedy}")
    numbers, where = _as_numpy(value), ""
    lower, above = (metadata.get(end, -np.inf) for end in ("lower", "above"))
    upper, below = (metadata.get(end, np.inf) for end in ("upper", "below"))
    wrong = ~((numbers >= lower) & (numbers <= upper) & (numbers > above) & (numbers < below))
    if not wrong.any():
        if metadata.get("nonzero") and not np.any(numbers):
            raise ValueError(f"{name} must not be the zero vector; got [0, 0, 0]. Give a direction of any length.")
        return
    if mapped:
        row, column, _ = first = np.unravel_index(np.argmax(wrong), shape)
        numbers, where = np.asarray(numbers[first]), f" at row {row}, column {column}"
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} must be finite; got {_shown(numbers)}{where}. {remedy}")
    allowed = f"at least {lower:g}" if np.isinf(upper) else f"between {lower:g} and {upper:g}"
    if above > -np.inf:
        allowed = f"above {above:g}" + (f" and below {below:g}" if below < np.inf else "")
    raise ValueError(f"{name} must be {allowed}; got {_shown(numbers)}{where}. Give a value in that range.")


def checked_colour(name: str, value: Numbers) -> Any:
    """Make a colour that is no field of a module, and check it."""
    colour = as_colour(value)
    _check_field(name, colour, _KINDS[as_colour], {"lower": 0})
    return colour


def refuse_traced(name: str, instead: str, **given: Any) -> None:
    """Refuse to look at numbers inside `jax.grad`, `jit` or `vmap`, where there are none; say what to do instead."""
    leaves = (
        f"{start}.{jax.tree_util.keystr(path, simple=True, separator='.')} is traced"
        for start, tree in given.items()
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
        if isinstance(leaf, Tracer)
    )
    # within a jit all that JAX computes is traced, whatever it is made of
    found = next(leaves, "it was called there" if isinstance(jnp.zeros(()), Tracer) else "")
    if found:
        raise TypeError(f"{name} needs numbers, which there are none of in jax.grad, jit or vmap: {found}. {instead}")


def _as_numpy(value: Any) -> np.ndarray:
    """Return a value as an array of a type whose numbers NumPy can compare and print."""
    numbers = np.asarray(value)
    return numbers if np.issubdtype(numbers.dtype, np.number) else numbers.astype(np.float64)


def _shown(numbers: np.ndarray) -> str:
    shown = ", ".join(f"{number:.10g}" for number in np.ravel(numbers))
    return f"({shown})" if np.ndim(numbers) else shown


def in_short(value: Any) -> str:
    """Return what a message says of a value: its numbers; of a module, whose repr is long, what it is; else a repr."""
    if isinstance(value, Array) and is_number(value.dtype) and is_concrete(value):
        return _shown(_as_numpy(value))
    return with_article(type(value).__name__) if isinstance(value, eqx.Module) else repr(value)


def check_kind(name: str, value: Any, kind: type, example: str) -> None:
    """Refuse what is not of a kind: a material where a surface should be."""
    if not isinstance(value, kind):
        noun = kind.__name__.removeprefix("Abstract")
        got = f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__
        raise TypeError(f"{name} must be {with_article(noun)}; got {got}. Give for example {example}.")


def check(tree: Any) -> None:
    """Check every module of a tree again: `eqx.tree_at` and `jax.tree.map` make modules that were never checked."""
    for module in _modules(tree):
        module.__check_init__()


def _modules(tree: Any) -> Iterator[Checked]:
    if isinstance(tree, Checked):
        yield tree
        for field in dataclasses.fields(tree):
            yield from _modules(getattr(tree, field.name))
    elif isinstance(tree, tuple):
        for item in tree:
            yield from _modules(item)


def quantities(
    tree: Any, keys: tuple[str | int, ...] = ()
) -> Iterator[tuple[tuple[str | int, ...], Array, dataclasses.Field]]:
    """Yield every number, vector and colour of a tree of modules: the keys that lead to it, its value and its field.

    ("objects", 0, "material", "k_d") are such keys; arrays of a G-buffer have none, nor has what is left out (None).
    """
    if isinstance(tree, tuple):
        for i, item in enumerate(tree):
            yield from quantities(item, (*keys, i))
    elif isinstance(tree, Checked):
        for field in dataclasses.fields(tree):
            inner, value = (*keys, field.name), getattr(tree, field.name)
            known = field.metadata.get("converter") in _KINDS and not is_over_pixels(value)
            if known and value is not None and not isinstance(value, Checked):
                yield inner, value, field
            else:
                yield from quantities(value, inner)

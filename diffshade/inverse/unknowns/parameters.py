"""Parameters: which numbers of a scene and its views are unknown, what they are called, and what they may be."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from ...core.fields import Array, as_coefficient, as_colour, as_exponent, as_vector, check_kind, quantities
from ...core.words import did_you_mean
from ...model.fresnel import Dielectric
from ...model.gbuffers import GBuffer
from ...model.scenes import Scene, StackedScene, bends, stack_scene
from ..data.views import View
from .constraints import Grey, Proportional

# What a search for a start begins with, by the last segment of the name: not the scene's values, which may not be
# known. Anything else (a light's position, an intensity) begins at the scene's value.
STARTS = {"k_a": 0.3, "k_d": 0.3, "k_s": 0.3, "k_e": 0.3, "k_t": 0.5, "n_s": 10.0, "linear": 0.0, "quadratic": 0.0}
LINEAR = {"k_a", "k_d", "k_s", "k_e", "black"}  # the image is linear in them
LOGARITHMIC = {"n_s"}  # solved for as log n_s: the error of n_s is proportional to it
RANGES = {"n_s": (0.1, 1e4), "exposure": (1e-9, np.inf)}  # where the range of a fit is narrower than that of the field
COLOURS = (as_colour, as_coefficient)
DIRECTIONS = ("direction", "side")  # of which only the unit vector has a meaning
PER_VIEW = ("exposure", "black")  # numbers of a view that can be free
CHANNELS = ("r", "g", "b", "x", "y", "z")


@dataclass
class Unknown:
    """One unknown number: its name, its short name, and the (path, channel) places of the scene that hold it."""

    name: str
    quantity: str
    """The name without the channel: `k_d` of `k_d.r`."""
    lower: float
    upper: float
    start: float
    logarithmic: bool
    places: list[tuple[str, int]] = field(default_factory=list)
    products: list[Product] = field(default_factory=list)
    """Places that hold a multiple of it."""
    prior: tuple[float, float] | None = None
    """Mean and standard deviation, in the solver's coordinates, of what is known of it beforehand."""

    @property
    def kind(self) -> str:
        """The last segment of its name: `k_d`."""
        return self.quantity.split(".")[-1]

    @property
    def is_linear(self) -> bool:
        """Whether the image is linear in it."""
        return self.kind in LINEAR and "/" not in self.quantity


@dataclass(frozen=True)
class Product:
    """A place that holds `constant` times an unknown, times another one where `other` is its index."""

    path: str
    channel: int
    constant: float
    other: int | None = None
    base: tuple[str, int] | None = None
    """The known place whose value `constant` is, where it is one."""


class Setup(eqx.Module):
    """Everything that can be unknown, as compiled programs take it: the scene, and a number for each view."""

    scene: StackedScene
    exposure: Shaped[Array, " views"]
    black: Shaped[Array, " views"]


class Slots(eqx.Module):
    """Where the unknowns go: a setup of indices into the vector of their values, -1 for a known number.

    A leaf of which nothing is unknown is None, so that nothing is differentiated through it.
    """

    indices: Setup
    logarithmic: Bool[Array, " p"]
    products: tuple[Int[Array, " m"], Int[Array, " m"], Float[Array, " m"]]
    """Values beyond the unknowns: constant * one unknown * another; the index p stands for 1."""
    units: Int[Array, "u 3"]
    """The unknowns that are a unit vector together."""

    def insert(self, theta: Float[Array, " p"], setup: Setup) -> Setup:
        """Return the setup with the unknowns theta, in the solver's coordinates, at their places."""
        values = natural(theta, self.logarithmic)
        one, other, constant = self.products
        padded = jnp.concatenate([values, jnp.ones(1, values.dtype)])
        values = jnp.concatenate([values, constant * padded[one] * padded[other]])
        return jax.tree.map(
            lambda index, leaf: leaf if index is None else jnp.where(index >= 0, values[index], leaf),
            self.indices,
            setup,
            is_leaf=lambda leaf: leaf is None,
        )


def natural(theta: Float[Array, " p"], logarithmic: Bool[Array, " p"]) -> Float[Array, " p"]:
    """Return the unknowns in their own units: exp(theta) where theta is a logarithm."""
    return jnp.where(logarithmic, jnp.exp(jnp.where(logarithmic, theta, 0.0)), theta)


def coordinates(values: Float[np.ndarray, " p"], unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return values in the solver's coordinates: log n_s; the inverse of `values_at`."""
    log = logarithms(unknowns)
    return np.where(log, np.log(np.where(log, values, 1.0)), values)


def values_at(theta: Float[np.ndarray, " p"], unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return the unknowns in their own units, in NumPy; see `natural`."""
    log = logarithms(unknowns)
    return np.where(log, np.exp(np.where(log, theta, 0.0)), theta)


def coordinate_slopes(values: Float[np.ndarray, " p"], unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return the derivatives of the coordinates by the values: of log n_s 1/n_s, as d/dn_s = (1/n_s) d/dlog n_s."""
    log = logarithms(unknowns)
    return np.where(log, 1.0 / np.where(log, values, 1.0), 1.0)


def logarithms(unknowns: Sequence[Unknown]) -> Bool[np.ndarray, " p"]:
    """Return which unknowns are solved for as logarithms."""
    return np.array([unknown.logarithmic for unknown in unknowns], bool)


def find_unknowns(
    scene: Scene,
    views: Sequence[View],
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    constraints: Sequence[Grey | Proportional] = (),
    priors: Mapping[str, Sequence[Any]] | None = None,
    *,
    from_scene: bool = False,
    grey: bool = False,
) -> list[Unknown]:
    """Return the unknowns that `free` names, in the scene's order.

    A name is any run of whole segments of a dotted path (`k_d`, `material.k_d`, `objects.0`, `views.0.exposure`).
    `constant`, the gauge of an attenuation, is freed only when it is named itself, and so are k_e, eta, the period and
    axes of a pattern, the side of a measured light, and a view's numbers, which most scenes do without. `tied` makes
    one unknown of the free numbers whose paths are equal after the matched run, channel by channel. `from_scene` starts
    all at the scene's values; `grey` makes one unknown of the channels of each colour. Raises ValueError for a name
    that matches nothing, a contradictory bound, constraint or prior, or a cutoff whose edge is hard.
    """
    known = {path: (value, spec) for path, value, spec in everything(scene, views)}
    _check_object_names(scene, known)
    free, tied, bounds, priors = _names("free", free, known), _names("tied", tied, known), bounds or {}, priors or {}
    check_kind("bounds", bounds, Mapping, "{'k_s': (0, 1)}")
    check_kind("priors", priors, Mapping, "{'n_s': (50, 0.2)}")
    freed = _freed(scene, free, list(known))
    colourless = _colourless(constraints, freed, known)
    proportions = _proportions(constraints, freed, known)
    for where, names in (("tied", tied), ("constraints", [c.name for c in constraints if not _fixes(c)])):
        for name in _names(where, names, known):
            if not any(_run(name, path) is not None for path in freed):
                raise ValueError(f"{where} names '{name}', which is not free. Add it to free, or leave it out.")
    unknowns: dict[tuple[str, int], Unknown] = {}
    for path in freed:
        if path in proportions:
            continue
        value, spec = known[path]
        _check_can_be_free(path, known)
        converter = spec.metadata["converter"]
        colour = converter in COLOURS or (converter is as_exponent and np.ndim(value) == 1)
        channels = "rgb" if colour else "xyz" if converter is as_vector else ""
        quantity = next((n for name in tied if (n := _tied_name(name, path))), path)
        for c, number in enumerate(_numbers(path, value)):
            one_for_all = not channels or (colour and (grey or path in colourless))
            unknown = unknowns.setdefault(
                (quantity, 0 if one_for_all else c),
                Unknown(
                    name=quantity if one_for_all else f"{quantity}.{channels[c]}",
                    quantity=quantity,
                    lower=-np.inf,
                    upper=np.inf,
                    start=float(number) if from_scene else _start(path, number, known),
                    logarithmic=path.split(".")[-1] in LOGARITHMIC,
                ),
            )
            unknown.places.append((path, c))
    found = list(unknowns.values())
    for path, (to, factor) in proportions.items():
        found += _proportional(path, to, factor, found, known, from_scene=from_scene)
    for where, names in (("bounds", bounds), ("priors", priors)):
        for name in names:
            _check_names_an_unknown(where, name, found, freed, proportions, known)
    _shorten(found, list(known))
    for unknown in found:
        _bound(unknown, bounds, known)
        unknown.prior = _prior(unknown, priors)
    _check_directions(found)
    return found


def everything(scene: Scene, views: Sequence[View]) -> Iterator[tuple[str, Array, dataclasses.Field]]:
    """Yield every number, vector and colour that can be unknown: its dotted path, its value and its field."""
    for path, value, spec in quantities(scene):
        yield _named(path, scene), value, spec
    fields = {spec.name: spec for spec in dataclasses.fields(View)}
    for i, view in enumerate(views):
        for name in PER_VIEW:
            yield f"views.{i}.{name}", getattr(view, name), fields[name]


def slots_of(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Slots:
    """Return the places of the unknowns as a setup of indices."""
    p = len(unknowns)
    index_of = {place: j for j, unknown in enumerate(unknowns) for place in unknown.places}
    products = [(j, product) for j, unknown in enumerate(unknowns) for product in unknown.products]
    for k, (_, product) in enumerate(products):
        index_of[product.path, product.channel] = p + k

    def indices(name: str, leaf: Array) -> np.ndarray:
        flat = [index_of.get((name, c), -1) for c in range(np.size(leaf))] if np.size(leaf) <= 3 else [-1]
        return np.broadcast_to(np.reshape(flat, np.shape(leaf) if np.size(leaf) <= 3 else ()), np.shape(leaf))

    leaves, structure = jax.tree_util.tree_flatten_with_path(without_gbuffers(scene))
    stacked = stack_scene(jax.tree.unflatten(structure, [indices(_name(path, scene), leaf) for path, leaf in leaves]))
    per_view = [np.array([index_of.get((f"views.{i}.{name}", 0), -1) for i in range(len(views))]) for name in PER_VIEW]
    others = [p if product.other is None else product.other for _, product in products]
    return Slots(
        jax.tree.map(lambda index: index if (index >= 0).any() else None, Setup(stacked, *per_view)),
        logarithms(unknowns),
        (
            np.array([j for j, _ in products], int),
            np.array(others, int),
            np.array([product.constant for _, product in products], float),
        ),
        np.array(unit_vectors(unknowns), int).reshape(-1, 3),
    )


def without_gbuffers(scene: Scene) -> Scene:
    """Return the scene with no surface where a G-buffer is: its points come with the pixels, and none is unknown."""
    for i, item in enumerate(scene.objects):
        if isinstance(item.surface, GBuffer):
            scene = eqx.tree_at(lambda s, i=i: s.objects[i].surface, scene, None)
    return scene


def unit_vectors(unknowns: Sequence[Unknown]) -> list[list[int]]:
    """Return the indices of the unknowns that are a unit vector together: a direction's x, y and z."""
    by_quantity: dict[str, list[int]] = {}
    for j, unknown in enumerate(unknowns):
        if unknown.kind in DIRECTIONS:
            by_quantity.setdefault(unknown.quantity, []).append(j)
    return list(by_quantity.values())


def put_back(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], values: Float[np.ndarray, " p"]
) -> tuple[Scene, tuple[View, ...]]:
    """Return the scene and the views with the values of the unknowns, in their own units, as NumPy float64."""
    changed: dict[str, np.ndarray] = {}
    known = {path: np.asarray(value, np.float64) for path, value, _ in everything(scene, views)}

    def put(path: str, c: int, value: float) -> None:
        changed.setdefault(path, known[path].copy()).reshape(-1)[c] = value

    for unknown, value in zip(unknowns, values, strict=True):
        for path, c in unknown.places:
            put(path, c, value)
        for product in unknown.products:
            put(
                product.path,
                product.channel,
                product.constant * value * (1.0 if product.other is None else values[product.other]),
            )
    leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
    new_scene = jax.tree.unflatten(structure, [changed.get(_name(path, scene), leaf) for path, leaf in leaves])
    new_views = []
    for i, view in enumerate(views):
        for name in PER_VIEW:
            if (path := f"views.{i}.{name}") in changed:
                view = eqx.tree_at(lambda v, name=name: getattr(v, name), view, changed[path])
        new_views.append(view)
    return new_scene, tuple(new_views)


def values_in(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return what the unknowns are in a scene, in their own units; of tied numbers, the first; NaN for 0/0."""
    known = {path: _numbers(path, value) for path, value, _ in everything(scene, views)}
    values = np.array([known[u.places[0][0]][u.places[0][1]] if u.places else np.nan for u in unknowns])
    for j, unknown in enumerate(unknowns):
        if not unknown.places:
            bases = [x.constant * (1.0 if x.other is None else values[x.other]) for x in unknown.products]
            base, product = max(zip(bases, unknown.products, strict=True), key=lambda pair: abs(pair[0]))
            values[j] = known[product.path][product.channel] / base if base else np.nan
    return values


def _name(path: Any, scene: Scene) -> str:
    return _named(jax.tree_util.keystr(path, simple=True, separator="."), scene)


def _named(path: str, scene: Scene) -> str:
    """Return a dotted path with an object's own name, where it has one, in place of its number."""
    head, _, rest = path.partition(".")
    number, _, rest = rest.partition(".")
    name = scene.objects[int(number)].name if head == "objects" else ""
    return f"objects.{name}.{rest}" if name else path


def _numbers(path: str, value: Array) -> Float[np.ndarray, " n"]:
    """Return the numbers of a value; of a direction those of the unit vector, the only part that has a meaning."""
    numbers = np.ravel(np.asarray(value, np.float64))
    return numbers / np.linalg.norm(numbers) if path.split(".")[-1] in DIRECTIONS else numbers


def _names(where: str, names: Iterable[str], known: Mapping[str, Any]) -> tuple[str, ...]:
    """Check that each name is a run of segments of some path."""
    names = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, Iterable) else (names,)
    segments = {segment for path in known for segment in path.split(".") if not segment.isdigit()}
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"{where} must hold names of parameters; got {name!r}. Give for example 'k_d'.")
        if all(segment.isdigit() for segment in name.split(".")):
            raise ValueError(
                f"{where} names '{name}', a number alone. Name what it counts, for example 'lights.{name}'."
            )
        if not any(_run(name, path) is not None for path in known):
            head, _, last = name.rpartition(".")
            of_a_material = head.endswith("material") and any(_run(head, path) is not None for path in known)
            # which a scene has only where they are given
            if last in ("k_t", "eta") and (of_a_material or last not in segments):
                raise ValueError(
                    f"{where} names '{name}', but no such material has one. Give it, for example {last}="
                    f"{'0.5' if last == 'k_t' else '1.5'}."
                )
            short = {path.partition(".")[2] for path in known}  # ball.material.k_d
            options = segments | set(known) | {path for path in short if not path[:1].isdigit()}
            if fuller := [path for path in options if _in_order(name, path)]:
                raise ValueError(f"no parameter is named '{name}'. Did you mean '{min(fuller, key=len)}'?")
            raise ValueError(f"no parameter is named '{name}'. {did_you_mean(name, options)}")
    return names


def _in_order(name: str, path: str) -> bool:
    """Whether a path has all segments of a name in their order: `ball.material.k_d` those of `ball.k_d`."""
    rest = iter(path.split("."))
    return all(segment in rest for segment in name.split("."))


def _run(name: str, path: str) -> int | None:
    """Return where the run of segments `name` ends in a path, or None where it is no part of it."""
    run, segments = name.split("."), path.split(".")
    for start in range(len(segments) - len(run) + 1):
        if segments[start : start + len(run)] == run:
            return start + len(run)
    return None


def _concerns(name: str, unknown: Unknown, path: str, channel: int) -> bool:
    """Whether a name means the number at a place: a run of its path, with its channel after it or without."""
    head, _, letter = name.rpartition(".")
    own = unknown.name.rpartition(".")[2]
    return _run(name, path) is not None or (
        own in CHANNELS
        and letter in CHANNELS
        and CHANNELS.index(letter) % 3 == channel
        and _run(head, path) is not None
    )


def _check_names_an_unknown(
    where: str,
    name: str,
    found: Sequence[Unknown],
    freed: Sequence[str],
    proportions: Mapping[str, tuple[str, float | None]],
    known: Mapping[str, Any],
) -> None:
    """Refuse a name in bounds or priors that means no unknown."""
    if any(name == _ratio(u, known) or any(_concerns(name, u, *place) for place in u.places) for u in found):
        return
    head, _, letter = name.rpartition(".")
    name = head if letter in CHANNELS and head else name
    if "/" not in name:
        _names(where, (name,), known)
    for path, (to, _) in proportions.items():
        if path in freed and _run(name, path) is not None:
            raise ValueError(f"{where} names '{name}', which follows {to} by a constraint. Name that instead.")
    raise ValueError(f"{where} names '{name}', which is not free. Add it to free, or leave it out.")


def _ratio(unknown: Unknown, known: Mapping[str, Any]) -> str:
    """Return the short name of an unknown factor, `k_s/k_d`."""
    return "/".join(_short(name, list(known)) for name in unknown.quantity.split("/")) if not unknown.places else ""


def _check_directions(unknowns: Sequence[Unknown]) -> None:
    """Refuse bounds that no unit vector is within."""
    for members in unit_vectors(unknowns):
        low, high = (np.array([getattr(unknowns[j], end) for j in members]) for end in ("lower", "upper"))
        nearest = np.linalg.norm(np.clip(0.0, low, high))
        farthest = np.linalg.norm(np.maximum(np.abs(low), np.abs(high)))
        if not nearest <= 1.0 <= farthest:
            raise ValueError(
                f"the bounds of '{unknowns[members[0]].quantity}' hold no unit vector, which a direction is in a fit. "
                "Widen them, or bound one component, for example 'direction.z'."
            )


def _frees(name: str, path: str) -> bool:
    last = path.split(".")[-1]
    by_its_own_name_only = last in ("constant", "k_e", "eta", "period", "u", "v", "side") or last in PER_VIEW
    return _run(name, path) is not None and (not by_its_own_name_only or last in name.split("."))


def _freed(scene: Scene, free: Sequence[str], paths: Sequence[str]) -> list[str]:
    """Return the paths that names free; refuse those that cannot be free for what the scene holds."""
    freed = [path for path in paths if any(_frees(name, path) for name in free)]
    gbuffer = any(isinstance(item.surface, GBuffer) for item in scene.objects)
    for i, item in enumerate(scene.objects):
        k_s, eta = (_named(f"objects.{i}.material.{last}", scene) for last in ("k_s", "eta"))
        if isinstance(item.material.fresnel, Dielectric) and k_s in freed:
            if any(_frees(name, k_s) and "k_s" in name.split(".") for name in free):
                raise ValueError(
                    f"{k_s} cannot be freed beside fresnel=Dielectric(), whose W follows from eta. Free eta instead, "
                    "or name the other k_s by their whole paths."
                )
            freed.remove(k_s)
        if gbuffer and bends(item) and eta in freed:
            raise ValueError(
                f"{eta} cannot be freed in a scene with a GBuffer, which glass does not bend. Leave eta out, or fit "
                "without the GBuffer."
            )
    return freed


def _tied_name(name: str, path: str) -> str | None:
    end = _run(name, path)
    return None if end is None else ".".join([name, *path.split(".")[end:]])


def _bound(unknown: Unknown, bounds: Mapping[str, Sequence[float | int]], known: Mapping[str, Any]) -> None:
    """Set the range of an unknown: the meet of those of all its places."""
    for path, channel in unknown.places:
        named = {name: pair for name, pair in bounds.items() if _concerns(name, unknown, path, channel)}
        lower, upper = _range(path, known[path][1].metadata, named)
        unknown.lower, unknown.upper = max(unknown.lower, lower), min(unknown.upper, upper)
    if not unknown.places:
        named = {name: pair for name, pair in bounds.items() if name == unknown.name}
        unknown.lower, unknown.upper = _range(unknown.name, {"lower": 0.0}, named)
    if not unknown.lower < unknown.upper:
        raise ValueError(
            f"the bounds of '{unknown.quantity}' leave nothing between {unknown.lower:g} and {unknown.upper:g}. "
            "Widen one of them."
        )
    unknown.start = float(np.clip(unknown.start, unknown.lower, unknown.upper))


def _range(path: str, metadata: Mapping[str, Any], bounds: Mapping[str, Sequence[float | int]]) -> tuple[float, float]:
    whole = (float(metadata.get("lower", -np.inf)), float(metadata.get("upper", np.inf)))
    whole = (0.0, 1.0) if ".k_t." in path else whole  # a colour of a pattern, whose own field knows no such end
    whole = lower, upper = RANGES.get(path.split(".")[-1], whole)
    allowed = f"[{lower:g}, {upper:g}]"
    for name, pair in bounds.items():
        low, high = _pair(f"bounds of '{name}'", pair, "(lower, upper)")
        if not low < high:
            raise ValueError(f"bounds of '{name}' must be lower < upper; got ({low:g}, {high:g}). Swap or widen them.")
        if low < whole[0] or high > whole[1]:
            raise ValueError(f"bounds of '{name}' must lie in {allowed}; got ({low:g}, {high:g}). Stay inside it.")
        lower, upper = max(lower, low), min(upper, high)
    return lower, upper


def _prior(unknown: Unknown, priors: Mapping[str, Sequence[Any]]) -> tuple[float, float] | None:
    """Return the prior of an unknown in the solver's coordinates; of two, the one named last."""
    prior = None
    for name, pair in priors.items():
        channel = next((c for path, c in unknown.places if _concerns(name, unknown, path, c)), None)
        if channel is None and name != unknown.name:
            continue
        pair = _of_unit_length(pair) if unknown.kind in DIRECTIONS else pair
        mean, width = _pair(f"the prior of '{name}'", _of_channel(pair, channel or 0), "(value, standard deviation)")
        if not (0 < width < np.inf and np.isfinite(mean)):
            raise ValueError(
                f"the prior of '{name}' must have a finite value and a standard deviation above 0; got ({mean:g}, "
                f"{width:g}). Give (value, standard deviation)."
            )
        if unknown.logarithmic and not mean > 0:
            raise ValueError(f"the prior of '{name}' must have a value above 0; got {mean:g}. It is held in log.")
        if not unknown.lower <= mean <= unknown.upper:
            raise ValueError(
                f"the prior of '{name}' must lie within [{unknown.lower:g}, {unknown.upper:g}]; got {mean:g}. Give a "
                "value in that range, or other bounds."
            )
        prior = (float(np.log(mean)) if unknown.logarithmic else mean, width)
    return prior


def _of_unit_length(pair: Any) -> Any:
    """Return the prior of a direction, which may have any length; the standard deviation is of the unit vector."""
    try:
        value, width = pair
        length = np.linalg.norm(value)
        return (np.asarray(value) / length, width) if np.shape(value) == (3,) and length > 0 else pair
    except (TypeError, ValueError):
        return pair


def _of_channel(pair: Any, channel: int) -> Any:
    """Return a prior for one channel, of one whose value is a vector or a colour."""
    try:
        value, width = pair
        return (value, width) if np.ndim(value) == 0 else (np.ravel(value)[channel], width)
    except (TypeError, ValueError, IndexError):
        return pair


def _pair(what: str, pair: Any, example: str) -> tuple[float, float]:
    try:
        low, high = (float(b) for b in pair)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be two numbers; got {pair!r}. Give {example}.") from None
    return low, high


def _fixes(constraint: Grey | Proportional) -> bool:
    return isinstance(constraint, Proportional) and constraint.factor is not None


def _colourless(constraints: Sequence[Grey | Proportional], freed: Sequence[str], known: Mapping[str, Any]) -> set[str]:
    """Return the paths of the colours whose channels are one unknown."""
    found = set()
    for constraint in constraints:
        if isinstance(constraint, Grey):
            (name,) = _names("constraints", (constraint.name,), known)
            for path in (path for path in freed if _run(name, path) is not None):
                if known[path][1].metadata["converter"] not in (*COLOURS, as_exponent):
                    raise ValueError(f"Grey needs colours; '{name}' names {path}, which is none. Leave it out.")
                if any(isinstance(c, Proportional) and _run(c.name, path) is not None for c in constraints):
                    raise ValueError(
                        f"Grey names '{name}', which Proportional makes follow another. Name that instead."
                    )
                found.add(path)
    return found


def _proportions(
    constraints: Sequence[Grey | Proportional], freed: Sequence[str], known: Mapping[str, Any]
) -> dict[str, tuple[str, float | None]]:
    """Return for each path that is proportional to another: that other, and the factor where it is given."""
    found: dict[str, tuple[str, float | None]] = {}
    for constraint in constraints:
        if not isinstance(constraint, Proportional):
            continue
        for name in _names("constraints", (constraint.name, constraint.to), known):
            if name.split(".")[-1] not in ("k_a", "k_d", "k_s"):
                raise ValueError(f"Proportional relates two of k_a, k_d and k_s; got '{name}'. Name one of these.")
        factor = constraint.factor
        if factor is not None and not (isinstance(factor, float | int | np.number) and 0 <= factor < np.inf):
            raise ValueError(
                f"the factor of {constraint} must be finite and at least 0; got {factor!r}. Give such a one."
            )
        for path in known:
            if _run(constraint.name, path) is None or (factor is None and path not in freed):
                continue
            if factor is not None and path in freed:
                raise ValueError(
                    f"'{path}' is fixed by {constraint} and free as well. Leave it out of free, or give no factor."
                )
            others = [p for p in known if _run(constraint.to, p) is not None]
            beside = [p for p in others if p.rpartition(".")[0] == path.rpartition(".")[0]]
            to = next(iter(beside or others))
            if path in found or to in found or to == path or (len(others) > 1 and len(beside) != 1):
                raise ValueError(
                    f"{constraint} does not say which number {path} is proportional to. Name one that is not "
                    "constrained itself, by its whole path."
                )
            if factor is not None and to not in freed:
                raise ValueError(
                    f"{constraint} relates {path} and {to}, both known. Free {to}, or set {path} in the scene."
                )
            found[path] = (to, factor)
    return found


def _proportional(
    path: str,
    to: str,
    factor: float | None,
    found: Sequence[Unknown],
    known: Mapping[str, Any],
    *,
    from_scene: bool,
) -> list[Unknown]:
    """Make the places of `path` multiples of `to`; return the unknown factor where it is one."""
    at = {place: j for j, unknown in enumerate(found) for place in unknown.places}
    value, base = (np.asarray(known[name][0], np.float64) for name in (path, to))
    new = []
    if factor is None:
        start = float(value.sum() / base.sum()) if from_scene and base.sum() > 0 else 1.0
        new = [Unknown(f"{path}/{to}", f"{path}/{to}", 0.0, np.inf, start, logarithmic=False)]
    for c in range(len(value)):
        j = at.get((to, c))
        if new and j is None:
            new[0].products.append(Product(path, c, float(base[c]), base=(to, c)))
        elif new:
            new[0].products.append(Product(path, c, 1.0, j))
        elif j is not None:
            found[j].products.append(Product(path, c, float(factor or 0.0)))
    return new


def _start(path: str, number: float, known: Mapping[str, Any]) -> float:
    head, _, last = path.rpartition(".")
    if last in ("linear", "quadratic") and not known[f"{head}.constant"][0] > 0:
        return 1.0  # with all three at 0 there is no attenuation to speak of
    return float(STARTS.get(last, number))


def _check_object_names(scene: Scene, known: Iterable[str]) -> None:
    """Refuse an object's name that names a parameter."""
    for item in scene.objects:
        if item.name and any(item.name in (p.split(".")[0], *p.split(".")[2:]) for p in known):
            raise ValueError(f"an object is named '{item.name}', which is a parameter's name. Rename it.")


def _check_can_be_free(path: str, known: Mapping[str, Any]) -> None:
    head, _, last = path.rpartition(".")
    if last == "cutoff" and not known[f"{head}.softness"][0] > 0:
        raise ValueError(
            f"{path} cannot be freed while softness is 0: a hard edge has no derivative. Give {head}.softness, in "
            "degrees, at least two pixels wide."
        )


def _shorten(unknowns: Sequence[Unknown], paths: Sequence[str]) -> None:
    """Shorten each name to its last segments, as few as still name this quantity alone among the scene's paths."""
    for unknown in unknowns:
        if not unknown.places:
            unknown.name = unknown.quantity = "/".join(_short(name, paths) for name in unknown.quantity.split("/"))
            continue
        own = {path for path, _ in unknown.places}
        segments = unknown.quantity.split(".")
        for k in range(1, len(segments) + 1):
            run = ".".join(segments[-k:])
            if segments[-k].isdigit():
                continue
            if all(path in own or _run(run, path) is None for path in paths):
                unknown.name = run + unknown.name[len(unknown.quantity) :]
                unknown.quantity = run
                break


def _short(path: str, paths: Sequence[str]) -> str:
    """Return the last segments of a path, as few as still name it alone."""
    segments = path.split(".")
    runs = (".".join(segments[-k:]) for k in range(1, len(segments) + 1) if not segments[-k].isdigit())
    return next((run for run in runs if all(p == path or _run(run, p) is None for p in paths)), path)

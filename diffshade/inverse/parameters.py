"""Parameters: which numbers of a scene are unknown, what they are called, what they may be, and where they start."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..fields import Array, as_colour, as_vector, did_you_mean, quantities
from ..scenes import Scene, StackedScene, stack_scene

# Where a fit starts, by the last segment of the name: not at the scene's values, which may not be known. Anything else
# (a light's position, an intensity) starts at the scene's value.
STARTS = {"k_a": 0.3, "k_d": 0.3, "k_s": 0.3, "n_s": 10.0, "linear": 0.0, "quadratic": 0.0}
LINEAR = {"k_a", "k_d", "k_s"}  # the image is linear in them
LOGARITHMIC = {"n_s"}  # solved for as log n_s: the error of n_s is proportional to it
RANGES = {"n_s": (0.1, 1e4)}  # where the range of a fit is narrower than that of the field


@dataclass
class Unknown:
    """One unknown number: its name, its short name, and the (leaf, channel) places of the scene that hold it."""

    name: str
    quantity: str
    """The name without the channel: `k_d` of `k_d.r`."""
    lower: float
    upper: float
    start: float
    logarithmic: bool
    places: list[tuple[str, int]] = field(default_factory=list)


class Slots(eqx.Module):
    """Where the unknowns go: a stacked scene of indices into the vector of unknowns, -1 for a known number.

    A leaf of which nothing is unknown is None, so that nothing is differentiated through it.
    """

    indices: StackedScene
    logarithmic: Bool[Array, " p"]

    def insert(self, theta: Float[Array, " p"], scene: StackedScene) -> StackedScene:
        """Return the scene with the unknowns theta, in the solver's coordinates, at their places."""
        values = natural(theta, self.logarithmic)
        return jax.tree.map(
            lambda index, leaf: leaf if index is None else jnp.where(index >= 0, values[index], leaf),
            self.indices,
            scene,
            is_leaf=lambda leaf: leaf is None,
        )


def natural(theta: Float[Array, " p"], logarithmic: Bool[Array, " p"]) -> Float[Array, " p"]:
    """Return the unknowns in their own units: exp(theta) where theta is a logarithm."""
    return jnp.where(logarithmic, jnp.exp(jnp.where(logarithmic, theta, 0.0)), theta)


def find_unknowns(
    scene: Scene,
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    grey: bool = False,
) -> list[Unknown]:
    """Return the unknowns that `free` names, in the scene's order.

    A name is any run of whole segments of a dotted path (`k_d`, `material.k_d`, `objects.0`). `constant`, the gauge of
    an attenuation, is freed only when it is named itself. `tied` makes one unknown of the free numbers whose paths are
    equal after the matched run, channel by channel. `grey` makes one unknown of the channels of each colour. Raises
    ValueError for a name that matches nothing, a contradictory bound, or a cutoff whose edge is hard.
    """
    known = {path: (value, spec) for path, value, spec in quantities(scene)}
    free, tied, bounds = _names("free", free, known), _names("tied", tied, known), dict(bounds or {})
    if any("direction" in name.split(".") for name in free):
        raise ValueError(
            "a light's direction cannot be freed by name: only the way it points has a meaning, not its length, and "
            "unit vectors are not fitted yet. Fix it."
        )
    freed = [path for path in known if any(_frees(name, path) for name in free)]
    for name in tied:
        if not any(_run(name, path) is not None for path in freed):
            raise ValueError(f"tied names '{name}', which is not free. Add it to free, or leave it out of tied.")
    for name in _names("bounds", bounds, known):
        if not any(_run(name, path) is not None for path in freed):
            raise ValueError(f"bounds names '{name}', which is not free. Add it to free, or leave it out of bounds.")
    unknowns: dict[tuple[str, int], Unknown] = {}
    for path in freed:
        value, spec = known[path]
        _check_can_be_free(path, known)
        last = path.split(".")[-1]
        lower, upper = _range(path, spec.metadata, bounds)
        colour = spec.metadata["converter"] is as_colour
        channels = "rgb" if colour else "xyz" if spec.metadata["converter"] is as_vector else ""
        quantity = next((n for name in tied if (n := _tied_name(name, path))), path)
        for c, number in enumerate(np.ravel(np.asarray(value, np.float64))):
            one_for_all = not channels or (grey and colour)
            name = quantity if one_for_all else f"{quantity}.{channels[c]}"
            unknown = unknowns.setdefault(
                (quantity, 0 if one_for_all else c),
                Unknown(name, quantity, lower, upper, _start(path, number, known), last in LOGARITHMIC),
            )
            unknown.lower, unknown.upper = max(unknown.lower, lower), min(unknown.upper, upper)
            unknown.places.append((path, c))
    for unknown in unknowns.values():
        if not unknown.lower < unknown.upper:
            raise ValueError(
                f"the bounds of '{unknown.quantity}' leave nothing between {unknown.lower:g} and "
                f"{unknown.upper:g}. Widen one of them."
            )
        unknown.start = float(np.clip(unknown.start, unknown.lower, unknown.upper))
    _shorten(list(unknowns.values()), list(known))
    return list(unknowns.values())


def slots_of(scene: Scene, unknowns: Sequence[Unknown]) -> Slots:
    """Return the places of the unknowns as a stacked scene of indices."""
    index_of = {place: j for j, unknown in enumerate(unknowns) for place in unknown.places}
    leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
    indices = []
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        flat = [index_of.get((name, c), -1) for c in range(np.size(leaf))] if np.size(leaf) <= 3 else -1
        indices.append(
            np.broadcast_to(np.asarray(flat).reshape(np.shape(leaf) if np.ndim(flat) else ()), np.shape(leaf))
        )
    stacked = stack_scene(jax.tree.unflatten(structure, indices))
    return Slots(
        jax.tree.map(lambda index: index if (index >= 0).any() else None, stacked),
        np.array([unknown.logarithmic for unknown in unknowns]),
    )


def put_back(scene: Scene, unknowns: Sequence[Unknown], values: Float[np.ndarray, " p"]) -> Scene:
    """Return the scene with the values of the unknowns, in their own units, as NumPy float64."""
    changed: dict[str, np.ndarray] = {}
    known = {path: np.asarray(value, np.float64) for path, value, _ in quantities(scene)}
    for unknown, value in zip(unknowns, values, strict=True):
        for path, c in unknown.places:
            changed.setdefault(path, known[path].copy()).reshape(-1)[c] = value
    leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
    names = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves]
    return jax.tree.unflatten(structure, [changed.get(n, leaf) for n, (_, leaf) in zip(names, leaves, strict=True)])


def values_in(scene: Scene, unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return what the unknowns are in a scene, in their own units; of tied numbers, the first."""
    known = {path: np.ravel(np.asarray(value, np.float64)) for path, value, _ in quantities(scene)}
    return np.array([known[path][c] for path, c in (unknown.places[0] for unknown in unknowns)])


def _names(where: str, names: Iterable[str], known: Mapping[str, Any]) -> tuple[str, ...]:
    """Check that each name is a run of segments of some path."""
    names = (names,) if isinstance(names, str) else tuple(names)
    segments = {segment for path in known for segment in path.split(".") if not segment.isdigit()}
    for name in names:
        if all(segment.isdigit() for segment in name.split(".")):
            raise ValueError(
                f"{where} names '{name}', a number alone. Name what it counts, for example 'lights.{name}'."
            )
        if not any(_run(name, path) is not None for path in known):
            raise ValueError(f"no parameter is named '{name}'. {did_you_mean(name, segments | set(known))}")
    return names


def _run(name: str, path: str) -> int | None:
    """Return where the run of segments `name` ends in a path, or None where it is no part of it."""
    run, segments = name.split("."), path.split(".")
    for start in range(len(segments) - len(run) + 1):
        if segments[start : start + len(run)] == run:
            return start + len(run)
    return None


def _frees(name: str, path: str) -> bool:
    gauge = path.split(".")[-1] == "constant"
    return _run(name, path) is not None and (not gauge or "constant" in name.split("."))


def _tied_name(name: str, path: str) -> str | None:
    end = _run(name, path)
    return None if end is None else ".".join([name, *path.split(".")[end:]])


def _range(path: str, metadata: Mapping[str, Any], bounds: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    whole = (float(metadata.get("lower", -np.inf)), float(metadata.get("upper", np.inf)))
    whole = lower, upper = RANGES.get(path.split(".")[-1], whole)
    allowed = f"[{lower:g}, {upper:g}]"
    for name, pair in bounds.items():
        if _run(name, path) is None:
            continue
        try:
            low, high = (float(b) for b in pair)
        except (TypeError, ValueError):
            raise ValueError(f"bounds of '{name}' must be two numbers; got {pair!r}. Give (lower, upper).") from None
        if not low < high:
            raise ValueError(f"bounds of '{name}' must be lower < upper; got ({low:g}, {high:g}). Swap or widen them.")
        if low < whole[0] or high > whole[1]:
            raise ValueError(f"bounds of '{name}' must lie in {allowed}; got ({low:g}, {high:g}). Stay inside it.")
        lower, upper = max(lower, low), min(upper, high)
    return lower, upper


def _start(path: str, number: float, known: Mapping[str, Any]) -> float:
    head, _, last = path.rpartition(".")
    if last in ("linear", "quadratic") and not known[f"{head}.constant"][0] > 0:
        return 1.0  # with all three at 0 there is no attenuation to speak of
    return float(STARTS.get(last, number))


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

"""Slots: where the values of the unknowns go in a scene and its views, and how they come back from there."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from ...core.fields import MOST_BANDS, Array
from ...model.scenes import Object, Scene, StackedScene, over_pixels_and_rest, stack_scene
from ..data.sensors import Sensor
from ..data.views import View
from .names import PER_VIEW, everything, numbers_of, path_name
from .unknown import Unknown, logarithms, natural, unit_vectors


class Setup(eqx.Module):
    """Everything that can be unknown, as compiled programs take it: the scene, and a number for each view."""

    scene: StackedScene
    exposure: Shaped[Array, " views"]
    black: Shaped[Array, " views"]
    sensor: Sensor | None
    """The sensors of the views, stacked; None where no view has one."""


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


def slots_of(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Slots:
    """Return the places of the unknowns as a setup of indices, in a scene without what comes with the pixels."""
    p = len(unknowns)
    index_of = {place: j for j, unknown in enumerate(unknowns) for place in unknown.places}
    products = [(j, product) for j, unknown in enumerate(unknowns) for product in unknown.products]
    for k, (_, product) in enumerate(products):
        index_of[product.path, product.channel] = p + k

    def indices(name: str, leaf: Array) -> np.ndarray:
        flat = [index_of.get((name, c), -1) for c in range(np.size(leaf))] if np.size(leaf) <= MOST_BANDS else [-1]
        return np.broadcast_to(np.reshape(flat, np.shape(leaf) if np.size(leaf) <= MOST_BANDS else ()), np.shape(leaf))

    leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
    places = [indices(path_name(path, scene), leaf) for path, leaf in leaves]
    stacked = stack_scene(jax.tree.unflatten(structure, places))

    def of_views(name: str) -> np.ndarray:
        return np.array([index_of.get((f"views.{i}.{name}", 0), -1) for i in range(len(views))])

    sensor = jax.tree_util.tree_map_with_path(
        lambda path, _: of_views("sensor." + jax.tree_util.keystr(path, simple=True, separator=".")), sensors_of(views)
    )
    setup = Setup(stacked, of_views("exposure"), of_views("black"), sensor)
    others = [p if product.other is None else product.other for _, product in products]
    return Slots(
        jax.tree.map(lambda index: index if (index >= 0).any() else None, setup),
        logarithms(unknowns),
        (
            np.array([j for j, _ in products], int),
            np.array(others, int),
            np.array([product.constant for _, product in products], float),
        ),
        np.array(unit_vectors(unknowns), int).reshape(-1, 3),
    )


def sensors_of(views: Sequence[View]) -> Sensor | None:
    """Return the sensors of the views, stacked; None where no view has one."""
    if all(view.sensor is None for view in views):
        return None
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(view.sensor or Sensor() for view in views))


def apart(scene: Scene) -> tuple[tuple[Object, ...], Scene]:
    """Return what comes with the pixels, as objects of which all else is None, and the scene without it.

    That is the G-buffers and the coefficients over the pixels; none of it is unknown.
    """
    over_pixels, rest = over_pixels_and_rest(scene.objects)
    return over_pixels, eqx.tree_at(lambda s: s.objects, scene, rest)


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
    new_scene = jax.tree.unflatten(structure, [changed.get(path_name(path, scene), leaf) for path, leaf in leaves])
    new_views = []
    for i, view in enumerate(views):
        for name in PER_VIEW:
            if (path := f"views.{i}.{name}") in changed:
                view = eqx.tree_at(lambda v, name=name: getattr(v, name), view, changed[path])
        if view.sensor is not None:
            view = eqx.tree_at(lambda v: v.sensor, view, _sensor_with(changed, view.sensor, f"views.{i}.sensor"))
        new_views.append(view)
    return new_scene, tuple(new_views)


def _sensor_with(changed: dict[str, np.ndarray], sensor: Sensor, head: str) -> Sensor:
    """Return a sensor with what changed under its path."""
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: changed.get(f"{head}.{jax.tree_util.keystr(path, simple=True, separator='.')}", leaf), sensor
    )


def values_in(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return what the unknowns are in a scene, in their own units; of tied numbers, the first; NaN for 0/0."""
    known = {path: numbers_of(value, spec) for path, value, spec in everything(scene, views)}
    values = np.array([known[u.places[0][0]][u.places[0][1]] if u.places else np.nan for u in unknowns])
    for j, unknown in enumerate(unknowns):
        if not unknown.places:
            bases = [x.constant * (1.0 if x.other is None else values[x.other]) for x in unknown.products]
            base, product = max(zip(bases, unknown.products, strict=True), key=lambda pair: abs(pair[0]))
            values[j] = known[product.path][product.channel] / base if base else np.nan
    return values

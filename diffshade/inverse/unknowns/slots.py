"""Slots: where the values of the unknowns go in a scene and its views, and how they come back from there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from ...core.fields import Array
from ...model.scenes import Object, Scene, StackedScene, over_pixels_and_rest, stack_scene
from ..data.sensors import Sensor
from ..data.views import View
from .places import Place, numbers_of
from .unknown import Named, Product, Unknown, logarithms, natural, unit_vectors


class Setup(eqx.Module):
    """Everything that can be unknown, as compiled programs take it: the scene, and a number for each view."""

    scene: StackedScene
    exposure: Shaped[Array, " views"]
    black: Shaped[Array, " views"]
    sensor: Sensor | None
    """The sensors of the views, stacked; None where no view has one."""

    @classmethod
    def of(cls, scene: Scene, views: Sequence[View], default: Sensor | None = None) -> Setup:
        """Return the setup of a scene and its views; `default` is the sensor of views without one beside others."""
        exposure, black = (np.array([getattr(view, name) for view in views], float) for name in ("exposure", "black"))
        if all(view.sensor is None for view in views):
            return cls(stack_scene(scene), exposure, black, None)
        sensors = [view.sensor or default or Sensor() for view in views]
        return cls(stack_scene(scene), exposure, black, jax.tree.map(lambda *leaves: np.stack(leaves), *sensors))


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
    products = [(j, product) for j, unknown in enumerate(unknowns) for product in unknown.products]
    index_of: dict[Place, float] = {place: j for j, unknown in enumerate(unknowns) for place in unknown.places}
    index_of |= {product.place: p + k for k, (_, product) in enumerate(products)}
    plain = None if all(view.sensor is None for view in views) else Sensor()
    blank = jax.tree.map(lambda leaf: np.broadcast_to(-1.0, np.shape(leaf)), (scene, tuple(views), plain))
    setup = Setup.of(*_put(blank[0], blank[1], index_of), default=blank[2])
    others = [p if product.other is None else product.other for _, product in products]
    return Slots(
        jax.tree.map(lambda index: index.astype(int) if (index >= 0).any() else None, setup),
        logarithms(unknowns),
        (
            np.array([j for j, _ in products], int),
            np.array(others, int),
            np.array([product.constant for _, product in products], float),
        ),
        np.array(unit_vectors(unknowns), int).reshape(-1, 3),
    )


def _put(scene: Scene, views: Sequence[View], numbers: Mapping[Place, float | int]) -> tuple[Scene, tuple[View, ...]]:
    """Return a scene and its views with these numbers at these places, in NumPy float64."""
    leaves: dict[Place, np.ndarray] = {}
    for place, number in numbers.items():
        whole = place.whole
        leaf = leaves.setdefault(whole, np.array(whole.value_in(scene, views), np.float64))
        leaf.reshape(-1)[place.channel] = number
    return eqx.tree_at(lambda of: [whole.value_in(*of) for whole in leaves], (scene, tuple(views)), [*leaves.values()])


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
    numbers: dict[Place, float] = {}
    for unknown, value in zip(unknowns, values, strict=True):
        numbers.update(dict.fromkeys(unknown.places, float(value)))
        for product in unknown.products:
            other = 1.0 if product.other is None else values[product.other]
            numbers[product.place] = product.constant * value * other
    return _put(scene, views, numbers)


def values_in(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"]:
    """Return what the unknowns are in a scene, in their own units; of tied numbers, the first; NaN for 0/0."""
    return np.array([value_in(scene, views, of, of.products) for of in unknowns])


def value_in(scene: Scene, views: Sequence[View], number: Named, products: Sequence[Product]) -> float:
    """Return what a number is in a scene, in its own units; of tied ones, the first; of a factor, NaN for 0/0."""

    def at(place: Place) -> float:
        return float(numbers_of(place.value_in(scene, views), number.parameter)[place.channel])

    if number.places:
        return at(number.places[0])
    multiple, base = max(((at(x.place), at(x.base)) for x in products), key=lambda pair: abs(pair[1]))
    return multiple / base if base else np.nan

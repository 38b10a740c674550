"""Unknown: one number that a fit finds: its names, its range, and the places of the scene that hold it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array, Parameter
from .places import Place


@dataclass(frozen=True)
class Named:
    """A number, or several that are the same: a name, and the places that it means."""

    quantity: str
    """The name without the channel: `k_d` of `k_d.r`."""
    channel: str
    """`r` of `k_d.r`; empty for a single number, and for all channels together."""
    places: tuple[Place, ...]
    """Empty for a factor, `k_s/k_d`."""
    parameter: Parameter
    """What is known of the field that it is a number of."""

    @property
    def name(self) -> str:
        """The name of the number."""
        return f"{self.quantity}.{self.channel}" if self.channel else self.quantity

    @property
    def kind(self) -> str:
        """The name of its field, `k_d`; empty for a factor."""
        return str(self.places[0].field) if self.places else ""


@dataclass(frozen=True)
class Unknown(Named):
    """One unknown number, and what is known of it beforehand."""

    lower: float
    upper: float
    start: float
    products: tuple[Product, ...] = ()
    """Places that hold a multiple of it."""
    prior: tuple[float, float] | None = None
    """Mean and standard deviation, in the solver's coordinates, of what is known of it beforehand."""

    @property
    def logarithmic(self) -> bool:
        """Whether it is solved for as its logarithm."""
        return self.parameter.logarithmic

    @property
    def all_places(self) -> tuple[Place, ...]:
        """The places whose values depend on it."""
        return (*self.places, *(product.place for product in self.products))


@dataclass(frozen=True)
class Product:
    """A place that holds `constant` times an unknown, times another one where `other` is its index."""

    place: Place
    constant: float
    base: Place
    """The place whose multiple it is: of an unknown, or of a known number, which `constant` then is."""
    other: int | None = None


def free_places(unknowns: Sequence[Unknown]) -> set[Place]:
    """Return the places that are unknown, whole vectors and colours, without those that follow another by a factor."""
    return {place.whole for unknown in unknowns for place in unknown.places}


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


def by_quantity(unknowns: Sequence[Named]) -> dict[str, list[int]]:
    """Return the names without channels, each with the indices of its unknowns, in the order of the channels."""
    found: dict[str, list[int]] = {}
    for j, unknown in enumerate(unknowns):
        found.setdefault(unknown.quantity, []).append(j)
    return found


def unit_vectors(unknowns: Sequence[Unknown]) -> list[list[int]]:
    """Return the indices of the unknowns that are a unit vector together: a direction's x, y and z."""
    return [of for of in by_quantity(unknowns).values() if unknowns[of[0]].parameter.role == "direction"]

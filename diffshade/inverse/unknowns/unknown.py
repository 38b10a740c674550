"""Unknown: one number that a fit finds: its names, its range, and the places of the scene that hold it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array, Parameter


@dataclass
class Unknown:
    """One unknown number: its name, its short name, and the (path, channel) places of the scene that hold it."""

    name: str
    quantity: str
    """The name without the channel: `k_d` of `k_d.r`."""
    lower: float
    upper: float
    start: float
    parameter: Parameter = field(default_factory=Parameter)
    """What is known of the field that it is a number of."""
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
        return self.parameter.linear and "/" not in self.quantity

    @property
    def logarithmic(self) -> bool:
        """Whether it is solved for as its logarithm."""
        return self.parameter.logarithmic


@dataclass(frozen=True)
class Product:
    """A place that holds `constant` times an unknown, times another one where `other` is its index."""

    path: str
    channel: int
    constant: float
    other: int | None = None
    base: tuple[str, int] | None = None
    """The known place whose value `constant` is, where it is one."""


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


def unit_vectors(unknowns: Sequence[Unknown]) -> list[list[int]]:
    """Return the indices of the unknowns that are a unit vector together: a direction's x, y and z."""
    by_quantity: dict[str, list[int]] = {}
    for j, unknown in enumerate(unknowns):
        if unknown.parameter.role == "direction":
            by_quantity.setdefault(unknown.quantity, []).append(j)
    return list(by_quantity.values())

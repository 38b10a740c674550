r"""Unexplained light: what photographs show beyond the model, between the lights that they were taken under (kriging).

$$ u(l) = k(l)^T (K + \lambda)^{-1} r, \quad K_{ij} = k(|l_i - l_j| / width) $$

r is the residual of a texel in every view, as a reflectance. Shadows, bounced light and what the shared highlight
cannot be move little between lights that are near one another; far from all of them u is 0. Width and lambda are those
that predict each view best from the others (Krige 1951; Rasmussen and Williams 2006, eq. 2.23, with a Matern kernel).
Where `between_lights` has learned what is shown under further lights, r has these too.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Float16

from ..core.fields import Array
from ..core.thresholds import SINGLE, SLIGHT
from ..model.lights import AbstractLight
from ..model.vectors import Vec3

WIDTHS = (0.1, 0.2, 0.4, 0.8)  # in units of a unit vector's change
NOISES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # lambda
MIN_PARTS = 9  # numbers that are kept of the residuals of a texel and channel
MAX_PARTS = 192  # the page that draws them has room for so many in its program
MAX_BYTES = 100e6  # of all texels' parts, where more than the least are kept
PARTS_OF_VIEW = 4  # parts that are kept at most for each view: more lights than these were learned of


class Interpolation(NamedTuple):
    """How the residuals of the views become light under another one."""

    toward: Float[np.ndarray, "views 3"]
    """Unit vectors to the light of each view."""
    width: float
    taken: Float[np.ndarray, "parts views"]
    """What is kept of the residuals of a texel: its products with them."""
    given: Float[np.ndarray, "views parts"]
    """k(l) times this is the weight of each number that was kept."""

    def in_units_of(self, size: float) -> Interpolation:
        """Return the same with what is kept divided by a size, so that half precision holds it."""
        return self._replace(taken=self.taken / size, given=self.given * size)

    def weights(self, toward: Float[np.ndarray, "3"]) -> Float[np.ndarray, " parts"]:
        """Return the weight of each number that was kept, under a light in this direction."""
        return _kernel(toward[None], self.toward, self.width)[0] @ self.given


class Unexplained(NamedTuple):
    """Maps of what photographs show beyond the model."""

    interpolation: Interpolation
    parts: Float16[np.ndarray, "h w c*parts"]
    """What is kept of the residuals, a reflectance, with all parts of a channel beside one another."""

    def light(
        self,
        lights: Sequence[AbstractLight],
        position: Float[Array, "h w 3"] | None,
        inside: Bool[np.ndarray, "h w"],
    ) -> Float[np.ndarray, "h w 3"]:
        """Return what lights show beyond the model: linear radiance.

        Args:
            lights: The lights.
            position: Points of the surface; lights without a position need none.
            inside: Where the surface is.
        """
        total = np.zeros((*inside.shape, 3))
        for light in lights:
            toward, arriving = self.toward(light, position, inside)
            if toward.any():
                weights = self.interpolation.weights(toward)
                beyond = self.parts.reshape(*inside.shape, -1, len(weights)) @ weights
                total += beyond * arriving.sum(-2)
        return total

    @staticmethod
    def toward(
        light: AbstractLight, position: Float[Array, "h w 3"] | None, inside: Bool[np.ndarray, "h w"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "... emitters 3"]]:
        """Return the mean direction to a light, 0 where none arrives, and what arrives from its emitters.

        Args:
            light: The light.
            position: Points of the surface; a light without a position needs none, and is the same for all of them.
            inside: Where the surface is.
        """
        p = None if position is None else Vec3.of(position)
        l, arriving = jax.vmap(lambda emitter: emitter.arriving(p))(light.emitters())
        l, arriving = (np.moveaxis(np.asarray(v.stack()), 0, -2) for v in (l, arriving))
        weighed = l * arriving.mean(-1, keepdims=True)
        toward = (weighed if weighed.ndim == 2 else weighed[inside]).reshape(-1, 3).sum(0)
        return toward / (np.linalg.norm(toward) or 1.0), arriving


def most_parts(numbers: int, views: int) -> int:
    """Return how many parts are kept of so many residuals of each view: texels times channels."""
    room = int(MAX_BYTES / (np.float16(0).itemsize * numbers))
    return max(MIN_PARTS, min(PARTS_OF_VIEW * views, MAX_PARTS, room))


class Smoothing(NamedTuple):
    """How far residuals are alike from light to light, and how much of them is noise."""

    width: float
    noise: float

    def weights(
        self, seen: Float[np.ndarray, "seen 3"], lights: Float[np.ndarray, "lights 3"]
    ) -> Float[np.ndarray, "lights seen"]:
        """Return the weights of residuals under lights that are seen, for each other light."""
        return np.linalg.solve(_noisy(seen, *self), _kernel(seen, lights, self.width)).T


def smoothing_of(toward: Float[np.ndarray, "views 3"], residual: Float[Array, "views texels"]) -> Smoothing | None:
    """Return the smoothing that predicts views best from the others, or None if none predicts them better than 0.

    Args:
        toward: Unit vectors to the light of each view.
        residual: What some texels show beyond the model, as a reflectance.
    """
    residual = np.asarray(residual, np.float64)
    size, best, chosen = float(np.mean(residual**2)), np.inf, None
    for width, noise in itertools.product(WIDTHS, NOISES):
        inverse = np.linalg.inv(_noisy(toward, width, noise))
        left_out = (inverse @ residual) / np.diag(inverse)[:, None]  # what each view has beyond the others' prediction
        error = float(np.mean(left_out**2))
        if error < best:
            best, chosen = error, Smoothing(width, noise)
    return chosen if 0.0 < best <= (1.0 - SLIGHT) ** 2 * size else None


def interpolation_of(
    toward: Float[np.ndarray, "lights 3"], residual: Float[Array, "lights texels"], smoothing: Smoothing, parts: int
) -> Interpolation:
    """Return the interpolation between lights: of all their combinations, those of which most light is made are kept.

    Args:
        toward: Unit vectors to the lights.
        residual: What some texels show beyond the model, as a reflectance.
        smoothing: How far it is alike from light to light.
        parts: How many numbers may be kept of a texel's residuals.
    """
    K = _kernel(toward, toward, smoothing.width)
    smooth = K @ np.linalg.inv(_noisy(toward, *smoothing))  # from residuals to what is interpolated at the same lights
    light = smooth @ np.asarray(residual, np.float64)
    largest = np.linalg.eigh(light @ light.T)[1][:, ::-1][:, :parts]
    return Interpolation(toward, smoothing.width, largest.T @ smooth, np.linalg.pinv(K, SINGLE) @ largest)


def _noisy(toward: Float[np.ndarray, "views 3"], width: float, noise: float) -> Float[np.ndarray, "views views"]:
    return _kernel(toward, toward, width) + noise * np.eye(len(toward))


def _kernel(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"], width: float) -> Float[np.ndarray, "n m"]:
    """Return the correlation between lights of these directions: Matern's of smoothness 3/2."""
    d = np.sqrt(3.0) * np.linalg.norm(a[:, None] - b[None], axis=-1) / width
    return (1.0 + d) * np.exp(-d)

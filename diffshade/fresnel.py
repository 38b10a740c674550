"""Fresnel reflection: how the weight W of the highlight depends on the angle of the light (E7)."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from .fields import Array
from .vectors import Vec3, safe_sqrt


class AbstractFresnel(eqx.Module):
    """The highlight's weight W as a function of cos theta = n.l, for both lobes alike."""

    @abc.abstractmethod
    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return W at cos theta >= 0."""


class NoFresnel(AbstractFresnel):
    """W = k_s at every angle."""

    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return k_s."""
        return k_s


class Schlick(AbstractFresnel):
    """W = k_s + (1 - k_s)(1 - cos theta)^5: k_s head on, 1 at grazing light (Schlick 1994, eq. 15)."""

    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return W."""
        fifth = (1.0 - cos) * (1.0 - cos) * (1.0 - cos) * (1.0 - cos) * (1.0 - cos)

        def of(k: Array) -> Array:
            return k + (1.0 - k) * fifth

        return Vec3(of(k_s.x), of(k_s.y), of(k_s.z))


class Dielectric(AbstractFresnel):
    """W = (r_s^2 + r_p^2)/2 of unpolarised light on a dielectric of index eta in air (Fresnel; Cook and Torrance 1982).

    With g = sqrt(eta^2 - 1 + cos^2 theta): r_s = (cos - g)/(cos + g), r_p = (eta^2 cos - g)/(eta^2 cos + g). Between 0
    and 1; 1 at total reflection (eta < 1), where the derivative is 0, as it is where both of cos and g are 0.
    """

    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return W; k_s is not looked at."""
        eta2 = eta * eta
        g2 = eta2 - 1.0 + cos * cos
        partial = g2 > 0
        g = safe_sqrt(g2)

        def squared(a: Array, b: Array) -> Array:  # of (a - b)/(a + b)
            some = a + b > 0
            ratio = jnp.where(some, a - b, 0.0) / jnp.where(some, a + b, 1.0)
            return ratio * ratio

        W = jnp.where(partial, 0.5 * (squared(cos, g) + squared(eta2 * cos, g)), 1.0)
        return Vec3(W, W, W)

"""Fresnel reflection: how the weight W of the highlight depends on the angle of the light (E7)."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from .vectors import Vec3, safe_sqrt


class AbstractFresnel(eqx.Module):
    """The highlight's weight W as a function of cos theta = n.l, the same for both lobes."""

    @abc.abstractmethod
    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return W at cos theta.

        Args:
            k_s: Specular reflection.
            eta: Index of refraction.
            cos: cos theta, at least 0.

        Returns:
            W, one value per channel.
        """


class NoFresnel(AbstractFresnel):
    """A weight of the highlight that is the same at every angle, $W = k_s$ (E7)."""

    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return k_s."""
        return k_s


class Schlick(AbstractFresnel):
    r"""Schlick's weight: k_s at normal incidence, 1 at grazing incidence (E7; Schlick 1994, eq. 15).

    $$ W = k_s + (1 - k_s)(1 - \cos\theta)^5, \qquad \cos\theta = n \cdot l $$
    """

    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return W."""
        fifth = (1.0 - cos) * (1.0 - cos) * (1.0 - cos) * (1.0 - cos) * (1.0 - cos)

        def of(k: Array) -> Array:
            return k + (1.0 - k) * fifth

        return Vec3(of(k_s.x), of(k_s.y), of(k_s.z))


class Dielectric(AbstractFresnel):
    r"""Fresnel's weight for unpolarised light on a dielectric in air (E7; Cook and Torrance 1982).

    $$ W = (r_s^2 + r_p^2) / 2, \qquad r_s = (c - g) / (c + g), \qquad r_p = (\eta^2 c - g) / (\eta^2 c + g) $$

    Here $c = n \cdot l$, $g = \sqrt{\eta^2 - 1 + c^2}$, and eta is the material's. W is between 0 and 1. At total
    reflection (eta < 1) W is 1 and the derivative is 0. The derivative is also 0 where both c and g are 0.
    """

    def weight(self, k_s: Vec3, eta: Float[Array, "..."], cos: Float[Array, "..."]) -> Vec3:
        """Return W; k_s is not used."""
        eta2 = eta * eta
        g2 = eta2 - 1.0 + cos * cos
        partial = g2 > 0
        g = safe_sqrt(g2)

        def squared(a: Array, b: Array) -> Array:  # ((a - b)/(a + b))^2
            some = a + b > 0
            ratio = jnp.where(some, a - b, 0.0) / jnp.where(some, a + b, 1.0)
            return ratio * ratio

        W = jnp.where(partial, 0.5 * (squared(cos, g) + squared(eta2 * cos, g)), 1.0)
        return Vec3(W, W, W)

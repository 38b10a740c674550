"""Attenuation: how light fades with distance (E2) and off a spot's axis (E3)."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .fields import Array, Checked, Scalar, as_scalar, is_concrete

NEAREST = 1e-6  # scene units; below it the distance counts as this, so that 1/d^2 stays finite


class RadialAttenuation(Checked):
    """Radial attenuation, f_rad = 1/(a0 + a1 d + a2 d^2), at distance d from a light (E2; Foley et al. 1990, 16.1.4).

    (1, 0, 0) is none, (0, 1, 0) is 1/d and (0, 0, 1) is 1/d^2; all three zero is an error. With `clamp=True`,
    min(1, f_rad). d is at least 1e-6; the derivative with respect to d is 0 below that, and every derivative is 0 where
    f_rad is clamped.
    """

    constant: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata={"lower": 0})
    linear: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    quadratic: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    clamp: bool = eqx.field(static=True, default=False)

    def check_together(self) -> None:
        if is_concrete(self.constant, self.linear, self.quadratic) and not np.any(
            [self.constant, self.linear, self.quadratic]
        ):
            raise ValueError(
                "RadialAttenuation needs one of constant, linear and quadratic above 0; got 0, 0 and 0. "
                "Give constant=1 for no attenuation."
            )

    def __call__(self, d: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return f_rad at distance d (scene units, at least 0)."""
        d = jnp.where(d > NEAREST, d, NEAREST)
        f = 1.0 / (self.constant + d * (self.linear + d * self.quadratic))
        return jnp.where(f < 1.0, f, 1.0) if self.clamp else f


def angular_attenuation(
    cos_phi: Float[Array, "..."], cutoff: Scalar, exponent: Scalar, softness: Scalar
) -> Float[Array, "..."]:
    """Angular attenuation of a spot at the angle phi off its axis (E3; Warn 1983, OpenGL 1.0).

    cos^exponent phi where cos phi >= max(cos cutoff, 0), else 0; x^0 = 1 on the lit side. With `softness` > 0, times
    smoothstep(cos cutoff, cos(cutoff - softness), cos phi), which makes the edge differentiable. `cutoff` (the half
    angle) and `softness` are in degrees, 0 <= softness <= cutoff <= 90. With softness 0 the edge is a jump, which no
    derivative sees.
    """
    edge = jnp.maximum(_cos_degrees(cutoff), 0.0)
    width = _cos_degrees(cutoff - softness) - edge
    soft = width > 0  # not of a softness so small that rounding takes it away
    lit = cos_phi >= edge
    inside = cos_phi > 0
    at_90_degrees = jnp.where(exponent == 0, 1.0, 0.0)
    lobe = jnp.where(inside, jnp.exp(exponent * jnp.log(jnp.where(inside, cos_phi, 1.0))), at_90_degrees)
    t = jnp.where(soft, (cos_phi - edge) / jnp.where(soft, width, 1.0), 1.0)
    t = jnp.where(t < 1.0, t, 1.0)
    return jnp.where(lit, lobe * t * t * (3.0 - 2.0 * t), 0.0)


def _cos_degrees(angle: Scalar) -> Scalar:
    """Return cos angle, which is exactly 0 at 90 degrees."""
    return jnp.sin(jnp.deg2rad(90.0 - angle))

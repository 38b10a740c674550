"""Attenuation: how light fades with distance (E2), off a spot's axis (E3), and on its way through the air (E14)."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import Array, Checked, Colour, Scalar, as_colour, as_scalar, is_concrete, parameter
from .vectors import Vec3

NEAREST = 1e-6  # scene units; below it the distance counts as this, so that 1/d^2 stays finite

FADE = parameter("attenuation", lower=0, start=0.0, gauge=1)


class RadialAttenuation(Checked):
    """Radial attenuation at distance d from a light (E2; Foley et al. 1990, 16.1.4).

    $$ f_{rad}(d) = 1 / (a_0 + a_1 d + a_2 d^2) $$

    `constant`, `linear`, `quadratic`: a_0, a_1 and a_2, at least 0, for d in scene units. (1, 0, 0) is none, (0, 1, 0)
    is 1/d and (0, 0, 1) is 1/d^2; all three zero is an error. With `clamp=True`, min(1, f_rad). d is at least 1e-6; the
    derivative with respect to d is 0 below that, and every derivative is 0 where f_rad is clamped.
    """

    constant: Scalar = eqx.field(
        converter=as_scalar, default=1.0, metadata=parameter("attenuation", lower=0, gauge=1, by_own_name=True)
    )
    linear: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=FADE)
    quadratic: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=FADE)
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


class AbstractAtmosphere(Checked):
    """What is between the surfaces and the eye: a radiance I becomes s I + (1 - s) I_dc (E14).

    s is a function of the distance z: along the camera's view axis, or along the ray where `radial` is true.
    """

    I_dc: eqx.AbstractVar[Colour]
    radial: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def visibility(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return s at the distance z."""

    def __call__(self, radiance: Vec3, z: Float[Array, "..."]) -> Vec3:
        """Return s I + (1 - s) I_dc."""
        s = self.visibility(z)
        return radiance * s + Vec3.of(self.I_dc) * (1.0 - s)


class DepthCueing(AbstractAtmosphere):
    r"""Linear depth cueing (E14; Foley et al. 1990, 16.1.3): s falls from s_f at z_f to s_b at z_b, constant beyond.

    $$ I' = s I + (1 - s) I_{dc}, \qquad s = s_b + (s_f - s_b)(z_b - z) / (z_b - z_f) $$

    z is the distance along the camera's view axis or, with `radial=True`, along the ray. `s_f`, `s_b`: 0 to 1. `z_f` <
    `z_b`: distances in scene units. `I_dc`: the colour that depth fades to, RGB or grey. At z_f and z_b the derivative
    is that of the constant side.
    """

    z_f: Scalar = eqx.field(converter=as_scalar)
    z_b: Scalar = eqx.field(converter=as_scalar)
    s_f: Scalar = eqx.field(kw_only=True, converter=as_scalar, default=1.0, metadata={"lower": 0, "upper": 1})
    s_b: Scalar = eqx.field(kw_only=True, converter=as_scalar, default=0.0, metadata={"lower": 0, "upper": 1})
    I_dc: Colour = eqx.field(kw_only=True, converter=as_colour, default=0.0, metadata={"lower": 0})
    radial: bool = eqx.field(kw_only=True, static=True, default=False)

    def check_together(self) -> None:
        if is_concrete(self.z_f, self.z_b) and not self.z_f < self.z_b:
            raise ValueError(
                f"DepthCueing.z_f must be less than z_b; got {self.z_f} and {self.z_b}. Give the nearer one as z_f."
            )

    def visibility(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return s_f up to z_f, s_b from z_b on, and s_b + (s_f - s_b)(z_b - z)/(z_b - z_f) between."""
        span = self.z_b - self.z_f
        near = (self.z_b - z) / jnp.where(span > 0, span, 1.0)  # 1 at z_f, 0 at z_b
        between = self.s_b + (self.s_f - self.s_b) * near
        return jnp.where(z <= self.z_f, self.s_f, jnp.where(z >= self.z_b, self.s_b, between))


class Fog(AbstractAtmosphere):
    r"""Exponential fog (E14; OpenGL's GL_EXP and, with `squared=True`, GL_EXP2).

    $$ I' = s I + (1 - s) I_{dc}, \qquad s = e^{-\rho z} \text{ or } e^{-(\rho z)^2} $$

    z is the distance along the camera's view axis or, with `radial=True`, along the ray; s is 1 for z <= 0. `density`:
    rho, at least 0, per scene unit. `I_dc`: the fog's colour, RGB or grey.
    """

    density: Scalar = eqx.field(converter=as_scalar, metadata={"lower": 0})
    I_dc: Colour = eqx.field(kw_only=True, converter=as_colour, default=0.0, metadata={"lower": 0})
    squared: bool = eqx.field(kw_only=True, static=True, default=False)
    radial: bool = eqx.field(kw_only=True, static=True, default=False)

    def visibility(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return s; 1 for z <= 0."""
        x = self.density * jnp.where(z > 0, z, 0.0)
        return jnp.exp(-x * x) if self.squared else jnp.exp(-x)

"""Attenuation: how light fades with distance (E2), away from a spot's axis (E3), and in the air (E14)."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import Array, Checked, Colour, Scalar, as_colour, as_scalar, check_kind, is_concrete, parameter
from ..core.thresholds import SINGLE
from .vectors import Vec3

NEAREST = SINGLE  # scene units; smaller distances count as this one, so that 1/d^2 stays finite


class AbstractAttenuation(Checked):
    """A law of radial attenuation: which fraction f_rad of a lamp's light arrives at a distance (E2).

    Its numbers are fields of one number each, with their ranges; in `Parameter.role` they are "attenuation", or
    "amplitude" for one that light of another intensity stands for.
    """

    @abc.abstractmethod
    def factor(self, d: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return f_rad at distance d, finite and with finite derivatives.

        Args:
            d: Distance from the light, scene units, at least 1e-6.

        Returns:
            f_rad, with the shape of d.
        """

    def glsl(self) -> str | None:
        """Return f_rad for the live pictures of a report: the body of a GLSL function, with the numbers in it.

        The function is `float (float d)`; d is at least 1e-6.

        Returns:
            The body; None, the default, shows no light that this law attenuates, and says so.
        """
        return None

    @classmethod
    def numbers(cls) -> tuple[str, ...]:
        """Return the names of its numbers."""
        return tuple(f.name for f in dataclasses.fields(cls) if f.metadata.get("converter") is as_scalar)

    def __call__(self, d: Float[Array, "..."] | float) -> Float[Array, "..."]:
        """Return f_rad at distance d; a smaller one than 1e-6 counts as that, where the derivative by d is 0.

        Args:
            d: Distance from the light, scene units, at least 0.

        Returns:
            f_rad, with the shape of d.
        """
        return self.factor(jnp.where(d > NEAREST, d, NEAREST))


def check_attenuation(light: Any) -> None:
    """Refuse a light whose `attenuation` is no law."""
    name = f"{type(light).__name__}.attenuation"
    check_kind(name, light.attenuation, AbstractAttenuation, "RadialAttenuation(1, 0, 0)")


COEFFICIENT = parameter("attenuation", lower=0, start=0.0, gauge=1)


class RadialAttenuation(AbstractAttenuation):
    """Radial attenuation at distance d from a light (E2; Foley et al. 1990, 16.1.4).

    $$ f_{rad}(d) = 1 / (a_0 + a_1 d + a_2 d^2) $$

    (1, 0, 0) means no attenuation, (0, 1, 0) is 1/d and (0, 0, 1) is 1/d^2. The distance d is in scene units and counts
    as at least 1e-6. The derivative with respect to d is 0 below 1e-6, and every derivative is 0 where f_rad is
    clamped.

    Args:
        constant: a_0, at least 0; 1 by default.
        linear: a_1, per scene unit, at least 0; 0 by default.
        quadratic: a_2, per squared scene unit, at least 0; 0 by default.
        clamp: Whether to use min(1, f_rad); False by default.

    Raises:
        ValueError: A coefficient is below 0 or not finite, or all three are 0.
        TypeError: A coefficient is not a number.
    """

    constant: Scalar = eqx.field(
        converter=as_scalar, default=1.0, metadata=parameter("amplitude", lower=0, gauge=1, by_own_name=True)
    )
    linear: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=COEFFICIENT)
    quadratic: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=COEFFICIENT)
    clamp: bool = eqx.field(static=True, default=False)

    def check_together(self) -> None:
        if is_concrete(self.constant, self.linear, self.quadratic) and not np.any(
            [self.constant, self.linear, self.quadratic]
        ):
            raise ValueError(
                "RadialAttenuation needs one of constant, linear and quadratic above 0; got 0, 0 and 0. "
                "Give constant=1 for no attenuation."
            )

    def factor(self, d: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return f_rad at distance d."""
        f = 1.0 / (self.constant + d * (self.linear + d * self.quadratic))
        return jnp.where(f < 1.0, f, 1.0) if self.clamp else f

    def glsl(self) -> str:
        """Return f_rad for the live pictures of a report."""
        a0, a1, a2 = (f"{float(a):.9e}" for a in (self.constant, self.linear, self.quadratic))
        f = f"1.0 / ({a0} + d * ({a1} + d * {a2}))"
        return f"  return min({f}, 1.0);" if self.clamp else f"  return {f};"


def angular_attenuation(
    cos_phi: Float[Array, "..."], cutoff: Scalar, exponent: Scalar, softness: Scalar
) -> Float[Array, "..."]:
    """Angular attenuation of a spot at the angle phi from its axis (E3; Warn 1983, OpenGL 1.0).

    The value is cos^exponent phi where cos phi >= max(cos cutoff, 0), else 0; x^0 = 1 on the lit side. With `softness`
    above 0 it is multiplied by smoothstep(cos cutoff, cos(cutoff - softness), cos phi), which makes the edge
    differentiable. With softness 0 the edge is a jump, which contributes no derivative.

    Args:
        cos_phi: Cosine of the angle from the axis.
        cutoff: Half angle of the cone, degrees, 0 to 90.
        exponent: Exponent of the cosine, at least 0.
        softness: Width of the smooth edge, degrees, 0 to `cutoff`.

    Returns:
        f_ang, with the shape of `cos_phi`.
    """
    edge = jnp.maximum(_cos_degrees(cutoff), 0.0)
    width = _cos_degrees(cutoff - softness) - edge
    lit = cos_phi >= edge
    inside = cos_phi > 0
    at_90_degrees = jnp.where(exponent == 0, 1.0, 0.0)
    lobe = jnp.where(inside, jnp.exp(exponent * jnp.log(jnp.where(inside, cos_phi, 1.0))), at_90_degrees)
    t = share_of_edge(cos_phi - edge, width)
    return jnp.where(lit, lobe * t * t * (3.0 - 2.0 * t), 0.0)


def share_of_edge(inside: Float[Array, "..."], width: Scalar) -> Float[Array, "..."]:
    """Return how far within a soft edge a value is, up to 1; 1 everywhere where the edge has no width.

    Args:
        inside: How far the value is beyond the limit, on the lit side.
        width: Width of the edge.

    Returns:
        The share, with the shape of `inside`; below 0 on the dark side.
    """
    soft = width > 0  # false where softness is so small that rounding removes it
    t = jnp.where(soft, inside / jnp.where(soft, width, 1.0), 1.0)
    return jnp.where(t < 1.0, t, 1.0)


def _cos_degrees(angle: Scalar) -> Scalar:
    """Return cos angle, which is exactly 0 at 90 degrees."""
    return jnp.sin(jnp.deg2rad(90.0 - angle))


class AbstractAtmosphere(Checked):
    """The medium between the surfaces and the eye: a radiance I becomes s I + (1 - s) I_dc (E14).

    s is a function of the distance z: along the camera's view axis, or along the ray if `radial` is true.
    """

    I_dc: eqx.AbstractVar[Colour]
    radial: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def visibility(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return s at the distance z.

        Args:
            z: Distance from the eye, scene units.

        Returns:
            s, with the shape of z.
        """

    def __call__(self, radiance: Vec3, z: Float[Array, "..."]) -> Vec3:
        """Return s I + (1 - s) I_dc.

        Args:
            radiance: I, the radiance of the surface.
            z: Distance of the surface from the eye, scene units.

        Returns:
            The radiance that reaches the eye.
        """
        s = self.visibility(z)
        return radiance * s + Vec3.of(self.I_dc) * (1.0 - s)


class DepthCueing(AbstractAtmosphere):
    r"""Linear depth cueing: s falls from s_f at z_f to s_b at z_b (E14; Foley et al. 1990, 16.1.3).

    $$ I' = s I + (1 - s) I_{dc}, \qquad s = s_b + (s_f - s_b)(z_b - z) / (z_b - z_f) $$

    s is constant beyond these distances. z is the distance along the camera's view axis or, with `radial=True`, along
    the ray. At z_f and z_b the derivative is that of the constant side.

    Args:
        z_f: Front distance, scene units, less than `z_b`.
        z_b: Back distance, scene units.
        s_f: s up to z_f, 0 to 1; 1 by default.
        s_b: s from z_b on, 0 to 1; 0 by default.
        I_dc: Colour that distant surfaces fade to, RGB or grey, at least 0; 0 (black) by default.
        radial: Whether z is measured along the ray; False by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, or z_f is not less than z_b.
        TypeError: A value is not a number or colour.
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

    z is the distance along the camera's view axis or, with `radial=True`, along the ray; s is 1 for z <= 0.

    Args:
        density: rho, per scene unit, at least 0.
        I_dc: Colour of the fog, RGB or grey, at least 0; 0 (black) by default.
        squared: Whether rho z is squared in the exponent; False by default.
        radial: Whether z is measured along the ray; False by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range.
        TypeError: A value is not a number or colour.
    """

    density: Scalar = eqx.field(converter=as_scalar, metadata={"lower": 0})
    I_dc: Colour = eqx.field(kw_only=True, converter=as_colour, default=0.0, metadata={"lower": 0})
    squared: bool = eqx.field(kw_only=True, static=True, default=False)
    radial: bool = eqx.field(kw_only=True, static=True, default=False)

    def visibility(self, z: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return s; 1 for z <= 0."""
        x = self.density * jnp.where(z > 0, z, 0.0)
        return jnp.exp(-x * x) if self.squared else jnp.exp(-x)

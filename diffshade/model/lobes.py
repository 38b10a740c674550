"""Lobes: how much of the light from one direction a surface sends towards another, and the shape of its highlight."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..core.fields import Array, Checked, Scalar, Vector, as_scalar, as_vector, parameter
from .fresnel import AbstractFresnel
from .vectors import Vec3, cross, dot, halfway, normalize, positive_power, reflect

EXPONENT_RANGE = (0.1, 1e4)  # range of n_s in a fit
EXPONENTS = tuple(4.0**k for k in range(7))  # tried by a fit: neighbours differ less than a basin of the cost is wide
EXPONENT = parameter("exponent", lower=0, logarithmic=True, start=10.0, fit_range=EXPONENT_RANGE, search=EXPONENTS)


class Coefficients(eqx.Module):
    """The coefficients of a material at the points that rays hit, where patterns have been evaluated to colours."""

    k_a: Vec3
    k_d: Vec3
    k_s: Vec3
    k_e: Vec3
    k_t: Vec3
    n_s: Float[Array, "..."] | Vec3
    eta: Float[Array, "..."]
    highlights: tuple[tuple[Vec3, Float[Array, "..."] | Vec3], ...] = ()
    """k_s and n_s of each further highlight."""


class AbstractReflectance(Checked):
    """How much of the light from l a surface sends towards v.

    Derive your own reflectance from this class if it has nothing of the classic model, and from `AbstractLobe` if only
    its highlight is different.
    """

    @abc.abstractmethod
    def reflected(self, k: Coefficients, fresnel: AbstractFresnel, n: Vec3, l: Vec3, v: Vec3) -> Vec3:
        """Return the fraction of the intensity that arrives from l which leaves towards v; 0 where n.l <= 0.

        All vectors are of unit length and point away from the surface. The numbers must be finite everywhere, and so
        must their derivatives.

        Args:
            k: The material's coefficients at the points.
            fresnel: The highlight's weight.
            n: Normal of the surface.
            l: Direction to the light.
            v: Direction to the viewer.

        Returns:
            The fraction, one value per channel.
        """


class AbstractLobe(AbstractReflectance):
    r"""A highlight beside diffuse reflection (E4): $k_d (n \cdot l)_+ + W \, highlight$, which is 0 where n.l <= 0."""

    @abc.abstractmethod
    def highlight(self, n_s: Float[Array, "..."] | Vec3, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."] | Vec3:
        """Return the highlight of weight 1 where n.l > 0; elsewhere it must only be finite, with finite derivatives.

        Args:
            n_s: The material's specular exponent, a `Vec3` where it has one per channel.
            n: Normal of the surface.
            l: Direction to the light.
            v: Direction to the viewer.

        Returns:
            The highlight, one value for all channels or one per channel.
        """

    def glsl(self) -> str | None:
        """Return the highlight for the live ball of a report: the body of a GLSL function, with the numbers in it.

        The function is `vec3 (vec3 n, vec3 l, vec3 v, vec3 n_s)`, and may call `vec3 halfway(vec3 l, vec3 v)` and `vec3
        power(float cosine, vec3 n_s)`. It is called where n.l > 0.

        Returns:
            The body; None, the default, shows Phong's highlight and says so.
        """
        return None

    def gated(
        self, lit: Bool[Array, "..."], n_s: Float[Array, "..."] | Vec3, n: Vec3, l: Vec3, v: Vec3
    ) -> Float[Array, "..."] | Vec3:
        """Return the highlight where the surface is lit, and 0 elsewhere."""
        found = self.highlight(n_s, n, l, v)
        _check_points(f"{type(self).__name__}.highlight", found, lit, n_s)
        if isinstance(found, Vec3):
            return Vec3(*(jnp.where(lit, c, 0.0) for c in (found.x, found.y, found.z)))
        return jnp.where(lit, found, 0.0)

    def diffuse_and_specular(
        self, k: Coefficients, fresnel: AbstractFresnel, n: Vec3, l: Vec3, v: Vec3
    ) -> tuple[Vec3, Vec3]:
        """Return k_d (n.l)_+ and W highlight, for a light whose colours are apart."""
        n_l = dot(n, l)
        lit = n_l > 0
        diffuse = jnp.where(lit, n_l, 0.0)
        W = fresnel.weight(k.k_s, k.eta, diffuse)
        return k.k_d * diffuse, W * self.gated(lit, k.n_s, n, l, v)

    def reflected(self, k: Coefficients, fresnel: AbstractFresnel, n: Vec3, l: Vec3, v: Vec3) -> Vec3:
        """Return k_d (n.l)_+ + W highlight."""
        diffuse, specular = self.diffuse_and_specular(k, fresnel, n, l, v)
        return diffuse + specular


class AbstractPowerLobe(AbstractLobe):
    r"""A highlight that is a cosine raised to n_s, $(cosine)_+^{n_s}$, whose fits are the fastest (E5, E6)."""

    @abc.abstractmethod
    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return the base of the highlight's power; all vectors are unit length and point away from the surface.

        Args:
            n: Normal of the surface.
            l: Direction to the light.
            v: Direction to the viewer.

        Returns:
            The cosine.
        """

    def highlight(self, n_s: Float[Array, "..."] | Vec3, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."] | Vec3:
        """Return (cosine)_+^n_s."""
        return _power(self.cosine(n, l, v), n_s)

    def gated(
        self, lit: Bool[Array, "..."], n_s: Float[Array, "..."] | Vec3, n: Vec3, l: Vec3, v: Vec3
    ) -> Float[Array, "..."] | Vec3:
        """Return (cosine)_+^n_s where the surface is lit; the cosine is gated, since its power costs the most."""
        cosine = self.cosine(n, l, v)
        _check_points(f"{type(self).__name__}.cosine", cosine, lit, n_s)
        return _power(jnp.where(lit, cosine, 0.0), n_s)


def _check_points(
    name: str, found: Float[Array, "..."] | Vec3, lit: Bool[Array, "..."], n_s: Float[Array, "..."] | Vec3
) -> None:
    """Refuse what a method of a user's lobe returns if it has an axis more than the points."""
    most = max(jnp.ndim(lit), 0 if isinstance(n_s, Vec3) else jnp.ndim(n_s))
    if not isinstance(found, Vec3) and jnp.ndim(found) > most:
        raise TypeError(
            f"{name} must return one number for each point, or a Vec3 of red, green and blue; got an array of shape "
            f"{jnp.shape(found)} for points of shape {jnp.shape(lit)}. Write it without a last axis for the channels."
        )


def _power(cosine: Float[Array, "..."], n_s: Float[Array, "..."] | Vec3) -> Float[Array, "..."] | Vec3:
    if isinstance(n_s, Vec3):  # one exponent per channel
        return Vec3(*(positive_power(cosine, n) for n in (n_s.x, n_s.y, n_s.z)))
    return positive_power(cosine, n_s)


class Phong(AbstractPowerLobe):
    r"""A highlight around the mirror direction r of the light (E5; Phong 1975).

    $$ W I_l (v \cdot r)_+^{n_s}, \qquad r = 2 (n \cdot l) n - l $$
    """

    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return v . r."""
        return dot(v, reflect(l, n))


class Blinn(AbstractPowerLobe):
    r"""A highlight around the halfway vector h (E6; Blinn 1977).

    $$ W I_l (n \cdot h)_+^{n_s}, \qquad h = (l + v) / |l + v| $$

    About four times Phong's n_s gives a similar highlight.
    """

    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return n . h."""
        return dot(n, halfway(l, v))


class Brushed(AbstractLobe):
    r"""Blinn's highlight with two exponents, of brushed metal, hair or satin (Ashikhmin and Shirley 2000, eq. 4).

    $$ W I_l (n \cdot h)_+^{(n_s (h \cdot u)^2 + n_v (h \cdot v)^2) / (1 - (h \cdot n)^2)} $$

    Here u is `along` projected into the surface and v = n x u; n_s is the material's. As in the rest of the model
    nothing is normalised: this is the paper's power alone. Where n_v = n_s it is Blinn's highlight.

    Args:
        along: Direction of the scratches, of any length except 0, in scene coordinates; the x axis by default.
        n_v: Exponent across the scratches, at least 0; 10 by default. Scratches along u widen the highlight across
            them, so n_v is below n_s for brushed metal.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, or the direction is the zero
            vector.
        TypeError: A value is not a number or vector of numbers.
    """

    along: Vector = eqx.field(converter=as_vector, default=(1.0, 0.0, 0.0), metadata=parameter("direction"))
    n_v: Scalar = eqx.field(converter=as_scalar, default=10.0, metadata=EXPONENT)

    def glsl(self) -> str:
        """Return the highlight for the live ball of a report."""
        x, y, z = (f"{float(c):.9e}" for c in self.along)
        return (
            "  vec3 h = halfway(l, v);\n"
            f"  vec3 u = vec3({x}, {y}, {z});\n"
            "  u -= dot(u, n) * n;\n"
            "  u = dot(u, u) > 0.0 ? normalize(u) : vec3(0.0);\n"
            "  float along = dot(h, u), across = dot(h, cross(n, u)), sine2 = along * along + across * across;\n"
            "  float share = sine2 > 0.0 ? along * along / sine2 : 0.0;\n"
            f"  return power(dot(n, h), mix(vec3({float(self.n_v):.9e}), n_s, share));"
        )

    def highlight(self, n_s: Float[Array, "..."] | Vec3, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."] | Vec3:
        """Return the power of n.h whose exponent depends on the azimuth of h."""
        h = halfway(l, v)
        n_h = dot(n, h)
        u = Vec3.of(self.along)
        u = normalize(u + n * -dot(u, n))  # 0 where the scratches are along the normal: Blinn's highlight of n_v
        across = dot(h, cross(n, u))
        along = dot(h, u)
        sine2 = along * along + across * across
        share = jnp.where(sine2 > 0, along * along, 0.0) / jnp.where(sine2 > 0, sine2, 1.0)

        def exponent(n_u: Array) -> Array:
            return self.n_v + (n_u - self.n_v) * share

        exponents = Vec3(*(exponent(c) for c in (n_s.x, n_s.y, n_s.z))) if isinstance(n_s, Vec3) else exponent(n_s)
        return _power(n_h, exponents)

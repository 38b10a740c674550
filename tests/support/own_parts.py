"""A lobe, a whole reflectance, lights, a pattern and a surface of a user's own, made of `diffshade.extension` alone."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffshade.extension import (
    AbstractAttenuation,
    AbstractEmitter,
    AbstractLamp,
    AbstractLight,
    AbstractLobe,
    AbstractPattern,
    AbstractPowerLobe,
    AbstractReflectance,
    AbstractSurface,
    Colour,
    Hit,
    Path,
    PointLight,
    RadialAttenuation,
    Scalar,
    Vec3,
    Vector,
    colour,
    dot,
    halfway,
    length,
    normalize,
    number,
    reflect,
    vector,
    where,
)


class MicroFacets(AbstractLobe):
    """Beckmann's distribution of facets with Torrance and Sparrow's shadowing (Cook and Torrance 1982)."""

    m: Scalar = number(0.3, lower=0.02, upper=2, start=0.3, search=(0.08, 0.15, 0.3, 0.6), logarithmic=True)

    def highlight(self, n_s, n, l, v):
        h = halfway(l, v)
        n_h, v_h, n_l, n_v = (jnp.where(c > 1e-3, c, 1e-3) for c in (dot(n, h), dot(v, h), dot(n, l), dot(n, v)))
        cos2, m2 = n_h * n_h, self.m * self.m
        D = jnp.exp((1.0 - 1.0 / cos2) / m2) / (4.0 * m2 * cos2 * cos2)
        G = jnp.minimum(1.0, jnp.minimum(2.0 * n_h * n_v / v_h, 2.0 * n_h * n_l / v_h))
        return D * G / n_v

    def glsl(self):
        return f"""
          vec3 h = halfway(l, v);
          float n_h = max(dot(n, h), 1e-3), v_h = max(dot(v, h), 1e-3), n_l = max(dot(n, l), 1e-3);
          float n_v = max(dot(n, v), 1e-3), cos2 = n_h * n_h, m2 = {float(self.m):.9e} * {float(self.m):.9e};
          float D = exp((1.0 - 1.0 / cos2) / m2) / (4.0 * m2 * cos2 * cos2);
          float G = min(1.0, min(2.0 * n_h * n_v / v_h, 2.0 * n_h * n_l / v_h));
          return vec3(D * G / n_v);"""


class WrappedDiffuse(AbstractReflectance):
    """Diffuse reflection that reaches round the terminator (wrap lighting), without a highlight."""

    wrap: Scalar = number(0.5, lower=0, upper=1)

    def reflected(self, k, fresnel, n, l, v):
        cosine = (dot(n, l) + self.wrap) / (1.0 + self.wrap)
        return k.k_d * jnp.where(cosine > 0, cosine, 0.0)


class Wide(AbstractPowerLobe):
    """A highlight that reaches round to the dark side of r."""

    def cosine(self, n, l, v):
        return 0.5 + 0.5 * dot(v, reflect(l, n))


class FadingLamp(AbstractEmitter):
    """A lamp that fades with 1/d."""

    position: Vector = vector(role="position")
    intensity: Colour = colour(1.0)

    @property
    def is_local(self):
        return True

    def path(self, p):
        assert p is not None
        to_light = Vec3.of(self.position) - p
        return Path(normalize(to_light), length(to_light), None)

    def arriving(self, p):
        l, d, _ = self.path(p)
        assert d is not None
        return l, Vec3.of(self.intensity) * (1.0 / d)


class Lantern(AbstractLamp):
    """A lamp that is the brighter the more it is above the point: what it sends down is not what it sends aside."""

    position: Vector = vector(role="position")
    intensity: Colour = colour(1.0)
    attenuation: RadialAttenuation = eqx.field(default_factory=RadialAttenuation)

    def path(self, p):
        assert p is not None
        to_light = Vec3.of(self.position) - p
        l = normalize(to_light)
        return Path(l, length(to_light), 0.5 + 0.5 * l.y)


class HazyAttenuation(AbstractAttenuation):
    """A medium that absorbs: e^(-rho d)."""

    rho: Scalar = number(0.1, lower=0, start=0.0, role="attenuation")

    def factor(self, d):
        return jnp.exp(-self.rho * d)

    def glsl(self):
        return f"return exp(-{float(self.rho):.9e} * d);"


class PowerAttenuation(AbstractAttenuation):
    """1/(a d^p), of which nothing is known but its formula."""

    a: Scalar = number(1.0, lower=0, role="amplitude", gauge=1)
    p: Scalar = number(2.0, lower=0, upper=6, search=(0.5, 1.0, 2.0, 4.0), role="attenuation")

    def factor(self, d):
        return 1.0 / (self.a * jnp.exp(self.p * jnp.log(d)))


class TubeLight(AbstractLight):
    """A tube: point lights along a line, which share its intensity."""

    start: Vector = vector(role="position")
    end: Vector = vector(role="position")
    intensity: Colour = colour(1.0)
    samples: int = eqx.field(static=True, default=6)

    @property
    def is_local(self):
        return True

    def emitters(self):
        def at(t):
            return PointLight(self.start + t * (self.end - self.start), self.intensity / self.samples)

        return jax.vmap(at)((np.arange(self.samples) + 0.5) / self.samples)


class Marble(AbstractPattern):
    """Two colours in veins: a sine whose phase three other sines bend."""

    a: Colour = colour()
    b: Colour = colour()
    turns: Scalar = number(2.0, lower=0.1)

    def __call__(self, p):
        bend = jnp.sin(3.1 * p.y + 1.0) + 0.5 * jnp.sin(6.7 * p.z + 2.0) + 0.25 * jnp.sin(13.3 * p.x)
        share = 0.5 + 0.5 * jnp.sin(self.turns * (2.0 * p.x + bend))
        a, b = Vec3.of(self.a), Vec3.of(self.b)
        return b + (a - b) * share


class PlateDisc(AbstractSurface):
    """A flat disc that faces +z."""

    radius: Scalar = number(1.0, lower=0)

    def extent(self):
        return float(self.radius)

    def intersect(self, rays):
        o, d = rays.origin, rays.direction
        meets = jnp.abs(d.z) > 1e-9
        t = -o.z / jnp.where(meets, d.z, 1.0)
        p = o + d * t
        one = jnp.ones_like(t)
        n = where(d.z < 0, Vec3(0 * one, 0 * one, one), Vec3(0 * one, 0 * one, -one))
        return Hit(t, p, n, meets & (t > 0) & (p.x * p.x + p.y * p.y < self.radius**2))

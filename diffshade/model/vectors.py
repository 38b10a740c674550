"""Vectors with separate components: points, directions and colours, and the few operations of the model.

A `Vec3` holds three arrays of one shape, whatever it is. So the body of a function is its equation, for one point, an
image or a block of pixels. If a formula has no derivative at a point, the one used here is finite and documented.
"""

from __future__ import annotations

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..core.fields import Array, Vector

T = TypeVar("T")


class Vec3(eqx.Module):
    """Three arrays of one shape: x, y, z of a point or direction, or R, G, B of a colour.

    `+ - *` act component by component (`*` of two colours is the product GLSL has); a plain array or number acts on
    all three.
    """

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    z: Float[Array, "..."]

    @staticmethod
    def of(array: Float[Array, "... 3"]) -> Vec3:
        """Take the last axis of an array apart."""
        return Vec3(array[..., 0], array[..., 1], array[..., 2])

    def stack(self) -> Float[Array, "... 3"]:
        """Put the components back on a last axis.

        This selects instead of calling `jnp.stack`: XLA's CPU compiler fuses a concatenation with everything before it,
        and repeats that in each branch (measured on an image: 9,000 ns a pixel against 11). A component that is
        concatenated with itself is a broadcast to XLA, and slices in reverse mode. The derivative of a broadcast would
        write an image for each component, and sum it.
        """
        x, y, z = (jnp.concatenate([c[..., None]] * 3, -1) for c in jnp.broadcast_arrays(self.x, self.y, self.z))
        component = jnp.arange(3).reshape((1,) * (x.ndim - 1) + (3,))
        return jnp.where(component == 0, x, jnp.where(component == 1, y, z))

    def __add__(self, other: Vec3) -> Vec3:
        return Vec3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vec3) -> Vec3:
        return Vec3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self) -> Vec3:
        return Vec3(-self.x, -self.y, -self.z)

    def __mul__(self, other: Vec3 | Float[Array, "..."] | float) -> Vec3:
        if isinstance(other, Vec3):
            return Vec3(self.x * other.x, self.y * other.y, self.z * other.z)
        return Vec3(self.x * other, self.y * other, self.z * other)

    __rmul__ = __mul__


def where(condition: Bool[Array, "..."], a: T, b: T) -> T:
    """Choose element by element between two vectors, or two trees of arrays of one structure."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def dot(a: Vec3, b: Vec3) -> Float[Array, "..."]:
    """a . b"""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec3, b: Vec3) -> Vec3:
    """a x b, right-handed."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def along_one_line(a: Vector, b: Vector) -> bool:
    """Whether two vectors span no plane, to rounding."""
    a, b = (np.asarray(vector, np.float64) for vector in (a, b))
    return bool(np.linalg.norm(np.cross(a, b)) <= 1e-9 * np.linalg.norm(a) * np.linalg.norm(b))


def safe_sqrt(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """sqrt(x) for x > 0, else 0; the derivative at and below 0 is 0 (the true one is infinite at 0)."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def length(a: Vec3) -> Float[Array, "..."]:
    """|a|, with derivative 0 at a = 0."""
    return safe_sqrt(dot(a, a))


def normalize(a: Vec3) -> Vec3:
    """a / |a|; the zero vector stays zero, with derivative 0."""
    squared = dot(a, a)
    positive = squared > 0
    return a * jnp.where(positive, 1.0 / jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def reflect(l: Vec3, n: Vec3) -> Vec3:
    """Mirror direction r = 2(n.l)n - l, so that l + r = 2(n.l)n (Phong 1975)."""
    return n * (2.0 * dot(n, l)) - l


def halfway(l: Vec3, v: Vec3) -> Vec3:
    """Halfway vector h = (l + v)/|l + v| (Blinn 1977); 0 where l = -v, to within 1e-6, with derivative 0."""
    h = l + v
    squared = dot(h, h)
    apart = squared > 1e-12  # below it, rounding would determine the direction of h
    return h * jnp.where(apart, 1.0 / jnp.sqrt(jnp.where(apart, squared, 1.0)), 0.0)


def tangents_of(n: Vec3) -> tuple[Vec3, Vec3]:
    """Return two unit vectors orthogonal to n and to each other, continuous but at z = 0 (Duff et al. 2017)."""
    sign = jnp.where(n.z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + n.z)
    b = n.x * n.y * a
    return Vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3(b, sign + n.y * n.y * a, -n.y)


def refract(v: Vec3, n: Vec3, ratio: Float[Array, "..."]) -> tuple[Vec3, Bool[Array, "..."]]:
    """Refracted direction T = (ratio cos t_i - cos t_r) n - ratio v, and whether there is one (E12; Snell).

    `v` and `n` point away from the surface to the side that light comes from, cos t_i = n.v; ratio = eta_i/eta_r, so
    that sin t_r = ratio sin t_i. If that exceeds 1, there is total internal reflection: T does not exist, and the
    vector returned is finite but meaningless. The true derivative is infinite at the critical angle; the one here is 0,
    that of the totally reflecting side.
    """
    cos_i = dot(n, v)
    cos2_r = 1.0 - ratio * ratio * (1.0 - cos_i * cos_i)
    return n * (ratio * cos_i - safe_sqrt(cos2_r)) - v * ratio, cos2_r > 0


def positive_power(x: Float[Array, "..."], n: Float[Array, "..."]) -> Float[Array, "..."]:
    """(x)_+^n: 0 for x <= 0 even at n = 0, and 1 for x > 0 at n = 0.

    The derivative at and below x = 0 is 0, that of the dark side. As x -> 0+ with 0 < n < 1 the true one is infinite.
    """
    positive = (
        x > 0
    )  # selected before the exponential: XLA repeats what follows it for each channel, but not the exponential
    return jnp.exp(jnp.where(positive, n * jnp.log(jnp.where(positive, x, 1.0)), -jnp.inf))

"""Patterns: coefficients that change from point to point of a surface, or with its texture coordinates."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import (
    Array,
    Checked,
    Coefficient,
    Colour,
    Scalar,
    Vector,
    as_coefficient,
    as_colour,
    as_scalar,
    as_vector,
    in_short,
    parameter,
)
from .vectors import Vec3, dot, where

AXIS = parameter(by_own_name=True) | {"nonzero": True}


class AbstractPattern(Checked):
    """A colour as a function of the point, or of the texture coordinates there."""

    @property
    def over_texture(self) -> bool:
        """Whether it is called with texture coordinates (u, v, 0), and not with a point of the scene."""
        return False

    @abc.abstractmethod
    def __call__(self, p: Vec3) -> Vec3:
        """Return the colour at a point.

        Args:
            p: The point, scene units; or (u, v, 0) where `over_texture` is True.

        Returns:
            The colour.
        """


class Chequer(AbstractPattern):
    r"""Squares of two colours in the plane of u and v: `a` where w > 0, `b` elsewhere.

    $$ w = \sin(2\pi \, p \cdot u / period) \sin(2\pi \, p \cdot v / period) $$

    With `smooth=True` the colour is $b + (a - b)(1 + w) / 2$, which is differentiable everywhere. At the edges of the
    hard squares there is a jump, which contributes no derivative.

    Args:
        a: Colour where w > 0, RGB or grey, at least 0, and in the range of the coefficient that it replaces.
        b: Colour elsewhere, as `a`.
        period: Length of two squares, scene units, above 0; 1 by default.
        smooth: Whether the colour changes smoothly; False by default.
        u: First direction along which squares are counted, not the zero vector; the x axis by default.
        v: Second direction, not the zero vector; the y axis by default. For a floor use (1, 0, 0) and (0, 0, 1).

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, or a direction is the zero
            vector.
        TypeError: A value is not a number, colour or vector.
    """

    a: Colour = eqx.field(converter=as_colour, metadata={"lower": 0})
    b: Colour = eqx.field(converter=as_colour, metadata={"lower": 0})
    period: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata=parameter(by_own_name=True) | {"above": 0})
    smooth: bool = eqx.field(static=True, default=False)
    u: Vector = eqx.field(converter=as_vector, default=(1.0, 0.0, 0.0), metadata=AXIS)
    v: Vector = eqx.field(converter=as_vector, default=(0.0, 1.0, 0.0), metadata=AXIS)

    def __call__(self, p: Vec3) -> Vec3:
        """Return the colour at p."""
        x, y = (jnp.sin(2.0 * np.pi / self.period * dot(Vec3.of(axis), p)) for axis in (self.u, self.v))
        a, b, wave = Vec3.of(self.a), Vec3.of(self.b), x * y
        return b + (a - b) * (0.5 + 0.5 * wave) if self.smooth else where(wave > 0, a, b)


class Texture(AbstractPattern):
    r"""An image over the texture coordinates of a surface, repeated, with bilinear interpolation.

    u runs to the right and v up, from 0 to 1 over the image; row 0 is on top. It is interpolated between its last
    column and its first, but not between its bottom row and its top. A `Sphere` has u around its y axis, 0.5 on the +z
    side, and v from its south pole to its north pole; each face of a `Box` has the whole image; on a `Plane` an image
    is one scene unit wide and high, around its point.

    Args:
        values: (H, W), (H, W, 1) or (H, W, 3), in the range of the coefficient that it stands for; a JAX array can be
            differentiated. Read a file of colours with `read_image`.

    Raises:
        ValueError: The array has another shape, or a number that is not finite.
        TypeError: It is not an array of numbers.
    """

    values: Float[Array, "h w 3"] = eqx.field(converter=as_coefficient)

    @property
    def over_texture(self) -> bool:
        """True."""
        return True

    def check_together(self) -> None:
        if np.ndim(self.values) != 3:
            raise ValueError(
                f"Texture.values must be an image (H, W) or (H, W, 3); got shape {np.shape(self.values)}. Give a "
                "colour to the coefficient itself."
            )

    def __call__(self, p: Vec3) -> Vec3:
        """Return the image at (u, v), between the centres of four of its pixels."""
        h, w = self.values.shape[:2]
        x, y = (p.x - jnp.floor(p.x)) * w - 0.5, (1.0 - (p.y - jnp.floor(p.y))) * h - 0.5
        left, top = jnp.floor(x), jnp.floor(y)
        along, down = x - left, y - top
        columns = [jnp.mod(left.astype(int) + k, w) for k in (0, 1)]
        rows = [jnp.clip(top.astype(int) + k, 0, h - 1) for k in (0, 1)]  # the poles of a sphere stay apart
        values = jnp.asarray(self.values)
        upper, lower = (
            Vec3.of(values[row, columns[0]]) * (1.0 - along) + Vec3.of(values[row, columns[1]]) * along for row in rows
        )
        return upper * (1.0 - down) + lower * down


def colour_at(coefficient: Coefficient, p: Vec3 | None, uv: Vec3 | None = None) -> Vec3:
    """Return a coefficient at the point p, with texture coordinates uv."""
    if isinstance(coefficient, AbstractPattern):
        at = uv if coefficient.over_texture else p
        assert at is not None
        found = coefficient(at)
        if not isinstance(found, Vec3):
            raise TypeError(
                f"{type(coefficient).__name__} must return a Vec3 of red, green and blue; got {in_short(found)}. Make "
                "one of three arrays of the point's shape: Vec3(r, g, b)."
            )
        return found
    return Vec3.of(coefficient)

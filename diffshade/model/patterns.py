"""Patterns: coefficients that change from point to point of a surface."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..core.fields import (
    Checked,
    Coefficient,
    Colour,
    Scalar,
    Vector,
    as_colour,
    as_scalar,
    as_vector,
    is_concrete,
    parameter,
)
from .vectors import Vec3, dot, where


class AbstractPattern(Checked):
    """A colour as a function of the point."""

    @abc.abstractmethod
    def __call__(self, p: Vec3) -> Vec3:
        """Return the colour at a point.

        Args:
            p: The point, scene units.

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
    period: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata=parameter(by_own_name=True))
    smooth: bool = eqx.field(static=True, default=False)
    u: Vector = eqx.field(converter=as_vector, default=(1.0, 0.0, 0.0), metadata=parameter(by_own_name=True))
    v: Vector = eqx.field(converter=as_vector, default=(0.0, 1.0, 0.0), metadata=parameter(by_own_name=True))

    def check_together(self) -> None:
        if is_concrete(self.period) and not self.period > 0:
            raise ValueError(f"Chequer.period must be above 0; got {self.period}. Give the length of two squares.")
        for name, axis in (("u", self.u), ("v", self.v)):
            if is_concrete(axis) and not np.any(axis):
                raise ValueError(
                    f"Chequer.{name} must not be the zero vector; got [0, 0, 0]. Give a direction in which to count."
                )

    def __call__(self, p: Vec3) -> Vec3:
        """Return the colour at p."""
        x, y = (jnp.sin(2.0 * np.pi / self.period * dot(Vec3.of(axis), p)) for axis in (self.u, self.v))
        a, b, wave = Vec3.of(self.a), Vec3.of(self.b), x * y
        return b + (a - b) * (0.5 + 0.5 * wave) if self.smooth else where(wave > 0, a, b)


def colour_at(coefficient: Coefficient, p: Vec3 | None) -> Vec3:
    """Return a coefficient at the point p."""
    if isinstance(coefficient, AbstractPattern):
        assert p is not None
        return coefficient(p)
    return Vec3.of(coefficient)

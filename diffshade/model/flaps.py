"""Flaps: planes across the axes of the world that confine the light of a lamp (E3; Warn 1983)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array, Checked, Scalar, as_scalar, check_kind, is_concrete
from .attenuation import share_of_edge
from .vectors import Vec3

LIMITS = tuple(f"{axis}_{end}" for axis in "xyz" for end in ("min", "max"))


class Flaps(Checked):
    r"""Flaps of a lamp: its light reaches only points between planes across the axes of the world (E3; Warn 1983).

    $$ f_{flaps} = \prod_{c \in \{x, y, z\}} S((c - c_{min}) / w) \; S((c_{max} - c) / w) $$

    (x, y, z) is the point and w is `softness`. S is 0 below 0, 1 above 1, and the smooth step $t^2 (3 - 2t)$ between,
    so that the light fades within the limits; with softness 0, S is 1 from 0 on (a hard edge), which contributes no
    derivative. A flap that is not given is open: its factor is 1. The factor multiplies the lamp's angular attenuation
    (Foley et al. 1990, 16.1.5).

    Args:
        x_min: Least x that the light reaches, scene units; none by default.
        x_max: Largest x, scene units, more than `x_min`; none by default.
        y_min: Least y, scene units; none by default.
        y_max: Largest y, scene units, more than `y_min`; none by default.
        z_min: Least z, scene units; none by default.
        z_max: Largest z, scene units, more than `z_min`; none by default.
        softness: w, the width of the smooth edge within each limit, scene units, at least 0; 0 by default. The limits
            can be fitted only if it is above 0.

    Raises:
        ValueError: A value is not finite or is out of its range, or a least value is not below the largest.
        TypeError: A value is not a number.
    """

    x_min: Scalar | None = eqx.field(converter=as_scalar, default=None)
    x_max: Scalar | None = eqx.field(converter=as_scalar, default=None)
    y_min: Scalar | None = eqx.field(converter=as_scalar, default=None)
    y_max: Scalar | None = eqx.field(converter=as_scalar, default=None)
    z_min: Scalar | None = eqx.field(converter=as_scalar, default=None)
    z_max: Scalar | None = eqx.field(converter=as_scalar, default=None)
    softness: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})

    def check_together(self) -> None:
        for axis, low, high in self._limits():
            if low is not None and high is not None and is_concrete(low, high) and not low < high:
                raise ValueError(
                    f"Flaps.{axis}_min must be less than {axis}_max; got {low} and {high}. Give the smaller one as "
                    f"{axis}_min, or leave one out."
                )

    def _limits(self) -> Iterator[tuple[str, Scalar | None, Scalar | None]]:
        for axis in "xyz":
            yield axis, getattr(self, f"{axis}_min"), getattr(self, f"{axis}_max")

    def __call__(self, p: Vec3) -> Float[Array, "..."]:
        """Return f_flaps at a point.

        Args:
            p: The point, scene units.

        Returns:
            f_flaps, with the shape of a component of p.
        """
        f = jnp.ones_like(p.x)
        for axis, low, high in self._limits():
            c = getattr(p, axis)
            f = f if low is None else f * self._passing(c - low)
            f = f if high is None else f * self._passing(high - c)
        return f

    def _passing(self, inside: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return S so far within a limit."""
        t = share_of_edge(inside, self.softness)
        return jnp.where(inside >= 0, t * t * (3.0 - 2.0 * t), 0.0)


def confined(f_ang: Float[Array, "..."] | None, flaps: Flaps | None, p: Vec3) -> Float[Array, "..."] | None:
    """Return an angular attenuation with that of a lamp's flaps; None is 1 of both.

    Args:
        f_ang: Angular attenuation of the lamp without flaps.
        flaps: The flaps.
        p: The point, scene units.

    Returns:
        The product.
    """
    if flaps is None:
        return f_ang
    return flaps(p) if f_ang is None else f_ang * flaps(p)


def check_flaps(light: Any) -> None:
    """Refuse flaps of a light that are none."""
    if light.flaps is not None:
        check_kind(f"{type(light).__name__}.flaps", light.flaps, Flaps, "Flaps(x_min=-1, x_max=1)")

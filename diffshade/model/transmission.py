"""Transmission: how a solid bends a ray that passes through it (E12; Snell). `tracing` follows the ray."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..core.barriers import computed_once
from ..core.fields import Array
from .cameras import Rays
from .surfaces import AbstractSolid, Hit
from .vectors import refract, where


class Way(eqx.Module):
    """The way of a ray that has met a solid: `length` along `inner`, within the solid, and then along `outer`."""

    inner: Rays
    length: Float[Array, "..."]
    outer: Rays


def straight(rays: Rays) -> Way:
    """Return the way of rays that have met nothing yet."""
    return Way(rays, jnp.zeros_like(rays.direction.x), rays)


def bend(solid: AbstractSolid, rays: Rays, hit: Hit, eta: Float[Array, "..."]) -> tuple[Way, Bool[Array, "..."]]:
    """Return the way of rays through a solid that they hit, and whether there is one (E12; Snell).

    On entering, T = refract(v, n, 1/eta) with v = -direction; on leaving, at the last point of the solid along T, n and
    the ratio invert. Outside is air. There is no way if the ray is totally reflected on entering or leaving. A ray that
    starts inside the solid only leaves it.
    """
    far, enters = computed_once((solid.leave(rays), ~solid.holds(rays)))
    T, enters_at_all = computed_once(refract(-rays.direction, hit.n, 1.0 / eta))
    assert hit.p is not None
    inside = Rays(hit.p, T)
    exit_ = computed_once(solid.leave(inside))
    inner = where(enters, inside, rays)
    p, n = where(enters, (exit_.p, exit_.n), (far.p, far.n))
    assert p is not None
    inner, p, n = computed_once((inner, p, n))
    out, leaves = computed_once(refract(-inner.direction, -n, eta))
    return Way(inner, jnp.where(enters, exit_.distance, far.distance), Rays(p, out)), (enters_at_all | ~enters) & leaves

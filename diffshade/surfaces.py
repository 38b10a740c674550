"""Surfaces: where a ray meets a shape, and which way the shape faces there."""

from __future__ import annotations

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from .cameras import Rays
from .fields import Array, Checked, Scalar, Vector, as_array, as_scalar, as_vector, is_concrete
from .vectors import Vec3, dot, normalize, safe_sqrt, where


class Hit(eqx.Module):
    """Where rays meet a surface: distance along the ray, point, unit normal, and whether they meet it at all.

    Outside `inside` the numbers are finite and mean nothing. `p` is None where the surface does not know it.
    """

    distance: Float[Array, "..."]
    p: Vec3 | None
    n: Vec3
    inside: Bool[Array, "..."]


class AbstractSurface(Checked):
    """A shape that rays meet."""

    @abc.abstractmethod
    def intersect(self, rays: Rays) -> Hit:
        """Return the first hit in front of each ray's origin."""


class Sphere(AbstractSurface):
    """A sphere; normals point outward, or to the viewer's side when seen from inside. Lengths are scene units.

    The derivative of a hit grows without bound at the silhouette. A ray that misses gets the sphere's nearest point,
    which is smooth across the silhouette's edge; `inside` is False there.
    """

    center: Vector = eqx.field(converter=as_vector, default=(0.0, 0.0, 0.0))
    radius: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata={"lower": 0})

    def check_together(self) -> None:
        if is_concrete(self.radius) and not self.radius > 0:
            raise ValueError(f"Sphere.radius must be above 0; got {self.radius}. Give the radius in scene units.")

    def intersect(self, rays: Rays) -> Hit:
        """Solve |o + t d - c|^2 = radius^2 for the smallest t > 0."""
        center = Vec3.of(self.center)
        o, d = rays.origin - center, rays.direction
        nearest = -dot(o, d)  # t of the point of the ray nearest to the centre
        miss = o + d * nearest
        half_chord2 = self.radius * self.radius - dot(miss, miss)
        half_chord = safe_sqrt(half_chord2)
        hit, outside = half_chord2 > 0, nearest > half_chord
        t = jnp.where(outside, nearest - half_chord, nearest + half_chord)
        n = normalize(where(hit, o + d * t, miss))
        facing = where(hit & ~outside, -n, n)
        return Hit(t, center + n * self.radius, facing, hit & (t > 0))


def as_mask(mask: ArrayLike) -> Bool[Array, "..."]:
    """Make a mask boolean: at least half is inside."""
    mask = mask if isinstance(mask, jax.Array) else np.asarray(mask)
    return mask if mask.dtype == bool else mask >= 0.5


class GBuffer(AbstractSurface):
    """A surface as one camera sees it: any shape, from a normal map, a mesh or another renderer.

    `normal`: (H, W, 3), unit to within 0.001, never flipped. `position`: (H, W, 3), scene units; needed by point and
    spot lights, a local viewer and several objects, else it may be left out. `mask`: (H, W), True (or at least half)
    where the surface is; without it, where the normal is not zero. Outside the mask the numbers are not looked at and
    not kept.
    """

    normal: Float[Array, "h w 3"]
    position: Float[Array, "h w 3"] | None
    mask: Bool[Array, "h w"]

    def __init__(self, normal: Array, position: Array | None = None, mask: ArrayLike | None = None):
        normal = as_array(normal)
        position = None if position is None else as_array(position)
        inside = (normal != 0).any(-1) if mask is None else as_mask(mask)
        for name, array in (("normal", normal), ("position", position)):
            if array is not None and (inside.ndim != 2 or array.shape != (*inside.shape, 3)):
                raise ValueError(
                    f"GBuffer.{name} must have shape (H, W, 3), with the mask's H and W; got {array.shape} with a mask "
                    f"of shape {inside.shape}. Give one vector a pixel."
                )
        keep = np.where if is_concrete(normal, position, inside) else jnp.where
        self.normal = keep(inside[..., None], normal, 0.0)
        self.position = None if position is None else keep(inside[..., None], position, 0.0)
        self.mask = inside

    def check_together(self) -> None:
        if not is_concrete(self.normal, self.mask):
            return
        squared = np.sum(np.square(self.normal), -1)
        points = self.normal if self.position is None else self.position
        wrong = np.asarray(self.mask) & ~((np.abs(squared - 1.0) < 2e-3) & np.isfinite(points).all(-1))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise ValueError(
                f"GBuffer needs a unit normal and a finite position at every pixel of its mask; at row {row}, column "
                f"{column} the normal is {self.normal[row, column]} and the position "
                f"{None if self.position is None else self.position[row, column]}. Normalise it or mask it out."
            )

    def intersect(self, rays: Rays) -> Hit:
        """Return the buffer's own points: the rays must be those of the camera that it was made for."""
        p = None if self.position is None else Vec3.of(self.position)
        distance = jnp.zeros(self.mask.shape) if p is None else dot(p - rays.origin, rays.direction)
        return Hit(distance, p, Vec3.of(self.normal), self.mask)

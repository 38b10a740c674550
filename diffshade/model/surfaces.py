"""Surfaces: where a ray meets a shape, and the normal there."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..core.fields import Array, Checked, Scalar, Vector, as_scalar, as_vector, parameter
from ..core.thresholds import TINY
from .cameras import Rays
from .vectors import Vec3, cross, dot, normalize, safe_sqrt, where


class Hit(eqx.Module):
    """Where rays meet a surface: distance along the ray, point, unit normal, and whether they meet it at all.

    Where `inside` is False the numbers are finite but have no meaning. `p` is None if the surface has no positions.
    """

    distance: Float[Array, "..."]
    p: Vec3 | None
    n: Vec3
    inside: Bool[Array, "..."]


class AbstractSurface(Checked):
    """A shape that rays can meet."""

    @abc.abstractmethod
    def intersect(self, rays: Rays) -> Hit:
        """Return the first hit in front of each ray's origin.

        Args:
            rays: Rays with unit directions.

        Returns:
            The hits, one per ray.
        """

    def extent(self) -> float:
        """Return the approximate distance from the middle of the surface to its edge.

        Returns:
            The distance in scene units; 0 for a surface without such a length.
        """
        return 0.0

    @property
    def is_textured(self) -> bool:
        """Whether the surface has texture coordinates."""
        return False

    def texture(self, p: Vec3, n: Vec3) -> tuple[Vec3, Vec3, Vec3]:
        """Return the texture coordinates of points of the surface, and the directions in which they grow.

        Args:
            p: The points.
            n: Their normals, on the viewer's side.

        Returns:
            (u, v, 0), and two unit vectors in the surface, along u and along v.
        """
        raise NotImplementedError  # asked only of a surface that `is_textured`


class AbstractSolid(AbstractSurface):
    """A convex shape with an interior through which rays can pass."""

    @abc.abstractmethod
    def leave(self, rays: Rays) -> Hit:
        """Return the last hit of each ray, where it leaves the solid, with the outward normal.

        Args:
            rays: Rays with unit directions.

        Returns:
            The hits, one per ray.
        """

    @abc.abstractmethod
    def holds(self, rays: Rays) -> Bool[Array, "..."]:
        """Return whether the origin of a ray that hits the solid is inside it; then the first hit is the last.

        Args:
            rays: Rays with unit directions.

        Returns:
            True for each ray that starts inside.
        """


def touching(t: Array, size: Array) -> Array:
    """Return the distance from a solid within which a ray's origin counts as on it: the ray enters there or misses.

    Rays continue from points on surfaces, and solids touch each other. The decision there must not depend on rounding:
    compiled code may compute a value more than once, for x of a point and for y, and round it differently each time.
    """
    return 4.0 * np.sqrt(float(jnp.finfo(t.dtype).eps)) * size


class Sphere(AbstractSolid):
    """A sphere; normals point outward, or to the viewer's side when seen from inside.

    $$ |o + t d - center|^2 = {radius}^2 $$

    A ray from o along d meets it at the smallest t > 0. The derivative of a hit grows without bound at the silhouette.
    A ray that misses gets the sphere's nearest point, which is smooth across the edge of the silhouette; `inside` is
    False there.

    Args:
        center: Centre, scene units; the origin by default.
        radius: Radius, scene units, above 0; 1 by default.

    Raises:
        ValueError: A value has the wrong shape or is not finite, or the radius is not above 0.
        TypeError: A value is not a number or vector of numbers.
    """

    center: Vector = eqx.field(converter=as_vector, default=(0.0, 0.0, 0.0), metadata=parameter("position"))
    radius: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata={"lower": 0, "above": 0})

    def extent(self) -> float:
        """Return the radius."""
        return float(self.radius)

    def intersect(self, rays: Rays) -> Hit:
        """Solve |o + t d - c|^2 = radius^2 for the smallest t > 0."""
        nearest, half_chord, hit, miss = self._chord(rays)
        within = self.holds(rays)
        t = jnp.where(within, nearest + half_chord, nearest - half_chord)
        n = self._normal(rays, t, hit, miss)
        facing = where(hit & within, -n, n)
        in_front = nearest + half_chord > touching(nearest, self.radius)
        return Hit(t, Vec3.of(self.center) + n * self.radius, facing, hit & in_front)

    def leave(self, rays: Rays) -> Hit:
        """Solve |o + t d - c|^2 = radius^2 for the largest t."""
        nearest, half_chord, hit, miss = self._chord(rays)
        t = nearest + half_chord
        n = self._normal(rays, t, hit, miss)
        return Hit(t, Vec3.of(self.center) + n * self.radius, n, hit & (t > 0))

    def holds(self, rays: Rays) -> Bool[Array, "..."]:
        """Return whether the sphere was entered behind the origin."""
        nearest, half_chord, _, _ = self._chord(rays)
        return nearest - half_chord <= -touching(nearest, self.radius)

    @property
    def is_textured(self) -> bool:
        """True."""
        return True

    def texture(self, p: Vec3, n: Vec3) -> tuple[Vec3, Vec3, Vec3]:
        """Return u = 1/2 + azimuth / 360 and v = 1/2 + elevation / 180, azimuth 0 at +z and 90 degrees at +x."""
        out = (p - Vec3.of(self.center)) * (1.0 / self.radius)
        across2 = out.x * out.x + out.z * out.z
        off_axis = across2 > 1e-24  # at the poles the azimuth is 0, with derivative 0
        across = jnp.sqrt(jnp.where(off_axis, across2, 1.0))
        azimuth = jnp.arctan2(jnp.where(off_axis, out.x, 0.0), jnp.where(off_axis, out.z, 1.0))
        elevation = jnp.arctan2(out.y, jnp.where(off_axis, across, 0.0) + jnp.where(off_axis, 0.0, 1e-12))
        zero = jnp.zeros_like(azimuth)
        along_u = Vec3(jnp.where(off_axis, out.z, 1.0), zero, jnp.where(off_axis, -out.x, 0.0)) * (
            1.0 / jnp.where(off_axis, across, 1.0)
        )
        return Vec3(0.5 + azimuth / (2.0 * np.pi), 0.5 + elevation / np.pi, zero), along_u, cross(out, along_u)

    def _chord(self, rays: Rays) -> tuple[Array, Array, Array, Vec3]:
        """Return t of the point of a ray nearest to the centre, half the chord, whether there is one, and the point."""
        o, d = rays.origin - Vec3.of(self.center), rays.direction
        nearest = -dot(o, d)
        miss = o + d * nearest
        half_chord2 = self.radius * self.radius - dot(miss, miss)
        return nearest, safe_sqrt(half_chord2), half_chord2 > 0, miss

    def _normal(self, rays: Rays, t: Array, hit: Array, miss: Vec3) -> Vec3:
        """Return the outward normal at t, or of the sphere's point nearest to a ray that misses."""
        return normalize(where(hit, rays.origin - Vec3.of(self.center) + rays.direction * t, miss))


class Plane(AbstractSurface):
    r"""An infinite plane through `point`; its normal is on the viewer's side.

    $$ (o + t d - point) \cdot normal = 0 $$

    A ray from o along d meets it at a t > 0. A ray along the plane misses it.

    Args:
        point: A point of the plane, scene units; the origin by default.
        normal: Normal, of any length except 0; (0, 1, 0) by default.

    Raises:
        ValueError: A value has the wrong shape or is not finite, or the normal is the zero vector.
        TypeError: A value is not a vector of numbers.
    """

    point: Vector = eqx.field(converter=as_vector, default=(0.0, 0.0, 0.0))
    normal: Vector = eqx.field(converter=as_vector, default=(0.0, 1.0, 0.0), metadata={"nonzero": True})

    def intersect(self, rays: Rays) -> Hit:
        """Solve (o + t d - point).n = 0 for t > 0."""
        n = normalize(Vec3.of(self.normal))
        n_d = dot(rays.direction, n)
        meets = jnp.abs(n_d) > TINY
        t = jnp.where(meets, dot(Vec3.of(self.point) - rays.origin, n), 0.0) / jnp.where(meets, n_d, 1.0)
        one = jnp.ones_like(t)
        return Hit(t, rays.origin + rays.direction * t, where(n_d > 0, -n * one, n * one), meets & (t > 0))

    @property
    def is_textured(self) -> bool:
        """True."""
        return True

    def texture(self, p: Vec3, n: Vec3) -> tuple[Vec3, Vec3, Vec3]:
        """Return the scene units from `point` along the x axis, projected into the plane, and across it.

        Where the plane is across the x axis, u is along the z axis.
        """
        up = normalize(Vec3.of(self.normal))
        x, z = Vec3.of(np.array([1.0, 0.0, 0.0])), Vec3.of(np.array([0.0, 0.0, 1.0]))
        along_u = normalize(where(jnp.abs(up.x) < 0.9, x - up * up.x, z - up * up.z))
        along_v = cross(up, along_u)
        off = p - Vec3.of(self.point)
        return Vec3(0.5 + dot(off, along_u), 0.5 + dot(off, along_v), jnp.zeros_like(off.x)), along_u, along_v


class Box(AbstractSolid):
    """A box around `center`; normals point outward, or to the viewer's side when seen from inside.

    A ray is inside it from the last of the near planes to the first of the far planes (Kay and Kajiya 1986). At an edge
    the derivative is that of one of the adjacent faces.

    Args:
        center: Centre, scene units; the origin by default.
        size: Width, height and depth, scene units, above 0; (1, 1, 1) by default.
        rotation: Degrees about the x, then the y, then the z axis, right-handed, about the centre; (0, 0, 0) by
            default.

    Raises:
        ValueError: A value has the wrong shape or is not finite, or a size is not above 0.
        TypeError: A value is not a vector of numbers.
    """

    center: Vector = eqx.field(converter=as_vector, default=(0.0, 0.0, 0.0), metadata=parameter("position"))
    size: Vector = eqx.field(converter=as_vector, default=(1.0, 1.0, 1.0), metadata={"lower": 0, "above": 0})
    rotation: Vector = eqx.field(converter=as_vector, default=(0.0, 0.0, 0.0))

    def extent(self) -> float:
        """Return half the diagonal."""
        return 0.5 * float(np.linalg.norm(self.size))

    def intersect(self, rays: Rays) -> Hit:
        """Return where a ray has crossed the first plane of each pair of faces or, from inside, where it leaves."""
        (near, entering), (far, leaving) = self._slabs(rays)
        within = self.holds(rays)
        t = jnp.where(within, far, near)
        n = where(within, -leaving, entering)
        in_front = far > touching(near, jnp.max(self.size))
        return Hit(t, rays.origin + rays.direction * t, n, (near < far) & in_front)

    def leave(self, rays: Rays) -> Hit:
        """Return where a ray crosses the first of the far faces' planes."""
        (near, _), (far, n) = self._slabs(rays)
        return Hit(far, rays.origin + rays.direction * far, n, (near < far) & (far > 0))

    def holds(self, rays: Rays) -> Bool[Array, "..."]:
        """Return whether the box was entered behind the origin."""
        (near, _), _ = self._slabs(rays)
        return near <= -touching(near, jnp.max(self.size))

    @property
    def is_textured(self) -> bool:
        """True."""
        return True

    def texture(self, p: Vec3, n: Vec3) -> tuple[Vec3, Vec3, Vec3]:
        """Return u and v from 0 to 1 over each face: along the box's y and z, z and x, or x and y axes."""
        rotated = rotation_axes(self.rotation)
        off = p - Vec3.of(self.center)
        share = [0.5 + dot(off, axis) / self.size[i] for i, axis in enumerate(rotated)]
        facing = [jnp.abs(dot(n, axis)) for axis in rotated]
        on_x, on_y = (facing[0] > facing[1]) & (facing[0] > facing[2]), facing[1] > facing[2]
        zero = jnp.zeros_like(off.x)
        faces = [(Vec3(share[i], share[j], zero), rotated[i], rotated[j]) for i, j in ((1, 2), (2, 0), (0, 1))]
        return where(on_x, faces[0], where(on_y, faces[1], faces[2]))

    def _slabs(self, rays: Rays) -> tuple[tuple[Array, Vec3], tuple[Array, Vec3]]:
        """Return t and the outward normal of the last plane crossed inwards, and of the first crossed outwards."""
        pairs = []
        for axis, size in zip(rotation_axes(self.rotation), (self.size[i] for i in range(3)), strict=True):
            o, d = dot(rays.origin - Vec3.of(self.center), axis), dot(rays.direction, axis)
            away = jnp.where(d < 0, -1.0, 1.0)  # which way the ray crosses this pair of faces
            speed = jnp.where(jnp.abs(d) > TINY, jnp.abs(d), TINY)
            middle, half = -o * away / speed, 0.5 * size / speed
            pairs.append((middle - half, middle + half, axis * away))
        near, entering = pairs[0][0], -pairs[0][2]
        far, leaving = pairs[0][1], pairs[0][2]
        for t_in, t_out, n in pairs[1:]:
            later, sooner = t_in > near, t_out < far
            near, entering = jnp.where(later, t_in, near), where(later, -n, entering)
            far, leaving = jnp.where(sooner, t_out, far), where(sooner, n, leaving)
        return (near, entering), (far, leaving)


def rotation_axes(degrees: Vector) -> tuple[Vec3, Vec3, Vec3]:
    """Return the x, y and z axes after a right-handed rotation about the x, then the y, then the z axis."""
    (a, b, c) = (jnp.deg2rad(degrees[i]) for i in range(3))
    (sa, ca), (sb, cb), (sc, cc) = ((jnp.sin(angle), jnp.cos(angle)) for angle in (a, b, c))
    return (
        Vec3(cc * cb, sc * cb, -sb),
        Vec3(cc * sb * sa - sc * ca, sc * sb * sa + cc * ca, cb * sa),
        Vec3(cc * sb * ca + sc * sa, sc * sb * ca - cc * sa, cb * ca),
    )

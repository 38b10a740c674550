"""Differences of height between neighbouring texels, as their normals give them, and how far noise moves them.

The chord between the points of two neighbours is perpendicular to the sum of their normals:

    (n_p + n_q) . (P_q - P_p) = 0

This is exact on planes and on spheres, for parallel and for perspective rays, and elsewhere off by the third order of
the texel's size. Along parallel rays P = o + z b, b towards the camera, and the equation gives z_q - z_p. Along rays from
the eye P = eye + d r, and it gives log d_q - log d_p. In both cases the unknown u (z, or -log d) grows towards the camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.backend import in_float64
from ...model.cameras import AbstractCamera

LEAST_FACING = np.sin(np.deg2rad(1.0))  # normals that face the camera less, 89 degrees from it, do not count
CREASE = 3.0  # a change of the normals' turning counts as a crease above so many of its standard errors


class Rays(NamedTuple):
    """The rays of a camera's texels, in world coordinates: parallel, or from one eye."""

    toward: Float[np.ndarray, "3"] | Float[np.ndarray, "h w 3"]
    """Towards the camera: a unit vector; or -r, for a ray r of which the component along the view axis is 1."""
    step: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
    """From one parallel ray's start to the next: across and down, scene units."""
    start: Float[np.ndarray, "h w 3"] | Float[np.ndarray, "3"]
    distance: float
    """From the eye to the plane through the camera's target, scene units."""

    @property
    def parallel(self) -> bool:
        """Whether the rays are parallel."""
        return self.toward.ndim == 1


def rays_of(camera: AbstractCamera) -> Rays:
    """Return the rays through the centres of a camera's texels; raise ValueError for an unusual camera."""
    with in_float64(camera) as seen_by:
        found = seen_by.projection()
        o, o_column, o_row, d, d_column, d_row, backward = (
            np.array([np.asarray(part) for part in (v.x, v.y, v.z)], np.float64)
            for v in (
                found.origin,
                found.origin_column,
                found.origin_row,
                found.direction,
                found.direction_column,
                found.direction_row,
                found.backward,
            )
        )
    row, column = (np.indices(camera.shape) + 0.5)[..., None]
    distance = float(np.linalg.norm(np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64)))
    if not d_column.any() and not d_row.any():
        return Rays(backward, (o_column, o_row), o + o_column * column + o_row * row, distance)
    if o_column.any() or o_row.any():
        raise ValueError(
            f"camera must have parallel rays or rays from one eye; those of {type(camera).__name__} are neither. Give "
            "a Camera or an OrthographicCamera."
        )
    zero = np.zeros(3)
    return Rays(-(d + d_column * column + d_row * row), (zero, zero), o, distance)


def facing(normals: Float[np.ndarray, "h w 3"], rays: Rays) -> Float[np.ndarray, "h w"]:
    """Return the cosine of the angle between each normal and the direction to the camera."""
    return _dot(normals, rays.toward) / np.linalg.norm(rays.toward, axis=-1)


class Differences(NamedTuple):
    """Along one axis of the image: from each texel to the next one, where both are inside and face the camera."""

    value: Float[np.ndarray, "h w"]
    """u of the next texel minus u of this one; 0 where there is none."""
    deviation: Float[np.ndarray, "h w"]
    """Its standard deviation; infinite where there is no difference."""
    lever: Float[np.ndarray, "h w 3"]
    """Its derivative by the mean of both normals."""
    share: Float[np.ndarray, "h w"]
    """Share of this texel in that mean; the rest is the next texel's."""
    crease: Float[np.ndarray, "h w"]
    """Standard deviation that a crease at an unknown place between the two adds; a part of `deviation`."""

    @property
    def known(self) -> Bool[np.ndarray, "h w"]:
        """Where there is a difference."""
        return np.isfinite(self.deviation)


def differences(
    normals: Float[np.ndarray, "h w 3"],
    sigma: Float[np.ndarray, "h w"],
    inside: Bool[np.ndarray, "h w"],
    rays: Rays,
) -> tuple[Differences, Differences]:
    r"""Return the differences across and down.

    The mean of two normals of unequal errors weighs them by x and 1 - x, so that its variance

    $$ x^2 \sigma_p^2 + (1 - x)^2 \sigma_q^2 + (1 - 2x)^2 \tau^2 / 4 $$

    is least, where tau is the angle between the two: a normal that is not known has no weight.

    Args:
        normals: Unit normals in world coordinates, those that are not known interpolated.
        sigma: Their standard deviation about each of two axes, radians.
        inside: Where there are texels.
        rays: The rays of the camera.
    """
    both = []
    for axis in (1, 0):
        here, there = _pair(axis)
        pair = inside[here] & inside[there]
        n_p, n_q, s_p, s_q = normals[here], normals[there], sigma[here] ** 2, sigma[there] ** 2
        turn = np.sum((n_q - n_p) ** 2, -1)
        turn = np.maximum(turn - 2.0 * (s_p + s_q), 0.0)  # what noise does not explain; each has two axes
        total = s_p + s_q + turn
        share = np.divide(s_q + turn / 2.0, total, out=np.full(total.shape, 0.5), where=total > 0)
        mean = share[..., None] * n_p + (1.0 - share)[..., None] * n_q
        variance = share**2 * s_p + (1.0 - share) ** 2 * s_q + (0.5 - share) ** 2 * turn
        value, lever, faces = _chord(mean, rays, axis, here, there)
        size = np.linalg.norm(lever, axis=-1)
        pair = pair & faces & np.isfinite(variance) & np.isfinite(size)
        crease = size * _crease(normals, sigma, inside, axis)
        deviation = np.sqrt(size**2 * variance + crease**2)
        both.append(
            Differences(
                np.where(pair, value, 0.0),
                np.where(pair, deviation, np.inf),
                np.where(pair[..., None], lever, 0.0),
                share,
                np.where(pair, crease, 0.0),
            )
        )
    return both[0], both[1]


def _chord(
    mean: Float[np.ndarray, "h w 3"], rays: Rays, axis: int, here: tuple[slice, ...], there: tuple[slice, ...]
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Return the difference for a mean normal, its derivative by that normal, and whether both rays see its front."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if rays.parallel:
            step = rays.step[1 - axis]
            front = _dot(mean, rays.toward)
            value = -_dot(mean, step) / front
            lever = -(step + value[..., None] * rays.toward) / front[..., None]
            return value, lever, front > 0.5 * LEAST_FACING
        r_p, r_q = rays.toward[here], rays.toward[there]
        front_p, front_q = _dot(mean, r_p), _dot(mean, r_q)
        value = np.log(front_q / front_p)
        lever = r_q / front_q[..., None] - r_p / front_p[..., None]
        least = 0.5 * LEAST_FACING * np.linalg.norm(r_p, axis=-1)
        return value, lever, np.minimum(front_p, front_q) > least


def _crease(
    normals: Float[np.ndarray, "h w 3"], sigma: Float[np.ndarray, "h w"], inside: Bool[np.ndarray, "h w"], axis: int
) -> Float[np.ndarray, "h w"]:
    """Return the standard deviation of the mean normal where the surface may have a crease between two texels.

    A crease lies anywhere between the centres: uniformly distributed, of deviation 1 / sqrt(12) of the turn. It is one
    where the second difference of the normals at either texel is beyond its noise; a curved surface has a small one.
    """
    here, there = _pair(axis)
    first, last = _pair(axis, 2)
    middle = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    second = np.sum((normals[first] - 2.0 * normals[middle] + normals[last]) ** 2, -1)
    noise = 2.0 * (sigma[first] ** 2 + 4.0 * sigma[middle] ** 2 + sigma[last] ** 2)
    whole = inside[first] & inside[middle] & inside[last]
    square = np.zeros(inside.shape)
    square[middle] = np.where(whole & (second > CREASE**2 * noise), second, 0.0)
    return np.sqrt(np.minimum(square[here], square[there]) / 12.0)


def _pair(axis: int, apart: int = 1) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the slices of all texels that have one `apart` further along an axis, and of those."""
    here, there = slice(None, -apart), slice(apart, None)
    return ((here, slice(None)), (there, slice(None))) if axis == 0 else ((slice(None), here), (slice(None), there))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)

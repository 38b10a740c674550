"""Differences of height between neighbouring texels, as their normals give them, and how far noise moves them.

The chord between the points of two neighbours is perpendicular to the sum of their normals:

    (n_p + n_q) . (P_q - P_p) = 0

This is exact on planes and on spheres, for parallel rays and for rays from one eye, and elsewhere off by the third
order of the texel's size. Along parallel rays P = o + z b, b towards the camera, and the equation gives z_q - z_p.
Along rays from the eye P = eye + d r, and it gives log d_q - log d_p. In both cases the unknown u (z, or -log d) grows
towards the camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float

from ...core.backend import in_float64
from ...core.robust_scale import RARE
from ...core.thresholds import DEGREE
from ...model.cameras import AbstractCamera
from ..robust.neighbours import MISFIT_SIDE


class TexelRays(NamedTuple):
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


def rays_of(camera: AbstractCamera, *, corners: bool = False) -> TexelRays:
    """Return the rays through the centres of a camera's texels, or through their corners, one more each way.

    Raises:
        ValueError: The rays are neither parallel nor from one eye.
    """
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
    rows, columns = camera.shape
    row, column = (np.indices((rows + 1, columns + 1)) if corners else np.indices(camera.shape) + 0.5)[..., None]
    distance = distance_to_target(camera)
    if not d_column.any() and not d_row.any():
        return TexelRays(backward, (o_column, o_row), o + o_column * column + o_row * row, distance)
    if o_column.any() or o_row.any():
        raise ValueError(
            f"camera must have parallel rays or rays from one eye; those of {type(camera).__name__} are neither. Give "
            "a Camera or an OrthographicCamera."
        )
    zero = np.zeros(3)
    return TexelRays(-(d + d_column * column + d_row * row), (zero, zero), o, distance)


def distance_to_target(camera: AbstractCamera) -> float:
    """Return the distance from the eye to the plane through the camera's target, scene units."""
    return float(np.linalg.norm(np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64)))


def facing(normals: Float[np.ndarray, "h w 3"], rays: TexelRays) -> Float[np.ndarray, "h w"]:
    """Return the cosine of the angle between each normal and the direction to the camera."""
    return _dot(normals, rays.toward) / np.linalg.norm(rays.toward, axis=-1)


class Differences(NamedTuple):
    """Along one axis of the image: from each texel to the next one, where both are inside and face the camera."""

    value: Float[np.ndarray, "g v"]
    """u of the next texel minus u of this one; 0 where there is none."""
    deviation: Float[np.ndarray, "g v"]
    """Its standard deviation; infinite where there is no difference."""
    lever: Float[np.ndarray, "g v 3"]
    """Its derivative by the mean of both normals."""
    share: Float[np.ndarray, "g v"]
    """Share of this texel in that mean; the rest is the next texel's."""
    crease: Float[np.ndarray, "g v"]
    """Standard deviation that a crease at an unknown place between the two adds; a part of `deviation`."""
    steepness: Float[np.ndarray, "g v"]
    """Deviation of the mean normal over its cosine to the camera: how far noise distorts the difference. Infinite where
    it cannot show a jump at all."""

    @property
    def known(self) -> Bool[np.ndarray, "g v"]:
        """Where there is a difference."""
        return np.isfinite(self.deviation)


def differences(
    normals: Float[np.ndarray, "h w 3"],
    sigma: Float[np.ndarray, "h w"],
    inside: Bool[np.ndarray, "h w"],
    rays: TexelRays,
    interpolated: Bool[np.ndarray, "h w"] | None = None,
) -> tuple[Differences, Differences]:
    r"""Return the differences across and down.

    The mean of two normals of unequal errors weighs them by x and 1 - x, so that its variance

    $$ x^2 \sigma_p^2 + (1 - x)^2 \sigma_q^2 + (1 - 2x)^2 \tau^2 / 4 $$

    is least, where tau is the angle between the two: a normal that is not known has no weight.

    A steep slope has a large variance. If a normal's own noise decided how steep it counts, weights and errors would be
    correlated and the heights biased; derivatives are therefore taken at smoothed normals. The bias of second order,
    half the trace of second derivative times covariance, is subtracted.

    Args:
        normals: Unit normals in world coordinates, those that are not known interpolated.
        sigma: Their standard deviation about each of two axes, radians; finite.
        inside: Where there are texels.
        rays: The rays of the camera.
        interpolated: Where the normal is interpolated; nowhere by default. It cannot show a jump.
    """
    smooth = smoothed(normals, inside)
    both = []
    for axis in (1, 0):
        here, there = _pair(axis)
        pair = inside[here] & inside[there]
        n_p, n_q, s_p, s_q = normals[here], normals[there], sigma[here] ** 2, sigma[there] ** 2
        turn = np.sum((n_q - n_p) ** 2, -1)
        turn = np.maximum(turn - 2.0 * (s_p + s_q), 0.0)  # what noise does not explain; each has two axes
        total = s_p + s_q + turn
        share = np.divide(s_q + turn / 2.0, total, out=np.full(total.shape, 0.5), where=total > 0)
        weight = share[..., None]
        noise = share**2 * s_p + (1.0 - share) ** 2 * s_q
        chord = _chord(weight * n_p + (1.0 - weight) * n_q, rays, axis)
        typical = _chord(weight * smooth[here] + (1.0 - weight) * smooth[there], rays, axis)
        size = np.linalg.norm(typical.lever, axis=-1)
        pair &= chord.front & typical.front
        shows = pair if interpolated is None else pair & ~(interpolated[here] | interpolated[there])
        crease = size * _crease(normals, sigma, inside, axis)
        deviation = np.sqrt(size**2 * (noise + (0.5 - share) ** 2 * turn) + crease**2)
        both.append(
            Differences(
                np.where(pair, chord.value - typical.bend * noise, 0.0),
                np.where(pair, deviation, np.inf),
                np.where(pair[..., None], typical.lever, 0.0),
                share,
                np.where(pair, crease, 0.0),
                np.where(shows, np.sqrt(noise) / np.maximum(typical.cosine, DEGREE), np.inf),
            )
        )
    return both[0], both[1]


class _Chord(NamedTuple):
    """What a mean normal says of the chord."""

    value: Float[np.ndarray, "g v"]
    lever: Float[np.ndarray, "g v 3"]
    """Derivative of the value by the normal."""
    bend: Float[np.ndarray, "g v"]
    """Half the trace of the second derivative, in the plane across the normal."""
    front: Bool[np.ndarray, "g v"]
    """Whether both rays see the front."""
    cosine: Float[np.ndarray, "g v"]
    """Of the normal with the direction to the camera."""


def _chord(mean: Float[np.ndarray, "g v 3"], rays: TexelRays, axis: int) -> _Chord:
    """Return the difference for a mean normal, and how it changes with that normal."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if rays.parallel:
            step, cosine = rays.step[1 - axis], _dot(mean, rays.toward)
            value = -_dot(mean, step) / cosine
            lever = -(step + value[..., None] * rays.toward) / cosine[..., None]
            return _Chord(value, lever, value / cosine**2, cosine > 0.5 * DEGREE, cosine)
        here, there = _pair(axis)
        r_p, r_q = rays.toward[here], rays.toward[there]
        front_p, front_q = _dot(mean, r_p), _dot(mean, r_q)
        square_p, square_q = _dot(r_p, r_p), _dot(r_q, r_q)
        value = np.log(front_q / front_p)
        lever = r_q / front_q[..., None] - r_p / front_p[..., None]
        bend = 0.5 * (square_p / front_p**2 - square_q / front_q**2)
        cosine = np.minimum(front_p / np.sqrt(square_p), front_q / np.sqrt(square_q))
        return _Chord(value, lever, bend, cosine > 0.5 * DEGREE, cosine)


def smoothed(normals: Float[np.ndarray, "h w 3"], inside: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return the normals smoothed by local planes: least squares of a + b x + c y in a window about each texel."""
    row, column = np.indices(inside.shape).astype(float)
    mask = inside.astype(float)

    def mean(image: np.ndarray) -> np.ndarray:
        return scipy.ndimage.uniform_filter(image * mask, MISFIT_SIDE, mode="constant")

    count = np.maximum(mean(np.ones_like(mask)), 0.5 / MISFIT_SIDE**2)
    y, x = mean(row) / count, mean(column) / count
    # the window's moments about its own middle, with a ridge for windows without extent
    ridge = 1e-3
    xx = mean(column**2) / count - x**2 + ridge
    yy = mean(row**2) / count - y**2 + ridge
    xy = mean(row * column) / count - x * y
    found = np.zeros(normals.shape)
    for axis in range(3):
        n = normals[..., axis]
        middle = mean(n) / count
        nx, ny = mean(n * column) / count - middle * x, mean(n * row) / count - middle * y
        determinant = xx * yy - xy**2
        slope_x, slope_y = (yy * nx - xy * ny) / determinant, (xx * ny - xy * nx) / determinant
        found[..., axis] = middle + slope_x * (column - x) + slope_y * (row - y)
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    return np.where(length > 0.5, found / np.maximum(length, 0.5), normals)


def _crease(
    normals: Float[np.ndarray, "h w 3"], sigma: Float[np.ndarray, "h w"], inside: Bool[np.ndarray, "h w"], axis: int
) -> Float[np.ndarray, "g v"]:
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
    square[middle] = np.where(whole & (second > RARE**2 * noise), second, 0.0)
    return np.sqrt(np.minimum(square[here], square[there]) / 12.0)


def _pair(axis: int, apart: int = 1) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the slices of all texels that have one `apart` further along an axis, and of those."""
    here, there = slice(None, -apart), slice(apart, None)
    return ((here, slice(None)), (there, slice(None))) if axis == 0 else ((slice(None), here), (slice(None), there))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)

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
from jaxtyping import Bool, Float, Int
from scipy.ndimage import correlate1d, minimum_filter1d

from ...core.robust_scale import RARE, UNIFORM
from ...core.thresholds import DEGREE, NEGLIGIBLE, SMALL
from ...model.cameras import AbstractCamera, affine_rays
from ..robust.neighbours import MISFIT_SIDE
from .system import HeightGrid


class TexelRays(NamedTuple):
    """The rays of a camera's texels, in world coordinates: parallel, or from one eye."""

    start: Float[np.ndarray, "h w 3"]
    toward: Float[np.ndarray, "h w 3"]
    """Towards the camera: of length 1 along the view axis."""
    parallel: bool
    distance: float
    """From the eye to the plane through the camera's target, scene units."""


def rays_of(camera: AbstractCamera, *, corners: bool = False) -> TexelRays:
    """Return the rays through the centres of a camera's texels, or through their corners, one more each way.

    Raises:
        ValueError: The rays are neither parallel nor from one eye.
    """
    origin, direction = affine_rays(camera)
    rows, columns = camera.shape
    row, column = np.indices((rows + 1, columns + 1)) if corners else np.indices(camera.shape) + 0.5
    place = np.stack([column, row, np.ones_like(row)], -1)
    parallel = not direction[:2].any()
    if not parallel and origin[:2].any():
        raise ValueError(
            f"camera must have parallel rays or rays from one eye; those of {type(camera).__name__} are neither. Give "
            "a Camera or an OrthographicCamera."
        )
    distance = np.linalg.norm(np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64))
    return TexelRays(place @ origin, -(place @ direction), parallel, float(distance))


class Differences(NamedTuple):
    """From the first texel of each pair to its second."""

    value: Float[np.ndarray, " edges"]
    """u of the second texel minus u of the first; 0 where one of the two rays would see the back."""
    deviation: Float[np.ndarray, " edges"]
    """Its standard deviation; infinite where there is no difference."""
    lever: Float[np.ndarray, "edges 3"]
    """Its derivative by the mean of both normals."""
    share: Float[np.ndarray, " edges"]
    """Share of the first texel in that mean; the rest is the second's."""
    crease: Float[np.ndarray, " edges"]
    """Standard deviation that a crease at an unknown place between the two adds; a part of `deviation`."""
    steepness: Float[np.ndarray, " edges"]
    """Deviation of the mean normal over its cosine to the camera: how far noise distorts the difference. Infinite where
    it cannot show a jump at all."""

    def shown(self, tail: float = 0.0) -> Float[np.ndarray, " edges"]:
        """Return the variances for a search of jumps, infinite where the surface is too steep for one.

        `tail`: deviations up to which the curl is to be trusted as if its distribution were normal. The square of a
        normal's noise makes steep differences too large by `tail` times the steepness there.
        """
        wider = 1.0 + tail * np.minimum(self.steepness, SMALL)
        return np.where(self.steepness > SMALL, np.inf, (wider * self.deviation) ** 2)


def differences(
    normals: Float[np.ndarray, "h w 3"],
    sigma: Float[np.ndarray, "h w"],
    grid: HeightGrid,
    rays: TexelRays,
    interpolated: Bool[np.ndarray, "h w"] | None = None,
) -> Differences:
    r"""Return the difference of each pair.

    The mean of two normals of unequal errors weighs them by x and 1 - x, so that its variance

    $$ x^2 \sigma_p^2 + (1 - x)^2 \sigma_q^2 + (1 - 2x)^2 \tau^2 / 4 $$

    is least, where tau is the angle between the two: a normal that is not known has no weight.

    A steep slope has a large variance. If a normal's own noise decided how steep it counts, weights and errors would be
    correlated and the heights biased; derivatives are therefore taken at smoothed normals. The bias of second order,
    half the trace of second derivative times covariance, is subtracted.

    Args:
        normals: Unit normals in world coordinates, those that are not known interpolated.
        sigma: Their standard deviation about each of two axes, radians; finite.
        grid: The texels.
        rays: The rays of the camera.
        interpolated: Where the normal is interpolated; nowhere by default. It cannot show a jump.
    """
    inside, p, q = grid.inside, grid.start, grid.end
    n, smooth, variance = normals[inside], smoothed(normals, inside), sigma[inside] ** 2
    s_p, s_q = variance[p], variance[q]
    turn = np.sum((n[q] - n[p]) ** 2, -1)
    turn = np.maximum(turn - 2.0 * (s_p + s_q), 0.0)  # what noise does not explain; each has two axes
    total = s_p + s_q + turn
    share = np.divide(s_q + turn / 2.0, total, out=np.full(total.shape, 0.5), where=total > 0)
    noise = share**2 * s_p + (1.0 - share) ** 2 * s_q
    value, _, _, own_cosine = _chord(grid.mean(n, share), grid, rays)
    _, lever, bend, cosine = _chord(grid.mean(smooth, share), grid, rays)
    size = np.linalg.norm(lever, axis=-1)
    front = np.minimum(own_cosine, cosine) > 0.5 * DEGREE
    hidden = ~front if interpolated is None else ~front | interpolated[inside][p] | interpolated[inside][q]
    crease = size * _crease(normals, sigma, grid)
    deviation = np.sqrt(size**2 * (noise + (0.5 - share) ** 2 * turn) + crease**2)
    return Differences(
        np.where(front, value - bend * noise, 0.0),
        np.where(front, deviation, np.inf),
        np.where(front[:, None], lever, 0.0),
        share,
        np.where(front, crease, 0.0),
        np.where(hidden, np.inf, np.sqrt(noise) / np.maximum(cosine, DEGREE)),
    )


def _chord(mean: Float[np.ndarray, "edges 3"], grid: HeightGrid, rays: TexelRays) -> tuple[np.ndarray, ...]:
    """Return the difference that a mean normal gives, and how it changes with that normal.

    Returns:
        The difference; its derivative by the normal; half the trace of its second derivative, in the plane across the
        normal; the normal's cosine to the camera, at the texel that faces it less.
    """
    toward = rays.toward[grid.inside]
    r_p, r_q = toward[grid.start], toward[grid.end]
    front_p, front_q = _dot(mean, r_p), _dot(mean, r_q)
    square_p, square_q = _dot(r_p, r_p), _dot(r_q, r_q)
    cosine = np.minimum(front_p / np.sqrt(square_p), front_q / np.sqrt(square_q))
    with np.errstate(divide="ignore", invalid="ignore"):
        if rays.parallel:
            start = rays.start[grid.inside]
            step = start[grid.end] - start[grid.start]
            value = -_dot(mean, step) / cosine
            return value, -(step + value[:, None] * r_p) / cosine[:, None], value / cosine**2, cosine
        value = np.log(front_q / front_p)
        lever = r_q / front_q[:, None] - r_p / front_p[:, None]
        return value, lever, 0.5 * (square_p / front_p**2 - square_q / front_q**2), cosine


def smoothed(normals: Float[np.ndarray, "h w 3"], inside: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "texels 3"]:
    """Return the normals smoothed by local planes: least squares of a + b x + c y in a window about each texel."""
    along, mask = np.arange(MISFIT_SIDE) - MISFIT_SIDE // 2.0, inside.astype(float)

    def moment(image: Float[np.ndarray, "h w"], powers: Int[np.ndarray, "2"]) -> Float[np.ndarray, " texels"]:
        for axis, power in enumerate(powers):
            image = correlate1d(image, along**power, axis, mode="constant")
        return image[inside]

    terms = np.array([(0, 0), (1, 0), (0, 1)])  # powers of y and x
    matrix = np.array([[moment(mask, one + other) for one in terms] for other in terms])
    right = np.array([[moment(mask * n, term) for n in np.moveaxis(normals, -1, 0)] for term in terms])
    matrix[[1, 2], [1, 2]] += NEGLIGIBLE * matrix[0, 0]  # for windows without extent
    found = np.linalg.solve(np.moveaxis(matrix, -1, 0), np.moveaxis(right, -1, 0))[:, 0]
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    return np.where(length > 0.5, found / np.maximum(length, 0.5), normals[inside])


def _crease(
    normals: Float[np.ndarray, "h w 3"], sigma: Float[np.ndarray, "h w"], grid: HeightGrid
) -> Float[np.ndarray, " edges"]:
    """Return the standard deviation of the mean normal where the surface may have a crease between two texels.

    A crease lies anywhere between the centres: uniformly distributed, of deviation 1 / sqrt(12) of the turn. It is one
    where the second difference of the normals at either texel is beyond its noise; a curved surface has a small one.
    """
    square = []
    for axis in (1, 0):
        second = np.sum(correlate1d(normals, [1.0, -2.0, 1.0], axis, mode="constant") ** 2, -1)
        noise = 2.0 * correlate1d(sigma**2, [1.0, 4.0, 1.0], axis, mode="constant")
        whole = correlate1d(grid.inside.astype(int), [1, 1, 1], axis, mode="constant") == 3
        of_texel = np.where(whole & (second > RARE**2 * noise), second, 0.0)
        square.append(minimum_filter1d(of_texel, 2, axis, origin=-1))
    return UNIFORM * np.sqrt(np.stack(square)[grid.pair])


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)

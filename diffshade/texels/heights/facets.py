r"""Facets: the squares of pixels, each facing along its pixel's own normal as far as that normal is to be believed.

With n a pixel's normal and S_k its corners (top left, top right, bottom left, bottom right), a_k = n . S_k. The square
faces along n where both its diagonals do, and is flat where it has no twist:

    g = (a_4 - a_1, a_2 - a_3) / sqrt(2) = 0,   t = (a_1 + a_4 - a_2 - a_3) / 2 = 0

There is about one corner for each pixel, so not all of this can be had. The corners are those of the least

    sum rho(c sqrt(g^2 + tau^2 t^2) / size) + HOLD^2 sum ((d - d_0) / size)^2

over the pixels, c the normal's cosine to the line of sight. rho is Huber's loss (1964), by reweighted least squares: a
pixel that no continuous surface can satisfy, as at a crease or where a jump was not found, does not turn the pixels
beside it. tau is the noise of the normals over the twist of the surface, which makes the sum, for normal distributions,
the most likely surface: exact normals are followed, noisy ones smoothed. Both are read from the mixed derivative of the
heights, which the normals give twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import aslinearoperator, cg

from ...core.thresholds import SLIGHT
from ...inverse.forward.losses import HUBER
from .regions import image_of

HOLD = SLIGHT  # weight of the distances that the search begins with

# Chosen with three real objects and balls in view, with exact normals and with two degrees of noise.
MIN_TAU, MAX_TAU = 0.5, 4.0
TWIST_QUANTILE = 0.75  # of the pixels, by which the twist of a surface is measured: it is small but along edges
STEPS, SOLVES = 4, 12  # of reweighting; of conjugate gradients, each: only corners near one another still have to move


class Facets(NamedTuple):
    """Squares of pixels as linear functions of the distances d of their corners: n . S = ahead - facing d."""

    of_pixel: Int[np.ndarray, "pixels 4"]
    """Index of each corner."""
    facing: Float[np.ndarray, "pixels 4"]
    """Of the normal along each corner's line of sight."""
    ahead: Float[np.ndarray, "pixels 4"]
    size: Float[np.ndarray, " pixels"]
    """Side of the square, seen by the camera, scene units."""
    cosine: Float[np.ndarray, " pixels"]
    """Of the normal with the line of sight."""


def refined(
    facets: Facets, inside: Bool[np.ndarray, "h w"], begun: Float[np.ndarray, " corners"]
) -> Float[np.ndarray, " corners"]:
    """Return the distances of the corners for which the squares of the pixels face along their normals.

    Args:
        facets: The squares of the pixels inside, in the order of the image.
        inside: Which pixels have one.
        begun: Distances of the corners to begin with.
    """
    tau, pixels = _tau(facets, inside), len(facets.size)
    of_corners = np.array([[-1.0, 0.0, 0.0, 1.0], [0.0, 1.0, -1.0, 0.0], [1.0, -1.0, -1.0, 1.0]]) * np.sqrt(0.5)
    of_corners[2] *= tau * np.sqrt(0.5)
    scale = (facets.cosine / facets.size)[:, None]
    begins = np.arange(0, 12 * pixels + 1, 4)  # rows of four numbers: the diagonals and the twist of each pixel
    columns, slope = np.repeat(facets.of_pixel, 3, 0).ravel(), (scale * facets.facing)[:, None] * of_corners
    turned = csr_array((slope.ravel(), columns, begins), (3 * pixels, len(begun)))
    held = np.bincount(facets.of_pixel.ravel(), np.repeat((HOLD / facets.size) ** 2, 4))
    d, start = begun, (scale * facets.ahead @ of_corners.T).ravel()
    for _ in range(STEPS):
        off = start - turned @ d
        length = np.linalg.norm(off.reshape(-1, 3), axis=-1)
        enough = HUBER * float(np.median(length) / scipy.stats.rayleigh.median())
        weight = np.repeat(enough / np.maximum(length, max(enough, np.finfo(float).tiny)), 3)
        weighted, holding = (aslinearoperator(diags_array(of)) for of in (weight, held))
        system = aslinearoperator(turned.T) @ weighted @ aslinearoperator(turned) + holding
        preconditioner = diags_array(1.0 / ((turned**2).T @ weight + held))
        b = turned.T @ (weight * off) + held * (begun - d)
        d = d + cg(system, b, M=preconditioner, maxiter=SOLVES)[0]
    return d


def _tau(facets: Facets, inside: Bool[np.ndarray, "h w"]) -> float:
    """Return the noise of the normals' slopes over the twist of the surface, both robust standard deviations.

    The slope across changes downwards as the slope down changes across; what differs between the two is noise.
    """
    planes = facets.ahead / np.maximum(facets.facing, np.finfo(np.float32).eps)  # where each plane meets the four rays
    first, second, third, fourth = planes.T
    slopes = (second + fourth - first - third) / 2.0, (third + fourth - first - second) / 2.0
    to_angles = facets.cosine**2 / facets.size
    across, down, scale = (image_of(inside, of, np.nan) for of in (*slopes, to_angles))
    downwards = scale[1:-1, 1:-1] * (across[2:, 1:-1] - across[:-2, 1:-1]) / 2.0
    sideways = scale[1:-1, 1:-1] * (down[1:-1, 2:] - down[1:-1, :-2]) / 2.0
    known = np.isfinite(downwards + sideways)
    if not known.any():
        return 1.0
    curl, mixed = (downwards - sideways)[known], (downwards + sideways)[known]
    noise = _deviation(curl, 0.5)
    twist = 0.5 * np.sqrt(max(_deviation(mixed, TWIST_QUANTILE) ** 2 - noise**2, 0.0))
    return float(np.clip(2.0 * noise / max(twist, np.finfo(float).tiny), MIN_TAU, MAX_TAU))


def _deviation(of: Float[np.ndarray, " n"], share: float) -> float:
    """Return the standard deviation of which a normal distribution would have this share as near to 0 as `of` has."""
    return float(np.quantile(np.abs(of), share) / scipy.stats.norm.ppf(0.5 + 0.5 * share))

r"""Uncalibrated: lights of which nothing is known, since a matte surface has three numbers a texel under all of them.

The matrix of all observations is a product of the texels' b = k_d n and the lights' s = I l (Hayakawa 1994), up to any
linear map A of the lights. The intensities say A up to a rotation (Woodham, Iwahori and Barman 1991). The rotation is
the one with which the normals are those of a surface,

$$ \partial_y (b_1 / b_3) = \partial_x (b_2 / b_3) $$

(Belhumeur, Kriegman and Yuille 1999), and of the two that are left, the one whose surface bulges towards the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...core.robust_scale import robust_scale
from ...core.thresholds import MINOR, NEGLIGIBLE, SLIGHT
from ...inverse.data.views import View, is_grey
from ...inverse.forward.losses import CAUCHY
from ...model.scenes import Scene
from ..tiles import TexelTile, ViewReader

MIN_RANK, MAX_RANK = 0.3, 0.9  # ranks of a texel's observations between which lie neither shadows nor highlights
ROUNDS = 60
STARTS = 8  # turns about the camera's axis
BAND, MAX_ROWS, MAX_SLOPES = 64, 512, 100_000  # rows read at once, rows and slopes in all
SIGMA = 2.0  # pixels: standard deviation of what takes the noise off slopes
REWEIGHTINGS = 5
MAX_CURL = 2.0 * SLIGHT  # of unit normals, a pixel: a larger one is an edge


class PseudoNormals(NamedTuple):
    """Pseudo-normals at texels that have neighbours to the right and below."""

    b: Float[np.ndarray, "n 3"]
    by_x: Float[np.ndarray, "n 3"]
    by_y: Float[np.ndarray, "n 3"]
    """Upwards."""
    place: Float[np.ndarray, "n 2"]
    """From the middle of the texels, right and up."""


def find_uncalibrated(
    scene: Scene, views: Sequence[View], reader: ViewReader, sample: TexelTile, light_of: Int[np.ndarray, " views"]
) -> Float[np.ndarray, "lights 3"]:
    """Return unit vectors towards the lights of the views, by the intensities of the scene.

    Args:
        scene: The lights, of whose directions nothing is used.
        views: The photographs.
        reader: What reads them.
        sample: Texels from all over the object.
        light_of: Which of the lights is on in each view.
    """
    strength = np.array([_strength(scene, view) for view in views])
    y, counts = _grey(sample, views, strength)
    s = factorize(y, counts)
    A = of_lengths(s)
    surface = _surface(reader, sample, views, strength, s)
    towards = s @ turned_to_surface(A, surface).T
    towards = towards * np.sign(np.median(towards[:, 2]))
    mean = np.stack([towards[light_of == i].mean(0) for i in range(light_of.max() + 1)])
    return mean / np.linalg.norm(mean, axis=-1, keepdims=True)


def _strength(scene: Scene, view: View) -> Float[np.ndarray, " channels"]:
    assert view.lit is not None or len(scene.lights) == 1
    light = scene.lights[0 if view.lit is None else view.lit[0]]
    of = float(view.exposure) * np.broadcast_to(np.asarray(light.intensity, np.float64), (3,))  # pyright: ignore[reportAttributeAccessIssue]
    return of.mean(keepdims=True) if is_grey(view) else of


def _grey(
    tile: TexelTile, views: Sequence[View], strength: Float[np.ndarray, "views channels"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the views show for each unit of light, the mean of the channels, and what of it counts."""
    black = np.array([float(view.black) for view in views])[:, None, None]
    y = ((np.asarray(tile.target, np.float64) - black) / strength[:, :, None]).mean(1)
    return y, tile.counts


def _surface(
    reader: ViewReader,
    sample: TexelTile,
    views: Sequence[View],
    strength: Float[np.ndarray, "views channels"],
    s: np.ndarray,
) -> PseudoNormals:
    """Return b and its slopes over the image, in bands of rows spread evenly over it."""
    width = reader.shape[1]
    top, bottom = sample.pixels.min() // width, sample.pixels.max() // width + 1
    bands = -(-min(bottom - top, MAX_ROWS) // BAND)
    starts = np.unique(np.linspace(top, max(bottom - BAND, top), bands).astype(int))
    parts = []
    for first in starts:
        last = min(first + BAND, bottom)
        tile = reader.read(int(first), int(last), BAND)
        if not len(tile.pixels):
            continue
        row, column = np.divmod(tile.pixels, width)
        inside = np.zeros((last - first, width), bool)
        inside[row - first, column] = True
        b = np.zeros((*inside.shape, 3))
        y, counts = _grey(tile, views, strength)
        b[row - first, column] = pseudo_normals(y, counts, s)
        *of, whole = slopes(inside, b)
        r, c = np.nonzero(whole)
        place = np.stack([c, -(r + first)], -1).astype(float)
        parts.append((*of, place))
    if not sum(len(part[0]) for part in parts):
        raise ValueError("the object has no texel with neighbours. Give photographs of more pixels, or the directions.")
    b, by_x, by_y, place = (np.concatenate(of) for of in zip(*parts, strict=True))
    some = np.linspace(0, len(b) - 1, min(len(b), MAX_SLOPES)).astype(int)
    return PseudoNormals(b[some], by_x[some], by_y[some], place[some] - place.mean(0))


def slopes(
    inside: Bool[np.ndarray, "h w"], b: Float[np.ndarray, "h w 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Bool[np.ndarray, "g v"]]:
    """Return b without its noise, its slopes along x and upwards, and where they are: with neighbours inside."""
    share = np.maximum(gaussian_filter(inside.astype(float), SIGMA), 1e-9)
    b = np.stack([gaussian_filter(b[..., k], SIGMA) for k in range(3)], -1) / share[..., None]
    whole = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:]
    here, right, below = b[:-1, :-1], b[:-1, 1:], b[1:, :-1]
    return (here + right + below)[whole] / 3.0, (right - here)[whole], (here - below)[whole], whole


def pseudo_normals(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"], s: Float[np.ndarray, "views 3"]
) -> Float[np.ndarray, "texels 3"]:
    """Return b of texels whose lights are known, under Cauchy's loss."""
    used = middle_ranks(y, counts)
    level = np.maximum((y * used).sum(0) / np.maximum(used.sum(0), 1), 1e-12)
    weight = used.astype(float)
    b = texels_under(y, weight, s)
    for _ in range(REWEIGHTINGS):
        r = ((b @ s.T).T - y) / level
        scale = max(robust_scale(r[used]), 1e-9) if used.any() else 1.0
        weight = used / (1.0 + (r / (CAUCHY * scale)) ** 2)
        b = texels_under(y, weight, s)
    return b


def middle_ranks(y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]) -> np.ndarray:
    """Return which observations lie in neither shadow nor highlight, by their rank among those of their texel."""
    rank = np.argsort(np.argsort(np.where(counts, y, np.inf), 0), 0)
    number = counts.sum(0)
    return counts & (rank >= MIN_RANK * number) & (rank < MAX_RANK * number)


def bright_texels(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]
) -> tuple[Float[np.ndarray, "views _"], Bool[np.ndarray, "views _"]]:
    """Return the texels that show something: of a black one only the noise would be left."""
    level = np.where(counts, y, 0.0).sum(0) / np.maximum(counts.sum(0), 1)
    bright = level > MINOR * np.median(level)
    return y[:, bright], counts[:, bright]


def factorize(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]
) -> Float[np.ndarray, "views 3"]:
    """Return the lights up to a linear map, by alternating least squares of both factors under Cauchy's loss."""
    y, counts = bright_texels(y, counts)
    used = middle_ranks(y, counts)
    y = y / ((y * used).sum(0) / np.maximum(used.sum(0), 1))
    weight = used.astype(float)
    s = np.linalg.svd(np.where(used, y, 1.0), full_matrices=False)[0][:, :3]
    for _ in range(ROUNDS):
        b = texels_under(y, weight, s)
        s = texels_under(y.T, weight.T, b)
        s = np.linalg.qr(s)[0]
        b = texels_under(y, weight, s)
        r = b @ s.T - y.T
        scale = max(robust_scale(r.T[used]), 1e-9)
        weight = used / (1.0 + (r.T / (CAUCHY * scale)) ** 2)
    return s


def texels_under(
    y: Float[np.ndarray, "views texels"], weight: Float[np.ndarray, "views texels"], s: Float[np.ndarray, "views 3"]
) -> Float[np.ndarray, "texels 3"]:
    """Return b of each texel under lights s, by weighted least squares."""
    A = np.einsum("vt,vi,vj->tij", weight, s, s, optimize=True)
    A += 1e-9 * (np.trace(A, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
    return np.linalg.solve(A, np.einsum("vt,vt,vi->ti", weight, y, s, optimize=True)[..., None])[..., 0]


def of_lengths(s: Float[np.ndarray, "views 3"]) -> Float[np.ndarray, "3 3"]:
    """Return A with |A s| nearest to 1: |A s|^2 is linear in A^T A, whose root is free to turn."""
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    columns = np.stack([s[:, i] * s[:, j] * (1.0 if i == j else 2.0) for i, j in pairs], -1)
    weight, q = np.ones(len(s)), np.zeros(6)
    for _ in range(ROUNDS):
        q = np.linalg.lstsq(columns * weight[:, None], weight, rcond=None)[0]
        r = columns @ q - 1.0
        scale = max(robust_scale(r), 1e-6)
        weight = 1.0 / np.sqrt(1.0 + (r / (CAUCHY * scale)) ** 2)
    Q = np.zeros((3, 3))
    for value, (i, j) in zip(q, pairs, strict=True):
        Q[i, j] = Q[j, i] = value
    values, axes = np.linalg.eigh(Q)
    return np.sqrt(np.maximum(values, NEGLIGIBLE * values.max()))[:, None] * axes.T


def turned_to_surface(A: Float[np.ndarray, "3 3"], surface: PseudoNormals) -> Float[np.ndarray, "3 3"]:
    """Return R A, with the rotation R by which the normals are those of a surface that bulges to the camera."""
    inverse = np.linalg.inv(A)  # b turns as A^-T b
    b, by_x, by_y = (of @ inverse for of in (surface.b, surface.by_x, surface.by_y))
    size = (b**2).sum(-1, keepdims=True)
    across_x, across_y = np.cross(b, by_x) / size, np.cross(b, by_y) / size
    best: tuple[float, np.ndarray] = (np.inf, np.eye(3))
    for mirror in (1.0, -1.0):
        towards = Rotation.align_vectors([[0.0, 0.0, 1.0]], [mirror * np.mean(b / np.sqrt(size), 0)])[0]

        def curl(turn: np.ndarray, towards: Rotation = towards, mirror: float = mirror) -> np.ndarray:
            M = mirror * (Rotation.from_rotvec(turn) * towards).as_matrix()
            r = across_x @ np.cross(M[1], M[2]) + across_y @ np.cross(M[2], M[0])
            return r / MAX_CURL

        for k in range(STARTS):
            begin = np.array([0.0, 0.0, 2.0 * np.pi * k / STARTS])
            end = least_squares(curl, begin, loss="cauchy")
            M = mirror * (Rotation.from_rotvec(end.x) * towards).as_matrix()
            n = b @ M.T
            bulges = np.sum(n[:, :2] / np.linalg.norm(n, axis=-1, keepdims=True) * surface.place) > 0.0
            cost = end.cost if bulges and np.mean(n[:, 2] > 0.0) > 0.5 else np.inf
            if cost < best[0]:
                best = cost, M
    if not np.isfinite(best[0]):
        raise ValueError(
            "no rotation of the lights gives the object a surface that bulges towards the camera. Give the directions, "
            "with light_error."
        )
    return best[1] @ A

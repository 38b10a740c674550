"""Highlights: the direction to a light from its reflection in a mirror ball, and its position from several balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ..core.thresholds import MINOR
from .balls import MIN_N_V, Ball

Vector = Float[np.ndarray, "3"]
Picture = Float[np.ndarray, "h w"]

LEVELS = (0.25, 0.5, 0.75)  # thresholds of the highlight's pixels, over the brightest pixel
STEPS = 50  # by which the point has settled to rounding: each moves it far less than the one before
CORE = 0.6  # radius of the discs that a highlight without streaks is made of, over its largest disc's
MIN_DISC = 4.0  # pixels: largest disc in a highlight below which the rounding of its edge counts for more than streaks


@dataclass(frozen=True, eq=False)
class Glint:
    """The highlight of a light on a mirror ball: its point on the ball, and the direction to the light from there."""

    point: Vector
    direction: Vector
    error: float
    """Root mean square error of the direction, degrees."""
    second: float
    """The light of the ball's next highlight, over this one's."""


def find_glint(picture: Picture, ball: Ball) -> Glint:
    """Find the light that a mirror ball shows: l = 2 (n.v) n - v at its highlight (Debevec 1998, SIGGRAPH, fig. 6).

    The highlight is the connected region that holds the most light, among the pixels of at least half the brightness of
    the brightest one. Around its brightest pixel the mean l is found for thresholds of a quarter, a half and three
    quarters, without the streaks by which a lamp that is too bright for the camera reaches beyond its image, and the
    result is the mean of these. The error includes how they differ, the error of the ball's outline,
    and the rounding of the highlight's edge to pixels.

    Args:
        picture: The mean of the channels.
        ball: The ball in the picture.

    Returns:
        The highlight.

    Raises:
        ValueError: If the ball is black, or shows no highlight.
    """
    box = _box(ball.mask)
    top, left = box[0].start, box[1].start
    mask, picture = ball.mask[box], picture[box]
    row, column = np.nonzero(mask)
    _, n, v = ball.seen(row + top + 0.5, column + left + 0.5)
    inside = np.zeros_like(mask)
    inside[row, column] = (n * v).sum(-1) > MIN_N_V
    light = np.where(inside, picture, 0.0)
    if not light.any():
        raise ValueError("the whole ball is black. Check the photograph and the mask.")
    half, second = brightest_piece(light)
    peak = np.unravel_index(np.argmax(np.where(half, light, 0.0)), light.shape)
    cleaned = without_streaks if largest_disc(half) >= MIN_DISC else lambda piece: piece
    highlights = [cleaned(_piece_about(light, level, peak)) for level in LEVELS]
    highlights = [piece for piece in highlights if piece.sum() <= MINOR * inside.sum()]
    covered = half.sum() / max(inside.sum(), 1)
    if covered > MINOR or not highlights:
        raise ValueError(
            f"the ball shows no highlight: {100 * covered:.2g} % of it is at least half as bright as its brightest "
            "pixel. Give photographs of a mirror ball in the dark, or ball='matte'."
        )

    def reflected(ball: Ball, highlight: np.ndarray) -> tuple[Vector, Vector]:
        row, column = np.nonzero(highlight)
        p, n, v = ball.seen(row + top + 0.5, column + left + 0.5)
        l = 2.0 * (n * v).sum(-1, keepdims=True) * n - v
        weight = light[row, column][:, None]
        mean = (weight * l).sum(0)
        return (weight * p).sum(0) / weight.sum(), mean / np.linalg.norm(mean)

    found = [reflected(ball, highlight) for highlight in highlights]
    point, direction = np.mean([p for p, _ in found], 0), np.mean([l for _, l in found], 0)
    direction /= np.linalg.norm(direction)
    spread = np.mean([np.sum((l - direction) ** 2) for _, l in found])
    core = cleaned(half)
    here = reflected(ball, core)[1]
    moved = [reflected(ball.moved(step), core)[1] - here for step in np.diag(ball.errors)]
    rounding = 2.0 / 12.0 * (2.0 / ball.radius) ** 2 / core.sum()  # one pixel turns l by 2/R, along rows and columns
    error = float(np.rad2deg(np.sqrt(spread + np.square(moved).sum() + rounding)))
    return Glint(point, direction, error, second)


def brightest_piece(light: Picture) -> tuple[np.ndarray, float]:
    """Return the region above half the brightest pixel that holds the most light, and the next one's light over its."""
    labels, count = ndimage.label(light >= 0.5 * light.max(), np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    held = ndimage.sum_labels(light, labels, np.arange(1, count + 1))
    first = int(np.argmax(held))
    return labels == 1 + first, float(np.delete(held, first).max(initial=0.0) / held[first])


def _piece_about(light: Picture, level: float, peak: tuple[np.intp, ...]) -> np.ndarray:
    """Return the connected region around a pixel, of the pixels above this fraction of its brightness."""
    labels, _ = ndimage.label(light >= level * light[peak], np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    return labels == labels[peak]


def without_streaks(piece: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return what discs cover of a region, of CORE times the radius of the largest in it (morphological opening)."""
    box, depth = _depth(piece)
    reach = CORE * depth.max()
    core = np.zeros_like(piece)
    core[box] = (np.asarray(ndimage.distance_transform_edt(depth < reach)) < reach)[1:-1, 1:-1]
    return core


def largest_disc(piece: Bool[np.ndarray, "h w"]) -> float:
    """Return the radius of the largest disc in a region, pixels."""
    return float(_depth(piece)[1].max())


def _depth(piece: Bool[np.ndarray, "h w"]) -> tuple[tuple[slice, slice], Float[np.ndarray, "rows columns"]]:
    """Return the rows and columns that a region spans, and how deep in it these pixels are, with one more around."""
    box = _box(piece)
    return box, np.asarray(ndimage.distance_transform_edt(np.pad(piece[box], 1)))


def _box(piece: Bool[np.ndarray, "h w"]) -> tuple[slice, slice]:
    """Return the rows and columns that a region spans."""
    return next(iter(ndimage.find_objects(piece.astype(np.uint8))), np.s_[0:0, 0:0])


def find_position(glints: Sequence[Glint]) -> tuple[Vector, Float[np.ndarray, "3"]]:
    """Return the point nearest to the rays from several balls to one light, and its standard errors; scene units.

    Minimises sum |(I - l l^T)(x - p)|^2 / (sigma |x - p|)^2 over x, with the distances of the previous x. sigma is each
    direction's error, scaled up if the rays miss each other by more. NaN with infinite errors if they do not meet.
    """
    p, l = np.array([g.point for g in glints]), np.array([g.direction for g in glints])
    sigma = np.deg2rad([max(g.error, 1e-6) for g in glints]) / np.sqrt(2.0)  # along each of the two axes across a ray
    across = np.eye(3) - l[:, :, None] * l[:, None, :]
    distance, x, H = np.ones(len(glints)), np.zeros(3), np.eye(3)
    for _ in range(STEPS):
        weight = (1.0 / (sigma * distance) ** 2)[:, None, None]
        H = (weight * across).sum(0)
        if not np.linalg.cond(H) * np.finfo(float).eps < 1.0:  # parallel
            return np.full(3, np.nan), np.full(3, np.inf)
        x = np.linalg.solve(H, (weight * across @ p[:, :, None]).sum(0)[:, 0])
        distance = np.maximum(np.linalg.norm(x - p, axis=-1), 1e-9)
    misses = np.einsum("kij,kj->ki", across, x - p)
    chi2 = float(((misses**2).sum(-1) / (sigma * distance) ** 2).sum()) / (2 * len(glints) - 3)
    errors = np.sqrt(np.diag(np.linalg.inv(H)) * max(chi2, 1.0))
    # behind a ball, or less certain than its distance: the light is too far away for a position
    if not (((x - p) * l).sum(-1) > 0).all() or np.linalg.norm(errors) > distance.min():
        return np.full(3, np.nan), np.full(3, np.inf)
    return x, errors

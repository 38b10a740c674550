"""Highlights: the way to a light from where a mirror ball shows it, and its place from what several balls show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from .balls import Ball

Vector = Float[np.ndarray, "3"]
Picture = Float[np.ndarray, "h w"]

LEVELS = (0.25, 0.5, 0.75)  # of the brightest pixel: how bright the highlight's pixels are at least
LARGEST = 0.05  # of the ball, that what is half as bright as the brightest pixel covers at most, if it is a highlight
STEPS = 50
PARALLEL = 1e10  # condition number beyond which rays do not meet
RIM = 0.15  # n.v below which a ball shows its rim, and the world behind it


@dataclass(frozen=True, eq=False)
class Glint:
    """A light as a mirror ball shows it: where on the ball, and the way to it from there."""

    point: Vector
    direction: Vector
    error: float
    """Root mean square error of the direction, degrees."""
    beside: float
    """How much light the next highlight of the ball holds, in parts of this one's."""


def find_glint(picture: Picture, ball: Ball) -> Glint:
    """Find the light that a mirror ball shows: l = 2 (n.v) n - v at its highlight (Debevec 1998, SIGGRAPH, fig. 6).

    `picture`: the mean of the channels. The highlight is the piece that holds most light of the pixels of at least half
    of the brightest one, and l the mean of its pixels' own; of the pixels about it of at least a quarter, a half and
    three quarters of its own brightest the mean is taken, and how they differ is in the error, with what the ball's
    outline leaves open and the rounding of the highlight's edge to pixels. Raises ValueError where nothing is one.
    """
    row, column = np.nonzero(ball.mask)
    _, n, v = ball.seen(row + 0.5, column + 0.5)
    inside = np.zeros_like(ball.mask)
    inside[row, column] = (n * v).sum(-1) > RIM
    light = np.where(inside, picture, 0.0)
    if not light.any():
        raise ValueError("the ball is black all over. Check the photograph and the mask.")
    half, beside = _brightest_piece(light)
    covered = half.sum() / max(inside.sum(), 1)
    if covered > LARGEST:
        raise ValueError(
            f"the ball shows no highlight: what is at least half as bright as its brightest pixel covers "
            f"{100 * covered:.2g} % of it. Give photographs of a mirror ball in the dark, or ball='matte'."
        )

    peak = np.unravel_index(np.argmax(np.where(half, light, 0.0)), light.shape)
    highlights = [_piece_about(light, level, peak) for level in LEVELS]
    highlights = [piece for piece in highlights if piece.sum() <= LARGEST * inside.sum()]

    def reflected(ball: Ball, highlight: np.ndarray) -> tuple[Vector, Vector]:
        row, column = np.nonzero(highlight)
        p, n, v = ball.seen(row + 0.5, column + 0.5)
        l = 2.0 * (n * v).sum(-1, keepdims=True) * n - v
        weight = light[row, column][:, None]
        mean = (weight * l).sum(0)
        return (weight * p).sum(0) / weight.sum(), mean / np.linalg.norm(mean)

    found = [reflected(ball, highlight) for highlight in highlights]
    point, direction = np.mean([p for p, _ in found], 0), np.mean([l for _, l in found], 0)
    direction /= np.linalg.norm(direction)
    spread = np.mean([np.sum((l - direction) ** 2) for _, l in found])
    here = reflected(ball, half)[1]
    moved = [reflected(ball.moved(step), half)[1] - here for step in np.diag(ball.errors)]
    digits = 2.0 / 12.0 * (2.0 / ball.radius) ** 2 / half.sum()  # a pixel is 2/R of a direction, in each of two ways
    error = float(np.rad2deg(np.sqrt(spread + np.square(moved).sum() + digits)))
    return Glint(point, direction, error, beside)


def _brightest_piece(light: Picture) -> tuple[np.ndarray, float]:
    """Return the piece that holds most light, of the pixels of at least half the brightest, and the next one's part."""
    labels, count = ndimage.label(light >= 0.5 * light.max(), np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    held = ndimage.sum_labels(light, labels, np.arange(1, count + 1))
    first = int(np.argmax(held))
    return labels == 1 + first, float(np.delete(held, first).max(initial=0.0) / held[first])


def _piece_about(light: Picture, level: float, peak: tuple[np.intp, ...]) -> np.ndarray:
    """Return the connected piece about a pixel, of those of at least this part of its brightness."""
    labels, _ = ndimage.label(light >= level * light[peak], np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    return labels == labels[peak]


def find_position(glints: Sequence[Glint]) -> tuple[Vector, Float[np.ndarray, "3"]]:
    """Return the point nearest to the rays from several balls to one light, and its standard errors; scene units.

    Minimises sum |(I - l l^T)(x - p)|^2 / (sigma |x - p|)^2 over x, with the distances of the last x; sigma is each
    direction's error, or more where the rays miss each other by more. NaN, with infinite errors, where they do not
    meet.
    """
    p, l = np.array([g.point for g in glints]), np.array([g.direction for g in glints])
    sigma = np.deg2rad([max(g.error, 1e-6) for g in glints]) / np.sqrt(2.0)  # along each of the two ways across a ray
    across = np.eye(3) - l[:, :, None] * l[:, None, :]
    distance, x, H = np.ones(len(glints)), np.zeros(3), np.eye(3)
    for _ in range(STEPS):
        weight = (1.0 / (sigma * distance) ** 2)[:, None, None]
        H = (weight * across).sum(0)
        if not np.linalg.cond(H) < PARALLEL:
            return np.full(3, np.nan), np.full(3, np.inf)
        x = np.linalg.solve(H, (weight * across @ p[:, :, None]).sum(0)[:, 0])
        distance = np.maximum(np.linalg.norm(x - p, axis=-1), 1e-9)
    misses = np.einsum("kij,kj->ki", across, x - p)
    chi2 = float(((misses**2).sum(-1) / (sigma * distance) ** 2).sum()) / (2 * len(glints) - 3)
    errors = np.sqrt(np.diag(np.linalg.inv(H)) * max(chi2, 1.0))
    # behind a ball, or as uncertain as it is far: the light is too far away for its place to be told
    if not (((x - p) * l).sum(-1) > 0).all() or np.linalg.norm(errors) > distance.min():
        return np.full(3, np.nan), np.full(3, np.inf)
    return x, errors

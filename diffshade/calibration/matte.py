"""Matte balls: directions and intensities from shading."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ..core.robust_scale import robust_scale
from ..core.thresholds import CLEARLY, FAR_MORE, MINOR
from ..model.lights import DirectionalLight
from ..model.materials import Material
from ..model.scenes import Object, Scene
from .balls import MIN_N_V, Ball, Vectors
from .laws import LAWS, PhotographLights, Shading, find_lamps
from .photographs import Photographs
from .result import Calibration, degrees

PATCHES = 6  # across a ball; the errors of the pixels in one patch are correlated
MAX_PIXELS = 8_000  # more make no error smaller: those of neighbours are one


def by_shading(
    taken: Photographs,
    ball: Ball,
    known: tuple[Vectors, Float[np.ndarray, " photographs"]] | None,
    report_progress: Callable[[str], None],
) -> Calibration:
    """Find the light of each photograph from the shading of a matte ball; with `known` directions, its intensity."""
    report_progress("shading")
    row, column, shading = sample_ball(taken, ball)
    laws = [find_lamps(shading, law, None if known is None else known[0]) for law in LAWS]
    lamps = laws[-1]
    shown = np.nanmedian(shading.values, -1)
    for name, level, intensity in zip(taken.names, shown, lamps.intensity, strict=True):
        if intensity < MINOR * level:
            raise ValueError(
                f"{name} shows no light on the ball, which is equally bright everywhere. Give photographs under one "
                "light each."
            )
    # E1 and E4 are the model's own law. They always count: a ball may differ from them in ways that no law here covers.
    others = [laws[1], *(one for one in laws[:1] if _scatter(one) <= CLEARLY * _scatter(lamps))]
    between = np.mean([degrees(of.direction, lamps.direction) ** 2 for of in others], 0)
    pose = np.rad2deg(np.linalg.norm(ball.errors) / float(ball.sphere.radius))
    errors = np.sqrt(_direction_errors(lamps) ** 2 + between + pose**2) if known is None else known[1]
    relative = lamps.intensity / lamps.intensity.mean()
    between_intensities = np.mean([(of.intensity / of.intensity.mean() / relative - 1.0) ** 2 for of in others], 0)
    along = np.einsum("ij,ijk,ik->i", lamps.direction, lamps.covariance, lamps.direction) / lamps.intensity**2
    intensities = _colours([np.asarray(image[:], np.float64)[row, column] for image in taken.images], lamps)
    lights = [DirectionalLight(-l, c) for l, c in zip(lamps.direction, intensities, strict=True)]
    notes = [
        *_outliers(taken, lamps),
        *_not_lambert(lamps),
        "only k_d times the intensity is measured: the intensities are those for a ball with k_d 1, and have the "
        "ball's colour.",
    ]
    if known is None:
        between_laws = float(np.sqrt(between.mean()))
        notes.append(
            f"other laws of shading turn the directions by {between_laws:.2g} degrees, which the errors include. A "
            f"mask shifted by one pixel would turn all of them by {np.rad2deg(1 / ball.radius):.2g} degrees; the "
            "errors include a shift of .29 pixels."
        )
    return Calibration(
        ball="matte",
        names=taken.names,
        balls=(ball,),
        scene=Scene(Object(ball.sphere, Material(k_d=1.0)), lights),
        images=taken.images,
        directions=lamps.direction,
        errors=errors,
        intensities=intensities,
        intensity_errors=np.sqrt(along + between_intensities),
        notes=(*notes, *taken.notes),
    )


def sample_ball(taken: Photographs, ball: Ball) -> tuple[np.ndarray, np.ndarray, Shading]:
    """Return rows and columns on the ball away from its rim, and what the photographs show there."""
    row, column = np.nonzero(ndimage.binary_erosion(ball.mask))
    _, n, v = ball.seen(row + 0.5, column + 0.5)
    inside = np.flatnonzero((n * v).sum(-1) > MIN_N_V)
    if len(inside) > MAX_PIXELS:
        inside = np.random.default_rng(0).choice(inside, MAX_PIXELS, replace=False)
    across, up = (_cells(of[inside]) for of in (column, row))
    cell = PATCHES * up + across
    order = np.argsort(cell, kind="stable")
    inside = inside[order]
    row, column, n, n_v = row[inside], column[inside], n[inside], (n * v).sum(-1)[inside]
    values = []
    for i, name in enumerate(taken.names):
        of = np.where(taken.clipped(i)[row, column], np.nan, taken.grey(i)[row, column])
        if not np.isfinite(of).any() or not np.nanmax(of) > 0:
            raise ValueError(f"{name} is black, or clipped, all over the ball. Check the photograph and the mask.")
        values.append(of)
    return row, column, Shading(np.array(values), n, n_v, np.unique(cell[order], return_inverse=True)[1])


def _cells(index: np.ndarray) -> np.ndarray:
    return ((index - index.min()) * PATCHES // (np.ptp(index) + 1)).astype(int)


def _colours(samples: Sequence[np.ndarray], lamps: PhotographLights) -> Vectors:
    """Return R, G, B of each light: its intensity times the share of each channel.

    Each channel is S = a + s L. L is what the light alone adds to the mean of the channels, s is fitted for each
    photograph, and the ambient a is the same for all of them.
    """
    w, L = lamps.weights, lamps.lit
    residual = w * (1.0 - L * ((w * L).sum(-1) / (w * L * L).sum(-1))[:, None])  # the part of a constant not along L
    ambient = sum(each @ of for each, of in zip(residual, samples, strict=True)) / residual.sum()
    shares = np.array([(each * l) @ (of - ambient) for each, l, of in zip(w, L, samples, strict=True)])
    return lamps.intensity[:, None] * shares / shares.mean(-1, keepdims=True) * np.ones(3)


def _scatter(lamps: PhotographLights) -> float:
    return robust_scale(lamps.residuals[np.isfinite(lamps.residuals)])


def _direction_errors(lamps: PhotographLights) -> Float[np.ndarray, " photographs"]:
    """Return the root mean square error of each direction by the patches, degrees."""
    l, covariance = lamps.direction, lamps.covariance
    across = np.trace(covariance, axis1=1, axis2=2) - np.einsum("ij,ijk,ik->i", l, covariance, l)
    return np.rad2deg(np.sqrt(np.maximum(across, 0.0)) / lamps.intensity)


def _outliers(taken: Photographs, lamps: PhotographLights) -> list[str]:
    """Name the photographs that one far light explains much worse than the others; shared texture does not count."""
    if len(taken.names) < 4:
        return []
    own = lamps.residuals - np.nanmedian(lamps.residuals, 0)
    scatter = np.sqrt(np.nanmean(own**2, -1))
    usual = max(float(np.median(scatter)), 1e-12)
    return [
        f"{name} is not lit by one far light as the others are (its residuals are {s / usual:.1f} times theirs): look "
        "for a second light, or a bright wall."
        for name, s in zip(taken.names, scatter, strict=True)
        if s > FAR_MORE * usual
    ]


def _not_lambert(lamps: PhotographLights) -> list[str]:
    """Report how far the ball's shading differs from Lambert's law, if it does."""
    a, s_1, s_2, s_3, s_4 = lamps.shared
    half = 0.5 * (1.0 + 0.5 * s_1 + 0.25 * s_2 + 0.5 * s_3 + 0.25 * s_4)
    if abs(half - 0.5) < 0.01 and abs(a) < 0.01:
        return []
    return [
        f"at n.l = n.v = 0.5 the ball shows {half:.2f} of what it shows at n.l = n.v = 1 (Lambert: 0.50), and the "
        f"ambient light is {a:.2f}."
    ]

"""Matte balls: directions and intensities from their shading."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from ..inverse.data.samples import erode
from ..model.lights import DirectionalLight
from ..model.materials import Material
from ..model.scenes import Object, Scene
from .balls import Ball
from .laws import LAWS, Lamps, Shading, find_lamps
from .outcome import Calibration, degrees, views_of
from .photographs import Photographs

Vectors = Float[np.ndarray, "photographs 3"]

RIM = 0.2  # n.v below which pixels are left out: there the outline matters most
PATCHES = 6  # across a ball, whose pixels err together
MOST_PIXELS = 8_000
AS_GOOD = 1.5  # times the residuals of a law that may bend: without ambient light it may be the right one
EVEN = 0.05  # of a photograph's median: a light that gives less is none
ODD = 2.0  # times the residuals of the middle photograph: it is another one


def by_shading(
    taken: Photographs,
    ball: Ball,
    known: tuple[Vectors, Float[np.ndarray, " photographs"]] | None,
    report_progress: Callable[[str], None],
) -> Calibration:
    """Find the light of each photograph from the shading of a matte ball; with `known` directions, its intensity."""
    report_progress("shading")
    row, column, shading = see(taken, ball)
    laws = [find_lamps(shading, law, None if known is None else known[0]) for law in LAWS]
    lamps = laws[-1]
    shown = np.nanmedian(shading.values, -1)
    for name, level, intensity in zip(taken.names, shown, lamps.intensity, strict=True):
        if intensity < EVEN * level:
            raise ValueError(
                f"{name} shows no light on the ball: it is as bright everywhere. Give photographs under one light each."
            )
    # the model's own law counts in any case: where a ball bends from it, it may do so in ways that no law here has
    others = [laws[1], *(of for of in laws[:1] if _scatter(of) <= AS_GOOD * _scatter(lamps))]
    between = np.mean([degrees(of.direction, lamps.direction) ** 2 for of in others], 0)
    pose = np.rad2deg(np.linalg.norm(ball.errors) / float(ball.sphere.radius))
    errors = np.sqrt(_turns(lamps) ** 2 + between + pose**2) if known is None else known[1]
    relative = lamps.intensity / lamps.intensity.mean()
    apart = np.mean([(of.intensity / of.intensity.mean() / relative - 1.0) ** 2 for of in others], 0)
    along = np.einsum("ij,ijk,ik->i", lamps.direction, lamps.covariance, lamps.direction) / lamps.intensity**2
    intensities = _colours([np.asarray(image[:], np.float64)[row, column] for image in taken.images], lamps)
    lights = [DirectionalLight(-l, c) for l, c in zip(lamps.direction, intensities, strict=True)]
    notes = [
        *_odd(taken, lamps),
        *_bent(lamps),
        "only k_d times the intensity is seen: the intensities are those of a ball with k_d 1, and coloured where "
        "the ball is.",
    ]
    if known is None:
        laws_turn = float(np.sqrt(between.mean()))
        notes.append(
            f"other laws of shading turn the directions by {laws_turn:.2g} degrees, which is in the errors; a mask "
            f"that lies a pixel to one side turns all of them by {np.rad2deg(1 / ball.radius):.2g}, of "
            "which .29 is."
        )
    return Calibration(
        ball="matte",
        names=taken.names,
        balls=(ball,),
        scene=Scene(Object(ball.sphere, Material(k_d=1.0)), lights),
        views=views_of(taken, (ball,)),
        directions=lamps.direction,
        errors=errors,
        intensities=intensities,
        intensity_errors=np.sqrt(along + apart),
        notes=(*notes, *taken.notes),
    )


def see(taken: Photographs, ball: Ball) -> tuple[np.ndarray, np.ndarray, Shading]:
    """Return what photographs show of a ball, and at which rows and columns, of its rim nothing."""
    row, column = np.nonzero(erode(ball.mask))
    _, n, v = ball.seen(row + 0.5, column + 0.5)
    inside = np.flatnonzero((n * v).sum(-1) > RIM)
    if len(inside) > MOST_PIXELS:
        inside = np.random.default_rng(0).choice(inside, MOST_PIXELS, replace=False)
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


def _colours(samples: Sequence[np.ndarray], lamps: Lamps) -> Vectors:
    """Return R, G, B of each light: its intensity, times what each channel has of it.

    Of each channel S = a + s L, where L is what the light gives the mean of the channels, s is the photograph's own and
    the ambient a is one for all.
    """
    w, L = lamps.weights, lamps.lit
    beside = w * (1.0 - L * ((w * L).sum(-1) / (w * L * L).sum(-1))[:, None])  # what of the ambient L does not explain
    ambient = sum(each @ of for each, of in zip(beside, samples, strict=True)) / beside.sum()
    shares = np.array([(each * l) @ (of - ambient) for each, l, of in zip(w, L, samples, strict=True)])
    return lamps.intensity[:, None] * shares / shares.mean(-1, keepdims=True) * np.ones(3)


def _scatter(lamps: Lamps) -> float:
    return float(1.4826 * np.nanmedian(np.abs(lamps.residuals)))


def _turns(lamps: Lamps) -> Float[np.ndarray, " photographs"]:
    """Return by how much the patches leave each direction open: root mean square, degrees."""
    l, covariance = lamps.direction, lamps.covariance
    across = np.trace(covariance, axis1=1, axis2=2) - np.einsum("ij,ijk,ik->i", l, covariance, l)
    return np.rad2deg(np.sqrt(np.maximum(across, 0.0)) / lamps.intensity)


def _odd(taken: Photographs, lamps: Lamps) -> list[str]:
    """Say which photographs no one light explains as it does the others, whatever texture they share."""
    if len(taken.names) < 4:
        return []
    own = lamps.residuals - np.nanmedian(lamps.residuals, 0)
    scatter = np.sqrt(np.nanmean(own**2, -1))
    usual = max(float(np.median(scatter)), 1e-12)
    return [
        f"{name} is not shaded by one far light as the others are (residuals of its own {s / usual:.1f} times theirs): "
        "look for a second light, or a bright wall."
        for name, s in zip(taken.names, scatter, strict=True)
        if s > ODD * usual
    ]


def _bent(lamps: Lamps) -> list[str]:
    """Say by how much the ball does not shade as Lambert says, where it does not."""
    a, s_1, s_2, s_3, s_4 = lamps.shared
    half = 0.5 * (1.0 + 0.5 * s_1 + 0.25 * s_2 + 0.5 * s_3 + 0.25 * s_4)
    if abs(half - 0.5) < 0.01 and abs(a) < 0.01:
        return []
    return [
        f"where n.l and n.v are a half the ball shows {half:.2f} of what it shows where they are 1 (Lambert: 0.50), "
        f"beside ambient light of {a:.2f}."
    ]

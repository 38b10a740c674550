"""Refining: lights and texels in turn, until the lights stay: each step of the lights has all texels eliminated.

Lights and normals may be mapped together, s -> M s and b -> M^-T b, and show almost the same: the few percent that a
model leaves out of real photographs are enough to shear all lights of an object by degrees. So what the texels say of
such a map is not believed. They say where the lights are but for a map, and the map is the one by which the lights are
nearest to those stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares

from ...core.thresholds import MINOR, MOST
from ...inverse.data.views import View
from ...inverse.forward.losses import CAUCHY
from ..lighting import LightingSetup, lighting_setup
from ..robust.choice import FIRST_ROUNDS
from ..robust.disagreement import CELLS, cells_of
from ..robust.learning import every_assumption, learned
from ..robust.run import RobustRun
from ..tiles import TexelTile
from .joint import TILT, LightEquations, light_equations, responses
from .placing import LightEstimates, PlacedLights

ROUNDS = 20
LONGEST_STEP = np.deg2rad(5.0), 0.3  # step of a direction, and of the logarithm of an intensity
LOOSE = np.deg2rad(10.0), 0.1  # how far a light may be from the stated one while its texels are fitted
MIN_GAIN_ERROR = 0.02  # relative, of stated intensities where a map is found: what a model leaves out is as much


class Stated(NamedTuple):
    """What is known of the lights beside the photographs."""

    directions: Float[np.ndarray, "lights 3"]
    error: Float[np.ndarray, " lights"]
    """Standard deviation of each direction about each axis, radians; 0 where it is exact."""
    intensity_error: Float[np.ndarray, " lights"]
    """Relative standard deviation of each intensity: 0 where it is exact, infinite where nothing is known."""


class Refined(NamedTuple):
    """Lights as found, with variances of both tilts of each and of the logarithm of its intensity."""

    lamps: LightEstimates
    own: Float[np.ndarray, "lights 3"]
    """Of each light by itself."""
    shared: Float[np.ndarray, "lights 3"]
    """Of the map that all share."""
    misfit: float
    """Typical residual of a texel, relative to its level."""
    settled: bool


def tangents_to(directions: Float[np.ndarray, "*many 3"]) -> Float[np.ndarray, "*many 2 3"]:
    """Return two unit vectors across each direction."""
    first = np.cross(directions, np.eye(3)[np.abs(directions).argmin(-1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], -2)


def refine(
    given: PlacedLights,
    views: Sequence[View],
    run: RobustRun,
    sample: TexelTile,
    light_of: Int[np.ndarray, " views"],
    stated: Stated,
    *,
    lambertian: bool = True,
) -> Refined:
    """Return the lights that agree best with all texels of a sample.

    Args:
        given: The lights, of a scene.
        views: The photographs.
        run: What works on the texels.
        sample: The texels.
        light_of: The light of each view.
        stated: What is known beside the photographs, where the rounds begin.
        lambertian: Whether k_d reflects by Lambert's law.
    """
    lights = len(stated.directions)
    lamps, cell = LightEstimates(stated.directions, np.ones(lights)), cells_of(sample.pixels, run.tiles.reader.shape)
    run = run.under(lighting_setup(given.moved(lamps), views))
    model, settled = run.learn(sample, every_assumption(lambertian=lambertian)[0])[0], False
    covariance = np.zeros((3 * lights, 3 * lights))
    exact, brighter = not (stated.error > 0.0).any(), np.tile([0.0, 0.0, 1.0], lights)[:, None]  # k_d takes that back
    free = np.stack([stated.error > 0.0, stated.error > 0.0, np.ones(lights, bool)], -1).ravel()

    def setup_of(lamps: LightEstimates) -> LightingSetup:
        return eqx.tree_at(lambda s: s.lobe, lighting_setup(given.moved(lamps), views), run.setup.lobe)

    for k in range(ROUNDS):
        run.tiles.report_progress("refining the lights:", (k + 1) / ROUNDS)
        run.setup = setup_of(lamps)
        if 0 < k < FIRST_ROUNDS:
            model = learned(model, run.sample_at_minimum(sample, model))
        tangents = tangents_to(lamps.directions)
        tilted = [setup_of(_moved(lamps, TILT * np.eye(3)[[axis] * lights], tangents)) for axis in range(2)]
        answer = responses(run, sample, [model], [run.setup, *tilted])
        equations = light_equations(answer, light_of, lights, cell, CELLS**2)
        seen = np.diag(equations.S).reshape(-1, 3)[:, 2]
        if not (seen > 0.0).all():
            raise ValueError(
                f"views[{np.flatnonzero(light_of == seen.argmin())[0]}] shows no texel that counts under its light. "
                "Leave the view out, or mend its mask."
            )
        maps = brighter if exact else _maps(lamps.directions, tangents)
        step = _step(equations, lamps, stated, tangents, free)
        covariance = _covariance(equations, maps, free)
        covariance += np.diag(free * (MOST * float(model.relative_misfit)) ** 2)
        own = step.ravel()[free] @ (N := _complement(maps[free])) @ N.T
        settled = bool((np.abs(own) < MINOR * np.sqrt(np.diag(covariance)[free])).all())
        if settled or k + 1 == ROUNDS:
            break
        lamps = _moved(lamps, step, tangents)
    return _anchored(lamps, covariance, stated, float(model.relative_misfit), settled=settled)


def _moved(
    lamps: LightEstimates, step: Float[np.ndarray, "lights 3"], tangents: Float[np.ndarray, "lights 2 3"]
) -> LightEstimates:
    """Return the lights after a step, of which none is too long."""
    tilt, brighter = step[:, :2], np.clip(step[:, 2], -LONGEST_STEP[1], LONGEST_STEP[1])
    tilt = tilt * np.minimum(1.0, LONGEST_STEP[0] / np.maximum(np.linalg.norm(tilt, axis=-1, keepdims=True), 1e-12))
    directions = lamps.directions + np.einsum("la,lai->li", tilt, tangents)
    return LightEstimates(
        directions / np.linalg.norm(directions, axis=-1, keepdims=True), lamps.gain * np.exp(brighter)
    )


def _away(
    lamps: LightEstimates, stated: Stated, tangents: Float[np.ndarray, "lights 2 3"]
) -> Float[np.ndarray, "lights 3"]:
    """Return how far lights are from those stated: along both tangents, and in the logarithm of the intensity."""
    tilt = np.einsum("li,lai->la", lamps.directions - stated.directions, tangents)
    return np.concatenate([tilt, np.log(lamps.gain)[:, None]], -1)


def _complement(G: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the steps that none of the columns of G has a part in."""
    return np.linalg.qr(G, mode="complete")[0][:, G.shape[1] :]


def _maps(directions: Float[np.ndarray, "lights 3"], tangents: Float[np.ndarray, "lights 2 3"]) -> np.ndarray:
    """Return the steps of the lights (3*lights, 9) by each element of a linear map of all of them."""
    frame = np.concatenate([tangents, directions[:, None]], 1)
    return np.einsum("lai,lj->laij", frame, directions).reshape(-1, 9)


def _step(
    equations: LightEquations,
    lamps: LightEstimates,
    stated: Stated,
    tangents: Float[np.ndarray, "lights 2 3"],
    free: Bool[np.ndarray, " 3*lights"],
) -> Float[np.ndarray, "lights 3"]:
    """Return the step of the lights to the minimum, loosely held by what is stated."""
    S, by_cell = equations
    loose = np.tile([1.0 / LOOSE[0] ** 2] * 2 + [1.0 / LOOSE[1] ** 2], len(S) // 3)
    g = by_cell.sum(0) + loose * _away(lamps, stated, tangents).ravel()
    step = np.zeros(len(S))
    step[free] = -np.linalg.solve((S + np.diag(loose))[np.ix_(free, free)], g[free])
    return step.reshape(-1, 3)


def _covariance(equations: LightEquations, maps: np.ndarray, free: Bool[np.ndarray, " 3*lights"]) -> np.ndarray:
    """Return the covariance of the lights, but for a map of all, from how the cells of the image disagree."""
    S, by_cell = equations
    cells = by_cell[np.abs(by_cell).sum(-1) > 0.0]
    apart = (cells - cells.mean(0))[:, free]
    S, G = S[np.ix_(free, free)], maps[free]
    N = _complement(G)
    Q = N.T - N.T @ S @ G @ np.linalg.pinv(G.T @ S @ G, rcond=1e-10, hermitian=True) @ G.T
    R = N @ np.linalg.solve(Q @ S @ N, Q)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = R @ apart.T @ apart @ R.T * len(cells) / max(len(cells) - 1, 1)
    return covariance


def _anchored(
    lamps: LightEstimates, covariance: np.ndarray, stated: Stated, misfit: float, *, settled: bool
) -> Refined:
    """Return the lights after the map by which they are nearest to those stated."""
    own = np.diag(covariance).reshape(-1, 3)
    if not (stated.error > 0.0).any():
        gain = lamps.gain / np.exp(np.log(lamps.gain).mean())
        return Refined(LightEstimates(lamps.directions, gain), own, np.zeros_like(own), misfit, settled)
    lamps = _mapped(lamps, stated)
    weights = np.stack([stated.error, stated.error, np.maximum(stated.intensity_error, MIN_GAIN_ERROR)], -1).ravel()
    G = _maps(lamps.directions, tangents_to(lamps.directions))
    whole = G @ np.linalg.pinv((G / weights[:, None] ** 2).T @ G, rcond=1e-10, hermitian=True) @ G.T
    return Refined(lamps, own, np.diag(whole).reshape(-1, 3), misfit, settled)


def _mapped(lamps: LightEstimates, stated: Stated) -> LightEstimates:
    """Return the lights after the linear map by which they are nearest to those stated."""
    vectors = lamps.directions * lamps.gain[:, None]
    tangents = tangents_to(stated.directions)
    error = np.maximum(stated.error, 1e-6)[:, None]

    def of(M: np.ndarray) -> LightEstimates:
        mapped = vectors @ M.reshape(3, 3).T
        length = np.linalg.norm(mapped, axis=-1)
        return LightEstimates(mapped / length[:, None], length)

    def apart(M: np.ndarray) -> np.ndarray:
        away = _away(of(M), stated, tangents)
        brighter = away[:, 2] - away[:, 2].mean()
        return np.concatenate(
            [(away[:, :2] / error).ravel(), brighter / np.maximum(stated.intensity_error, MIN_GAIN_ERROR)]
        )

    found = of(least_squares(apart, np.eye(3).ravel(), loss="cauchy", f_scale=CAUCHY).x)
    return LightEstimates(found.directions, found.gain / np.exp(np.log(found.gain).mean()))

"""Gammas: how well the texels of an object agree with photographs that are raised to a power."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from ...core.robust_scale import robust_scale
from ...core.thresholds import CLEARLY, MINOR
from ...core.words import Note
from ...inverse.data.sensors import Sensor, linear_level
from ..between_lights import MIN_VIEWS  # of 8, a texel's four numbers fit the brightest, whatever the gamma
from ..robust.choice import fewer
from ..robust.learning import Fitted, every_assumption
from ..robust.run import RobustRun
from ..tiles import TexelTile
from .taught import Taught

Misfit = Callable[[TexelTile, float], float]
RANGE = 0.4, 2.5  # of gammas that photographs have, and their inverses


def by_gamma_or_law(taught: Taught) -> Taught:
    """Return what was taught, or what Lambert's law teaches where a gamma explains the photographs better, with a note.

    Through a wrong gamma a matte thing looks as if it were rough, or as if light entered it.
    """
    unfit = len(taught.views) < MIN_VIEWS or any(float(view.black) != 0.0 for view in taught.views)
    if unfit or all(bool(model.assumed.lambertian) for model in taught.models):
        return taught
    few, run = fewer(taught.sample), taught.run
    as_they_are = misfit_in_file(few, few, run.sample_at_minimum(few, taught.models[0]), 1.0)
    gamma, least = lowest(partial(misfit_through, run), few, np.log(RANGE))
    if not as_they_are > CLEARLY * least:
        return taught
    text = (
        f"the photographs are not linear: raised to about {gamma:.2g}, they have a misfit of {least:.2%}, and of "
        f"{as_they_are:.2%} as they are. Read them with their own curve, or give the views a Sensor(gamma=...); "
        "lights.find_response finds the gamma."
    )
    return taught._replace(models=run.learn(taught.sample, every_assumption()[0])).noted(Note(text, "cause"))


def misfit_through(run: RobustRun, sample: TexelTile, gamma: float) -> float:
    """Return the misfit of texels, by Lambert's law, to photographs raised to a gamma."""
    anew, linear = run.under(run.setup), raised(sample, gamma)
    model = anew.learn(linear, every_assumption()[0])[0]
    return misfit_in_file(sample, linear, anew.sample_at_minimum(linear, model), gamma)


def misfit_in_file(sample: TexelTile, linear: TexelTile, found: Fitted, gamma: float) -> float:
    """Return the typical residual relative to a texel's brightness, as the file has both.

    A residual r of the linear y = f^gamma is one of r f / (gamma y) in the file. Taken there, noise is as large through
    every gamma; of linear samples, a large gamma would make that of the dark ones small.
    """
    f, y = (tile.target.mean(1) for tile in (sample, linear))
    believed = np.asarray(found.weight > 0.0) & (f > MINOR * f.max(0))
    level = np.where(believed, f, 0.0).sum(0) / np.maximum(believed.sum(0), 1)
    of_level = np.where(believed, y, 0.0).sum(0) / np.maximum(believed.sum(0), 1)
    slope = f / np.maximum(gamma * y, 1e-12) * of_level / np.maximum(level, 1e-12)
    off = (np.asarray(found.residual) * slope)[believed]
    return robust_scale(off) if len(off) else np.inf


def raised(sample: TexelTile, gamma: float) -> TexelTile:
    """Return texels whose photographs are made linear by a gamma."""
    linear = linear_level(Sensor(gamma=gamma), sample.target).astype(sample.target.dtype)
    return eqx.tree_at(lambda tile: tile.target, sample, linear)


def lowest(misfit: Misfit, sample: TexelTile, bounds: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """Return the gamma at which a misfit is least, and that misfit, between two logarithms of gamma."""
    found: Any = minimize_scalar(lambda log: misfit(sample, float(np.exp(log))), bounds=bounds, options={"xatol": 0.01})
    return float(np.exp(found.x)), float(found.fun)

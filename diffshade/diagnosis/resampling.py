"""Resampling: repeated fits to views drawn with replacement."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..core.backend import in_float64
from ..core.fields import check_kind
from ..core.progress import showing
from ..inverse.result import Fit
from ..inverse.unknowns.unknown import values_at
from .patches import Parts, keep_only


def bootstrap(fit: Fit, *, draws: int = 200, seed: int = 0, progress: bool = False) -> Float[np.ndarray, "draws p"]:
    """Fit again to views drawn with replacement, and return the fitted values (the bootstrap; Efron 1979).

    Views with the same camera and lights are drawn together. The standard deviation of a column is the error of that
    unknown, and its percentiles are an interval. Both include errors that the samples of one view share, and not errors
    that all views share. Each fit starts at the given fit. An unknown that no view of a draw shows keeps its value.

    Args:
        fit: The fit to resample, of at least three views with different cameras or lights.
        draws: The number of fits, at least 1.
        seed: The seed of the random draws, at least 0.
        progress: Show a progress line on the terminal.

    Returns:
        The fitted values, one row per draw, in the order of `fit.names`.

    Raises:
        ValueError: If there are fewer than three different views, or `draws` or `seed` is out of range.
        TypeError: If `fit` is not a `Fit`.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    groups = fit.solved.problem.data.setups
    if len(groups) < 3:
        raise ValueError(
            f"bootstrap needs at least three views with different cameras or lights; got {len(groups)}. Add views."
        )
    if not (isinstance(draws, int | np.integer) and draws >= 1):
        raise ValueError(f"draws must be a whole number of at least 1; got {draws!r}. Give for example 200.")
    if not (isinstance(seed, int | np.integer) and seed >= 0):
        raise ValueError(f"seed must be a whole number of at least 0; got {seed!r}. Give for example 0.")
    random = np.random.default_rng(seed)
    found = np.empty((draws, len(fit.values)))
    with (
        showing("bootstrap", show=progress) as report_progress,
        in_float64(fit) as fit,
    ):
        laid, data = fit.solved.laid_out(), fit.solved.problem.data
        chunks = Parts([keep_only(data, group) for group in groups], "views").weighed(laid)
        for draw in range(draws):
            report_progress(f"draw {draw + 1} of {draws}", draw / draws)
            drawn = random.integers(len(groups), size=len(groups))
            theta = laid.minimise(chunks=[chunk for g in drawn for chunk in chunks[g]], rtol=1e-10).theta
            found[draw] = values_at(theta, fit.unknowns)
    return found

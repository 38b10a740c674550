"""Forecast: the errors of a fit, and what it will not determine, before the photographs are taken or fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from ..core.backend import in_float64
from ..core.fields import as_float64
from ..core.tables import as_text, parameters
from ..inverse.data.recording import photograph
from ..inverse.data.view_sets import ViewSet
from ..inverse.data.views import Noise, View, has_alpha
from ..inverse.fitting import checked, new_problem
from ..inverse.laid_out import lay_out
from ..inverse.solve.solvers import Minimum, evaluate
from ..inverse.statistics.uncertainty import Vector
from ..inverse.summary import summarise
from ..inverse.unknowns.constraints import Grey, Proportional
from ..inverse.unknowns.parameters import find_unknowns
from ..inverse.unknowns.slots import values_in
from ..inverse.unknowns.unknown import coordinates
from ..model.scenes import Scene
from ..parallel.threads import ONE_BLAS_THREAD


@dataclass(frozen=True, eq=False)
class Forecast:
    """The errors to expect of a fit to photographs of a scene; `print` it for the table."""

    names: tuple[str, ...]
    values: Vector
    """The scene's values."""
    errors: Vector
    """The standard errors to expect for independent noise; infinite where a value will not be determined."""
    determined: Bool[np.ndarray, " p"]
    notes: tuple[str, ...]
    """What these views will not determine, and a remedy: a sentence each."""

    def __str__(self) -> str:
        """Return the table of expected errors, and the notes below it."""
        columns = parameters(self.names, self.values, self.errors, self.determined)
        return as_text("forecast: the scene's values, and the errors to expect of a fit", columns, notes=self.notes)


def forecast(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str],
    tied: Iterable[str] = (),
    constraints: Sequence[Grey | Proportional] | Grey | Proportional = (),
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    priors: Mapping[str, Sequence[Any]] | None = None,
    noise: Noise | float = 0.01,
) -> Forecast:
    r"""Return the errors to expect of a fit if the scene is the truth, and what the fit would not determine.

    $$ Cov = \sigma^2 (J^T J)^{-1} $$

    at the scene's values, with J the derivatives of every sample: the inverse of the Fisher information for independent
    noise (Rao 1945).

    Args:
        scene: The scene, with the values that are assumed to be true.
        views: The photographs to be taken. Camera, mask, lights, exposure, noise and saturation count; the images may
            hold anything of the right shape.
        free: The parameters to fit, as in `fit`.
        tied: Parameters with one value for all lamps, as in `fit`.
        constraints: As in `fit`.
        bounds: As in `fit`.
        priors: As in `fit`.
        noise: The standard deviation of a sample (white = 1), above 0, or a `Noise`; 0.01 by default. Used for views
            without a `Noise` of their own.

    Returns:
        The expected errors.

    Raises:
        ValueError: If `noise` is not above 0, or an argument is refused by `fit`.
        TypeError: If an argument has another type.
    """
    views, constraints = checked(scene, views, constraints)
    if not isinstance(noise, Noise) and not (isinstance(noise, float | int | np.number) and 0 < noise < np.inf):
        raise ValueError(f"noise must be above 0; got {noise!r}. Give the standard deviation of a sample, or a Noise.")
    with in_float64((jax.tree.map(as_float64, scene), views)) as (scene, views), ONE_BLAS_THREAD:
        data = ViewSet.of(scene, views)
        views = tuple(_with_expected_image(scene, view, noise) for view in data.views)
        unknowns = find_unknowns(
            scene, views, free, tied, bounds, constraints, priors, from_scene=True, grey=bool(data.grey)
        )
        data = dataclasses.replace(data, views=views)
        problem = new_problem(scene, data, unknowns, "squares", "hinge", forecast=True)
        theta = coordinates(values_in(scene, views, unknowns), unknowns)
        laid = lay_out(problem, theta, problem.sum_of_squares(problem.chunks()))
        fit = summarise(laid, Minimum(evaluate(theta, laid.task, laid.chunks), 0, ""), forecast=True)
    return Forecast(fit.names, fit.values, fit.plain_errors, fit.determined, fit.notes)


def _with_expected_image(scene: Scene, view: View, noise: Noise | float) -> View:
    """Return a view with the photograph to expect of the scene, without noise."""
    image = photograph(scene, view)
    if has_alpha(view):
        image = np.concatenate([image, view.image[:][..., -1:]], -1)
    noise = noise if view.noise is None else view.noise
    return dataclasses.replace(view, image=image, noise=noise)

"""Fitting: photographs in, the scene's unknown numbers out, with what is and is not known about them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..backend import check_backend
from ..fields import check, check_kind
from ..progress import showing
from ..scenes import Scene
from .outcome import Fit, diagnose
from .parameters import LINEAR, find_unknowns, slots_of
from .residuals import prepare
from .solvers import solve
from .views import View, is_grey

MAX_STEPS = 200


def fit(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    progress: bool = False,
) -> Fit:
    """Fit the free numbers of a scene to photographs, by least squares over every pixel that shows an object.

    Minimises sum (exposure * radiance - image)^2 over the samples of all views by Levenberg-Marquardt on J^T J, in
    float64 whatever the global flag, with n_s as log n_s. It starts at k = 0.3, n_s = 10 and no attenuation, whatever
    the scene says of them, and at the scene's values for anything else.

    `free`, `tied`: names, any run of whole segments of a dotted path: `"k_d"`, `"lights.0.intensity"`,
    `"attenuation"` (which frees `linear` and `quadratic`; `constant`, the gauge, only by its own name). A tied name
    makes one unknown of the free numbers that are called the same after it. `bounds`: name to (lower, upper); by
    default coefficients, intensities and attenuation are at least 0 and n_s is in [0.1, 1e4]. `progress`: show a line
    on the terminal.

    Raises ValueError, TypeError: one sentence that names the view, pixel or parameter and the remedy;
    FloatingPointError where the scene gives no finite image; RuntimeError where this jaxlib adds up wrongly.
    """
    views = (views,) if isinstance(views, View) else tuple(views)
    if not views:
        raise ValueError("fit needs at least one view; got none. Give a View for each photograph.")
    check_kind("scene", scene, Scene, "Scene(Object(Sphere()), PointLight((2, 3, 4)))")
    for i, view in enumerate(views):
        check_kind(f"views[{i}]", view, View, "View(image, camera)")
    check((scene, views))
    check_backend()
    scene = jax.tree.map(_numpy, scene)
    unknowns = find_unknowns(scene, free, tied, bounds, grey=all(is_grey(view) for view in views))
    if not unknowns:
        raise ValueError(
            "free must name at least one parameter; got none. Give for example free=('k_d', 'k_s', 'n_s')."
        )
    moving = any("surface" in path.split(".") for unknown in unknowns for path, _ in unknown.places)
    lower, upper, start = (np.array([getattr(u, name) for u in unknowns]) for name in ("lower", "upper", "start"))
    logarithmic = np.array([u.logarithmic for u in unknowns])
    with jax.enable_x64(True):
        problem, counts = prepare(scene, views, slots_of(scene, unknowns), moving=moving)
        if counts.samples < len(unknowns):
            raise ValueError(
                f"these views have fewer samples than there are unknowns, {counts.samples} for {len(unknowns)}. "
                "Free fewer parameters or add views."
            )
        with showing("fit") if progress else contextlib.nullcontext() as number:
            solution = solve(
                jnp.asarray(_log(start, logarithmic)),
                problem,
                jnp.asarray(_log(lower, logarithmic)),
                jnp.asarray(_log(upper, logarithmic)),
                jnp.asarray([u.quantity.split(".")[-1] in LINEAR for u in unknowns]),
                MAX_STEPS,
                None if number is None else jnp.asarray(number),
            )
            theta, result = np.asarray(solution.value), optx.RESULTS[solution.result]
            gram = jax.tree.map(np.asarray, solution.aux)
        steps = int(solution.stats["steps"])
    if not (np.isfinite(theta).all() and np.isfinite(gram.cost).all()):
        raise FloatingPointError(
            f"the fit met a number that is not finite at {', '.join(f'{t:g}' for t in theta)}. Check the scene for "
            "extreme values."
        )
    values = np.where(logarithmic, np.exp(np.where(logarithmic, theta, 0.0)), theta)
    for bound in (lower, upper):  # right at the bound, not a rounding beside it
        values = np.where(np.isclose(values, bound, rtol=1e-12, atol=0.0), bound, values)
    return diagnose(scene, views, unknowns, values, lower, upper, gram, counts, steps, result)


def _numpy(leaf: object) -> np.ndarray:
    array = np.asarray(leaf)
    return array if array.dtype == bool else array.astype(np.float64)


def _log(values: np.ndarray, logarithmic: np.ndarray) -> np.ndarray:
    return np.where(logarithmic, np.log(np.where(logarithmic, values, 1.0)), values)

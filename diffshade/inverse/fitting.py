"""Fitting: photographs in, the scene's unknown numbers out, with what is and is not known about them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..backend import check_backend
from ..fields import check, check_kind
from ..progress import showing, silent
from ..scenes import Scene
from .constraints import Grey, Proportional
from .losses import LOSSES
from .outcome import Fit, diagnose
from .parameters import Unknown, find_unknowns
from .residuals import Counts
from .study import Study
from .views import Samples, View, find_samples, is_grey, repeats

CLIPPED = ("hinge", "tobit", "leave out")


def fit(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    constraints: Sequence[Grey | Proportional] | Grey | Proportional = (),
    priors: Mapping[str, Sequence[Any]] | None = None,
    loss: str = "squares",
    clipped: str = "hinge",
    start: str = "search",
    progress: bool = False,
) -> Fit:
    """Fit the free numbers of a scene to photographs, by least squares over every pixel that shows an object.

    Minimises sum (exposure * radiance + black - image)^2 over the samples of all views by Levenberg-Marquardt on J^T J
    within bounds, in float64 whatever the global flag, with n_s as log n_s. It needs no start: whatever the scene says
    of them, k_a, k_d, k_s are solved for exactly, n_s is searched for, and the attenuation begins at none; geometry (a
    light's position or direction, a spot's shape, a sphere) is searched for around the scene's values.

    `free`, `tied`: names, any run of whole segments of a dotted path: `"k_d"`, `"lights.0.intensity"`,
    `"attenuation"` (which frees `linear` and `quadratic`; `constant`, the gauge, only by its own name), `"exposure"`
    and `"black"` of each view, `"views.0.exposure"`. A direction is fitted as a unit vector. A tied name makes one
    unknown of the free numbers that are called the same after it. `bounds`: name to (lower, upper), where a name may
    end in a channel, as the table prints it ("k_d.r", "position.x"); by default coefficients, intensities and
    attenuation are at least 0 and n_s is in [0.1, 1e4]. `constraints`: `Grey`, `Proportional`. `priors`: name to
    (value, standard deviation), Gaussian, where the value may be a colour or vector; of n_s the deviation of log n_s.
    `loss`: "squares"; or, for outliers, "huber", "cauchy" or "geman-mcclure", whose scale is found from the residuals'
    median unless the views' noise is known. `clipped`: what a sample at the end of the sensor's range says: "hinge",
    that the truth is at least (or at most) that; "tobit", the same with the noise known, alone without bias where much
    lies within the noise of the sensor's floor; "leave out", nothing, nor do its pixel's other channels. `start`:
    "search", or "scene" to begin at the scene's values. `progress`: show a line on the terminal.

    Raises ValueError, TypeError: one sentence that names the view, pixel or parameter and the remedy;
    FloatingPointError where the scene gives no finite image; RuntimeError where this jaxlib adds up wrongly.
    """
    views = (views,) if isinstance(views, View) else tuple(views)
    constraints = (constraints,) if isinstance(constraints, Grey | Proportional) else tuple(constraints)
    check_choices(scene, views, constraints, loss, clipped, start)
    check_backend()
    scene = jax.tree.map(_numpy, scene)
    grey = all(is_grey(view) for view in views)
    unknowns = find_unknowns(
        scene, views, free, tied, bounds, constraints, priors, from_scene=start == "scene", grey=grey
    )
    check_free(unknowns)
    with showing("fit") if progress else contextlib.nullcontext(silent) as tell, jax.enable_x64(True):
        tell("reading the views")
        samples, counts = look_at(scene, views, unknowns, clipped)
        return run(scene, views, unknowns, samples, counts, loss, clipped, from_scene=start == "scene", tell=tell)


def look_at(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], clipped: str, *, foreseen: bool = False
) -> tuple[list[Samples], Counts]:
    """Find the samples of every view; raise ValueError that names the view, or says that there are too few.

    A view that is an earlier one again has none; `foreseen` says that the photographs are still to be taken.
    """
    moving = any("surface" in path.split(".") for unknown in unknowns for path, _ in unknown.places)
    samples, clipping, again = [], 0, {} if foreseen else repeats(scene, views)
    for i, view in enumerate(views):
        try:
            found = find_samples(scene, view, moving=moving)
        except ValueError as error:
            raise ValueError(f"views[{i}]: {error}") from None
        if i in again:  # the same numbers tell nothing more
            found = eqx.tree_at(lambda s: s.pixels, found, found.pixels[:0])
        ends = found.ends()
        clipping += int(np.abs(ends).sum())
        if clipped == "leave out" and ends.any():
            found = eqx.tree_at(lambda s: s.pixels, found, found.pixels[~ends.any(-1)])
        samples.append(found)
    pixels = sum(len(s.pixels) for s in samples)
    number = sum(len(s.pixels) * s.photograph.shape[2] for s in samples)
    left_out = clipped == "leave out"
    for noun, have in (
        ("pixels", pixels),
        ("samples that are not clipped", number - clipping * (clipped != "leave out")),
    ):
        if have < len(unknowns):
            raise ValueError(
                f"these views have fewer {noun} than there are unknowns, {have} for {len(unknowns)}. Free fewer "
                "parameters or add views."
            )
    if all(s.brightest <= 0.0 for s in samples):
        raise ValueError("the images are black: no pixel that shows an object is above 0. Check the files and masks.")
    kept, left = (0, clipping) if left_out else (clipping, 0)
    return samples, Counts(len(views) - len(again), pixels, number, kept, left)


def run(
    scene: Scene,
    views: tuple[View, ...],
    unknowns: Sequence[Unknown],
    samples: Sequence[Samples],
    counts: Counts,
    loss: str,
    clipped: str,
    *,
    from_scene: bool = False,
    tell: Callable[[str], None] = silent,
) -> Fit:
    """Find the minimum for these unknowns over these samples, and say what is known there. In float64."""
    study = Study(scene, views, unknowns, samples, counts, loss, clipped)
    study.lay_out()
    end = study.solve(from_scene=from_scene, tell=tell)
    return diagnose(scene, views, unknowns, study.likelihood, clipped, end, *study.evidence(end), counts, study.squares)


def check_free(unknowns: Sequence[Unknown]) -> None:
    """Refuse a fit of nothing."""
    if not unknowns:
        raise ValueError(
            "free must name at least one parameter; got none. Give for example free=('k_d', 'k_s', 'n_s')."
        )


def check_choices(
    scene: Any, views: Sequence[Any], constraints: Sequence[Any], loss: Any, clipped: Any, start: Any
) -> None:
    """Refuse what is no scene, view, constraint or choice."""
    if not views:
        raise ValueError("fit needs at least one view; got none. Give a View for each photograph.")
    check_kind("scene", scene, Scene, "Scene(Object(Sphere()), PointLight((2, 3, 4)))")
    for i, view in enumerate(views):
        check_kind(f"views[{i}]", view, View, "View(image, camera)")
    check((scene, tuple(views)))
    for i, constraint in enumerate(constraints):
        if not isinstance(constraint, Grey | Proportional):
            raise TypeError(
                f"constraints[{i}] must be a Grey or a Proportional; got {constraint!r}. Give for example Grey('k_s')."
            )
    for name, value, choices in (
        ("loss", loss, tuple(LOSSES)),
        ("clipped", clipped, CLIPPED),
        ("start", start, ("search", "scene")),
    ):
        if value not in choices:
            listed = ", ".join(f"'{choice}'" for choice in choices)
            raise ValueError(f"{name} must be one of {listed}; got {value!r}. Give one of them.")
    known = [view.noise is not None for view in views]
    if any(known) and not all(known):
        raise ValueError(
            f"views[{known.index(False)}] has no noise while views[{known.index(True)}] has. Give all of them or none."
        )
    if clipped == "tobit" and not all(known):
        raise ValueError("clipped='tobit' needs the noise of every view; views[0] has none. Give View.noise.")


def _numpy(leaf: object) -> np.ndarray:
    array = np.asarray(leaf)
    return array if array.dtype == bool else array.astype(np.float64)

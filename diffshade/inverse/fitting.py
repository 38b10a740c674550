"""Fitting: photographs in, the scene's unknown numbers out, with what is and is not known about them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import ArrayLike, Float

from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64, check, check_kind, refuse_traced
from ..core.progress import showing
from ..model.scenes import Scene
from ..parallel.threads import ONE_BLAS_THREAD
from .data.view_sets import ViewSet
from .data.views import View
from .forward.features import MOST_LIGHTS
from .forward.losses import LOSSES
from .misfit.noise_tests import leftovers, whiteness
from .problem import FitProblem, fit_problem, moves_surface
from .result import Fit
from .solving import solve
from .summary import summarise
from .unknowns.constraints import Grey, Proportional
from .unknowns.light_priors import stated_errors
from .unknowns.parameters import find_unknowns
from .unknowns.unknown import Unknown
from .verdicts.contradictions import check_priors
from .verdicts.known_lights import widen_by_lights
from .verdicts.outlines import check_outlines
from .verdicts.residuals import allow_for_faults
from .verdicts.stability import allow_for_omissions

DERIVATIVES = "Fit outside; for derivatives, call ds.sensitivity(fit, name) or ds.image_sensitivity(fit, view)."
CLIPPED = ("hinge", "tobit", "exclude")
MEMORY = 4e9  # bytes that the pixels of a fit may take laid out


def fit(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    constraints: Sequence[Grey | Proportional] | Grey | Proportional = (),
    priors: Mapping[str, Sequence[Any]] | None = None,
    light_error: Float[ArrayLike, " lights"] | float | None = None,
    intensity_error: Float[ArrayLike, " lights"] | float | None = None,
    loss: str | None = None,
    clipped: str = "hinge",
    start: str = "search",
    memory: float | int = MEMORY,
    devices: Mesh | None = None,
    progress: bool = False,
) -> Fit:
    r"""Fit the free numbers of a scene to photographs, by least squares over every pixel that shows an object.

    $$ \min \sum \rho(exposure \cdot radiance + black - image) $$

    The sum is over the samples of all views; rho is the square unless another `loss` is given. The solver is
    Levenberg-Marquardt on J^T J (Marquardt 1963) within bounds, in float64 whatever the global flag. It needs no start
    values: k_a, k_d and k_s are solved for exactly, n_s (as log n_s) is searched for, and attenuation begins at none;
    the scene's values of these are ignored. Geometry (a light's position or direction, a spot's shape, a sphere) is
    searched for near the scene's values. Lights that each have views of their own, from eight on, are searched for all
    at once: they begin where the scene has them, and at the end a light whose views cost twice as much as the others'
    is tried at places all around.

    A fit checks itself. If its residuals are not noise, a note names what explains them, such as a light that is off, a
    gamma or dust, and the errors contain what it may have moved; a value lost in that is not determined. Where they
    name no cause, and the views disagree or samples are clipped, it is repeated without the saturated pixels and
    without the brightest half of the highlight. The errors then contain how far a number moves, if these samples
    contradict its old value; one that moves by 30 % is not determined. If views without a mask show a dark background
    inside the scene's silhouette, nothing is determined. A prior is reported if it is four standard deviations from the
    value that the images alone give, and values that it moves by two errors are not determined. If the images of
    integer files have less noise than a step, the steps are found from the values, and the effect of rounding is added
    to the errors (`Fit.rounding`).

    Cameras, and renderers with several rays a pixel, average over pixels. Where the background beside the objects shows
    that, the pixels along edges are left out (`Fit.counts.mixed`), and the errors contain what averages change in the
    others. Lazy images are not looked at for this, nor compared with the silhouette.

    Args:
        scene: The scene. Its values of free parameters matter only if the search begins at them (see above).
        views: The photographs; one or several.
        free: Names of the parameters to fit. A name is any run of whole segments of a dotted path: `"k_d"`,
            `"lights.0.intensity"`, `"attenuation"` (which frees `linear` and `quadratic`; `constant`, the gauge, only
            by its own name), `"exposure"` and `"black"` of each view, `"views.0.exposure"`. A direction is fitted as a
            unit vector.
        tied: Names. Free numbers with the same path from the name on are one unknown: `"attenuation"` is then one for
            all lamps.
        bounds: Name to (lower, upper). A name may end in a channel, as the table prints it: `"k_d.r"`, `"position.x"`.
            By default coefficients, intensities and attenuation are at least 0, and n_s is in [0.1, 1e4].
        constraints: `Grey` and `Proportional`.
        priors: Name to (value, standard deviation), Gaussian; the value may be a colour or vector. For n_s the
            deviation is that of log n_s.
        light_error: Standard deviation of the scene's directions to the lights about each axis, degrees: one number, or
            one for each light. Free directions and positions then have that prior, and begin at the scene's values;
            of known ones it is part of the errors. By default nothing is stated: free ones have no prior, and known
            ones are taken to be exact.
        intensity_error: Relative standard deviation of the lights' intensities (.05 for 5 %): one number, or one for
            each light. As `light_error`, for intensities; the prior is of their logarithm.
        loss: `"squares"`, the default; or, for outliers, `"huber"`, `"cauchy"` or `"geman-mcclure"`, whose scale is
            found from the residuals' median unless the views' noise is known.
        clipped: How a sample at an end of the sensor's range counts. `"hinge"`: by a one-sided residual, since the true
            value is there or beyond. `"tobit"`: by the censored likelihood, which needs the views' noise; only this has
            no bias if many samples lie within the noise of the sensor's floor. `"exclude"`: its pixel is excluded.
        start: `"search"`, or `"scene"` to begin at the scene's values.
        memory: Bytes that the pixels may take, about 100 each; default 4e9. Of more pixels only a part is fitted: each
            view has its share, evenly spread over the image and over brightness, and a note says what that costs. Lazy
            images (`open_image`) are never whole in memory.
        devices: A `jax.sharding.Mesh` of the devices that share the pixels; by default one device has all.
        progress: Whether to show a line on the terminal.

    Returns:
        The fit; print it for the table of values and errors.

    Raises:
        ValueError: One sentence that names the view, pixel or parameter, and the remedy.
        TypeError: As ValueError, for arguments of another type.
        FloatingPointError: Where the scene gives no finite image.
        RuntimeError: Where this jaxlib adds up wrongly.
    """
    loss = "squares" if loss is None else loss
    views, constraints = checked(scene, views, constraints, loss, clipped, start)
    check_scale(memory, devices)
    shared_by = [] if devices is None else own_devices(devices)
    check_backend()
    with (
        showing("fit", show=progress) as report_progress,
        in_float64((jax.tree.map(as_float64, scene), views)) as (scene, views),
        ONE_BLAS_THREAD,
    ):
        data = ViewSet.of(scene, views)
        unknowns = find_unknowns(
            scene,
            data.views,
            free,
            tied,
            bounds,
            constraints,
            priors,
            light_error,
            intensity_error,
            from_scene=start == "scene",
            grey=bool(data.grey),
        )
        report_progress("reading the views")
        problem = new_problem(scene, data, unknowns, loss, clipped, memory=memory)
        laid, end = solve(problem, from_scene=start == "scene", devices=shared_by, report_progress=report_progress)
        found, residuals = summarise(laid, end), whiteness(leftovers(laid, end.theta))
        del laid
        of_lights = stated_errors(found.scene, light_error, intensity_error)
        for judge in (
            check_outlines,
            check_priors,
            partial(widen_by_lights, errors=of_lights),
            partial(allow_for_faults, residuals=residuals),
            allow_for_omissions,
        ):
            found = judge(found, report_progress)
        return found


def new_problem(
    scene: Scene,
    data: ViewSet,
    unknowns: Sequence[Unknown],
    loss: str,
    clipped: str,
    *,
    memory: float = np.inf,
    forecast: bool = False,
) -> FitProblem:
    """Return the problem of a fit to views of which no samples are chosen yet.

    Args:
        scene: The scene.
        data: The photographs.
        unknowns: What is to be found.
        loss: "squares", "huber", "cauchy" or "geman-mcclure".
        clipped: What samples at an end of the sensor's range say; "exclude" leaves their pixels out.
        memory: Bytes that the pixels may take.
        forecast: Whether the photographs are still to be taken, so that equal ones are no repetition.

    Raises:
        ValueError: The views leave too little to fit to.
    """
    # samples and weights, and what lights do there
    numbers = 2 * len(scene.channels) + 4 * min(max(map(len, data.lit)), MOST_LIGHTS)
    at_most, moving = memory / (8 * numbers), moves_surface(unknowns)
    data = data.sampled(scene, clipped, len(unknowns), at_most, moving=moving, forecast=forecast)
    return fit_problem(scene, data, unknowns, loss)


def own_devices(mesh: Mesh) -> list[Any]:
    """Return the devices of a mesh; refuse one with devices of other processes."""
    devices = list(mesh.devices.flat)
    if any(device.process_index != jax.process_index() for device in devices):
        raise ValueError(
            "a fit runs in one process, but devices has some of other processes. Make it of jax.local_devices()."
        )
    return devices


def checked(
    scene: Any, views: Any, constraints: Any, loss: Any = "squares", clipped: Any = "hinge", start: Any = "search"
) -> tuple[tuple[View, ...], tuple[Grey | Proportional, ...]]:
    """Return one view or several, and constraints, as tuples; refuse a wrong type, and choices that do not exist."""
    check_kind("scene", scene, Scene, "Scene(Object(Sphere()), PointLight((2, 3, 4)))")
    if not isinstance(views, View | Iterable):
        raise TypeError(f"views must be a View, or several; got {views!r}. Give for example [View(image, camera)].")
    views = (views,) if isinstance(views, View) else tuple(views)
    constraints = (constraints,) if isinstance(constraints, Grey | Proportional | str) else tuple(constraints)
    if not views:
        raise ValueError("fit needs at least one view; got none. Give a View for each photograph.")
    for i, view in enumerate(views):
        check_kind(f"views[{i}]", view, View, "View(image, camera)")
    refuse_traced("a fit", DERIVATIVES, scene=scene, views=tuple(views))
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
    others = [i for i, view in enumerate(views) if not eqx.tree_equal(view.camera, views[0].camera)]
    mapped = [f"objects[{i}].material.{name}" for i, item in enumerate(scene.objects) for name in item.material.maps]
    if others and mapped:
        raise ValueError(
            f"{mapped[0]} is over the pixels of one camera, but views[0] and views[{others[0]}] have different ones. "
            "Give a Texture, which belongs to the surface, or the views of one camera."
        )
    if clipped == "tobit" and views[0].noise is None:
        raise ValueError("clipped='tobit' needs the noise of every view; views[0] has none. Give View.noise.")
    return views, constraints


def check_scale(memory: Any, devices: Any) -> None:
    """Refuse a memory size or devices of a wrong type or value."""
    if isinstance(memory, bool) or not isinstance(memory, int | float | np.number) or not memory > 0:
        raise ValueError(f"memory must be a number of bytes above 0; got {memory!r}. Give for example 4e9.")
    if devices is not None:
        check_kind("devices", devices, Mesh, "jax.sharding.Mesh(jax.devices(), ('devices',))")

"""Checks: what a fit of texels cannot handle is refused, in one sentence with the remedy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import ArrayLike, Int

from ..core.fields import check, check_kind, refuse_traced
from ..core.words import did_you_mean
from ..inverse.data.view_sets import ViewSet
from ..inverse.data.views import View, is_grey, lights_on
from ..inverse.forward.losses import LOSSES
from ..inverse.unknowns.light_priors import error_of_each
from ..model.bands import refuse_bands
from ..model.fresnel import NoFresnel
from ..model.lobes import EXPONENT_RANGE, AbstractPowerLobe
from ..model.rendering import select
from ..model.scenes import Scene, check_positions, check_shapes
from .lighting import LightErrors
from .prediction import COEFFICIENTS

FREE = (*COEFFICIENTS, "n_s", "normal")


def checked(
    scene: Scene, views: Sequence[View], free: Iterable[str], regions: Int[np.ndarray, "h w"] | None, loss: str | None
) -> tuple[str, ...]:
    """Raise ValueError or TypeError for arguments of `fit_texels` that are wrong; return the free names in order."""
    if len(views) < 2:
        raise ValueError(f"fit_texels needs at least two views; got {len(views)}. Give a View for each photograph.")
    check_kind("scene", scene, Scene, "Scene(Object(Sphere()), PointLight((2, 3, 4)))")
    for i, view in enumerate(views):
        check_kind(f"views[{i}]", view, View, "View(image, camera)")
    refuse_traced("a fit", "Fit outside.", scene=scene, views=tuple(views))
    check((scene, tuple(views)))
    refuse_bands(
        "a fit of texels",
        scene.bands,
        "Fit three of them at a time as a scene of three, or each from grey photographs.",
    )
    ViewSet.of(scene, views)  # refuses views of more channels, and noise of some
    free = _checked_names(free)
    if loss is not None and (not isinstance(loss, str) or loss not in LOSSES):
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}; got {loss!r}. Give one of them.")
    _check_scene(scene, free)
    _check_views(scene, views, free)
    if regions is not None:
        _check_regions(np.asarray(regions), views[0].camera.shape, free)
    return free


def checked_light_error(
    light_error: ArrayLike, scene: Scene, views: Sequence[View], free: tuple[str, ...], loss: str | None
) -> LightErrors:
    """Return how well the light of each view is known, its brightness exactly; raise ValueError for a wrong error."""
    of_light = error_of_each("light_error", light_error, len(scene.lights), "1.0")
    of_view = np.array([of_light[list(lights_on(scene, view))].max(initial=0.0) for view in views])
    if set(free) != {"k_d", "k_s", "n_s", "normal"} or loss == "squares":
        raise ValueError(
            f"light_error needs k_d, k_s, n_s and normal free alone, and a robust loss; got free={free}, "
            f"loss={loss!r}. Free them, or leave light_error out."
        )
    return LightErrors.within(np.deg2rad(of_view))


def _checked_names(free: Iterable[str]) -> tuple[str, ...]:
    """Return the free names in their order; raise ValueError for others."""
    free = (free,) if isinstance(free, str) else tuple(free)
    for name in free:
        if name not in FREE:
            hint = did_you_mean(str(name), FREE)
            raise ValueError(f"free must hold names of maps; got {name!r}. {hint}")
    if not free:
        raise ValueError("free must name at least one map; got none. Give for example free=('k_d', 'k_s', 'n_s').")
    return tuple(name for name in FREE if name in free)


def _check_regions(regions: np.ndarray, shape: tuple[int, int], free: tuple[str, ...]) -> None:
    """Raise ValueError for regions without a free n_s, or of a wrong shape or type."""
    if "n_s" not in free:
        raise ValueError("regions share n_s, which is not free. Add 'n_s' to free, or leave regions out.")
    if regions.shape != shape or not np.issubdtype(regions.dtype, np.integer) or regions.min() < 0:
        raise ValueError(
            f"regions must be whole numbers from 0 of the camera's shape {shape}; got {regions.dtype} of shape "
            f"{regions.shape}. Give np.zeros(shape, int) for one n_s."
        )


def _check_scene(scene: Scene, free: tuple[str, ...]) -> None:
    """Raise ValueError for a scene that is more than reflection by one object."""
    if len(scene.objects) != 1:
        raise ValueError(
            f"fit_texels needs a scene of one object; got {len(scene.objects)}. Remove the others and mask them out."
        )
    material = scene.objects[0].material
    for wrong, what, remedy in (
        (scene.atmosphere is not None, "an atmosphere", "Leave it out."),
        (material.k_t is not None, "k_t, a transparent material", "Leave it out."),
        (not isinstance(material.fresnel, NoFresnel), f"fresnel={material.fresnel!r}", "Leave it out."),
        (bool(material.patterns), "a pattern among the coefficients", "Give plain colours."),
        (bool(material.maps), "coefficients over the pixels", "Give plain colours: they are fitted at every texel."),
        (np.ndim(material.n_s) > 0, "an n_s for each channel", "Give one n_s."),
        (bool(material.highlights), "several highlights", "Give one, by k_s and n_s."),
        (
            not isinstance(material.lobe, AbstractPowerLobe),
            f"the lobe {type(material.lobe).__name__}, whose highlight is not the power of a cosine",
            "Give Phong() or Blinn(), or derive the lobe from AbstractPowerLobe.",
        ),
        (not scene.lights, "a scene without lights", "Give the lights of the photographs."),
        (scene.shadows, "shadows=True", "Give shadows=False, or use ds.fit."),
    ):
        if wrong:
            raise ValueError(f"fit_texels does not support {what}. {remedy}")
    for name, needed in (("n_s", "k_s"), ("normal", "k_d")):
        if name in free and needed not in free and not np.any(getattr(material, needed)):
            raise ValueError(f"{name} is free, but {needed} is neither free nor above 0. Add {needed!r} to free.")
    if material.n_s < EXPONENT_RANGE[0] and "n_s" not in free and ("k_s" in free or np.any(material.k_s)):
        raise ValueError(
            f"Material.n_s must be at least {EXPONENT_RANGE[0]} in a fit of texels; got {material.n_s}. Raise it."
        )
    if "k_a" in free and not np.all(scene.ambient > 0):
        raise ValueError(f"k_a is free, but scene.ambient is {scene.ambient}. Give the ambient light, above 0.")


def _check_views(scene: Scene, views: Sequence[View], free: tuple[str, ...]) -> None:
    """Raise ValueError for views that do not show each texel at one pixel, or that cannot be fitted together."""
    first = views[0]
    for i, view in enumerate(views):
        if not eqx.tree_equal(jax.tree.map(np.asarray, first.camera), jax.tree.map(np.asarray, view.camera)):
            raise ValueError(
                f"views[{i}] has another camera than views[0]: a texel must be at one pixel in all views. Give the "
                "views one camera, or use ds.fit."
            )
        if is_grey(view) != is_grey(first):
            raise ValueError(f"views[{i}] and views[0] must both be grey or both be colour. Convert one of them.")
        try:
            select(scene, view.lit)
        except ValueError as error:
            raise ValueError(f"views[{i}].{error}") from None
    material, lights = scene.objects[0].material, [np.ravel(getattr(light, "intensity", 1.0)) for light in scene.lights]
    for name in ("k_d", "k_s"):
        coloured = np.ptp(getattr(material, name)) > 0 and any(np.ptp(light) > 0 for light in lights)
        if is_grey(first) and name not in free and coloured:
            raise ValueError(
                f"grey photographs under coloured lights do not support a known {name} that is coloured; got "
                f"{getattr(material, name)}. Give it one number, or add it to free."
            )
    for i, light in enumerate(scene.lights):
        if not light.has_one_colour:
            raise ValueError(
                f"a fit of texels needs lights of one colour each; lights[{i}] has its own ambient or specular colour. "
                "Give its intensity alone, or use ds.fit."
            )
    check_shapes(scene, first.camera)
    check_positions(scene, first.camera)


def check_anything_left(status: np.ndarray) -> None:
    """Raise ValueError if no pixel was fitted."""
    if not np.any(status):
        raise ValueError(
            "no pixel is left to fit: the masks, alpha channels and the object's silhouette have none in common. "
            "Check the camera, and that the masks are white on the object."
        )

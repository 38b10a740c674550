"""Prediction bands: where the samples of photographs not yet seen lie, by fits that leave groups of photographs out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ..core.backend import in_float64
from ..core.progress import showing
from ..core.words import count
from ..inverse.data.views import View, is_grey
from ..inverse.result import Fit, Prediction
from ..model.rendering import intersect, select
from ..model.scenes import Scene
from ..texels.maps import TexelMaps
from ..texels.unexplained import Unexplained
from .residual_quantiles import ResidualQuantiles, residual_quantiles

FEWEST = 8  # photographs under different lights
LEVELS = (0.5, 0.95)


@dataclass(frozen=True, eq=False)
class PredictionBands:
    """A fit, and bands that hold the samples of photographs that it has not seen, from `fit_bands`."""

    result: Fit | TexelMaps
    """The fit to all photographs."""
    level: float
    """The share of the samples that the bands are made to hold."""
    groups: tuple[tuple[int, ...], ...]
    """The views that were left out together, as indices."""
    refits: tuple[Fit | TexelMaps, ...]
    """The fit without each group."""
    inside: Bool[np.ndarray, "h w"]
    """Pixels that a photograph shows the object at."""
    residuals: ResidualQuantiles
    """How far photographs lie from the fits without their group, at those pixels."""

    def predict(self, view: View) -> Prediction:
        """Return a photograph beside the prediction of all photographs, with the band of each sample.

        Args:
            view: A photograph by the camera of the fit, under lights of its scene.

        Returns:
            The prediction with `lower` and `upper`, in the photograph's units.

        Raises:
            ValueError: The view has another shape than the fitted ones, or its `lit` is not an index of a light.
        """
        found = self.result.predict(view)
        shape = (*self.inside.shape, self.residuals.scale.shape[1])
        if found.image.shape != shape:
            raise ValueError(
                f"the view must have the shape of the fitted ones, {shape}; got {found.image.shape}. Give a photograph "
                "by their camera."
            )
        without = np.array([_radiance(refit.predict(view).image, view)[self.inside] for refit in self.refits])
        ends = self.residuals.band(without, self.level)
        lower, upper = (_put(found.image, self.inside, float(view.exposure) * end + float(view.black)) for end in ends)
        return dataclasses.replace(found, lower=lower, upper=upper, counts=found.counts & self.inside[..., None])

    def coverage(self, views: Sequence[View] | View) -> Float[np.ndarray, " views"]:
        """Return the share of the samples of each photograph, such as ones left out of the fit, that their bands hold.

        Args:
            views: Photographs by the camera of the fit, under lights of its scene.

        Returns:
            One number from 0 to 1 for each view; NaN where none of its samples counts.
        """
        views = (views,) if isinstance(views, View) else views
        return np.array([self.predict(view).coverage for view in views])

    def __str__(self) -> str:
        """Return what the bands come from, in one sentence."""
        number = sum(map(len, self.groups))
        return (
            f"bands for {self.level:.0%} of the samples of a photograph not seen, from {count(number, 'photograph')} "
            f"left out in {len(self.groups)} groups"
        )


def fit_bands(
    fit: Callable[[Sequence[View]], Fit | TexelMaps],
    views: Sequence[View],
    *,
    level: float | int = 0.9,
    groups: int = 8,
    progress: bool = False,
) -> PredictionBands:
    r"""Fit photographs, and again without each of some groups of them: bands for photographs not yet seen.

    $$ lower = q_{(1 - level)/2}(\mu_{-k}(x) + s R_i), \quad upper = q_{(1 + level)/2}(\mu_{-k}(x) + s R_i) $$

    mu_{-k} is the prediction without group k, and R_i are the residuals of photographs from the fit without their
    group, divided by s, the size of a texel's residuals; q are quantiles of all these sums (jackknife+ and CV+; Barber,
    Candes, Ramdas and Tibshirani 2021; with photographs, whose samples share an error, as groups: Lee, Barber and
    Willett 2023). The residuals are those of predictions as bright, relative to the texel's median photograph: a
    highlight may miss by more than a matte sample, and upward by another amount than downward. So nothing is assumed of
    the noise, or of what the model leaves out. Each group is spread over all lights.

    The bands hold for further photographs like those fitted, under lights drawn from the same directions. They hold
    fewer samples where light comes from another side and new shadows fall. It takes `groups` further fits.

    Args:
        fit: What fits views, and returns a `Fit` or `TexelMaps`, such as
            `lambda views: ds.fit_texels(scene, views, free=free)`.
        views: The photographs, of one camera, under at least 8 different lights.
        level: Share of the samples that the bands shall hold, from 0.5 to 0.95.
        groups: How many groups are left out, at least 2; as many as there are different lights at most.
        progress: Show a line of progress on the terminal.

    Returns:
        The fit to all photographs (`result`), and what predicts photographs with bands.

    Raises:
        ValueError: There are too few lights, or several cameras, or `level` or `groups` is out of range.
        TypeError: `fit` returns neither a `Fit` nor `TexelMaps`.
    """
    views = tuple(views)
    if not LEVELS[0] <= level <= LEVELS[1]:
        raise ValueError(f"level must be from {LEVELS[0]} to {LEVELS[1]}; got {level!r}. Give for example 0.9.")
    if not (isinstance(groups, int | np.integer) and groups >= 2):
        raise ValueError(f"groups must be a whole number of at least 2; got {groups!r}. Give for example 8.")
    for i, view in enumerate(views):
        if not eqx.tree_equal(view.camera, views[0].camera) or is_grey(view) != is_grey(views[0]):
            raise ValueError(
                f"bands need views of one camera, all grey or all in colour; views[{i}] differs. Leave it out."
            )
    alike = _under_the_same_lights(views)
    if len(alike) < FEWEST:
        raise ValueError(
            f"bands need photographs under at least {FEWEST} different lights; got {len(alike)}. Add photographs."
        )
    with showing("bands", show=progress) as report_progress:
        report_progress("all photographs", 0.0)
        result = fit(views)
        if not isinstance(result, Fit | TexelMaps):
            raise TypeError(
                f"fit must return a Fit or TexelMaps; got {type(result).__name__}. Give for example lambda views: "
                "ds.fit(scene, views, free=('k_d',))."
            )
        scene = result.scene if isinstance(result, Fit) else result.as_scene()
        parts = spread_groups(scene, views, alike, groups)
        seen, predicted, refits = [], [], []
        for k, part in enumerate(parts):
            report_progress(f"without group {k + 1} of {len(parts)}", (k + 1) / (len(parts) + 1))
            refits.append(fit([view for i, view in enumerate(views) if i not in part]))
            for i in part:
                found = refits[-1].predict(views[i])
                seen.append(np.where(found.counts, _radiance(found.target, views[i]), np.nan))
                predicted.append(_radiance(found.image, views[i]))
    inside = np.any(np.isfinite(seen), axis=(0, -1))
    seen, predicted = (np.array([image[inside] for image in images]) for images in (seen, predicted))
    return PredictionBands(result, level, parts, tuple(refits), inside, residual_quantiles(seen, predicted))


def _radiance(image: Float[np.ndarray, "h w c"], view: View) -> Float[np.ndarray, "h w c"]:
    return (image - float(view.black)) / float(view.exposure)


def _put(
    image: Float[np.ndarray, "h w c"], where: Bool[np.ndarray, "h w"], samples: Float[np.ndarray, "n c"]
) -> Float[np.ndarray, "h w c"]:
    changed = image.copy()
    changed[where] = samples
    return changed


def spread_groups(
    scene: Scene, views: Sequence[View], alike: Sequence[Sequence[int]], groups: int
) -> tuple[tuple[int, ...], ...]:
    """Return views in groups, each of which is spread over the lights: neighbouring lights belong to different groups.

    Args:
        scene: The scene.
        views: The photographs.
        alike: Indices of the views under the same lights, which stay together.
        groups: How many groups there shall be at most.
    """
    toward = _toward(scene, [views[of[0]] for of in alike])

    def in_order(which: np.ndarray) -> list[int]:
        """Halves of halves, across where the directions differ most, so that neighbours follow one another."""
        if len(which) < 2:
            return which.tolist()
        across = np.argmax(np.ptp(toward[which], axis=0))
        ordered = which[np.argsort(toward[which, across], kind="stable")]
        return in_order(ordered[: len(which) // 2]) + in_order(ordered[len(which) // 2 :])

    ordered = in_order(np.arange(len(alike)))
    return tuple(tuple(sorted(i for j in ordered[k::groups] for i in alike[j])) for k in range(min(groups, len(alike))))


def _under_the_same_lights(views: Sequence[View]) -> list[list[int]]:
    found: dict[tuple[int, ...] | None, list[int]] = {}
    for i, view in enumerate(views):
        lit = None if view.lit is None else tuple(sorted(int(light) for light in np.ravel(view.lit)))
        found.setdefault(lit, []).append(i)
    return list(found.values())


def _toward(scene: Scene, views: Sequence[View]) -> Float[np.ndarray, "views 3"]:
    """Return the mean direction from the object to the lights of each view."""
    with in_float64((scene, views[0].camera)) as (scene, camera):
        buffer = intersect(scene, camera)
        inside = np.asarray(buffer.mask)
        return np.array(
            [
                sum((Unexplained.toward(l, buffer.position, inside)[0] for l in select(scene, view.lit)), np.zeros(3))
                for view in views
            ]
        )

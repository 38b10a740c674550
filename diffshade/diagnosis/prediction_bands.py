"""Prediction bands: where the samples of photographs not yet seen lie, by fits that leave groups of photographs out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ..core.backend import in_float64
from ..core.progress import showing
from ..core.thresholds import FEW, MINOR, MOST
from ..core.words import count
from ..inverse.data.recording import developed, linear
from ..inverse.data.views import View, is_grey
from ..inverse.result import Fit, Prediction
from ..inverse.unknowns.unknown import free_places
from ..model.cameras import AbstractCamera
from ..model.rendering import intersect
from ..model.scenes import Scene
from ..texels.maps import TexelMaps
from ..texels.unexplained import Unexplained
from .residual_quantiles import ResidualQuantiles, residual_quantiles

LEVELS = (MOST, 1.0 - MINOR)
NEIGHBOURS = 2  # lights whose mean angle from a new one is how far it is from those fitted
MIN_DISTANCE = 1.0  # degrees, below which lights are taken to be this far apart
NEAR = 1.3  # of that distance, up to which a fit without a group counts as one with all lights near the new one


@dataclass(frozen=True, eq=False)
class PredictionBands:
    """A fit, and bands that hold the samples of photographs that it has not seen, from `fit_bands`."""

    result: Fit | TexelMaps = field(repr=False)
    """The fit to all photographs."""
    level: float
    """The share of the samples that the bands are made to hold."""
    groups: tuple[tuple[int, ...], ...]
    """The views that were left out together, as indices."""
    refits: tuple[Fit | TexelMaps, ...] = field(repr=False)
    """The fit without each group."""
    inside: Bool[np.ndarray, "h w"] = field(repr=False)
    """Pixels that a photograph shows the object at."""
    lights: Float[np.ndarray, "lights 3"]
    """Unit vectors from the object to each light of the scene."""
    toward: Float[np.ndarray, "views 3"]
    """Unit vectors to the lights of the views."""
    residuals: ResidualQuantiles = field(repr=False)
    """How far photographs lie from the fits without their group, at those pixels."""

    @property
    def scene(self) -> Scene:
        """The scene of the fit."""
        return _scene_of(self.result)

    @property
    def source(self) -> str:
        """What the bands come from, in words: each photograph may be left out twice."""
        number = len({i for group in self.groups for i in group})
        return f"{count(number, 'photograph')} left out in {len(self.groups)} groups"

    def predict(self, view: View) -> Prediction:
        """Return a photograph beside the prediction of all photographs, with the band of each sample.

        Args:
            view: A photograph by the camera of the fit, under lights of its scene.

        Returns:
            The prediction with `lower` and `upper`, in linear light: without the photograph's sensor, if it has one or
            the fit found one, but with its exposure, black and blur.

        Raises:
            ValueError: The view has another shape than the fitted ones, or its `lit` is not an index of a light.
        """
        found = _predicted(self.result, view)
        shape = (*self.inside.shape, self.residuals.scale.shape[1])
        if found.image.shape != shape:
            raise ValueError(
                f"the view must have the shape of the fitted ones, {shape}; got {found.image.shape}. Give a photograph "
                "by their camera."
            )
        toward = _toward(self.lights, view)
        others = [self.toward[[i for i in range(len(self.toward)) if i not in group]] for group in self.groups]
        near = np.array([distance_to(toward, lights) for lights in others])
        distance = distance_to(toward, self.toward)
        useful = [refit for refit, d in zip(self.refits, near, strict=True) if d <= max(NEAR * distance, near.min())]
        without = np.array([_radiance(_predicted(refit, view).image, view)[self.inside] for refit in useful])
        ends = np.repeat(found.image[None], 2, 0)
        band = np.array(self.residuals.band(without, self.level, distance))
        ends[:, self.inside] = float(view.exposure) * band + float(view.black)
        counts = found.counts & self.inside[..., None]
        return dataclasses.replace(found, lower=ends[0], upper=ends[1], counts=counts)

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
        return f"bands for {self.level:.0%} of the samples of a photograph not seen, from {self.source}"


def fit_bands(
    fit: Callable[[Sequence[View]], Fit | TexelMaps],
    views: Sequence[View],
    *,
    level: float | int = 0.9,
    groups: int = 8,
    progress: bool = False,
) -> PredictionBands:
    r"""Fit photographs, and again without each of some groups of them: bands for photographs not yet seen.

    $$ lower = q_{(1 - level)/2}(m_k(x) + s R_i), \quad upper = q_{(1 + level)/2}(m_k(x) + s R_i) $$

    m_k is the prediction without group k, drawn towards the median of all of these, and R_i are the residuals of
    photographs from the fit without their group, divided by s, the size of a texel's residuals; q are quantiles of all
    these sums (after jackknife+ and CV+; Barber, Candes, Ramdas and Tibshirani 2021; with photographs, whose samples
    share an error, as groups: Lee, Barber and Willett 2023). The residuals are those of predictions as bright, relative
    to the texel's median photograph: a highlight may miss by more than a matte sample, and upward by another amount
    than downward. So nothing is assumed of the noise, or of what the model leaves out.

    Half of the groups are spread over all lights, and half are neighbouring lights, of 8 groups a quarter of all as
    seen from the object, so that every photograph is left out twice: with fitted lights near its own, and far from it.
    How its residuals grow in between is a power of that distance, for predictions as bright, by which R_i is that of
    photographs as far from the fitted lights as the new one. Where few photographs show predictions as bright,
    quantiles are as much wider as Student's t.

    The bands hold for further photographs like those fitted. They hold fewer samples where light comes from quite
    another side than in any of them. It takes `groups` further fits. Where the fit finds a sensor, that takes the place
    of the sensors of predicted views.

    Args:
        fit: What fits views, and returns a `Fit` or `TexelMaps`, such as
            `lambda views: ds.fit_texels(scene, views, free=free)`.
        views: The photographs, of one camera, under at least 8 different lights.
        level: Share of the samples that the bands shall hold, from 0.5 to 0.95.
        groups: How many groups are left out, at least 2; of fewer than 4 all are spread over the lights.
        progress: Show a line of progress on the terminal.

    Returns:
        The fit to all photographs (`result`), and what predicts photographs with bands.

    Raises:
        ValueError: There are too few lights, or several cameras, or `level` or `groups` is out of range, or the fit
            finds a sensor for each photograph.
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
    if len(alike) < FEW:
        raise ValueError(
            f"bands need photographs under at least {FEW} different lights; got {len(alike)}. Add photographs."
        )
    with showing("bands", show=progress) as report_progress:
        report_progress("all photographs", 0.0)
        result = fit(views)
        if not isinstance(result, Fit | TexelMaps):
            raise TypeError(
                f"fit must return a Fit or TexelMaps; got {type(result).__name__}. Give for example lambda views: "
                "ds.fit(scene, views, free=('k_d',))."
            )
        if isinstance(result, Fit) and _finds_sensor(result):
            sensors = [view.sensor for view in result.views]
            if not all(eqx.tree_equal(sensor, sensors[0]) for sensor in sensors):
                raise ValueError("bands need one sensor for all photographs; got one for each. Give tied=('sensor',).")
        lights = _to_lights(_scene_of(result), views[0].camera)
        toward = np.array([_toward(lights, view) for view in views])
        parts = groups_of(toward, alike, groups)
        seen, predicted, refits, left_out, distances = [], [], [], [], []
        for k, part in enumerate(parts):
            report_progress(f"without group {k + 1} of {len(parts)}", (k + 1) / (len(parts) + 1))
            others = [i for i in range(len(views)) if i not in part]
            refits.append(fit([views[i] for i in others]))
            for i in part:
                found = _predicted(refits[-1], views[i])
                seen.append(np.where(found.counts, _radiance(found.target, views[i]), np.nan))
                predicted.append(_radiance(found.image, views[i]))
                left_out.append(i)
                distances.append(distance_to(toward[i], toward[others]))
    inside = np.any(np.isfinite(seen), axis=(0, -1))
    seen, predicted = (np.array([image[inside] for image in images]) for images in (seen, predicted))
    residuals = residual_quantiles(seen, predicted, np.array(left_out), np.array(distances))
    return PredictionBands(result, level, parts, tuple(refits), inside, lights, toward, residuals)


def _scene_of(result: Fit | TexelMaps) -> Scene:
    return result.scene if isinstance(result, Fit) else result.as_scene()


def distance_to(toward: Float[np.ndarray, "3"], lights: Float[np.ndarray, "lights 3"]) -> float:
    """Return how far a light is from others, degrees: the mean angle from the nearest."""
    cosine = np.sort(lights @ toward)[::-1][:NEIGHBOURS]
    return max(float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))).mean()), MIN_DISTANCE)


def _radiance(image: Float[np.ndarray, "h w c"], view: View) -> Float[np.ndarray, "h w c"]:
    return (image - float(view.black)) / float(view.exposure)


def groups_of(
    toward: Float[np.ndarray, "views 3"], alike: Sequence[Sequence[int]], groups: int
) -> tuple[tuple[int, ...], ...]:
    """Return groups of views that are spread over the lights, and as many of neighbouring lights.

    Of 8 groups, neighbours are those of one quarter, as seen from the object, so that some lights are far from the
    others across as well as along a row: residuals grow otherwise in one direction than in the other. Of 4 groups they
    are halves.

    Args:
        toward: Unit vectors to the lights of the views.
        alike: Indices of the views under the same lights, which stay together.
        groups: How many groups there shall be at most; of fewer than 4, none is of neighbours.
    """
    each = toward[[of[0] for of in alike]]

    axes = np.argsort(-np.ptp(each, axis=0), kind="stable")[:2]

    def parts(which: np.ndarray, number: int, turn: int = 0) -> list[list[int]]:
        """Halves of halves, by turns along the two axes in which the directions differ most: neighbours follow."""
        if number < 2:
            return [which.tolist()]
        ordered, half = which[np.argsort(each[which, axes[turn]], kind="stable")], number // 2
        cut = len(which) * half // number
        return parts(ordered[:cut], half, 1 - turn) + parts(ordered[cut:], number - half, 1 - turn)

    every = np.arange(len(alike))
    ordered = [j for (j,) in parts(every, len(alike))]
    half = min(groups, len(alike)) // 2
    blocks = half if half > 1 else 0
    spread = min(groups - blocks, len(alike))
    of_lights = [ordered[k::spread] for k in range(spread)] + (parts(every, blocks) if blocks else [])
    return tuple(tuple(sorted(i for j in lights for i in alike[j])) for lights in of_lights)


def _under_the_same_lights(views: Sequence[View]) -> list[list[int]]:
    lit = [None if view.lit is None else tuple(sorted(view.lit)) for view in views]
    return [[i for i, own in enumerate(lit) if own == one] for one in dict.fromkeys(lit)]


def _to_lights(scene: Scene, camera: AbstractCamera) -> Float[np.ndarray, "lights 3"]:
    with in_float64((scene, camera)) as (scene, camera):
        buffer = intersect(scene, camera)
        inside = np.asarray(buffer.mask)
        return np.array([Unexplained.toward(light, buffer.position, inside)[0] for light in scene.lights])


def _toward(lights: Float[np.ndarray, "lights 3"], view: View) -> Float[np.ndarray, "3"]:
    """Return the mean direction from the object to the lights of a view, of length 1."""
    found = (lights if view.lit is None else lights[list(view.lit)]).sum(0)
    return found / max(float(np.linalg.norm(found)), 1e-12)


def _predicted(result: Fit | TexelMaps, view: View) -> Prediction:
    """Return a photograph and its prediction in linear light, through the sensor that the fit found, if it did."""
    if isinstance(result, TexelMaps):
        return result.predict(view)
    if _finds_sensor(result):
        view = dataclasses.replace(view, sensor=result.views[0].sensor)
    found = result.predict(view)
    target = np.asarray(developed(dataclasses.replace(view, image=found.target)).image)
    return dataclasses.replace(found, target=target, image=linear(found.image, view))


def _finds_sensor(fit: Fit) -> bool:
    return any(place.part == "sensor" for place in free_places(fit.unknowns))

"""Running: the samples of all views looked at, and one minimum found over them, in memory."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from ..core.progress import Tell, silent
from ..model.scenes import Scene
from .data.views import Samples, View, find_samples, is_grey, lights_on, repeats
from .forward.features import MOST_LIGHTS
from .forward.residuals import Counts
from .problem import Study
from .result import Fit, diagnose
from .unknowns.parameters import Unknown


def look_at(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], clipped: str, *, foreseen: bool = False
) -> tuple[list[Samples], Counts]:
    """Find the samples of every view; raise ValueError that names the view, or says that there are too few.

    A view that is an earlier one again has none; `foreseen` says that the photographs are still to be taken.
    """
    moving = moves_surface(unknowns)
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
    pixels = [len(s.pixels) for s in samples]
    kept, left = (0, clipping) if clipped == "leave out" else (clipping, 0)
    counts = counted(views, len(views) - len(again), pixels, kept, left)
    check_enough(counts, unknowns, [s.brightest for s in samples])
    return samples, counts


def counted(views: Sequence[View], taken: int, pixels: Sequence[int], clipped: int, left_out: int) -> Counts:
    """Return the counts of a fit, given the pixels of each view that count."""
    number = sum(n * (1 if is_grey(view) else 3) for n, view in zip(pixels, views, strict=True))
    return Counts(taken, sum(pixels), number, clipped, left_out)


def check_enough(counts: Counts, unknowns: Sequence[Unknown], brightest: Sequence[float]) -> None:
    """Refuse fewer pixels or samples than unknowns, and black images."""
    for noun, have in (("pixels", counts.pixels), ("samples that are not clipped", counts.samples - counts.clipped)):
        if have < len(unknowns):
            raise ValueError(
                f"these views have fewer {noun} than there are unknowns, {have} for {len(unknowns)}. Free fewer "
                "parameters or add views."
            )
    if all(most <= 0.0 for most in brightest):
        raise ValueError("the images are black: no pixel that shows an object is above 0. Check the files and masks.")


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
    tell: Tell = silent,
) -> Fit:
    """Find the minimum for these unknowns over these samples, and say what is known there. In float64."""
    study = Study(scene, views, unknowns, samples, counts, loss, clipped)
    study.lay_out()
    end = study.solve(from_scene=from_scene, tell=tell)
    return diagnose(scene, views, unknowns, study.likelihood, clipped, end, *study.evidence(end), counts, study.squares)


def laid_bytes(scene: Scene, views: Sequence[View], pixels: int | None = None) -> float:
    """Return about how many bytes pixels take laid out, by default all of the views: samples, and numbers a light."""
    pixels = sum(view.image.shape[0] * view.image.shape[1] for view in views) if pixels is None else pixels
    lights = max(len(lights_on(scene, view)) for view in views)
    return 8.0 * pixels * (6 + 4 * min(lights, MOST_LIGHTS))


def moves_surface(unknowns: Sequence[Unknown]) -> bool:
    """Whether a surface is free."""
    return any("surface" in path.split(".") for unknown in unknowns for path, _ in unknown.places)

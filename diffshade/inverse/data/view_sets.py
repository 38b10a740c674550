"""View sets: the views of a scene, and of a fit the samples that count: found once, and asked by all that follows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Int

from ...core.fields import is_concrete
from ...core.masks import Mask
from ...core.words import count
from ...io.lazy_images import row_tiles
from ...model.scenes import Scene
from .mixed_pixels import Edges
from .samples import MIN_PIXELS, Samples, find_samples, share_of
from .views import View, camera_key, is_grey, lights_on

Masks = Sequence[Mask | None]
"""For each view the pixels to keep; None keeps all."""


class Counts(eqx.Module):
    """How many pixels and samples (channels of pixels) a fit looks at."""

    views: int = 0
    pixels: int = 0
    samples: int = 0
    clipped: int = 0
    """Samples at an end of the sensor's range, which say only that the truth is beyond it."""
    left_out: int = 0
    """Samples at an end of the sensor's range that were left out, with their pixels."""
    mixed: int = 0
    """Pixels along edges that were left out, since the photographs mix there what is on both sides."""
    repeats: tuple[tuple[int, int], ...] = ()
    """Pairs of a view that repeats an earlier one, and that earlier view; the two are counted once."""
    beyond_memory: int = 0
    """Pixels that were not looked at, since they did not fit into memory."""


@dataclass(frozen=True, eq=False)
class ViewSet:
    """The views of a scene, what they share, and in a fit the samples of each that count."""

    views: tuple[View, ...]
    """With their channels taken as the scene's."""
    lit: tuple[tuple[int, ...], ...]
    """The lights that are on in each."""
    clipped: str = "hinge"
    """What samples at an end of the sensor's range say: "hinge", "tobit", or "exclude", by which they are left out."""
    samples: tuple[Samples, ...] = ()
    """Those of each view that count; none of a view that repeats an earlier one."""
    counts: Counts = dataclasses.field(default_factory=Counts)

    @classmethod
    def of(cls, scene: Scene, views: Sequence[View]) -> ViewSet:
        """Return the views of a scene; refuse views of other channels, or noise of some alone, by their number.

        In a scene of red, green and blue a view may be grey, and its last channel alpha; in one of other bands it has a
        channel for each band.
        """
        for i, view in enumerate(views):
            _check_channels(scene, view, f"views[{i}]")
        known = [view.noise is not None for view in views]
        if any(known) and not all(known):
            without, with_it = known.index(False), known.index(True)
            raise ValueError(f"views[{without}] has no noise, but views[{with_it}] has. Give noise for all or none.")
        if len(scene.channels) != 3:
            views = [dataclasses.replace(view, bands=True) for view in views]
        return cls(tuple(views), tuple(lights_on(scene, view) for view in views))

    @cached_property
    def cameras(self) -> list[tuple[Any, ...]]:
        """A key of each view's camera, the same for equal cameras."""
        return [camera_key(view.camera) for view in self.views]

    @cached_property
    def setups(self) -> list[list[int]]:
        """The views grouped by setup, one camera under the same lights: the model is wrong in the same way there."""
        groups: dict[Any, list[int]] = {}
        for i, setup in enumerate(zip(map(frozenset, self.lit), self.cameras, strict=True)):
            groups.setdefault(setup, []).append(i)
        return list(groups.values())

    @cached_property
    def repeats(self) -> dict[int, int]:
        """The views that repeat an earlier one (image, mask and setup), each with the index of the earlier one."""
        found: dict[int, int] = {}
        for group in self.setups:
            for k, i in enumerate(group):
                if (first := next((j for j in group[:k] if _repeats(self.views[i], self.views[j])), None)) is not None:
                    found[i] = first
        return found

    @cached_property
    def grey(self) -> bool | None:
        """Whether the views are grey; None where some are."""
        kinds = {is_grey(view) for view in self.views}
        return None if len(kinds) > 1 else kinds.pop()

    @property
    def noise_known(self) -> bool:
        """Whether the noise of the views is given; it is given for all or for none."""
        return self.views[0].noise is not None

    @cached_property
    def homoscedastic(self) -> bool:
        """Whether the noise is the same at every level of a view."""
        return all(view.noise is None or view.noise.is_uniform for view in self.views)

    @property
    def pixels(self) -> list[int]:
        """How many pixels of each view count."""
        return [len(s.pixels) for s in self.samples]

    def sampled(
        self, scene: Scene, clipped: str, unknowns: int, at_most: float, *, moving: bool, forecast: bool
    ) -> ViewSet:
        """Find the samples of every view; raise ValueError that names the view, or says that there are too few.

        Args:
            scene: The scene, whose objects the pixels must show.
            clipped: What samples at an end of the sensor's range say; "exclude" leaves their pixels out.
            unknowns: How many numbers are to be found, which there must be as many samples for.
            moving: Whether a surface is free, which takes a mask.
            at_most: The most pixels of all views; of more, each view has its share.
            forecast: Whether the photographs are still to be taken, so that equal ones are no repetition.
        """
        samples, left_out, mixed, repeats = [], 0, 0, {} if forecast else self.repeats
        edges: dict[Any, Edges] = {}
        shown: dict[Any, list[Int[np.ndarray, " n"]]] = {}
        for i, (view, camera) in enumerate(zip(self.views, self.cameras, strict=True)):
            try:
                found = find_samples(scene, view, moving=moving, edges=edges)
            except ValueError as error:
                raise ValueError(f"views[{i}]: {error}") from None
            if i in repeats:  # the same numbers tell nothing more
                found = found.at(found.pixels[:0])
            else:
                mixed += int(np.count_nonzero(found.inside)) - len(found.pixels)
            if clipped == "exclude" and (ends := found.ends()).any():
                left_out += int(np.abs(ends).sum())
                found = found.at(found.pixels[~ends.any(-1)])
            alike = shown.setdefault((camera, len(found.pixels)), [])
            same = next((pixels for pixels in alike if np.array_equal(pixels, found.pixels)), found.pixels)
            alike.append(same)
            samples.append(found.at(same))
        counts = Counts(left_out=left_out, mixed=mixed, repeats=tuple(repeats.items()))
        whole = dataclasses.replace(self, samples=tuple(samples), clipped=clipped, counts=counts)
        found = whole.part(at_most)
        beyond = sum(whole.pixels) - found.counts.pixels
        _check_enough(found, unknowns)
        return dataclasses.replace(found, counts=dataclasses.replace(found.counts, beyond_memory=beyond))

    def part(self, at_most: float) -> ViewSet:
        """Return the views with so many pixels at most in all, of which each has its share, and some at least."""
        share = min(at_most / max(sum(self.pixels), 1), 1.0)
        return self.with_samples([share_of(s, max(int(len(s.pixels) * share), MIN_PIXELS)) for s in self.samples])

    def with_samples(self, samples: Sequence[Samples]) -> ViewSet:
        """Return the views with other samples, counted anew."""
        counts = dataclasses.replace(
            self.counts,
            views=sum(len(s.pixels) > 0 for s in samples),
            pixels=sum(len(s.pixels) for s in samples),
            samples=sum(s.count for s in samples),
            clipped=sum(int(np.abs(s.ends()).sum()) for s in samples),
        )
        return dataclasses.replace(self, samples=tuple(samples), counts=counts)

    def keeping(self, masks: Masks) -> ViewSet:
        """Return the views with the samples of the pixels that masks keep."""
        samples = [
            s if mask is None else s.at(s.pixels[mask.reshape(-1)[s.pixels]])
            for s, mask in zip(self.samples, masks, strict=True)
        ]
        return self.with_samples(samples)


def _check_channels(scene: Scene, view: View, name: str) -> None:
    wanted, got, rgb = len(scene.channels), view.image.shape[2], len(scene.channels) == 3
    if got > 4 if rgb else got != wanted:
        has = "red, green and blue" if not scene.bands else f"{count(wanted, 'band')}, {', '.join(scene.bands)}"
        remedy = f"Give Scene(..., bands={got})" if rgb else "Give an image with a channel for each"
        raise ValueError(f"{name}.image has {count(got, 'channel')}, but the scene has {has}. {remedy}.")
    gains = () if view.sensor is None or not scene.bands else (view.sensor.red, view.sensor.blue)
    if is_concrete(*gains) and any(gain != 1.0 for gain in gains):
        raise ValueError(
            f"{name}.sensor has gains of red and blue, but the scene has {count(wanted, 'band')}. Leave them out, and "
            "give the gains of bands as the lights' intensities."
        )


def _check_enough(found: ViewSet, unknowns: int) -> None:
    """Refuse fewer pixels or samples than unknowns, and black images."""
    counts = found.counts
    for noun, have in (("pixels", counts.pixels), ("samples that are not clipped", counts.samples - counts.clipped)):
        if have < unknowns:
            raise ValueError(
                f"these views have fewer {noun} than there are unknowns, {have} for {unknowns}. Free fewer "
                "parameters or add views."
            )
    if all(s.brightest <= 0.0 for s in found.samples):
        raise ValueError("the images are black: no pixel that shows an object is above 0. Check the files and masks.")


def _repeats(one: View, other: View) -> bool:
    return _equal(one.mask, other.mask) and _equal(one.image, other.image)


def _equal(one: Any, other: Any) -> bool:
    """Whether two masks or images are equal; images are read by rows, as those larger than memory must be."""
    if one is other or one is None or other is None or one.shape != other.shape:
        return one is other
    return all(np.array_equal(one[first:last], other[first:last]) for first, last in row_tiles(*one.shape[:2]))

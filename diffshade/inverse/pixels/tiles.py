"""Tiles: the views of a fit read by rows, so that memory holds a few of them whatever the number of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...io.lazy_images import row_tiles, rows_of_a_tile
from ...model.rendering import silhouette_of_rows
from ...model.scenes import Scene
from ..data.samples import Samples, check_any, check_view, erode, extremes, sensor_range
from ..data.views import View, colours, has_alpha

LOOKED_AT = 1 << 25  # pixels at most that are read for a part of them, evenly spread


class Tile(NamedTuple):
    """Some rows of a view."""

    view: int
    first: int
    last: int


class Survey(NamedTuple):
    """What the views hold, summed tile by tile. A row has two counts where pixels at the sensor's ends are left out."""

    rows: Float[np.ndarray, "2 rows"]
    """For each row of all views the pixels that count: if the sensor's range ends where it may, and if it does not."""
    sums: Float[np.ndarray, "views 3"]
    """Pixels inside, samples at or above the level at which the sensor may clip, samples at or below its floor."""
    ends: Float[np.ndarray, "views 2"]
    """The smallest and the largest sample."""


class Tiles:
    """The views of a fit, by tiles of rows: which pixels count, and where they are, from one survey of all."""

    def __init__(self, scene: Scene, views: Sequence[View], again: Sequence[int], *, moving: bool, leave_out: bool):
        """Check the views; those that are an earlier one `again` have no tiles."""
        for i, view in enumerate(views):
            try:
                check_view(scene, view, moving=moving)
            except ValueError as error:
                raise ValueError(f"views[{i}]: {error}") from None
        self.scene, self.views, self.moving, self.leave_out = scene, views, moving, leave_out
        self.again = set(again)
        heights = [view.image.shape[0] for view in views]
        self.starts = np.concatenate([[0], np.cumsum(heights)])
        self.all = [
            Tile(i, *rows)
            for i, view in enumerate(views)
            if i not in self.again
            for rows in row_tiles(*view.image.shape[:2])
        ]
        self.longest = max(rows_of_a_tile(view.image.shape[1]) * view.image.shape[1] for view in views)
        self.ranges = [(-np.inf, np.inf)] * len(views)
        self.brightest = np.full(len(views), -np.inf)
        self.rows = np.zeros(self.starts[-1], np.int64)

    def read(self, tile: Tile) -> Float[np.ndarray, "r w c"]:
        """Read the rows of a tile, and where it takes them to erode the alpha channel, one above and one below."""
        view = self.views[tile.view]
        more = 1 if self.moving and has_alpha(view) else 0
        return np.asarray(view.image[max(tile.first - more, 0) : tile.last + more])

    def samples(self, tile: Tile, read: Float[np.ndarray, "r w c"]) -> Samples:
        """Return the samples of a tile that count."""
        floor, level = self.ranges[tile.view]
        inside, image = self._inside(tile, read)
        pixels = np.flatnonzero(inside) + tile.first * inside.shape[1]
        found = Samples(inside, pixels, image, floor, level, self.brightest[tile.view], tile.first)
        if self.leave_out and len(pixels):
            kept = pixels[~found.ends().any(-1)]
            found = Samples(inside, kept, image, floor, level, self.brightest[tile.view], tile.first)
        return found

    def _inside(self, tile: Tile, read: np.ndarray) -> tuple[Bool[np.ndarray, "r w"], Float[np.ndarray, "r w c"]]:
        """Return which pixels of a tile show an object, and its colours."""
        view, height = self.views[tile.view], self.views[tile.view].image.shape[0]
        alpha = has_alpha(view)
        above, below = (max(tile.first - 1, 0), min(tile.last + 1, height)) if self.moving else tile[1:]
        start = above if alpha else tile.first  # the first row that was read
        masks = [] if view.mask is None else [view.mask[above:below]]
        if alpha:
            masks.append(read[..., -1] >= 0.5)
        if not self.moving:
            masks.append(silhouette_of_rows(self.scene.objects, view.camera, tile.first, tile.last))
        inside = np.logical_and.reduce(masks)
        if self.moving:
            inside = erode(inside)[tile.first - above :][: tile.last - tile.first]
        image = read[tile.first - start :][: tile.last - tile.first]
        return np.asarray(inside), image[..., :-1] if alpha else image

    # The survey

    def nothing(self) -> Survey:
        """Return the survey of no tile."""
        views = len(self.views)
        ends = np.tile([np.inf, -np.inf], (views, 1))
        return Survey(np.zeros((2, self.starts[-1])), np.zeros((views, 3)), ends)

    def look(self, tile: Tile, read: Float[np.ndarray, "r w c"]) -> tuple[Tile, Survey]:
        """Return the survey of a tile, with its own rows alone; raise ValueError for a sample that is not finite."""
        view, rounded = self.views[tile.view], self.views[tile.view].image.dtype.type
        inside, image = self._inside(tile, read)
        width = inside.shape[1]
        pixels = np.flatnonzero(inside)
        rows = np.tile(inside.sum(1), (2, 1)).astype(float)
        if not len(pixels):
            return tile, Survey(rows, np.zeros(3), np.array([np.inf, -np.inf]))
        found = Samples(inside, pixels + tile.first * width, image, -np.inf, np.inf, 0.0, tile.first)
        try:
            ends = extremes(found)
        except ValueError as error:
            raise ValueError(f"views[{tile.view}]: {error}") from None
        level = 1.0 if view.saturation is None else float(rounded(view.saturation))
        floor = -np.inf if view.floor is None else float(rounded(view.floor))
        sums = np.array([len(pixels), 0, 0], float)
        if ends[1] >= level or ends[0] <= floor:
            values = found.values(found.pixels)
            top, bottom = values >= level, values <= floor
            sums[1:] = top.sum(), bottom.sum()
            if self.leave_out:
                for of, out in zip(rows, ((top | bottom).any(-1), bottom.any(-1)), strict=True):
                    of -= np.bincount(pixels[out] // width, minlength=len(of))
        return tile, Survey(rows, sums, np.array(ends))

    def add(self, survey: Survey, found: tuple[Tile, Survey]) -> Survey:
        """Add the survey of a tile."""
        tile, of_tile = found
        start = self.starts[tile.view]
        survey.rows[:, start + tile.first : start + tile.last] += of_tile.rows
        survey.sums[tile.view] += of_tile.sums
        low, high = survey.ends[tile.view]
        survey.ends[tile.view] = min(low, of_tile.ends[0]), max(high, of_tile.ends[1])
        return survey

    def settle(self, survey: Survey) -> tuple[int, int]:
        """Take the survey of all tiles; return how many samples are at an end of the sensor's range: kept, left out."""
        at_ends = 0
        for i, view in enumerate(self.views):
            if i in self.again:
                continue
            least, most = survey.ends[i]
            try:
                check_any(int(survey.sums[i, 0]))
                self.ranges[i] = sensor_range(view, least, most)
            except ValueError as error:
                raise ValueError(f"views[{i}]: {error}") from None
            self.brightest[i] = most
            clips = bool(np.isfinite(self.ranges[i][1]))
            at_ends += int(survey.sums[i, 1] * clips + survey.sums[i, 2])
            rows = slice(self.starts[i], self.starts[i + 1])
            self.rows[rows] = survey.rows[0 if clips else 1, rows].astype(np.int64)
        self.all = [t for t in self.all if self.rows[self.starts[t.view] :][t.first : t.last].any()]
        return (0, at_ends) if self.leave_out else (at_ends, 0)

    @property
    def pixels(self) -> list[int]:
        """How many pixels of each view count."""
        return [int(self.rows[a:b].sum()) for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]

    def part(self, at_most: int) -> list[Samples]:
        """Return the samples of so many pixels, evenly spread over all, or over rows of them that are evenly spread."""
        numbers = self.pixels
        total = sum(numbers)
        found = []
        for i, (view, number) in enumerate(zip(self.views, numbers, strict=True)):
            width = view.image.shape[1]
            rows = np.flatnonzero(self.rows[self.starts[i] : self.starts[i + 1]])
            most = max(LOOKED_AT // (len(self.views) * width), 16)
            few = at_most < total
            if few and len(rows) > most:
                rows = rows[np.arange(most) * len(rows) // most]
            held = self.rows[self.starts[i] + rows]
            count = int(held.sum())
            if few:
                count = min(max(number * at_most // total, min(number, 256)), count)
            pixels = self._pixels(i, rows, held, np.arange(count) * int(held.sum()) // max(count, 1))
            none = np.zeros((0, width), bool)
            found.append(Samples(none, pixels, colours(view), *self.ranges[i], float(self.brightest[i])))
        return found

    def _pixels(self, view: int, rows: np.ndarray, held: np.ndarray, order: np.ndarray) -> np.ndarray:
        """Return where the pixels are that come at these places when those of some rows are counted through."""
        width = self.views[view].image.shape[1]
        ends = np.cumsum(held)
        at = np.searchsorted(ends, order, side="right")  # in which of the rows
        within = order - (ends - held)[at]
        step = rows_of_a_tile(width)
        found = np.zeros(len(order), np.int64)
        used = rows[at]
        for tile in np.unique(used // step):
            which = np.flatnonzero(used // step == tile)
            first, last = int(used[which[0]]), int(used[which[-1]]) + 1
            some = Tile(view, first, last)
            pixels = self.samples(some, self.read(some)).pixels
            before = np.searchsorted(pixels, used[which] * width)  # where each row begins among the tile's pixels
            found[which] = pixels[before + within[which]]
        return found

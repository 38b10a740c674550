"""Noise tests: whether what a fit leaves of its photographs is noise, for a few additions a pixel.

The residuals of a right description are independent, so that their sums over any cells have a variance that is the sum
of their squares (White 1980). Where the sums over parts of the picture or of the range of brightness, or the products
with neighbours and with the picture's own gradient and curvature, are larger, the description is wrong somewhere. The
numbers that were fitted take a part of each sum away, so that these tests err on the side of noise.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import special

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...core.thresholds import CLEARLY, MINOR
from ...parallel.threads import on_all_cores
from ..forward.interface import AbstractForwardModel
from ..forward.rendered import costs
from ..laid_out import LaidOut
from ..pixels.blocks import BLOCK, CHUNK, Block, total
from ..pixels.blocks import chunks as in_chunks

FALSE_ALARM = 1e-4  # the significance level of all these tests together, and of each test of a fault
CELLS, SIZES = 16, 3  # cells along each side of the object, which are joined to 8 and to 4
BINS = CELLS  # of equally many pixels, by brightness


class Footprint:
    """Where the pixels of a view are; views of one camera that show the same share it."""

    def __init__(self, pieces: Sequence[Int[np.ndarray, " n"]], shape: tuple[int, int]):
        """Find which pixels of a picture have four neighbours, and the cells of rows and of columns."""
        whole = np.zeros(shape, bool)
        for pixels in pieces:  # in ascending order
            whole.reshape(-1)[pixels] = True
        rows, columns = (np.flatnonzero(whole.any(axis)) for axis in (1, 0))
        self.inside = inside = np.pad(whole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], 1)
        middle = inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
        self.middle = np.pad(middle, ((0, 0), (1, 1)))
        self.first = np.append(0, np.cumsum(np.count_nonzero(inside, 1)))  # pixel of each row
        down, along = (np.eye(CELLS, dtype=np.float32)[np.arange(side) * CELLS // side] for side in middle.shape)
        self.down, self.along = down.T, np.pad(along, ((1, 1), (0, 0)))

    def rows_of(self, of: Float[np.ndarray, " n"], first: int, last: int) -> Float[np.ndarray, "h w"]:
        """Return some rows of a picture of the pixels, with a border on each side; 0 beside the object."""
        inside = self.inside[first:last]
        found = np.zeros(inside.shape, of.dtype)
        found[inside] = of[self.first[first] : self.first[last]]
        return found


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a fit leaves of one view: the whitened residuals, the channels added up, and the prediction's brightness.

    Of float32, in units of the samples' root mean square and of the brightest one.
    """

    view: int
    shown: Footprint
    residual: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]
    colours: Float[np.ndarray, "colours n"] = dataclasses.field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """The residuals of each third of the channels; none of a grey photograph."""

    @cached_property
    def mean_square(self) -> float:
        """The mean square of the residuals."""
        return float(self.residual @ self.residual) / len(self.residual)


Sums = tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]]  # of residuals over cells, and of their squares


def leftovers(laid: LaidOut, theta: Float[np.ndarray, " p"]) -> list[Leftover]:
    """Return what is left of each view, at these numbers; clipped samples count as met."""
    data = laid.problem.data
    units = np.sqrt(laid.squares / data.counts.samples), max(s.brightest for s in data.samples)
    lengths = [[len(part.pixels) for part in of] for of in in_chunks(laid.parts)]
    starts = np.cumsum([0, *map(sum, lengths)])
    channels, at = laid.chunks[0].observed.target.shape[1], laid.task.with_padding(theta)
    planes = np.empty((2 + len(_thirds(channels)), starts[-1]), np.float32)

    def fill(k: int) -> None:
        of_chunk = _residuals(at, units, laid.task.padded_model, laid.chunks[k])
        for out, found in zip(planes[:, starts[k] : starts[k + 1]], of_chunk, strict=True):
            np.concatenate([row[:n] for row, n in zip(np.asarray(found), lengths[k], strict=True)], out=out)

    on_all_cores(fill, range(len(lengths)))
    shown: dict[tuple[int, ...], Footprint] = {}
    left, end = [], 0
    for view, of in itertools.groupby(laid.parts, key=lambda part: part.view):
        pixels = [part.pixels for part in of]
        start, end = end, end + sum(map(len, pixels))
        if (key := tuple(map(id, pixels))) not in shown:
            shown[key] = Footprint(pixels, data.views[view].camera.shape)
        residual, light = planes[:2, start:end]
        left.append(Leftover(view, shown[key], residual, light, planes[2:, start:end]))
    return left


def _thirds(channels: int) -> list[slice]:
    """Return thirds of the channels: what moves one colour up and another down is not in the sum of all."""
    return [slice(k * channels // 3, (k + 1) * channels // 3) for k in range(3)] if channels >= 3 else []


@partial(jit_quickly, options=PLAINLY)
def _residuals(
    theta: Array, units: tuple[Array, Array], model: AbstractForwardModel, chunk: Block
) -> tuple[Array, ...]:
    """Return sums over the channels of the whitened residuals and of the predictions, and residuals by colour.

    A residual is 0 where a sample is clipped.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, weight = model.predict(theta, block), model.sample_weights(block)
        terms = costs(model.likelihood, m, dataclasses.replace(block.observed, weight=weight))
        residual = [t.slope / jnp.sqrt(jnp.where(t.curvature > 0, t.curvature, 1.0)) for t in terms]
        light = sum(jnp.where(w > 0, of, 0.0) for of, w in zip(m, weight, strict=True))
        by_colour = [sum(residual[third]) / units[0] for third in _thirds(len(residual))]
        return tuple(jnp.astype(of, np.float32) for of in (sum(residual) / units[0], light / units[1], *by_colour))

    return jax.lax.map(of_block, chunk)


class Whiteness(NamedTuple):
    """Whether residuals are noise."""

    p_value: float
    """The probability of noise to look as little like noise in any of the tests, at most 1."""
    correlation: float
    """The variance of sums over the cells of the size where it is largest, over that of independent residuals."""
    squares: Mapping[int, float]
    """The mean square of the residuals of each view that has some, in any unit."""
    shared: float | None = 1.0
    """The same of most cells, if the residuals look like noise that neighbours share; None if they do not."""


def whiteness(views: Sequence[Leftover]) -> Whiteness:
    """Test whether what is left of the views is noise."""
    views = [view for view in views if len(view.residual) > 1 and view.residual.any()]
    if not views:
        return Whiteness(1.0, 1.0, {})
    *sums, of_variance, along = zip(*map(_all_sums, views), strict=True)
    found = [p for of in sums for p in _p_values(of)]
    found += [min(map(_p_of_variance, of)) * len(views) for of in (of_variance, along)]
    over_cells = [sum(np.sum(S**2) for S, _ in of) / sum(np.sum(Q) for _, Q in of) for of in sums[:SIZES]]
    squares = {view.view: view.mean_square for view in views}
    shared = [_shared(sums[k : k + SIZES]) for k in range(0, SIZES * (1 + len(views[0].colours)), SIZES)]
    of_sums = None if None in shared else shared[0]
    return Whiteness(min(1.0, min(found) * len(found)), max(1.0, *map(float, over_cells)), squares, of_sums)


def _shared(sizes: Sequence[Sequence[Sums]]) -> float | None:
    """Return the variance of sums of noise over that of independent noise, of most cells; None if it is no noise.

    Neighbours share noise less far than cells reach, so that it is nearly the same for cells of any size, where that of
    a wrong description grows with their area; in all cells, where a highlight that is wrong is in few; and in sums over
    the views, which may all be wrong alike.
    """
    S, Q = ([np.array([of[k] for of in views]) for views in sizes] for k in range(2))
    cells = Q[1] > 0
    if not cells.any():  # a colour that is met exactly
        return 1.0
    finest, fine, coarse = (float(np.sum(s**2) / q.sum()) for s, q in zip(S, Q, strict=True))
    alike = float(np.sum(S[1].sum(0) ** 2) / Q[1].sum())
    usual = max(1.0, float(np.median(S[1][cells] ** 2 / Q[1][cells]) / special.chdtri(1, 0.5)))
    grows = special.fdtrc(np.count_nonzero(Q[2]), np.count_nonzero(cells), coarse / fine) < MINOR
    return None if grows or max(fine, alike) > CLEARLY * min(finest, usual) else max(1.0, min(fine, usual))


def _all_sums(view: Leftover) -> list[Sums]:
    """Return the sums of one view over cells of three sizes, then by brightness, and with what the picture looks like.

    They are of the channels together, then of each colour. The last are the sums of the squares by brightness, less
    their mean, and of the squares of these; and both along the brightness, since most noise grows with it.
    """
    light, at = view.light, view.shown
    unit = np.float32(1.0 / view.mean_square**0.5)  # whose fourth powers single precision holds
    some = light[:: max(len(light) // 1024, 1)]
    edges = np.quantile(some, np.arange(1, BINS) / BINS).astype(light.dtype)

    def of_band(rows: slice) -> list[np.ndarray]:
        part = slice(at.first[rows.start + 1], at.first[rows.stop + 1])
        bins = reduce(np.add, [(light[part] > edge).view(np.int8) for edge in edges])
        run = np.append(0, np.flatnonzero(bins[1:] != bins[:-1]) + 1)  # where neighbours are not in one bin
        count, fourth = np.bincount(bins[run], np.diff(run, append=len(bins)), BINS), np.zeros(())
        shade, found = at.rows_of(light, rows.start, rows.stop + 2), []
        for of in (view.residual, *view.colours):
            residual = unit * of[part]
            picture = unit * at.rows_of(of, rows.start, rows.stop + 2)
            squares, own = residual * residual, picture[1:-1]
            found += [at.down[:, rows] @ (x @ at.along) for x in (own, own * own)]
            found += [np.bincount(bins[run], np.add.reduceat(x, run), BINS) for x in (residual, squares)]
            found.append(_looks(at.middle[rows], picture, shade, bend_only=of is not view.residual))
            if of is view.residual:
                fourth = np.asarray(squares @ squares)
        return [*found, count, fourth]

    height, width = at.middle.shape
    step = max(CHUNK * BLOCK // width, 1)  # what a band needs stays in a core's cache
    bands = [slice(first, min(first + step, height)) for first in range(0, height, step)]
    filled = [rows for rows in bands if at.first[rows.start + 1] < at.first[rows.stop + 1]]
    *parts, count, fourth = total(on_all_cores(of_band, filled))
    cells: list[Sums] = []
    found: list[Sums] = []
    for first in range(0, len(parts), 5):  # the sum of the channels, then each colour
        *fine, of_bins, squares, looks = parts[first : first + 5]
        cells += [_joined(fine, CELLS // side) for side in (CELLS >> k for k in range(SIZES))]
        found += [(of_bins, squares), *((of[:1], of[1:]) for of in looks)]
    squares = parts[3]
    excess, expected = squares - count, count * (fourth / len(light) - 1.0)
    middles = np.quantile(some, (np.arange(BINS) + 0.5) / BINS)
    along = middles - count @ middles / len(light)
    return [*cells, *found, (excess, expected), (along[None] @ excess, along[None] ** 2 @ expected)]


def _looks(
    middle: Bool[np.ndarray, "h w"],
    residual: Float[np.ndarray, "h+2 w"],
    light: Float[np.ndarray, "h+2 w"],
    *,
    bend_only: bool,
) -> Float[np.ndarray, "looks 2"]:
    """Return sums of residuals times curvature, gradient and neighbours, and of the squares of these products.

    The pictures have one more row above and below, and nothing in their first and last columns, so that a step to a
    neighbour is one along the flattened picture.
    """
    width, n = middle.shape[1], middle.size

    def beside(of: np.ndarray, step: int) -> np.ndarray:
        return of.reshape(-1)[width + step : width + step + n]

    own, shade = beside(residual, 0), beside(light, 0)
    inner = own * middle.reshape(-1)
    down, up, right, left = (beside(light, step) for step in (width, -width, 1, -1))
    bend = down + up
    bend += right
    bend += left
    bend -= 4.0 * shade
    if bend_only:
        return _sums_of([(inner, bend)])
    beside_it = _sums_of([(own, beside(residual, step)) for step in (-width, -1)])
    looks = _sums_of([(inner, of) for of in (bend, down - up, right - left)])
    return np.array([*looks, beside_it.sum(0)])


def _sums_of(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> Float[np.ndarray, "pairs 2"]:
    """Return the sum of each pair's products, and that of their squares."""
    products = [a * b for a, b in pairs]
    return np.array([(a @ b, of @ of) for (a, b), of in zip(pairs, products, strict=True)], np.float64)


def _joined(fine: Sequence[np.ndarray], side: int) -> Sums:
    """Return sums over cells joined to larger ones of so many on a side."""
    a, b = (of.reshape(CELLS // side, side, CELLS // side, side).sum((1, 3)).ravel() for of in fine)
    return a, b


def _p_values(of_views: Sequence[Sums]) -> list[float]:
    """Return p-values of the cells of the view with the least, of all views' together, and of their sums over views."""
    S, Q = (np.array(of) for of in zip(*of_views, strict=True))
    chi2, freedom = np.sum(S**2 / np.where(Q > 0, Q, 1.0), -1), np.sum(Q > 0, -1)
    shared = Q.sum(0)
    of_sums = np.sum(S.sum(0) ** 2 / np.where(shared > 0, shared, 1.0))
    each = special.chdtrc(np.maximum(freedom, 1), chi2)
    return [
        float(each.min()) * len(S),
        float(special.chdtrc(freedom.sum(), chi2.sum())),
        float(special.chdtrc(max(np.sum(shared > 0), 1), of_sums)),
    ]


def _p_of_variance(of: Sums) -> float:
    """Return the p-value of the residuals' variance being the same at every brightness (Koenker 1981)."""
    excess, expected = of
    chi2 = np.sum(excess**2 / np.maximum(expected, 1e-300))
    return float(special.chdtrc(max(int(np.sum(expected > 0)) - 1, 1), chi2))

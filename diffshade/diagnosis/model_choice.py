"""Model choice: which of several fits predicts photographs that it has not seen, and when that cannot be told."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import in_float64
from ..core.fields import Array, check_kind
from ..core.progress import showing
from ..core.words import listing
from ..inverse.data.views import is_grey, setups
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.forward.losses import LOSSES
from ..inverse.pixels.blocks import BLOCK, CHUNK, Block, Piece
from ..inverse.refits import LaidOutFit
from ..inverse.result import Fit
from ..inverse.solve.solvers import evaluate
from ..inverse.statistics.uncertainty import single_views
from .patches import cut_in_patches, patch_width, residual_images

ERRORS = 2.0  # jackknife errors, the least difference for a verdict
SHARE = 0.1  # of the residuals, the least difference of two fitted images for one
GREY_LEVEL = 1.0 / 255.0  # half of it is the least that is seen in a file of 8 bits
FEWEST_VIEWS = 3  # with fewer, patches of them are left out


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """Fits of the same photographs, by how well they predict those they have not seen; `print` it for the table.

    Every array is NumPy float64, one entry a fit, the best first.
    """

    names: tuple[str, ...]
    errors: Float[np.ndarray, " fits"]
    """Root mean square error of the samples left out; in units of the noise where that is given."""
    rmse: Float[np.ndarray, " fits"]
    """Root mean square residual of the samples fitted, in the images' units."""
    unknowns: Int[np.ndarray, " fits"]
    differences: Float[np.ndarray, " fits"]
    """Mean square error of the samples left out, less that of the best fit."""
    difference_errors: Float[np.ndarray, " fits"]
    """Its standard error, by leaving one cluster out at a time."""
    image_differences: Float[np.ndarray, " fits"]
    """Root mean square difference between the fitted images and those of the best fit."""
    worse: Bool[np.ndarray, " fits"]
    """Whether a fit is told from the best one, and worse."""
    bic: Float[np.ndarray, " fits"]
    clusters: int
    what: str
    """What was left out, one at a time."""
    notes: tuple[str, ...]

    @property
    def best(self) -> str | None:
        """The name of the best fit; None where it cannot be told from another."""
        return self.names[0] if self.worse[1:].all() else None

    def __str__(self) -> str:
        """Return the table of fits, the best first, and below it what can be told and what cannot."""
        wide = max(len("model"), *map(len, self.names))
        lines = [
            f"{len(self.names)} models by their error on what they have not seen: {self.what}, left out one at a time",
            f"{'model':<{wide}} {'unknowns':>8} {'left out':>10} {'fitted':>10} {'difference of MSE':>22} {'BIC':>10}",
        ]
        for i, name in enumerate(self.names):
            beside = f"{self.differences[i]:.2e} +- {self.difference_errors[i]:.1e}" if i else "-"
            lines.append(
                f"{name:<{wide}} {self.unknowns[i]:>8d} {self.errors[i]:>10.4g} {self.rmse[i]:>10.4g} {beside:>22} "
                f"{self.bic[i]:>10.1f}"
            )
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


def compare(fits: Mapping[str, Fit], *, progress: bool = False) -> ModelChoice:
    """Say which of several fits of the same photographs to believe, or that they cannot tell.

    Each photograph is left out in turn, each model is fitted to the others from where its fit ended, and predicts it:
    leave-one-out cross-validation (Stone 1974), whose mean square error punishes a term that only follows the noise. Of
    one or two photographs it is patches that are left out, wider than the residuals of the best fit hang together. Two
    models are told apart only where their errors, paired, differ by two standard errors by jackknife, and their fitted
    images by a tenth of the residuals and by half a grey level of 8 bits, root mean square, for images in [0, 1]: what
    is less may be the lens, the lamp or the file. `fits`: name to fit, two or more, all of the same views and loss.
    `progress`: show a line on the terminal.

    Raises ValueError, TypeError: one sentence that names the fit, what differs and the remedy.
    """
    check_kind("fits", fits, Mapping, "{'Phong': fit_a, 'Blinn': fit_b}")
    if len(fits) < 2:
        raise ValueError(
            f"compare needs at least two fits; got {len(fits)}. Give for example {{'Phong': a, 'Blinn': b}}."
        )
    for name, fit in fits.items():
        if not isinstance(name, str):
            raise TypeError(f"fits must have names that are words; got {name!r}. Give for example 'Phong'.")
        check_kind(f"fits['{name}']", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    names = sorted(fits)  # whatever the order of the mapping
    for name in names[1:]:
        _check_same_photographs(names[0], fits[names[0]], name, fits[name])
    with (
        showing("compare", show=progress) as report_progress,
        in_float64(dict(fits)) as fits,
    ):
        laid = {name: LaidOutFit(fits[name]) for name in names}
        for name in names[1:]:
            _check_same_pixels(names[0], laid[names[0]], name, laid[name])
        tightest = min(names, key=lambda name: (fits[name].rmse, name))
        cut = _cut(laid[tightest])
        scale = min(float(fits[name].likelihood.sigma) for name in names)
        tried = {
            name: _left_out(
                laid[name], cut, scale, lambda share, k=k: report_progress("leaving out", (k + share) / len(names))
            )
            for k, name in enumerate(names)
        }
        errors = {name: float(t.squares.sum() / t.samples.sum()) for name, t in tried.items()}
        names.sort(key=lambda name: (errors[name], name))
        best = tried[names[0]]
        apart = np.array([_image_difference(tried[name], best) for name in names])
    pairs = [_paired(tried[name].squares - best.squares, best.samples) for name in names]
    rmse = np.array([tried[name].rmse for name in names])
    differences, their_errors = (np.array(of) for of in zip(*pairs, strict=True))
    visible = apart >= max(SHARE * rmse[0], 0.5 * GREY_LEVEL)
    worse = (differences > 0) & (differences >= ERRORS * their_errors) & visible
    number = np.array([_unknowns(fits[name]) for name in names])
    bic = cut.count * np.log(np.maximum(rmse**2, 1e-300)) + number * np.log(cut.count)
    notes = [
        *(_verdict(names, i, differences, their_errors, apart, rmse, worse) for i in range(1, len(names))),
        *_of_few_views(cut, worse),
        *_own_numbers(names, tried, fits),
        f"BIC = n log(fitted^2) + unknowns log n with n = {cut.count}, the clusters left out, not the samples, which "
        "hang together; no verdict is by it.",
    ]
    return ModelChoice(
        tuple(names),
        np.sqrt([errors[name] for name in names]),
        rmse,
        number,
        differences,
        their_errors,
        apart,
        worse,
        bic,
        cut.count,
        cut.what,
        tuple(notes),
    )


def _check_same_photographs(one: str, a: Fit, other: str, b: Fit) -> None:
    """Refuse fits of different photographs, or of different weights of their samples."""
    both = f"fits['{one}'] and fits['{other}']"
    if len(a.views) != len(b.views):
        raise ValueError(f"{both} must be of the same views; got {len(a.views)} and {len(b.views)}. Fit both to all.")
    for i, (v, w) in enumerate(zip(a.views, b.views, strict=True)):
        of_one = [(name, getattr(v, name), getattr(w, name)) for name in ("image", "mask", "saturation", "floor")]
        of_one += [("channels", is_grey(v), is_grey(w)), ("noise", *map(_numbers, (v.noise, w.noise)))]
        for what, x, y in of_one:
            if (x is None) != (y is None) or not (x is None or np.array_equal(x, y)):
                raise ValueError(f"{both} must be of the same views; views[{i}] has another {what}. Fit both to one.")
    for what, x, y in (("loss", a.likelihood.loss, b.likelihood.loss), ("clipped", a.clipped, b.clipped)):
        if x != y:
            raise ValueError(f"{both} must have the same {what}; got '{x}' and '{y}'. Fit both with one.")


def _numbers(noise: Any) -> np.ndarray | None:
    return None if noise is None else np.array(jax.tree.leaves(noise), float)


def _check_same_pixels(one: str, a: LaidOutFit, other: str, b: LaidOutFit) -> None:
    """Refuse fits that look at different pixels of their photographs, by other surfaces, cameras or clipping."""
    for i, (s, t) in enumerate(zip(a.samples, b.samples, strict=True)):
        if not np.array_equal(s.pixels, t.pixels):
            raise ValueError(
                f"fits['{one}'] and fits['{other}'] must look at the same pixels; of views[{i}] they have "
                f"{len(s.pixels):,} and {len(t.pixels):,}. Give the view a mask that lies inside both silhouettes."
            )


@dataclass(frozen=True, eq=False)
class Cut:
    """The pixels that count, cut into the clusters that are left out one at a time."""

    pieces: list[Piece]
    size: int
    cluster: Int[np.ndarray, " pieces"]
    """Which cluster each piece is of."""
    by_view: bool
    what: str

    @property
    def count(self) -> int:
        """The number of clusters."""
        return int(self.cluster.max()) + 1


def _unknowns(fit: Fit) -> int:
    """Return how many numbers a fit determines."""
    return int(np.sum(fit.evidence.determined & ~fit.at_bound)) - len(fit.evidence.units)


def _cut(laid: LaidOutFit) -> Cut:
    """Return the clusters: views, those taken alike together, where there are three or more of them, else patches."""
    samples, size = laid.samples, laid.problem.block_size
    groups = [[v for v in group if len(samples[v].pixels)] for group in setups(laid.fit.scene, laid.fit.views)]
    groups = [group for group in groups if group]  # a view that is an earlier one again has no pixels
    if len(groups) >= FEWEST_VIEWS:
        parts = [Piece(v, samples[v], samples[v].pixels) for group in groups for v in group]
        cluster = np.array([k for k, group in enumerate(groups) for _ in group])
        return _in_blocks(parts, cluster, size, f"{len(groups)} views")
    width = patch_width(*residual_images(laid.fit))
    parts, cluster = cut_in_patches(laid.fit, samples, width)
    count = len(set(cluster))
    if count < 2:
        raise ValueError(
            f"these views cannot be cut for a comparison: their residuals hang together over {width} pixels, which is "
            "all there are. Add photographs."
        )
    size = min(BLOCK, max(64, 1 << int(np.ceil(np.log2(max(len(part.pixels) for part in parts))))))
    return _in_blocks(parts, cluster, size, f"{count} patches of {width} x {width} pixels")


def _in_blocks(parts: Sequence[Piece], cluster: Int[np.ndarray, " n"], size: int, what: str) -> Cut:
    """Cut the pixels of each piece into blocks."""
    found = [
        (k, Piece(part.view, part.samples, part.pixels[at : at + size]))
        for k, part in zip(cluster, parts, strict=True)
        for at in range(0, len(part.pixels), size)
    ]
    return Cut([p for _, p in found], size, np.array([k for k, _ in found]), what.endswith("views"), what)


@dataclass(frozen=True, eq=False)
class Tried:
    """How a model did."""

    laid: LaidOutFit
    chunks: list[Block]
    squares: Float[np.ndarray, " clusters"]
    """Sum of squares of each cluster, predicted without it."""
    samples: Float[np.ndarray, " clusters"]
    rmse: float
    held: tuple[str, ...]
    """The unknowns that one view alone shows."""
    stuck: bool
    """Whether a fit without one of the clusters did not converge."""

    def shown(self, c: int) -> tuple[np.ndarray, ...]:
        """Return what the fit shows in a chunk, and the weight of each sample that was measured, else 0."""
        return _shown(jnp.asarray(self.laid.theta), self.laid.model, self.chunks[c])


def _left_out(laid: LaidOutFit, cut: Cut, scale: float, report_progress: Callable[[float], None]) -> Tried:
    """Predict each cluster by a fit to the others."""
    problem, rho = laid.problem, LOSSES[laid.fit.likelihood.loss].value
    chunks = problem.lay_out(cut.pieces, cut.size)  # weighed by the photograph, the same for every model
    weighed = problem.reweigh(laid.theta, chunks)
    none = [Piece(p.view, p.samples, p.pixels[:0]) for p in cut.pieces[:CHUNK]]
    (empty,) = laid.lay_out(none, cut.size)
    of_block = [cut.cluster[at : at + CHUNK] for at in range(0, len(cut.cluster), CHUNK)]
    # a view's own exposure is not known without the view
    single_view = single_views(np.asarray(evaluate(laid.theta, laid.task, weighed).views.hessian))
    single_view = single_view if cut.by_view else np.full(len(single_view), -1)
    squares, samples, stuck = np.zeros(cut.count), np.zeros(cut.count), False
    for k in range(cut.count):
        report_progress(k / cut.count)
        views = [part.view for part, of in zip(cut.pieces, cut.cluster, strict=True) if of == k]
        held = {int(j): float(laid.theta[j]) for j in np.flatnonzero(np.isin(single_view, views))}
        others = [
            _without(chunk, empty, blocks == k) if (blocks == k).any() else chunk
            for chunk, blocks in zip(weighed, of_block, strict=True)
            if (blocks != k).any()
        ]
        end = laid.minimise(held, laid.theta, others)
        stuck |= bool(end.message)
        for chunk, blocks in zip(chunks, of_block, strict=True):
            if (blocks == k).any():
                mine = np.flatnonzero(blocks == k)
                m, weight = (x[mine] for x in _shown(jnp.asarray(end.theta), laid.model, chunk))
                s = weight * (m - np.asarray(chunk.observed.target)[mine]) ** 2 / scale**2
                squares[k] += scale**2 * float(np.sum(rho(s)))
                samples[k] += float(np.sum(weight > 0))
    own = dict.fromkeys(u.quantity for u, alone in zip(laid.fit.unknowns, single_view, strict=True) if alone >= 0)
    tried = Tried(laid, chunks, squares, samples, 0.0, tuple(own), stuck)
    residual = 0.0
    for c, chunk in enumerate(chunks):
        m, weight = tried.shown(c)
        residual += float(np.sum(((m - np.asarray(chunk.observed.target)) ** 2)[weight > 0]))
    return dataclasses.replace(tried, rmse=float(np.sqrt(residual / samples.sum())))


def _without(chunk: Block, empty: Block, out: Bool[np.ndarray, " blocks"]) -> Block:
    """Return a chunk in which some blocks hold no pixel: of the same shape, so that nothing compiles anew."""
    padded = np.zeros(len(chunk.view), bool)
    padded[: len(out)] = out
    return jax.tree.map(
        lambda leaf, none: jnp.where(padded.reshape(-1, *[1] * (leaf.ndim - 1)), none[:1], leaf), chunk, empty
    )


def _shown(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[np.ndarray, ...]:
    return tuple(map(np.asarray, _predicted(theta, model, chunk)))


@jax.jit
def _predicted(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, Array]:
    """Return the predictions of a chunk, and the weights of its samples: 0 where one is clipped, and no number."""

    def of_block(block: Block) -> tuple[Array, Array]:
        weight, seen = model.sample_weights(block), block.observed
        measured = weight if seen.clipped is None else jnp.where(seen.clipped == 0, weight, 0.0)
        return jnp.stack(model.predict(theta, block)), measured

    return jax.lax.map(of_block, chunk)


def _paired(difference: Float[np.ndarray, " clusters"], count: Float[np.ndarray, " clusters"]) -> tuple[float, float]:
    """Return the mean of paired sums over all samples, and its standard error by leaving one cluster out at a time.

    The jackknife of a ratio (Efron and Tibshirani 1993, ch. 11); of clusters of one size, that of a mean.
    """
    G = len(count)
    without = (difference.sum() - difference) / (count.sum() - count)
    error = np.sqrt((G - 1) / G * np.sum((without - without.mean()) ** 2))
    return float(difference.sum() / count.sum()), float(error)


def _image_difference(one: Tried, other: Tried) -> float:
    """Return the root mean square difference of two fitted images where samples count."""
    squares = 0.0
    for c in range(len(one.chunks)):
        (a, weight), (b, _) = one.shown(c), other.shown(c)
        squares += float(np.sum(((a - b) ** 2)[weight > 0]))
    return float(np.sqrt(squares / one.samples.sum()))


def _verdict(
    names: Sequence[str],
    i: int,
    differences: np.ndarray,
    errors: np.ndarray,
    apart: np.ndarray,
    rmse: np.ndarray,
    worse: np.ndarray,
) -> str:
    """Say whether a model is worse than the best, or why that cannot be told."""
    best, other = names[0], names[i]
    times = differences[i] / errors[i] if errors[i] > 0 else np.inf if differences[i] > 0 else 0.0
    if worse[i]:
        return (
            f"{best} predicts what it has not seen better than {other}: the mean square error differs by {times:.1f} "
            f"standard errors, and the fitted images by {apart[i]:.2g} where the residuals are {rmse[0]:.2g}."
        )
    why = []
    if not differences[i] >= ERRORS * errors[i] or differences[i] <= 0:
        why.append(f"their mean square errors differ by {times:.1f} standard errors, where {ERRORS:g} are asked for")
    if apart[i] < 0.5 * GREY_LEVEL:
        why.append(f"their fitted images differ by {apart[i]:.2g}, less than half a grey level, {0.5 * GREY_LEVEL:.2g}")
    elif apart[i] < SHARE * rmse[0]:
        why.append(
            f"their fitted images differ by {apart[i]:.2g}, less than {SHARE:.0%} of the residuals, {rmse[0]:.2g}"
        )
    return f"these views cannot tell {best} from {other}: {'; '.join(why)}."


def _of_few_views(cut: Cut, worse: np.ndarray) -> list[str]:
    """Say what would tell models apart that patches do not."""
    if cut.by_view or worse[1:].all():
        return []
    return ["what tells models apart is in few patches of one photograph. Add photographs under other lights."]


def _own_numbers(names: Sequence[str], tried: Mapping[str, Tried], fits: Mapping[str, Fit]) -> list[str]:
    """Say what was held when the view that alone shows it was left out, and what a fit did not reach."""
    held = list(dict.fromkeys(quantity for name in sorted(names) for quantity in tried[name].held))
    said = []
    if held:
        said.append(f"{listing(held)}, which one view alone shows, stayed as fitted when that view was left out.")
    stuck = [name for name in sorted(names) if tried[name].stuck or not fits[name].converged]
    if stuck:
        said.append(f"a fit of {listing(stuck)} did not converge, so that its error here may be too large.")
    return said

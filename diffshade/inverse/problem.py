"""Problem: what a fit minimises, in stages that each add something and change nothing.

`FitProblem` has the unknowns, the samples and the model that predicts them. `Start`, found by `starting.find_start` on
a part of the pixels, has the first values, the scale of the residuals and the steps of the files. `LaidOutProblem` has
all pixels with their weights, and is minimised.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.backend import jit_quickly
from ..core.fields import Array
from ..core.progress import ReportProgress
from ..model.scenes import Object, Scene
from ..parallel.checkpoints import Checkpoint
from ..parallel.devices import DeviceGroup
from ..parallel.threads import on_all_cores
from .data.samples import Counts, Samples
from .data.views import View, camera_key, channels, is_grey, lights_on
from .forward.features import MOST_LIGHTS, feature_model, features_can_serve
from .forward.gram import Gram
from .forward.interface import AbstractForwardModel
from .forward.layout import lay_plain, lay_weighed, place, weigh, with_weights, without_clipped
from .forward.losses import Likelihood
from .forward.rendered import AROUND, RenderedModel, prepare
from .forward.rounding import MOST_NOISE, Rounded, Rounding, share_of_waves
from .forward.streams import AllPixels, StreamingReduction, sum_over
from .forward.sums import spread, sum_of_squares, waves, weights_of_views
from .pixels.blocks import LEAST, Block, Observed, Piece, block_size, chunks, observed, pieces, shares, views_of
from .pixels.tiles import Tiles
from .solve.solvers import Box, Minimum, PriorResiduals, Task, minimise
from .solve.start_search import steepest
from .unknowns.slots import apart
from .unknowns.unknown import Unknown, coordinates, unit_vectors
from .unknowns.visibility import arrow_of

MAX_STEPS = 200
PART = 1 << 15  # pixels on which the search for a start follows its candidates
FEW = 1 << 12  # pixels on which it judges them, where they are many

Theta = Float[np.ndarray, " p"]


@dataclass(frozen=True, eq=False)
class FitProblem:
    """The unknowns of a scene, the samples that count, and the model that predicts them. To be used in float64."""

    scene: Scene
    views: Sequence[View]
    unknowns: Sequence[Unknown]
    samples: Sequence[Samples] | Tiles
    """The samples of each view, in memory; or the tiles of rows from which they are read."""
    counts: Counts
    loss: str
    clipped: str
    """How clipped samples count: "hinge", "tobit" or "exclude"."""
    model: AbstractForwardModel
    """It begins with squares, scale 1 and no steps of the files; later stages replace these."""
    box: Box
    block_size: int
    over_pixels: tuple[Object, ...]
    """What of the objects comes with the pixels (`slots.apart`)."""
    alike: tuple[int, ...]
    """For each view the first one with the same camera, and the same lights if `model.knows_lights`."""

    @property
    def noise_known(self) -> bool:
        """Whether the noise of the views is given; it is given for all or for none."""
        return self.views[0].noise is not None

    @cached_property
    def homoscedastic(self) -> bool:
        """Whether the noise is the same at every level of a view."""
        return _homoscedastic(self.views)

    @cached_property
    def grey(self) -> bool:
        """Whether all views are grey."""
        return all(is_grey(view) for view in self.views)

    @property
    def clips(self) -> bool:
        """Whether any sample is clipped."""
        return self.counts.clipped > 0

    @property
    def pixels(self) -> list[int]:
        """How many pixels of each view count."""
        return self.samples.pixels if isinstance(self.samples, Tiles) else [len(s.pixels) for s in self.samples]

    def with_scale(self, sigma: float, loss: str) -> FitProblem:
        """Return the problem with another scale of the residuals and another loss."""
        if loss == self.model.likelihood.loss and sigma == float(self.model.likelihood.sigma):
            return self
        # a strong type: with a weak one, all programs would be compiled again
        likelihood = Likelihood(jnp.asarray(np.float64(sigma)), loss, self.model.likelihood.tobit)
        return dataclasses.replace(self, model=self.model.use(likelihood))

    def with_rounding(self, rounding: Rounding) -> FitProblem:
        """Return the problem with the steps of the views' files."""
        if not (rounding.exists or self.model.setting.rounding.exists):
            return self
        model = eqx.tree_at(lambda m: m.setting.rounding, self.model, jax.tree.map(jnp.asarray, rounding))
        return dataclasses.replace(self, model=model)

    def size_for(self, at_most: int | None) -> int:
        """Return how many pixels a block holds of so many evenly spread ones."""
        return min(self.block_size, block_size(shares(self.pixels, at_most)))

    def chunks(self, at_most: int | None = None, size: int | None = None) -> list[Block]:
        """Return the chunks of all pixels, or of some, evenly spread; in blocks of another size where it is given."""
        size = size or self.size_for(at_most)
        if isinstance(self.samples, Tiles):
            return self.lay_out(pieces(self.samples.part(at_most or self.counts.pixels), size), size)
        return self.lay_out(pieces(self.samples, size, at_most), size)

    def lay_out(self, parts: Sequence[Piece], size: int) -> list[Block]:
        """Return the chunks of pieces of at most so many pixels, a block a piece.

        Chunks that show the same points share them: those that a camera sees under a hundred lights are found once.
        """
        found = chunks(parts)
        shows = [tuple((self.alike[part.view], id(part.pixels)) for part in of) for of in found]
        times = Counter(shows)
        shared = {key: parts for key, parts in zip(shows, found, strict=True) if times[key] > 1}

        def points(parts: list) -> Any:
            where, view = place(parts, self.views, size, self.over_pixels), views_of(parts)
            used = np.zeros((len(view), 1))
            used[: len(parts), 0] = [len(part.pixels) for part in parts]
            return jax.device_put(self.model.fields(where, view, np.arange(size) < used))

        shown = dict(zip(shared, on_all_cores(points, shared.values()), strict=True))

        def chunk(of: tuple[list, tuple]) -> Block:
            parts, key = of
            here = shown[key] if key in shown else points(parts)
            laid = Block(views_of(parts), here, self.observed(parts, size))
            return with_weights(None, self.model, laid, noise_known=self.noise_known)

        return on_all_cores(chunk, zip(found, shows, strict=True))

    def observed(self, parts: Sequence[Piece], size: int, length: int | None = None) -> Observed:
        """Return the samples of a chunk as NumPy arrays."""
        most = 1 if self.grey else len(self.scene.channels)
        return observed(parts, self.views, size, most, clipping=self.clips, length=length)

    def gather(self, parts: Sequence[Piece], size: int, length: int | None = None) -> Block:
        """Return a chunk as NumPy arrays, with the places of its pixels instead of the points that they show."""
        where = place(parts, self.views, size, self.over_pixels, length)
        return Block(views_of(parts, length), where, self.observed(parts, size, length))

    def few(self) -> list[Block]:
        """Return the chunks of a few pixels, in smaller blocks, without clipped samples."""
        laid = self.chunks(FEW, min(self.block_size, max(FEW // max(len(self.views), 2), LEAST)))
        return on_all_cores(without_clipped, laid) if self.clips else laid

    def reweigh(self, theta: Theta, laid: list[Block]) -> list[Block]:
        """Return the chunks with weights by the noise at the level that theta predicts."""
        if self.homoscedastic:
            return laid
        return on_all_cores(lambda chunk: weigh(jnp.asarray(theta), self.model, chunk), laid)

    def sum_of_squares(self, chunks: Sequence[Block]) -> float:
        """Return the weighted sum of squares of the samples of chunks; 1 where all are 0."""
        weights = np.asarray(weights_of_views(self.model)) if self.noise_known else np.ones(len(self.views))
        return sum(sum_of_squares(weights, chunk) for chunk in chunks) or 1.0

    def priors(self, squares: float) -> PriorResiduals:
        """Return the residuals of the priors and unit vectors; `squares` is the sum of squares of the images."""
        known = [(j, *u.prior) for j, u in enumerate(self.unknowns) if u.prior is not None]
        index, mean, width = (np.array([row[k] for row in known]) for k in range(3))
        units = np.array(unit_vectors(self.unknowns), int).reshape(-1, 3)
        weight = float(self.model.likelihood.sigma) / width.astype(float)
        return PriorResiduals(index.astype(int), mean.astype(float), weight, units, np.asarray(np.sqrt(squares)))

    def task(self, squares: float) -> Task:
        """Return what is to be minimised."""
        return Task(self.model, self.priors(squares), self.box)


def fit_problem(
    scene: Scene,
    views: Sequence[View],
    unknowns: Sequence[Unknown],
    samples: Sequence[Samples] | Tiles,
    counts: Counts,
    loss: str,
    clipped: str,
    *,
    rendered: bool = False,
) -> FitProblem:
    """Return the problem of a fit, with the fastest model that serves.

    Args:
        scene: The scene; it has values for the unknowns too.
        views: The photographs.
        unknowns: What is to be found.
        samples: The samples of each view that count, or the tiles to read them by.
        counts: How many there are.
        loss: "squares", "huber", "cauchy" or "geman-mcclure".
        clipped: What clipped samples say: "hinge", "tobit" or "exclude".
        rendered: Whether to take the model for any scene even if a faster one would do.
    """
    setting = prepare(scene, views, unknowns)
    likelihood = Likelihood(np.asarray(1.0), "squares", clipped == "tobit")
    model: AbstractForwardModel
    if features_can_serve(scene, views, unknowns) and not rendered:
        shared = loss == "squares" and not counts.clipped and _homoscedastic(views)
        kinds = {is_grey(view) for view in views}
        grey = None if len(kinds) > 1 else kinds.pop()
        model = feature_model(setting, likelihood, scene, unknowns, shared=shared, grey=grey)
    else:
        model = RenderedModel(setting, likelihood, steepest(unknowns))
    lower, upper = (coordinates(np.array([getattr(u, end) for u in unknowns]), unknowns) for end in ("lower", "upper"))
    linear, arrow = np.array([u.is_linear for u in unknowns]), arrow_of(scene, views, unknowns)
    in_border = arrow is not None and linear.any() and linear[arrow.border].sum() == linear.sum()
    box = Box(lower, upper, linear, arrow, bool(in_border))
    pixels = samples.pixels if isinstance(samples, Tiles) else [len(s.pixels) for s in samples]
    size = block_size(pixels, len(AROUND) if setting.blurred else 1)
    over_pixels, _ = apart(scene)
    alike = _alike(scene, views, lit=model.knows_lights)
    return FitProblem(scene, views, unknowns, samples, counts, loss, clipped, model, box, size, over_pixels, alike)


def _alike(scene: Scene, views: Sequence[View], *, lit: bool) -> tuple[int, ...]:
    first: dict[Any, int] = {}
    return tuple(
        first.setdefault((camera_key(view.camera), tuple(lights_on(scene, view)) if lit else ()), v)
        for v, view in enumerate(views)
    )


@dataclass(frozen=True, eq=False)
class Start:
    """Where a fit begins, and the scale and steps, all found on a part of the pixels."""

    theta: Theta
    sigma: float
    """The scale of the residuals."""
    squares: float
    """Sum of squares of that part of the images, weighted."""
    rounding: Rounding
    """The steps of the views' files."""
    step_variance: float
    """Mean square of the weighted residuals that rounding alone makes."""
    damping: float
    """Of the first step from theta: `NEAR` if that is the minimum over that part, so that the one over all is near."""

    def to_array(self) -> Float[np.ndarray, " n"]:
        """Return all numbers, for a checkpoint and for other processes."""
        known = self.sigma, self.squares, self.step_variance, self.damping
        return np.array([*self.theta, *known, *np.asarray(self.rounding.step), *np.asarray(self.rounding.srgb)])

    @staticmethod
    def zeros(problem: FitProblem) -> Float[np.ndarray, " n"]:
        """Return zeros of the length of `to_array`, for a process that receives its start from another."""
        return np.zeros(len(problem.unknowns) + 4 + 2 * len(problem.views))

    @staticmethod
    def from_array(numbers: Float[np.ndarray, " n"], views: int) -> Start:
        """Return the start from its array, as made by `to_array`."""
        theta, known, step, srgb = np.split(numbers, np.cumsum([len(numbers) - 4 - 2 * views, 4, views]))
        sigma, squares, step_variance, damping = known.tolist()
        return Start(theta, sigma, squares, Rounding(step, srgb, np.zeros(())), step_variance, damping)


@dataclass(frozen=True, eq=False)
class LaidOutProblem:
    """A problem whose scale is settled, with all of its pixels, weighed. To be used in float64."""

    problem: FitProblem
    start: Start
    pixels: AllPixels
    squares: float
    """Sum of squares of the images, weighted."""

    @cached_property
    def task(self) -> Task:
        """What is to be minimised."""
        return self.problem.task(self.squares)

    def minimise(self, report_progress: ReportProgress) -> Minimum:
        """Return the minimum over all pixels."""
        return minimise(
            self.start.theta,
            self.task,
            self.pixels,
            squares=self.squares,
            max_steps=MAX_STEPS,
            damping=self.start.damping,
            report_progress=lambda step, cost: report_progress(f"step {step}, cost {cost:.6g}"),
        )

    def prior_gram(self, end: Minimum) -> Gram:
        """Return the Gram of the priors and unit vectors at the end."""
        return prior_gram(end.point.theta, self.problem.priors(self.squares))

    def spread(self, end: Minimum) -> Float[np.ndarray, "5"]:
        """Return the sums of `Likelihood.spread` at the end."""
        cost, model = float(end.point.views.cost.sum()), self.problem.model
        if model.projects and cost > 1e-8 * self.squares:  # a smaller cost has lost its digits by cancellation
            sizes = zip(self.problem.pixels, self.problem.views, strict=True)
            count = float(sum(n * channels(view) for n, view in sizes))
            return np.array([count, *[2 * cost] * 2, *[count] * 2])
        return np.asarray(sum_over(self.pixels, spread, end.point.theta, model))

    def rounded(self, end: Minimum, of: Float[np.ndarray, "5"]) -> Rounded | None:
        """Return what rounding adds to the errors, given the spread; None without steps, or where noise hides them."""
        square, variance = float(of[2] / of[0]), self.start.step_variance
        beyond = max(square - variance, 0.0)
        if not self.start.rounding.exists or beyond > 12.0 * MOST_NOISE**2 * variance:
            return None
        rounding = dataclasses.replace(self.start.rounding, noise=np.asarray(np.sqrt(beyond)))
        model = self.problem.with_rounding(rounding).model
        held = variance * share_of_waves(beyond / (12.0 * variance))
        rows = np.asarray(sum_over(self.pixels, waves, end.point.theta, model))
        return Rounded(rounding, rows, min(held / max(square, 1e-300), 1.0))


def lay_out_all(
    problem: FitProblem,
    start: Start,
    part: list[Block],
    *,
    memory: float | int,
    checkpoint: Checkpoint,
    device_group: DeviceGroup | None,
    report_progress: ReportProgress,
) -> LaidOutProblem:
    """Return the problem with the scale and steps of a start, and all of its pixels, with weights at the start.

    Args:
        problem: The problem, with the scale and loss that it was made with.
        start: Where to begin.
        part: Chunks of the pixels on which the start was found. If these are all pixels, they are not laid out again.
        memory: Bytes for tiles that stay laid out; the other tiles are laid out again at each pass.
        checkpoint: Keeps the sums of each pass over tiles.
        device_group: The devices to sum over; None for this process's cores.
        report_progress: Reports progress.
    """
    settled = problem.with_scale(start.sigma, problem.loss).with_rounding(start.rounding)
    squares = start.squares * max(problem.counts.pixels / PART, 1.0)
    if not isinstance(problem.samples, Tiles):
        all_chunks = part if problem.counts.pixels <= PART else settled.chunks()
        return LaidOutProblem(settled, start, settled.reweigh(start.theta, all_chunks), squares)

    def gather(parts: list, length: int | None) -> Block:
        return settled.gather(parts, settled.block_size, length)

    tiles = StreamingReduction(
        problem.samples,
        gather,
        lay_weighed if settled.noise_known else lay_plain,
        settled.block_size,
        weigh_at=None if settled.homoscedastic else start.theta,
        memory=memory,
        checkpoint=checkpoint,
        device_group=device_group,
        report_progress=report_progress,
    )
    return LaidOutProblem(settled, start, tiles, squares)


def _homoscedastic(views: Sequence[View]) -> bool:
    return all(view.noise is None or view.noise.is_uniform for view in views)


def laid_bytes(scene: Scene, views: Sequence[View], pixels: int | None = None) -> float:
    """Return the approximate bytes of laid-out pixels, by default all of the views: samples, and numbers per light."""
    pixels = sum(view.image.shape[0] * view.image.shape[1] for view in views) if pixels is None else pixels
    lights = max(len(lights_on(scene, view)) for view in views)
    return 8.0 * pixels * (2 * len(scene.channels) + 4 * min(lights, MOST_LIGHTS))


@jit_quickly
def _prior_gram(theta: Array, priors: PriorResiduals) -> Gram:
    gram = priors.gram(theta)
    return Gram(gram.cost, gram.gradient, gram.hessian.as_matrix())


def prior_gram(theta: Array, priors: PriorResiduals) -> Gram:
    """Return the Gram of the priors and unit vectors, as NumPy arrays."""
    if not (len(priors.index) or len(priors.units)):
        p = len(theta)
        return Gram(np.zeros(()), np.zeros(p), np.zeros((p, p)))
    return jax.tree.map(np.asarray, _prior_gram(theta, priors))

"""A fit at work: pixels laid out, a search for a start, weights and scale settled, and the minimum over all pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core.backend import jit_quickly
from ..core.fields import Array
from ..core.progress import Tell
from ..model.gbuffers import GBuffer
from ..model.scenes import Scene
from ..parallel.checkpoints import Checkpoint
from ..parallel.devices import Lanes
from ..parallel.threads import on_all_cores
from .data.views import Samples, View, is_grey
from .forward.features import feature_form, has_features
from .forward.gram import Gram
from .forward.losses import NOT_CONVEX, Likelihood
from .forward.residuals import Counts, Rendered, place, prepare
from .forward.rounding import (
    MOST_NOISE,
    Rounded,
    Rounding,
    find_rounding,
    no_rounding,
    share_of_waves,
    variance_of_steps,
    waves,
)
from .pixels.blocks import Block, Piece, block_size, chunks, measured_weights, observed, pieces, total, weights
from .pixels.streams import Passes, compiled
from .pixels.tiles import Tiles
from .solve.solvers import Box, Minimum, Soft, Task, minimise
from .solve.starts import is_local, search, steepest, with_wide_edges
from .unknowns.parameters import Unknown, coordinates, slots_of, unit_vectors

MAX_STEPS = 200
PART = 1 << 15  # pixels on which the search for a start follows its candidates
FEW = 1 << 12  # pixels on which it judges them, where they are many


class Study:
    """One fit at work: the pixels laid out, the form that predicts them, the scale of the residuals."""

    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        unknowns: Sequence[Unknown],
        samples: Sequence[Samples] | Tiles,
        counts: Counts,
        loss: str,
        clipped: str,
        rendered: bool = False,
    ):
        """Gather what the fit needs; `rendered` asks for the form that serves any scene where a faster one would do."""
        self.scene, self.views, self.unknowns = scene, views, unknowns
        self.tiles, self.samples = (samples, []) if isinstance(samples, Tiles) else (None, samples)
        self.loss, self.count = loss, counts.pixels
        self.clips = counts.clipped > 0
        self.noisy = views[0].noise is not None
        self.uniform = all(view.noise is None or view.noise.is_uniform for view in views)
        self.grey = all(is_grey(view) for view in views)
        self.likelihood = Likelihood(np.asarray(1.0), "squares", clipped == "tobit")
        self.rounding = no_rounding(len(views))
        self.of_rounding = 0.0  # mean square of the weighted residuals that rounding alone makes
        problem = prepare(scene, views, slots_of(scene, views, unknowns))
        if has_features(scene, views, unknowns) and not rendered:
            plain = loss == "squares" and not self.clips and self.uniform
            form = feature_form(problem, self.likelihood, unknowns, shared=plain, grey=self.grey)
        else:
            form = Rendered(problem, self.likelihood, steepest(unknowns))
        self.form: Any = jax.device_put(form)
        ends = (coordinates(np.array([getattr(u, end) for u in unknowns]), unknowns) for end in ("lower", "upper"))
        lower, upper = ends
        self.box = jax.device_put(Box(lower, upper, np.array([u.is_linear for u in unknowns])))
        self.size = block_size(samples.pixels if isinstance(samples, Tiles) else [len(s.pixels) for s in samples])
        self.gbuffers = [item.surface if isinstance(item.surface, GBuffer) else None for item in scene.objects]

    def lay_out(self) -> None:
        """Lay out a part of the pixels, evenly spread, for the search; all follow when the programs are compiled."""
        self.part = self.chunks(PART)
        self.whole: Any = self.part if self.count <= PART else []
        self.measured = on_all_cores(_without_clipped, self.part) if self.clips else self.part
        self.squares = float(np.sum(on_all_cores(lambda chunk: _squares(self.form, chunk), self.measured))) or 1.0

    def few(self) -> list[Block]:
        """Return the chunks of a few pixels, in smaller blocks, without clipped samples."""
        laid = self.chunks(FEW, min(self.size, FEW // max(len(self.views), 2)))
        return on_all_cores(_without_clipped, laid) if self.clips else laid

    def chunks(self, at_most: int | None = None, size: int | None = None) -> list[Block]:
        """Return the chunks of all pixels, or of some; in blocks of another size than usual where it is given."""
        size = size or self.size
        if self.tiles is not None:
            return self.lay(pieces(self.tiles.part(at_most or self.count), size), size)
        return self.lay(pieces(self.samples, size, at_most), size)

    def lay(self, parts: Sequence[Piece], size: int) -> list[Block]:
        """Return the chunks of pieces of at most so many pixels, a block a piece."""

        def chunk(parts: list) -> Block:
            return laid(None, self.form, self.gathered(parts, size), noisy=self.noisy)

        return on_all_cores(chunk, chunks(parts))

    def gathered(self, parts: Sequence[Piece], size: int, length: int | None = None) -> Block:
        """Return a chunk as NumPy arrays, with where its pixels are in place of the points they show."""
        channels = 1 if self.grey else 3
        seen, row, column = observed(parts, self.views, size, channels, clipping=self.clips, length=length)
        view = np.zeros(len(row), np.int64)
        view[: len(parts)] = [part.view for part in parts]
        return Block(view, place(parts, row, column, self.gbuffers), seen)

    def reweigh(self, theta: np.ndarray, laid: list[Block]) -> list[Block]:
        """Return the chunks with weights by the noise at the level that theta predicts."""
        if self.uniform:
            return laid
        return on_all_cores(lambda chunk: _weigh(jnp.asarray(theta), self.form, chunk), laid)

    def use(self, sigma: float, loss: str) -> None:
        """Set the scale of the residuals and the loss."""
        # not of a weak type, as which all programs would compile anew
        self.likelihood = Likelihood(jnp.asarray(np.float64(sigma)), loss, self.likelihood.tobit)
        self.form = eqx.tree_at(lambda f: f.likelihood, self.form, self.likelihood)

    def soft(self) -> Soft:
        """Return what is known of the unknowns beside the views."""
        known = [(j, *u.prior) for j, u in enumerate(self.unknowns) if u.prior is not None]
        index, mean, width = (np.array([row[k] for row in known]) for k in range(3))
        units = np.array(unit_vectors(self.unknowns), int).reshape(-1, 3)
        weight = float(self.likelihood.sigma) / width.astype(float)
        soft = Soft(index.astype(int), mean.astype(float), weight, units, np.asarray(np.sqrt(self.squares)))
        return jax.device_put(soft)

    def solve(self, *, from_scene: bool, tell: Tell) -> Minimum:
        """Search on a part of the pixels, settle weights and scale there, and finish on all of them."""
        theta = self.begin(from_scene=from_scene, tell=tell)
        self.whole = self.reweigh(theta, self.whole or self.chunks())
        return self.finish(theta, tell)

    def begin(self, *, from_scene: bool, tell: Tell) -> np.ndarray:
        """Search on a part of the pixels, and settle weights and scale there."""
        begin = coordinates(np.array([u.start for u in self.unknowns]), self.unknowns)
        theta = begin if from_scene else self.search(tell)
        if self.loss != "squares" or not self.uniform or (not self.noisy and any(u.prior for u in self.unknowns)):
            theta = self.settle(theta)
        self.find_rounding()
        return theta

    def find_rounding(self) -> None:
        """Find the steps of the views' files, and how much of the residuals they make."""
        levels = [0.0 if view.noise is None else float(view.noise.levels) for view in self.views]
        self.round(find_rounding(self.part, levels))
        if self.rounding.exists:
            count, squares = total(on_all_cores(lambda chunk: _variance_of_steps(self.form, chunk), self.part))
            self.of_rounding = float(squares / max(count, 1.0))

    def round(self, rounding: Rounding) -> None:
        """Take the steps of the views' files."""
        self.rounding = jax.tree.map(np.asarray, rounding)
        self.form = eqx.tree_at(lambda f: f.problem.rounding, self.form, jax.tree.map(jnp.asarray, rounding))

    def finish(self, theta: np.ndarray, tell: Tell) -> Minimum:
        """Return the minimum over all pixels."""
        self.squares *= max(self.count / PART, 1.0)
        return minimise(
            theta,
            self.task(),
            self.whole,
            squares=self.squares,
            max_steps=MAX_STEPS,
            tell=lambda step, cost: tell(f"step {step}, cost {cost:.6g}"),
        )

    def stream(
        self,
        kept: Checkpoint,
        lanes: Lanes | None,
        memory: float | int,
        *,
        from_scene: bool,
        tell: Tell,
    ) -> np.ndarray:
        """Settle where to begin, which one process does for all, and make ready to pass over the tiles."""
        assert self.tiles is not None

        def begin() -> list[np.ndarray]:
            numbers = np.zeros(len(self.unknowns) + 3 + 2 * len(self.views))
            if lanes is None or lanes.first:
                self.lay_out()
                theta = self.begin(from_scene=from_scene, tell=tell)
                known = float(self.likelihood.sigma), self.squares, self.of_rounding
                numbers = np.array([*theta, *known, *self.rounding.step, *self.rounding.srgb])
                self.part, self.measured = [], []
            return [numbers if lanes is None else lanes.from_first(numbers)]

        theta, known, step, srgb = np.split(
            kept.once("start", begin)[0], np.cumsum([len(self.unknowns), 3, len(self.views)])
        )
        sigma, self.squares, self.of_rounding = known.tolist()
        self.use(sigma, self.loss)
        self.round(Rounding(step, srgb, np.zeros(())))
        self.whole = Passes(
            self.tiles,
            lambda parts, length: self.gathered(parts, self.size, length),
            lay_weighed if self.noisy else lay_plain,
            self.size,
            weigh_at=None if self.uniform else theta,
            memory=memory,
            checkpoint=kept,
            lanes=lanes,
            tell=tell,
        )
        return theta

    def search(self, tell: Tell) -> np.ndarray:
        """Return the best start; where a cutoff is unknown, as its spot would be seen with a wider edge."""
        sharp = self.form
        wide = with_wide_edges(self.scene, self.unknowns)
        if wide is not self.scene:
            problem = prepare(wide, self.views, slots_of(wide, self.views, self.unknowns))
            self.form = eqx.tree_at(lambda f: f.problem, sharp, jax.device_put(problem))
        coarse = self.few() if is_local(self.unknowns) else self.measured
        theta = search(self.unknowns, self.scene, self.task(), coarse, self.measured, self.squares, tell)
        self.form = sharp
        return theta

    def task(self) -> Task:
        """Return what is to be minimised."""
        return Task(self.form, self.soft(), self.box)

    def settle(self, theta: np.ndarray) -> np.ndarray:
        """Alternate between the scale of the residuals, their weights and the minimum; then take a loss not convex."""
        robust = self.loss != "squares"
        rms = float(np.sqrt(self.squares / min(self.count, PART)))
        sigma = 0.0
        for repeat in range(20):
            self.part = self.reweigh(theta, self.part)
            new = 1.0 if self.noisy else max(self.scale(theta, robust=robust), 1e-9 * rms)
            self.use(new, "huber" if robust else "squares")
            theta = self.polish(theta)
            if abs(new - sigma) <= 0.01 * new and (self.uniform or repeat > 1):
                break
            sigma = new
        if self.loss in NOT_CONVEX:
            self.use(float(self.likelihood.sigma), self.loss)
            theta = self.polish(theta)
        return theta

    def polish(self, theta: np.ndarray) -> np.ndarray:
        """Return the minimum on the part of the pixels."""
        return minimise(theta, self.task(), self.part, squares=self.squares, max_steps=MAX_STEPS).theta

    def scale(self, theta: np.ndarray, *, robust: bool) -> float:
        """Return the scale of the residuals: 1.4826 times the median of their size, or their root mean square."""
        found = on_all_cores(lambda chunk: _residuals(jnp.asarray(theta), self.form, chunk), self.part)
        r = np.concatenate([np.asarray(r)[np.asarray(counts)] for r, counts in found])
        return float(1.4826 * np.median(np.abs(r)) if robust else np.sqrt(np.mean(r**2)))

    def evidence(self, end: Minimum) -> tuple[Any, Any, Rounded | None]:
        """Return the Gram of what is known beside the views, sums of `Likelihood.spread`, and what rounding adds."""
        spread = self.spread(end)
        return beside(end.point.theta, self.soft()), spread, self.rounded(end.point.theta, spread)

    def rounded(self, theta: Any, spread: Any) -> Rounded | None:
        """Return what rounding adds to the errors; None where the views have no steps, or noise hides them."""
        square = float(spread[2] / spread[0])
        beyond = max(square - self.of_rounding, 0.0)
        if not self.rounding.exists or beyond > 12.0 * MOST_NOISE**2 * self.of_rounding:
            return None
        self.round(dataclasses.replace(self.rounding, noise=np.asarray(np.sqrt(beyond))))
        held = self.of_rounding * share_of_waves(beyond / (12.0 * self.of_rounding))
        return Rounded(self.rounding, self.waves(theta), min(held / max(square, 1e-300), 1.0))

    def waves(self, theta: Any) -> Any:
        """Return what rounding makes the gradient of each view vary by, over all pixels."""
        if isinstance(self.whole, Passes):
            return self.whole.summed(waves, theta, self.form)
        program = compiled(waves, self.form.transparent)
        return total(on_all_cores(lambda chunk: program(theta, self.form, chunk), self.whole))

    def spread(self, end: Minimum) -> Any:
        """Return the sums of `Likelihood.spread` at the end."""
        theta = end.point.theta
        cost = float(end.point.views.cost.sum())
        if self.form.projects and cost > 1e-8 * self.squares:  # else it is a difference of like numbers
            numbers = self.tiles.pixels if self.tiles is not None else [len(s.pixels) for s in self.samples]
            count = float(sum(n * (1 if is_grey(view) else 3) for n, view in zip(numbers, self.views, strict=True)))
            return np.array([count, *[2 * cost] * 2, *[count] * 2])
        if isinstance(self.whole, Passes):
            return self.whole.summed(spread_of, theta, self.form)
        return total(on_all_cores(lambda chunk: _spread(theta, self.form, chunk), self.whole))


@jit_quickly
def _soft_gram(theta: Array, soft: Soft) -> Gram:
    return soft.gram(theta)


def beside(theta: Array, soft: Soft) -> Gram:
    """Return the Gram of what is known of the unknowns beside the views."""
    return jax.tree.map(np.asarray, _soft_gram(theta, soft))


@jax.jit
def _weigh(theta: Array | None, form: Any, chunk: Block) -> Block:
    """Return a chunk whose samples weigh as the noise says at the level of the prediction; else of the photograph."""

    def weight(block: Block) -> Array:
        seen = block.observed
        level = seen.target if theta is None else jnp.stack(form.predict(theta, block))
        noise = jax.tree.map(lambda leaf: leaf[block.view], form.problem.noise)
        return jnp.where(seen.weight > 0, 1.0 / noise.variance(level), 0.0)

    return eqx.tree_at(lambda c: c.observed.weight, chunk, jax.lax.map(weight, chunk))


@jax.jit
def _without_clipped(chunk: Block) -> Block:
    """Return a chunk in which no clipped sample counts."""
    weight = jnp.where(chunk.observed.clipped == 0, chunk.observed.weight, 0.0)
    return eqx.tree_at(lambda c: c.observed.weight, chunk, weight)


@jax.jit
def _squares(form: Any, chunk: Block) -> Array:
    """Return the weighted sum of squares of a chunk's samples."""
    return jnp.sum(jax.lax.map(lambda block: jnp.sum(weights(form, block) * block.observed.target**2), chunk))


@jax.jit
def _residuals(theta: Array, form: Any, chunk: Block) -> tuple[Array, Array]:
    """Return the weighted residuals of a chunk, and which samples were measured."""

    def of_block(block: Block) -> tuple[Array, Array]:
        weight = weights(form, block)
        m = jnp.stack(form.predict(theta, block))
        return jnp.sqrt(weight) * (m - block.observed.target), measured_weights(form, block) > 0

    return jax.lax.map(of_block, chunk)


def laid(theta: Array | None, form: Any, gathered: Block, *, noisy: bool) -> Block:
    """Return a chunk laid out: the points its pixels show, and weights by the noise at the level that theta predicts.

    Without theta the level is the photograph's.
    """
    seen = gathered.observed
    points = form.fields(gathered.points, gathered.view, seen.weight[:, 0] > 0)
    if form.projects:
        seen = eqx.tree_at(lambda o: o.weight, seen, None)
    chunk = jax.device_put(Block(gathered.view, points, seen))
    return _weigh(theta, form, chunk) if noisy and not form.projects else chunk


def lay_plain(theta: Array | None, form: Any, gathered: Block) -> Block:
    """Return a chunk laid out whose samples all weigh alike."""
    return laid(theta, form, gathered, noisy=False)


def lay_weighed(theta: Array | None, form: Any, gathered: Block) -> Block:
    """Return a chunk laid out whose samples weigh as the noise says."""
    return laid(theta, form, gathered, noisy=True)


def spread_of(theta: Any, form: Any, chunk: Block) -> Array:
    """Return the sums of `Likelihood.spread` over a chunk."""

    def add(total: Array, block: Block) -> tuple[Array, None]:
        seen = block.observed
        m = jnp.stack(form.predict(theta, block))
        return total + form.likelihood.spread(m, seen.target, weights(form, block), seen.clipped), None

    return jax.lax.scan(add, jnp.zeros(5), chunk)[0]


_spread, _variance_of_steps = jax.jit(spread_of), jax.jit(variance_of_steps)

"""Robust run: what the texels of an object have in common, then their numbers tile by tile, then their errors."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...core.thresholds import DEGREE
from ...model.vectors import Vec3
from ..between_lights import BetweenLights, from_leaves, learned_between
from ..lighting import LightErrors, LightingSetup
from ..map_arrays import MapArrays
from ..maps import SharedHighlight, TexelMaps
from ..prediction import KnownCoefficients, TexelBlock
from ..status import MIN_LIT_WITH_NORMAL, ROUNDING, status_of
from ..tile_runner import TileRunner
from ..tiles import SQUARE, TexelTile
from ..unexplained import NOISES, Interpolation, Unexplained, interpolation_of, most_parts, smoothing_of
from .block_coefficients import BlockCoefficients, coefficients_of, kept_of, shown_under
from .block_fits import Normals, beyond_grey, brightest_of, lowest_two, normals_of
from .choice import MATTE_NOTE, ROUNDS, best_model, from_nothing
from .disagreement import CELLS, cells_of, disagreements, note_on_disagreements
from .learning import Assumptions, ObjectModel, learned
from .neighbours import MARGIN, corrected, grid_of, mean_around, scatter_of
from .reflection_shape import EXPONENTS, EitherLobe, beside_blinn, lobe_taken, note_on_lobe, notes_on_diffuse
from .stated_errors import COLUMNS, PartFits, SpreadColumns, fit_parts, state_errors
from .texel_work import FEW_EVERY, FEWEST_OF_REGION, Shared, TexelWork

# Share of Blinn's misfit below which the scene's lobe is kept. Real highlights follow the half vector (Ngan, Durand and
# Matusik 2005).
MAX_MISFIT_RATIO = 0.85


class RobustRun(TexelWork):
    """One robust fit: what is known of the scene, and the tiles that it works on."""

    def __init__(
        self,
        setup: LightingSetup,
        known: KnownCoefficients,
        loss: str,
        regions: Int[np.ndarray, " pixels"] | None,
        tiles: TileRunner,
        *,
        neighbours: bool,
        light_error: LightErrors | None = None,
    ):
        """Gather what all texels have in common.

        Args:
            setup: The lights of the views.
            known: The coefficients that are not fitted.
            loss: Name of the robust loss.
            regions: Region of each pixel, numbered from 0 without gaps; None makes the object one.
            tiles: What reads the tiles and stores the maps.
            neighbours: Whether a normal is the median of those around it.
            light_error: How well each view's lights are known; by default to a degree.
        """
        setup = eqx.tree_at(lambda setup: setup.lobe, setup, beside_blinn(setup.lobe))
        super().__init__(setup, known, loss, regions, tiles, light_error)
        self.neighbours = neighbours
        self.light_error = light_error or LightErrors.within(np.full(len(tiles.reader.views), DEGREE))

    def under(self, setup: LightingSetup, light_error: LightErrors | None = None) -> RobustRun:
        """Return what works on the same texels, for photographs, and errors of lights, that are described otherwise."""
        same, light_error = (self.known, self.loss, self.regions, self.tiles), light_error or self.stated
        return RobustRun(setup, *same, neighbours=self.neighbours, light_error=light_error)

    def learn(self, sample: TexelTile, assumed: Assumptions | None = None) -> list[ObjectModel]:
        """Return the model of the object, or that of each region, from a sample of its texels.

        Args:
            sample: Texels.
            assumed: What is assumed of the object. By default it is chosen with Blinn's lobe; the scene's lobe is tried
                where there is a highlight.
        """
        report, lobe = self.tiles.report_progress, self.setup.lobe
        few = sample.part(np.arange(0, len(sample.pixels), FEW_EVERY))
        self._take_second(False)
        whole = best_model(self, sample) if assumed is None else from_nothing(self, few, assumed)
        if whole.assumed.glossy and isinstance(lobe, EitherLobe) and lobe.second:
            self._take_second(True)
            other = from_nothing(self, few, whole.assumed)
            if other.relative_misfit < MAX_MISFIT_RATIO * whole.relative_misfit:
                whole = other
            else:
                self._take_second(False)
        for k in range(ROUNDS):
            report("learning the highlight:", (k + 1) / ROUNDS)
            whole = learned(whole, self.sample_at_minimum(sample, whole))
        if self.regions is None:
            return [whole]
        models = []
        for region in range(int(self.regions.max()) + 1):
            part = sample.part(np.flatnonzero(self.region_of(sample.pixels) == region))
            model = whole
            if len(part.pixels) >= FEWEST_OF_REGION:
                for _ in range(ROUNDS):
                    model = learned(model, self.sample_at_minimum(part, model))
            models.append(model)
        return models

    def _take_second(self, yes: bool) -> None:
        """Take the scene's lobe, or Blinn's, where these are two."""
        if isinstance(self.setup.lobe, EitherLobe):
            lobe = EitherLobe(self.setup.lobe.lobes, np.array(yes))
            self.setup = eqx.tree_at(lambda setup: setup.lobe, self.setup, lobe)

    def maps(self, models: Sequence[ObjectModel], sample: TexelTile, notes: tuple[str, ...]) -> TexelMaps:
        """Fit all texels, tile by tile, and return their maps.

        Args:
            models: What `learn` returned.
            sample: Texels from which is found how residuals are interpolated, and how bright a highlight can be.
            notes: What was reported before.
        """
        tiles, store, reader = self.tiles, self.tiles.store, self.tiles.reader
        arrays = MapArrays(tiles, ("k_d", "k_s", "n_s", "normal"))
        spread = store.array("spread", (*reader.shape, COLUMNS), np.float32)
        # numbers of observations of each tile, view and cell: the doubted ones, and all
        doubts = store.array("doubts", (tiles.count, len(reader.views), CELLS * CELLS, 2), np.float32)
        parts = fit_parts(self, models)
        shared = self._shared(models, sample, parts)
        if shared.taken is not None:
            store.array("unexplained", (*reader.shape, reader.channels * len(shared.taken)), np.float16)

        def fit(t: int, tile: TexelTile) -> None:
            self._fit_tile(t, tile, shared, arrays)

        arrays.fill(fit, margin=SQUARE if reader.with_position else MARGIN)
        times = state_errors(self, shared, parts, arrays, spread)
        store.wait_for_all()
        note = note_on_disagreements(disagreements(doubts.sum(0)), reader.shape)
        given, taken = reader.scene.objects[0].material.lobe, lobe_taken(self.setup.lobe)
        on_highlight = note_on_lobe(given, taken) if models[0].assumed.glossy else (MATTE_NOTE,)
        notes = (*notes, *note, *on_highlight, *notes_on_diffuse([model.shape for model in models]))
        scene = eqx.tree_at(lambda scene: scene.objects[0].material.lobe, reader.scene, taken)
        beyond = shared.interpolation and Unexplained(shared.interpolation, store.read("unexplained"))
        highlights = self._highlights(shared.refined)
        return arrays.maps(scene, notes, times_95=times, highlights=highlights, unexplained=beyond)

    def _shared(self, models: Sequence[ObjectModel], sample: TexelTile, parts: PartFits) -> Shared:
        """Return what the texels share, from a sample of them."""
        region = self.region_of(sample.pixels)
        refined = [self.refined(m, sample.part(np.flatnonzero(region == r))) for r, m in enumerate(models)]
        pieces = self.tiles.reader.pieces(sample, np.zeros((2, len(sample.pixels))))
        seen = self.tiles.each(lambda block, _: brightest_of(self.setup, self.known, block), pieces)
        brightest = seen.max(keepdims=True)[0]
        leaves = self.tiles.store.kept(
            "between_lights", lambda: jax.tree.leaves(self._interpolated(sample, refined, brightest))
        )
        own_95 = 0.0
        if self.neighbours:
            alone = self.each(parts.sample, self._normals, models)
            own = parts.held_by(np.asarray(alone.spread[0]), parts.found.angle)
            own_95 = own.errors * own.times_95
        return Shared(models, refined, brightest, own_95, *from_leaves(leaves))

    def _interpolated(
        self, sample: TexelTile, models: Sequence[ObjectModel], brightest: Float[np.ndarray, ""]
    ) -> tuple[Interpolation | None, BetweenLights | None]:
        """Return how what is beyond the model is interpolated between lights, and what is predicted there first."""

        def shown(lights: Float[Array, "lights 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Return what the views show beyond the model, grey and not, and the model under distant lights."""

            def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> tuple[Array, Array, Array]:
                observed, state = self.at_minimum(block, model)
                k, beyond = coefficients_of(self.setup, self.known, block, observed, model, state.n, brightest)
                return beyond_grey(observed, model, state), beyond, shown_under(lights, observed, model, state.n, k)

            return jax.tree.map(np.asarray, self.each(sample, program, models))

        lights = toward = self.toward(sample)
        grey, beyond, model = shown(toward)
        smoothing = smoothing_of(toward, grey)
        if smoothing is None:
            return None, None
        self.tiles.report_progress("learning what is between the lights")
        between = learned_between(toward, beyond, model, smoothing)
        if between is not None:  # what was learned is smooth already
            lights, smoothing = np.asarray(between.toward, np.float64), smoothing._replace(noise=min(NOISES))
            grey = np.asarray(between.beyond(beyond, shown(lights)[-1])).mean(1)
        reader = self.tiles.reader
        parts = most_parts(reader.shape[0] * reader.shape[1] * reader.channels, len(toward))
        return interpolation_of(lights, grey, smoothing, parts).in_units_of(float(brightest)), between

    def _fit_tile(self, t: int, tile: TexelTile, shared: Shared, arrays: MapArrays) -> None:
        """Fit the texels of a tile that was read with those around it, and write what belongs to the tile."""
        width, models, stored = self.tiles.reader.shape[1], shared.models, self.tiles.store.arrays
        first, last = self.tiles.rows_of(t)
        found = self.each(tile, self._normals, models)
        grid = grid_of(tile.pixels, width)
        alone = grid.image(found.n.T)
        own_95 = grid.image(shared.own_95 * np.asarray(found.spread[:1]).T)
        n = corrected(alone, own_95, grid.mask) if self.neighbours else alone
        normal = n[grid.row, grid.column].T
        own = np.flatnonzero((tile.pixels >= first * width) & (tile.pixels < last * width))
        if not len(own):
            return
        part, normal = tile.part(own), normal[:, own]
        k, kept = self._coefficients(part, shared, normal)

        def around(each: Float[Array, " n"]) -> Float[np.ndarray, " m"]:
            return mean_around(grid.image(each[:, None])[..., 0], grid.mask)[grid.row, grid.column][own]

        misfit, brighter = np.sqrt(around(np.minimum(found.spread[0], np.pi / 2) ** 2)), around(found.brighter)
        scatter = np.ones(len(own))
        if self.neighbours:
            scatter = scatter_of(alone, grid.mask)[grid.row, grid.column][own]
        bounce, (k_d, k_s) = np.minimum(found.by_bounce[own], np.pi / 2), np.asarray(found.spread[1:, own])
        spread = SpreadColumns(
            misfit * brighter,
            scatter,
            bounce * brighter,
            k_d,
            k_s,
            *map(np.asarray, (found.by_lights[own], found.by_choice[own])),
        ).stacked()
        unknown = (found.plane[own] < DEGREE) | (k.level < ROUNDING * shared.brightest)
        shadowed = found.lit[own] < MIN_LIT_WITH_NORMAL
        spread[unknown | shadowed] = np.inf
        stored["spread"].reshape(-1, COLUMNS)[part.pixels] = spread
        status = status_of(~unknown, unknown, shadowed)  # until the errors are known
        n_s = np.array([model.shape.exponent for model in shared.refined])[self.region_of(part.pixels)]
        numbers = {"k_d": k.k_d, "k_s": k.k_s, "n_s": n_s[None], "normal": normal}
        arrays.write(part.pixels, numbers | {"status": status[None], "residual": k.residual[None]})
        cell = cells_of(part.pixels, self.tiles.reader.shape)
        for v, doubts in enumerate(stored["doubts"][t]):
            for i, of in enumerate((k.doubted[v], k.counts[v])):
                doubts[:, i] = np.bincount(cell, of, CELLS * CELLS)
        if kept is not None:
            stored["unexplained"].reshape(-1, kept.shape[0] * kept.shape[1])[part.pixels] = kept.reshape(-1, len(own)).T

    def _coefficients(
        self, tile: TexelTile, shared: Shared, normal: Float[np.ndarray, "3 n"]
    ) -> tuple[BlockCoefficients, Float[Array, "channels parts n"] | None]:
        """Return the coefficients of the texels of a tile, and what is kept of what the views show beyond them."""

        def program(
            block: TexelBlock, model: ObjectModel, given: np.ndarray | None
        ) -> tuple[BlockCoefficients, Array | None]:
            assert given is not None
            observed, n = self.observed(block, model), Vec3(*given)
            k, beyond = coefficients_of(self.setup, self.known, block, observed, model, n, shared.brightest)
            if shared.taken is None:
                return k, None
            return k, kept_of(observed, model, n, k, beyond, shared.taken, shared.between)

        return self.each(tile, program, shared.refined, np.ascontiguousarray(normal, np.float32))

    def _normals(self, block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Normals:
        observed = self.observed(block, model)
        return normals_of(self.setup, block, observed, model, lowest_two(observed, model), self.light_error)

    def _highlights(self, models: Sequence[ObjectModel]) -> tuple[SharedHighlight, ...]:
        """Return the powers that the highlight of every texel consists of."""
        weights = np.stack([np.asarray(model.shape.weight, np.float64) for model in models])
        shape = self.tiles.reader.shape
        found = []
        for j, exponent in enumerate(EXPONENTS):
            if (weights[:, j] > 0.0).any():
                weight = weights[0, j] if self.regions is None else weights[self.regions, j].reshape(*shape, 1)
                found.append(SharedHighlight(weight, exponent))
        return tuple(found)

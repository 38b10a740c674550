"""Robust run: what the texels of an object have in common, then their numbers tile by tile, then their errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Float16, Int

from ...core.fields import Array
from ...core.thresholds import DEGREE
from ..between_lights import BetweenLights, from_leaves, learned_between
from ..blocks import TexelBlock
from ..checks import check_anything_left
from ..lighting import LightErrors, LightingSetup
from ..map_arrays import MapArrays
from ..maps import SharedHighlight, TexelMaps
from ..prediction import KnownCoefficients
from ..status import MIN_LIT_WITH_NORMAL, ROUNDING, status_of
from ..tile_runner import TileRunner
from ..tiles import SQUARE, TexelTile
from ..unexplained import NOISES, Interpolation, Smoothing, Unexplained, interpolation_of, most_parts, smoothing_of
from .block_coefficients import BlockCoefficients, Shown, coefficients_of, shown_by
from .block_fits import Normals, normals_of, seen_by
from .choice import MATTE_NOTE, ROUNDS, best_model, from_nothing
from .disagreement import CELLS, cells_of, disagreements, note_on_disagreements
from .learning import Assumptions, ObjectModel, learned
from .neighbours import MARGIN, corrected, grid_of, mean_around, scatter_of
from .reflection_shape import EXPONENTS, EitherLobe, beside_blinn, lobe_taken, note_on_lobe, note_on_roughness
from .stated_errors import COLUMNS, PartFits, SpreadColumns, fit_parts, state_errors
from .texel_work import FEW_EVERY, FEWEST_OF_REGION, Shared, TexelWork

# Share of Blinn's misfit below which the scene's lobe is kept. Real highlights follow the half vector (Ngan, Durand and
# Matusik 2005).
MAX_MISFIT_RATIO = 0.85


class _Scratch(NamedTuple):
    """What a tile writes beside its maps."""

    spread: Float[np.ndarray, "h w columns"]
    """What the errors follow from, see `SpreadColumns`."""
    doubts: Float[np.ndarray, "views cells 2"]
    """Numbers of observations of each view and cell: the doubted ones, and all."""
    unexplained: Float16[np.ndarray, "h w _"] | None


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
        super().__init__(setup, known, loss, regions, tiles)
        self.neighbours = neighbours
        self.light_error = light_error or LightErrors.within(np.full(len(tiles.reader.views), DEGREE))

    def under(self, setup: LightingSetup, light_error: LightErrors | None = None) -> RobustRun:
        """Return what works on the same texels, for photographs, and errors of lights, that are described otherwise."""
        return RobustRun(
            setup,
            self.known,
            self.loss,
            self.regions,
            self.tiles,
            neighbours=self.neighbours,
            light_error=light_error or self.light_error,
        )

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
        arrays = MapArrays(store, ("k_d", "k_s", "n_s", "normal"), reader.shape, reader.channels)
        spread = store.array("spread", (*reader.shape, COLUMNS), np.float32)
        doubts = store.array("doubts", (tiles.count, len(reader.views), CELLS * CELLS, 2), np.float32)
        parts = fit_parts(self, models)
        shared = self._shared(models, sample, parts)
        unexplained = None
        if shared.taken is not None:
            width = reader.channels * len(shared.taken)
            unexplained = store.array("unexplained", (*reader.shape, width), np.float16)

        def fit(t: int, tile: TexelTile) -> None:
            if len(tile.pixels):
                self._fit_tile(tiles.rows_of(t), tile, shared, arrays, _Scratch(spread, doubts[t], unexplained))
            store.finish(t)

        tiles.each_tile(fit, store.done, "fitted", margin=SQUARE if reader.with_position else MARGIN)
        store.wait_for_all()
        check_anything_left(arrays.arrays["status"])
        times = state_errors(self, shared, parts, arrays, spread)
        store.wait_for_all()
        note = note_on_disagreements(disagreements(doubts.sum(0)), reader.shape)
        given, taken = reader.scene.objects[0].material.lobe, lobe_taken(self.setup.lobe)
        on_highlight = note_on_lobe(given, taken) if models[0].assumed.glossy else (MATTE_NOTE,)
        notes = (*notes, *note, *on_highlight, *note_on_roughness(models[0].shape))
        scene = eqx.tree_at(lambda scene: scene.objects[0].material.lobe, reader.scene, taken)
        return TexelMaps(
            arrays.values(),
            arrays.errors(),
            store.read("status")[..., 0],
            store.read("residual")[..., 0],
            scene,
            reader.camera,
            notes,
            times,
            self._highlights(shared.refined),
            None if shared.interpolation is None else Unexplained(shared.interpolation, store.read("unexplained")),
        )

    def _shared(self, models: Sequence[ObjectModel], sample: TexelTile, parts: PartFits) -> Shared:
        """Return what the texels share, from a sample of them."""
        region = self.region_of(sample.pixels)
        refined = [self.refined(m, sample.part(np.flatnonzero(region == r))) for r, m in enumerate(models)]
        seen = self.each(sample, lambda block, model, _: seen_by(self.setup, self.known, block, model), refined)
        brightest = np.asarray(seen.brightest).max(keepdims=True)[0]
        leaves = self.tiles.store.kept(
            "between_lights", lambda: jax.tree.leaves(self._interpolated(sample, refined, seen.beyond, brightest))
        )
        own_95 = 0.0
        if self.neighbours:
            alone = self.each(parts.sample, self._normals, models)
            own = parts.held_by(np.asarray(alone.spread[0]), parts.found.angle)
            own_95 = own.errors * own.times_95
        return Shared(models, refined, brightest, own_95, *from_leaves(leaves))

    def _interpolated(
        self,
        sample: TexelTile,
        models: Sequence[ObjectModel],
        beyond: Float[Array, "views texels"],
        brightest: Float[np.ndarray, ""],
    ) -> tuple[Interpolation | None, BetweenLights | None]:
        """Return how what is beyond the model is interpolated between lights, and what is predicted there first."""
        toward = self.toward(sample)
        smoothing = smoothing_of(toward, beyond)
        if smoothing is None:
            return None, None
        between, beyond = self._between(sample, models, brightest, toward, smoothing) or (None, beyond)
        reader = self.tiles.reader
        parts = most_parts(reader.shape[0] * reader.shape[1] * reader.channels, len(toward))
        lights = toward
        if between is not None:  # what was learned is smooth already
            lights, smoothing = np.asarray(between.toward, np.float64), smoothing._replace(noise=min(NOISES))
        return interpolation_of(lights, beyond, smoothing, parts).in_units_of(float(brightest)), between

    def _between(
        self,
        sample: TexelTile,
        models: Sequence[ObjectModel],
        brightest: Float[np.ndarray, ""],
        toward: Float[np.ndarray, "views 3"],
        smoothing: Smoothing,
    ) -> tuple[BetweenLights, Float[np.ndarray, "lights texels"]] | None:
        """Return what a sample teaches of lights between those of the views, and what it then shows beyond the model.

        The latter is grey. None where nothing was learned.
        """
        self.tiles.report_progress("learning what is between the lights")

        def under(toward: Float[Array, "lights 3"]) -> Shown:
            return self.each(
                sample,
                lambda block, model, _: shown_by(self.setup, self.known, block, model, brightest, toward),
                models,
            )

        shown = under(toward)
        between = learned_between(toward, shown.beyond, shown.model, smoothing)
        if between is None:
            return None
        return between, np.asarray(between.beyond(shown.beyond, under(between.toward).model)).mean(1)

    def _fit_tile(
        self,
        rows: tuple[int, int],
        tile: TexelTile,
        shared: Shared,
        arrays: MapArrays,
        scratch: _Scratch,
    ) -> None:
        """Fit the texels of a tile that was read with those around it, and write what belongs to the tile."""
        width, models = self.tiles.reader.shape[1], shared.models
        found = self.each(tile, self._normals, models)
        grid = grid_of(tile.pixels, width)
        alone = grid.image(found.n.T)
        own_95 = grid.image(shared.own_95 * np.asarray(found.spread[:1]).T)
        n = corrected(alone, own_95, grid.mask) if self.neighbours else alone
        normal = n[grid.row, grid.column].T
        own = np.flatnonzero((tile.pixels >= rows[0] * width) & (tile.pixels < rows[1] * width))
        if not len(own):
            return
        part, normal = tile.part(own), normal[:, own]

        def coefficients(block: TexelBlock, model: ObjectModel, n: np.ndarray | None) -> BlockCoefficients:
            assert n is not None
            kept = (shared.brightest, shared.taken, shared.between)
            return coefficients_of(self.setup, self.known, block, model, n, *kept)

        k = self.each(part, coefficients, shared.refined, np.ascontiguousarray(normal, np.float32))

        def around(each: Float[Array, " n"]) -> Float[np.ndarray, " m"]:
            return mean_around(grid.image(each[:, None])[..., 0], grid.mask)[grid.row, grid.column][own]

        misfit, brighter = np.sqrt(around(np.minimum(found.spread[0], np.pi / 2) ** 2)), around(found.brighter)
        scatter = np.ones(len(own))
        if self.neighbours:
            scatter = scatter_of(alone, grid.mask)[grid.row, grid.column][own]
        flat = scratch.spread.reshape(-1, COLUMNS)
        flat[part.pixels] = SpreadColumns(
            misfit * brighter,
            scatter,
            np.minimum(found.by_bounce[own], np.pi / 2) * brighter,
            np.asarray(found.spread[1, own]),
            np.asarray(found.spread[2, own]),
            np.asarray(found.by_lights[own]),
            np.asarray(found.by_choice[own]),
        ).stacked()
        lit, plane = found.lit[own], found.plane[own]
        unknown = (plane < DEGREE) | (k.level < ROUNDING * shared.brightest)
        flat[part.pixels[unknown | (lit < MIN_LIT_WITH_NORMAL)]] = np.inf
        status = status_of(~unknown, unknown, lit < MIN_LIT_WITH_NORMAL)  # until the errors are known
        n_s = np.array([model.shape.exponent for model in shared.refined])[self.region_of(part.pixels)]
        arrays.write_numbers(
            part.pixels,
            {
                "k_d": k.k_d,
                "k_s": k.k_s,
                "n_s": n_s[None],
                "normal": normal,
                "status": status[None],
                "residual": k.residual[None],
            },
        )
        cell = cells_of(part.pixels, self.tiles.reader.shape)
        for v in range(len(scratch.doubts)):
            for i, of in enumerate((k.doubted[v], k.counts[v])):
                scratch.doubts[v, :, i] = np.bincount(cell, of, CELLS * CELLS)
        if scratch.unexplained is not None:
            assert k.kept is not None
            kept = k.kept.reshape(-1, len(part.pixels)).T
            scratch.unexplained.reshape(-1, kept.shape[1])[part.pixels] = kept

    def _normals(self, block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Normals:
        return normals_of(self.setup, self.known, block, model, self.light_error)

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

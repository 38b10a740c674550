"""Robust run: what the texels of an object have in common, then their numbers tile by tile, then their errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.fields import Array
from ...core.words import Note
from ...model.lobes import Blinn, Phong
from ..blocks import TexelBlock
from ..checks import check_anything_left
from ..light_directions import COPLANAR
from ..lighting import LightingSetup
from ..map_arrays import MapArrays
from ..maps import SharedHighlight, TexelMaps
from ..prediction import KnownCoefficients
from ..status import DETERMINED, LEAST_LIT_WITH_NORMAL, MAX_NORMAL_ERROR, NO_HIGHLIGHT, OUTSIDE, SHADOWED, UNDETERMINED
from ..tile_runner import TileRunner
from ..tiles import Piece, TexelTile
from .block_fits import Coefficients, Normals, Turned, coefficients_of, lights_toward, lowest_state, normals_of, turned
from .calibration import Spreads, calibrated, parts_of
from .disagreement import CELLS, disagreements, note_on_disagreements
from .highlight_shape import EXPONENTS
from .learning import Fitted, ObjectModel, first_model, fitted, learned
from .neighbours import MARGIN, geometric_median, root_mean_square, scatter_of
from .observations import observe

T = TypeVar("T")
BLOCK = 1024  # texels in one call of a compiled program: their sums over the candidates stay in a core's cache
NEAR_BLOCK, CELL = 256, 16  # with lamps nearby, whose directions differ within a block, and side of its square
LEARNING_SAMPLE, CALIBRATION_SAMPLE = 2048, 1024
FIRST_ROUNDS, ROUNDS = 4, 5  # with each lobe on a part of the sample, then with the better one on all of it
FIRST_EVERY = 3
# Share of Blinn's misfit below which the scene's lobe is kept. Real highlights follow the half vector (Ngan, Durand and
# Matusik 2005).
BETTER_LOBE = 0.85
FEWEST_OF_REGION = 64  # texels of a sample from which a region learns a highlight of its own
MISFIT_POWER = 0.4  # of a texel's misfit in its spread; the rest is the scatter of its neighbours
LEAST_FACING = 0.2  # cosine to the camera below which a spread grows no further
WORST = np.pi / 2  # largest spread of a normal
LEAST_SHARE = 0.05  # of the grey error that a channel has at least
ANGLE_68 = float(np.sqrt(-2.0 * np.log(0.32)))  # standard deviations about two axes within which 68 % lie


class RobustRun:
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
        light_error: Float[np.ndarray, " views"] | None,
    ):
        """Gather what all texels have in common.

        Args:
            setup: The lights of the views.
            known: The coefficients that are not fitted.
            loss: Name of the robust loss.
            regions: Region of each pixel, numbered from 0 without gaps; None makes the object one.
            tiles: What reads the tiles and stores the maps.
            neighbours: Whether a normal is the median of those around it.
            light_error: Standard deviation of each view's lights about each axis, radians.
        """
        self.setup, self.known, self.loss, self.regions, self.tiles = setup, known, loss, regions, tiles
        self.neighbours, self.light_error = neighbours, light_error
        self.block = NEAR_BLOCK if tiles.reader.with_position else BLOCK

    def learn(self, sample: TexelTile) -> list[ObjectModel]:
        """Return the model of the object, or that of each region, from a sample of its texels."""
        report = self.tiles.report_progress
        given, few = self.setup.lobe, sample.part(np.arange(0, len(sample.pixels), FIRST_EVERY))
        lobes = (Blinn(),) if isinstance(given, Blinn) else (Blinn(), given)
        tried = []
        for lobe in lobes:
            self.setup = eqx.tree_at(lambda setup: setup.lobe, self.setup, lobe)
            whole = first_model(self.loss)
            for k in range(FIRST_ROUNDS):
                report(f"learning the highlight, {type(lobe).__name__}:", (k + 1) / FIRST_ROUNDS)
                whole = learned(whole, self.sample_at_minimum(few, whole))
            tried.append(whole)
        better = int(len(tried) == 2 and tried[1].relative_misfit < BETTER_LOBE * tried[0].relative_misfit)
        self.setup = eqx.tree_at(lambda setup: setup.lobe, self.setup, lobes[better])
        whole = tried[better]
        for k in range(ROUNDS):
            report("learning the highlight:", (k + 1) / ROUNDS)
            whole = learned(whole, self.sample_at_minimum(sample, whole))
        if self.regions is None:
            return [whole]
        models = []
        for region in range(int(self.regions.max()) + 1):
            part = sample.part(np.flatnonzero(self.regions[sample.pixels] == region))
            model = whole
            if len(part.pixels) >= FEWEST_OF_REGION:
                for _ in range(ROUNDS):
                    model = learned(model, self.sample_at_minimum(part, model))
            models.append(model)
        return models

    def sample_at_minimum(self, sample: TexelTile, model: ObjectModel) -> Fitted:
        """Return the texels of a sample at their minimum."""

        def program(block: TexelBlock) -> Fitted:
            observed = observe(self.setup, self.known, block)
            return fitted(observed, model, lowest_state(observed, model))

        return self.each(sample, lambda block, *_: program(block), [model])

    def maps(self, models: Sequence[ObjectModel], notes: tuple[str, ...]) -> TexelMaps:
        """Fit all texels, tile by tile, and return their maps."""
        tiles, store, reader = self.tiles, self.tiles.store, self.tiles.reader
        arrays = MapArrays(store, ("k_d", "k_s", "n_s", "normal"), reader.shape, reader.channels)
        spread = store.array("spread", (*reader.shape, 4), np.float32)
        doubts = store.array("doubts", (tiles.count, len(reader.views), CELLS * CELLS, 2), np.float32)

        def fit(t: int, tile: TexelTile) -> None:
            if len(tile.pixels):
                self._fit_tile(tiles.rows_of(t), tile, models, arrays, spread, doubts[t])
            store.finish(t)

        tiles.each_tile(fit, store.done, "fitted", margin=MARGIN)
        store.wait_for_all()
        check_anything_left(arrays.arrays["status"])
        tiles.report_progress("fitting halves of the lights")
        times = self._errors(models, arrays, spread)
        store.wait_for_all()
        note = note_on_disagreements(disagreements(doubts.sum(0)), reader.shape)
        notes = (*notes, *note, *self._note_on_lobe())
        scene = eqx.tree_at(lambda scene: scene.objects[0].material.lobe, reader.scene, self.setup.lobe)
        maps = TexelMaps(
            arrays.values(),
            arrays.errors(),
            store.read("status")[..., 0],
            store.read("residual")[..., 0],
            scene,
            reader.camera,
            notes,
            times,
            self._highlights(models),
        )
        if store.folder is not None and store.first:
            maps.describe(store.folder)
        return maps

    def _fit_tile(
        self,
        rows: tuple[int, int],
        tile: TexelTile,
        models: Sequence[ObjectModel],
        arrays: MapArrays,
        spread: Float[np.ndarray, "h w 4"],
        doubts: Float[np.ndarray, "views cells 2"],
    ) -> None:
        """Fit the texels of a tile that was read with those around it, and write what belongs to the tile."""
        width = self.tiles.reader.shape[1]
        found = self.each(tile, self._normals, models)
        grid = grid_of(tile.pixels, width)
        alone = grid.image(found.n.T)
        n = geometric_median(alone, grid.mask) if self.neighbours else alone
        normal = n[grid.row, grid.column].T
        own = np.flatnonzero((tile.pixels >= rows[0] * width) & (tile.pixels < rows[1] * width))
        if not len(own):
            return
        part, normal = tile.part(own), normal[:, own]
        k = self.each(part, self._coefficients, models, np.ascontiguousarray(normal, np.float32))
        misfit = root_mean_square(grid.image(np.minimum(found.spread[:1], WORST).T)[..., 0], grid.mask)
        misfit = misfit[grid.row, grid.column][own]
        if self.neighbours:
            around = scatter_of(alone, grid.mask)[grid.row, grid.column][own]
            misfit = misfit**MISFIT_POWER * around ** (1.0 - MISFIT_POWER)
        facing = np.maximum(found.facing[own], LEAST_FACING)
        flat = spread.reshape(-1, 4)
        flat[part.pixels] = np.stack(
            [np.minimum(misfit / facing, WORST), *(found.spread[1:, own]), found.by_lights[own]], -1
        )
        lit, plane = found.lit[own], found.plane[own]
        flat[part.pixels[(plane < COPLANAR) | (lit < LEAST_LIT_WITH_NORMAL)]] = np.inf
        status = np.where(plane < COPLANAR, UNDETERMINED, DETERMINED)
        status = np.where(lit < LEAST_LIT_WITH_NORMAL, SHADOWED, status).astype(np.uint8)
        n_s = np.array([model.shape.exponent for model in models])[self._region(part)]
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
        cell = _cells(part.pixels, self.tiles.reader.shape)
        for v in range(len(doubts)):
            for i, of in enumerate((k.doubted[v], k.counts[v])):
                doubts[v, :, i] = np.bincount(cell, of, CELLS * CELLS)

    def _errors(
        self, models: Sequence[ObjectModel], arrays: MapArrays, spread: Float[np.ndarray, "h w 4"]
    ) -> dict[str, float]:
        """Turn spreads into errors; return how many errors hold the truth 95 % of the time."""
        sample = self.tiles.reader.sample(CALIBRATION_SAMPLE)
        parts = parts_of(self._toward(sample))

        def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Turned:
            return turned(self.setup, self.known, block, model, parts)

        found = self.each(sample, program, models)
        there = spread.reshape(-1, 4)[sample.pixels].T
        held = {
            "normal": calibrated(found.angle, there[0], found.reached),
            "k_d": calibrated(np.abs(found.k_d), there[1], found.reached),
            "k_s": calibrated(np.abs(found.k_s), there[2], found.reached),
        }
        exponents = np.array([self._exponent_error(sample, model, parts) for model in models])
        for t in self.tiles.own:
            rows = slice(*self.tiles.rows_of(t))
            self._write_errors(arrays.arrays, spread, held, exponents, rows)
        return {name: one.times_95 for name, one in held.items()}

    def _write_errors(
        self,
        values: dict[str, np.ndarray],
        spread: Float[np.ndarray, "h w 4"],
        held: dict[str, Spreads],
        exponents: Float[np.ndarray, " regions"],
        rows: slice,
    ) -> None:
        """Write the errors of some rows, and what they show not to be known into the status."""
        status, here = values["status"][rows, :, 0], spread[rows]
        inside = status != OUTSIDE
        with np.errstate(invalid="ignore", over="ignore"):
            normal = np.rad2deg(np.hypot(here[..., 0] * held["normal"].errors, here[..., 3] * ANGLE_68))
            errors = {"normal": np.where(normal <= 90.0, normal, np.inf)[..., None]}
            for i, name in ((1, "k_d"), (2, "k_s")):
                value = values[name][rows]
                grey = value.mean(-1, keepdims=True)
                share = np.where(grey > 0.0, value / np.where(grey > 0.0, grey, 1.0), 1.0)  # errs as it reflects
                errors[name] = here[..., i, None] * held[name].errors * np.maximum(share, LEAST_SHARE)
        pixels = np.arange(rows.start * status.shape[1], rows.stop * status.shape[1])
        region = np.zeros(status.shape, int) if self.regions is None else self.regions[pixels].reshape(status.shape)
        relative = np.where(np.isinf(here[..., 0]), np.inf, exponents[region])
        errors["n_s"] = (np.where(inside, relative, 0.0) * np.maximum(values["n_s"][rows, :, 0], 1.0))[..., None]
        for name, error in errors.items():
            values[f"{name}_error"][rows] = np.where(inside[..., None] & ~np.isnan(error), error, 0.0)
        large = values["normal_error"][rows, :, 0] > np.rad2deg(MAX_NORMAL_ERROR)
        dull = (values["k_s"][rows] <= values["k_s_error"][rows]).all(-1)
        status[(status == DETERMINED) & dull] = NO_HIGHLIGHT
        status[((status == DETERMINED) | (status == NO_HIGHLIGHT)) & large] = UNDETERMINED

    def _exponent_error(self, sample: TexelTile, model: ObjectModel, parts: Bool[np.ndarray, "parts views"]) -> float:
        """Return the relative error of n_s: by how much it changes when parts of the views alone are learned from."""
        if np.isinf(float(model.brightest)):
            return np.inf
        changes = []
        for part in parts:
            of_part = eqx.tree_at(lambda tile: tile.counts, sample, sample.counts & part[:, None])
            other = learned(model, self.sample_at_minimum(of_part, model))
            changes.append(abs(np.log(other.shape.exponent / model.shape.exponent)))
        return float(np.expm1(np.sqrt(len(parts) - 1.0) * max(changes)))

    def _normals(self, block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Normals:
        return normals_of(self.setup, self.known, block, model, self.light_error)

    def _coefficients(self, block: TexelBlock, model: ObjectModel, n: np.ndarray | None) -> Coefficients:
        assert n is not None
        return coefficients_of(self.setup, self.known, block, model, n)

    def each(
        self,
        tile: TexelTile,
        program: Callable[[TexelBlock, ObjectModel, np.ndarray | None], T],
        models: Sequence[ObjectModel],
        given: Float[np.ndarray, "3 n"] | None = None,
    ) -> T:
        """Return what a program gives for all texels of a tile, each by its region's model.

        Args:
            tile: The texels.
            program: Takes a block, a model, and the block's part of `given`.
            models: The model of each region, or one for all texels.
            given: Numbers of each texel.
        """
        reader = self.tiles.reader
        region = self._region(tile) if len(models) > 1 else np.zeros(len(tile.pixels), int)
        no_exponent = np.zeros((2, len(tile.pixels)))
        pieces: list[tuple[Piece, ObjectModel]] = []
        for r, model in enumerate(models):
            which = np.flatnonzero(region == r)
            if reader.with_position:  # lamps nearby: texels of one square of the image make a block
                row, column = np.divmod(tile.pixels[which], reader.shape[1])
                which = which[np.lexsort((column // CELL, row // CELL))]
            starts = range(0, len(which), self.block)  # blocks of one size: a texel's numbers are the same in any band
            pieces += [(Piece(tile, which[i : i + self.block], self.block, no_exponent), model) for i in starts]

        def of_piece(item: tuple[Piece, ObjectModel]) -> T:
            piece, model = item

            def of_block(block: TexelBlock) -> T:
                padded = np.concatenate([piece.part, np.full(piece.size - len(piece.part), piece.part[0])])
                return program(block, model, None if given is None else given[:, padded])

            return self.tiles.evaluate(of_block, piece)

        found = jax.tree.map(lambda *parts: np.concatenate(parts, -1), *self.tiles.on_all(of_piece, pieces))
        order = np.argsort(np.concatenate([piece.part for piece, _ in pieces]), kind="stable")
        return jax.tree.map(lambda leaf: leaf[..., order], found)

    def _region(self, tile: TexelTile) -> Int[np.ndarray, " n"]:
        """Return the region of each texel."""
        return np.zeros(len(tile.pixels), int) if self.regions is None else self.regions[tile.pixels]

    def _toward(self, sample: TexelTile) -> Float[np.ndarray, "views 3"]:
        """Return the mean direction from some texels to the lights of each view."""

        def program(block: TexelBlock, _: ObjectModel, __: np.ndarray | None) -> Float[np.ndarray, "views 3 n"]:
            return lights_toward(self.setup, block)

        mean = self.each(sample, program, [first_model(self.loss)]).mean(-1)
        length = np.linalg.norm(mean, axis=-1, keepdims=True)
        return mean / np.where(length > 0.0, length, 1.0)

    def _note_on_lobe(self) -> tuple[Note, ...]:
        """Return a note where the highlight has another lobe than the scene's."""
        given, taken = self.tiles.reader.scene.objects[0].material.lobe, self.setup.lobe
        if type(given) is type(taken):
            return ()
        more = ", whose n_s is about four times that of the same highlight by Phong" if isinstance(given, Phong) else ""
        return (Note(f"the highlight is {type(taken).__name__}'s (n.h){more}.", "lobe"),)

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


class _Grid(NamedTuple):
    """The rows of the image that some texels lie in."""

    mask: Bool[np.ndarray, "h w"]
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]

    def image(self, values: Float[Array, "n _"]) -> Float[np.ndarray, "h w _"]:
        """Return the values of the texels as an image, 0 elsewhere."""
        found = np.zeros((*self.mask.shape, values.shape[1]))
        found[self.row, self.column] = values
        return found


def grid_of(pixels: Int[np.ndarray, " n"], width: int) -> _Grid:
    """Return the rows that some pixels lie in."""
    row, column = np.divmod(pixels, width)
    row = row - row.min()
    mask = np.zeros((int(row.max()) + 1, width), bool)
    mask[row, column] = True
    return _Grid(mask, row, column)


def _cells(pixels: Int[np.ndarray, " n"], shape: tuple[int, int]) -> Int[np.ndarray, " n"]:
    """Return the cell of a coarse grid over the image that each pixel lies in."""
    row, column = np.divmod(pixels, shape[1])
    return row * CELLS // shape[0] * CELLS + column * CELLS // shape[1]

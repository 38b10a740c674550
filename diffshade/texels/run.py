"""Run: the stages of a fit of texels over all tiles: lights, noise, region exponents, typical residuals, maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..core.thresholds import NEGLIGIBLE, SLIGHT
from ..inverse.data.views import View
from ..model.lobes import EXPONENT_RANGE
from ..model.scenes import Scene
from .blocks import FitOptions, TexelBlock, scatter_of_block
from .checks import check_anything_left
from .descent import GRID
from .estimates import Estimates, estimate, estimate_few
from .light_directions import LightDistribution, light_distribution
from .lighting import lighting_setup
from .map_arrays import MapArrays
from .maps import TexelMaps
from .minima import residual_sizes
from .prediction import COEFFICIENTS, KnownCoefficients
from .region_exponents import MAX_PASSES, by_region, grid_costs, next_exponents, slopes
from .status import TypicalResidual
from .tile_runner import TileRunner
from .tiles import LEARNING_SAMPLE, TexelPart, TexelTile

FIRST_STEPS, MORE_STEPS = 8, 60  # steps at most for all texels, and for the few that have not converged then
NOISE_SAMPLE = 2 * LEARNING_SAMPLE  # texels from which the scale of a robust loss is found
TYPICAL_SAMPLE = 256  # texels from which the distribution of the lights and the typical residual are found
SCALE_ROUNDS = 4  # of the scale of a robust loss, unless it settles before


class Exponents(NamedTuple):
    """log n_s of each region, and its standard error."""

    x: Float[np.ndarray, " regions"]
    error: Float[np.ndarray, " regions"]


class TexelRun:
    """One fit of texels: what is known of the scene, and the tiles that it works on."""

    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        free: tuple[str, ...],
        loss: str,
        regions: Int[np.ndarray, " pixels"] | None,
        tiles: TileRunner,
    ):
        """Gather what all texels have in common.

        Args:
            scene: One object and its lights.
            views: The photographs.
            free: Names of the numbers to fit.
            loss: Name of the loss.
            regions: Region of each pixel, numbered from 0 without gaps; None fits n_s at each texel.
            tiles: What reads the tiles and stores the maps.
        """
        self.scene, self.regions, self.tiles = scene, regions, tiles
        homoscedastic = all(view.noise is None or view.noise.is_uniform for view in views)
        self.options = FitOptions(free, loss, homoscedastic, known_noise=views[0].noise is not None)
        self.setup = lighting_setup(scene, views)
        self.known = known_coefficients(scene, free, tiles.reader.channels)
        self.log_n_s = float(np.log(np.maximum(scene.objects[0].material.n_s, EXPONENT_RANGE[0])))

    @cached_property
    def typical_sample(self) -> TexelTile:
        """Some texels, by which the lights and the typical residual are judged."""
        return self.tiles.reader.sample(TYPICAL_SAMPLE)

    def maps(self, lights: LightDistribution | None, notes: tuple[str, ...]) -> TexelMaps:
        """Fit all texels, tile by tile, and return their maps.

        Args:
            lights: How the lights are distributed, where normals are free.
            notes: What is known before the fit.
        """
        options = self.options if lights is None else self.options._replace(narrow=lights.narrow)
        sigma = np.asarray(1.0 if options.known_noise or options.loss == "squares" else self._noise_scale())
        exponents = None if self.regions is None else self._region_exponents(sigma)
        if exponents is not None:
            options = options.without("n_s")._replace(shared=True)
        typical = self._typical_residual(self.typical_sample, options, sigma, exponents)
        return self._fit_all(options, sigma, typical, exponents, notes)

    def estimates(self, tile: TexelTile) -> Estimates:
        """Return the estimates of a few texels, by squares, with a program that is soon compiled."""
        options = self.options._replace(loss="squares")
        return self._fit(tile, options, np.asarray(1.0), unlimited(), None, FIRST_STEPS, program=estimate_few)

    def _fit_all(
        self,
        options: FitOptions,
        sigma: np.ndarray,
        typical: TypicalResidual,
        exponents: Exponents | None,
        notes: tuple[str, ...],
    ) -> TexelMaps:
        """Fit the tiles that are not done and return the maps of all."""
        store, reader = self.tiles.store, self.tiles.reader
        arrays = MapArrays(store, self.options.free, reader.shape, reader.channels)

        def fit(t: int, tile: TexelTile) -> None:
            if len(tile.pixels):
                arrays.write(tile.pixels, self._fit_to_the_end(tile, options, sigma, typical, exponents))
            store.finish(t)

        self.tiles.each_tile(fit, store.done, "fitted")
        store.wait_for_all()
        check_anything_left(arrays.arrays["status"])
        status, residual = (store.read(name)[..., 0] for name in ("status", "residual"))
        return TexelMaps(arrays.values(), arrays.errors(), status, residual, self.scene, reader.camera, notes)

    def _fit_to_the_end(
        self,
        tile: TexelTile,
        options: FitOptions,
        sigma: np.ndarray,
        typical: TypicalResidual,
        exponents: Exponents | None,
    ) -> Estimates:
        """Return the estimates of a tile, with more steps for the texels that have not converged after the first."""
        found = self._fit(tile, options, sigma, typical, exponents, FIRST_STEPS)
        slow = np.flatnonzero(~found.converged)
        if not len(slow):
            return found
        again = self._fit(tile, options, sigma, typical, exponents, MORE_STEPS, slow)

        def replace_slow(all_texels: np.ndarray, of_slow: np.ndarray) -> None:
            all_texels[..., slow] = of_slow

        jax.tree.map(replace_slow, found, again)
        return found

    def _fit(
        self,
        tile: TexelTile,
        options: FitOptions,
        sigma: np.ndarray,
        typical: TypicalResidual,
        exponents: Exponents | None,
        max_steps: int,
        which: Int[np.ndarray, " m"] | None = None,
        program: Callable[..., Estimates] = estimate,
    ) -> Estimates:
        """Return the estimates of a tile, or of some of its texels."""

        def of_block(block: TexelBlock) -> Estimates:
            return program(self.setup, self.known, block, sigma, typical, np.asarray(max_steps), options)

        pieces = self.tiles.reader.pieces(tile, self._log_n_s_of(tile, exponents), which)
        found = self.tiles.on_all(lambda piece: self.tiles.evaluate(of_block, piece), pieces)
        return jax.tree.map(lambda *parts: np.concatenate(parts, -1), *found)

    def lights(self) -> LightDistribution:
        """Return how the lights of some texels are distributed."""
        sample = self.typical_sample

        def program(block: TexelBlock) -> Float[Array, "3 3 texels"]:
            return scatter_of_block(self.setup, block, "k_a" in self.options.free)

        pieces = self.tiles.reader.pieces(sample, self._log_n_s_of(sample))
        found = self.tiles.on_all(lambda piece: self.tiles.evaluate(program, piece), pieces)
        return light_distribution(np.concatenate([np.zeros((3, 3, 0)), *found], -1))

    def _typical_residual(
        self, sample: TexelTile, options: FitOptions, sigma: np.ndarray, exponents: Exponents | None
    ) -> TypicalResidual:
        """Return the median residual variance of some texels; infinite where none has degrees of freedom."""
        if not len(sample.pixels):
            return unlimited()
        found = self._fit(sample, options, sigma, unlimited(), exponents, FIRST_STEPS)
        usable = np.isfinite(found.variance) & (found.level > 0.0)
        if not usable.any():
            return unlimited()
        variance, level = found.variance[usable], found.level[usable]
        return TypicalResidual(np.median(variance), np.median(variance / level))

    def _noise_scale(self) -> float:
        """Return the scale of a robust loss: the median size of the residuals of some texels, by repeated fits."""
        self.tiles.report_progress("judging the residuals")
        sample = self.tiles.reader.sample(NOISE_SAMPLE)
        sigma, options = 1.0, self.options._replace(loss="squares")
        for _ in range(SCALE_ROUNDS):
            sizes = self._residual_sizes(sample, options, sigma)
            new = float(np.median(sizes)) if len(sizes) else 1.0
            if abs(new - sigma) <= SLIGHT * new:
                break
            sigma, options = max(new, np.finfo(float).eps), self.options._replace(loss="huber")
        return sigma

    def _residual_sizes(self, tile: TexelTile, options: FitOptions, sigma: float) -> Float[np.ndarray, " observations"]:
        """Return the size of the residual of each observation of a tile that counts."""

        def program(block: TexelBlock) -> Float[np.ndarray, "views texels"]:
            return residual_sizes(self.setup, self.known, block, np.asarray(sigma), np.asarray(MORE_STEPS), options)

        def of_piece(piece: TexelPart) -> Float[np.ndarray, " observations"]:
            return self.tiles.evaluate(program, piece)[tile.counts[:, piece.part]]

        found = self.tiles.on_all(of_piece, self.tiles.reader.pieces(tile, self._log_n_s_of(tile)))
        return np.concatenate(found or [np.zeros(0)])

    def _region_exponents(self, sigma: np.ndarray) -> Exponents:
        """Return log n_s of each region: the best of the grid, then Gauss-Newton steps over all tiles."""
        assert self.regions is not None
        regions, max_steps = int(self.regions.max()) + 1, np.asarray(MORE_STEPS)

        def costs(block: TexelBlock) -> Float[np.ndarray, "grid texels"]:
            return grid_costs(self.setup, self.known, block, self.options)

        def steps(block: TexelBlock) -> Float[np.ndarray, "4 texels"]:
            return slopes(self.setup, self.known, block, sigma, max_steps, self.options)

        zero = np.zeros(regions)
        unknown = Exponents(np.full(regions, self.log_n_s), zero)
        x = GRID[np.argmin(self._sums_of_regions("search", len(GRID), costs, unknown), 0)]
        error, change = np.full(regions, np.inf), np.full(regions, np.inf)
        for k in range(MAX_PASSES):
            before = x
            x, error = next_exponents(before, self._sums_of_regions(f"pass_{k}", 4, steps, Exponents(before, zero)))
            change = np.abs(x - before)
            if (change <= NEGLIGIBLE).all():
                break
        return Exponents(x, np.maximum(error, change))  # an exponent that still changes has at least that error

    def _sums_of_regions(
        self, name: str, rows: int, program: Callable[[TexelBlock], np.ndarray], exponents: Exponents
    ) -> Float[np.ndarray, "rows regions"]:
        """Return for each region the sum over its texels of what a program gives at these exponents."""
        region_of, regions = self.regions, len(exponents.x)
        assert region_of is not None

        def of_tile(tile: TexelTile) -> np.ndarray:
            region = region_of[tile.pixels]

            def of_piece(piece: TexelPart) -> np.ndarray:
                return by_region(self.tiles.evaluate(program, piece), region[piece.part], regions)

            pieces = self.tiles.reader.pieces(tile, self._log_n_s_of(tile, exponents))  # none without the object
            return sum(self.tiles.on_all(of_piece, pieces), np.zeros((rows, regions)))

        verb = f"n_s of the regions, {name.replace('_', ' ')}:"
        return self.tiles.sum_over_tiles(name, (rows, regions), of_tile, verb)

    def _log_n_s_of(self, tile: TexelTile, exponents: Exponents | None = None) -> Float[np.ndarray, "2 n"]:
        """Return log n_s of each texel where it is not fitted, and its error: those of its region, or the scene's."""
        if exponents is not None and self.regions is not None:
            region = self.regions[tile.pixels]
            return np.stack([exponents.x[region], exponents.error[region]])
        return np.stack([np.full(len(tile.pixels), self.log_n_s), np.zeros(len(tile.pixels))])


def unlimited() -> TypicalResidual:
    """Return a typical residual by which nothing is a misfit."""
    return TypicalResidual(np.asarray(np.inf), np.asarray(np.inf))


def known_coefficients(scene: Scene, free: tuple[str, ...], channels: int) -> KnownCoefficients:
    """Return the scene's coefficients that are not free, in the channels of the photographs."""
    material = scene.objects[0].material

    def in_channels(name: str) -> Float[np.ndarray, " channels"]:
        colour = np.asarray(getattr(material, name), np.float64)
        if channels == 3:
            return colour
        if name == "k_a" and np.any(scene.ambient):  # a grey photograph shows the mean of k_a I_a
            return np.mean(colour * scene.ambient, keepdims=True) / np.mean(scene.ambient)
        return colour.mean(keepdims=True)

    k_a, k_d, k_s = (None if name in free else in_channels(name) for name in COEFFICIENTS)
    return KnownCoefficients(k_a, k_d, k_s, in_channels("k_e"))

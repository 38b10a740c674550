"""Run: the stages of a fit of texels over all tiles: lights, noise, region exponents, typical residuals, maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

from ..core.thresholds import NEGLIGIBLE, SLIGHT
from ..inverse.data.views import View
from ..model.lobes import EXPONENT_RANGE
from ..model.scenes import Scene
from .blocks import scatter_of_block
from .descent import GRID
from .estimates import Estimates, estimate, estimate_few
from .light_directions import LightDistribution, light_distribution
from .lighting import lighting_setup
from .map_arrays import MapArrays
from .maps import TexelMaps
from .minima import residual_sizes
from .prediction import COEFFICIENTS, FitOptions, KnownCoefficients, TexelBlock
from .region_exponents import MAX_PASSES, by_region, grid_costs, next_exponents, slopes
from .status import TypicalResidual
from .tile_runner import TileRunner
from .tiles import LEARNING_SAMPLE, TexelTile

T = TypeVar("T")
FIRST_STEPS, MORE_STEPS = 8, 60  # steps at most for all texels, and for the few that have not converged then
NOISE_SAMPLE = 2 * LEARNING_SAMPLE  # texels from which the scale of a robust loss is found
TYPICAL_SAMPLE = 256  # texels from which the distribution of the lights and the typical residual are found
SCALE_ROUNDS = 4  # of the scale of a robust loss, unless it settles before


class Exponents(NamedTuple):
    """log n_s of each region, and its standard error."""

    x: Float[np.ndarray, " regions"]
    error: Float[np.ndarray, " regions"]


def unlimited() -> TypicalResidual:
    """Return a typical residual by which nothing is a misfit."""
    return TypicalResidual(np.asarray(np.inf), np.asarray(np.inf))


class Settled(NamedTuple):
    """What is settled before texels are fitted."""

    options: FitOptions
    sigma: float = 1.0
    """Scale of a robust loss."""
    typical: TypicalResidual = unlimited()
    """The residuals of typical texels, by which a misfit is recognised."""
    exponents: Exponents | None = None
    """Those of regions."""


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
        settled = Settled(options)
        if not options.known_noise and options.loss != "squares":
            settled = Settled(options, self._noise_scale())
        if self.regions is not None:
            exponents = self._region_exponents(settled.sigma)
            settled = settled._replace(options=options.without("n_s")._replace(shared=True), exponents=exponents)
        settled = settled._replace(typical=self._typical_residual(settled))
        arrays = MapArrays(self.tiles, self.options.free)

        def fit(_: int, tile: TexelTile) -> None:
            found = self._fit_to_the_end(tile, settled)
            errors = {f"{name}_error": error for name, error in found.errors.items()}
            numbers = {"status": found.status[None], "residual": found.residual[None], **found.values, **errors}
            arrays.write(tile.pixels, numbers)

        arrays.fill(fit)
        return arrays.maps(self.scene, notes)

    def estimates(self, tile: TexelTile) -> Estimates:
        """Return the estimates of a few texels, by squares, with a program that is soon compiled."""
        return self._fit(tile, Settled(self.options._replace(loss="squares")), FIRST_STEPS, program=estimate_few)

    def lights(self) -> LightDistribution:
        """Return how the lights of some texels are distributed."""
        ambient = "k_a" in self.options.free
        if not len(self.typical_sample.pixels):
            return light_distribution(np.zeros((3, 3, 0)))
        return light_distribution(
            self._each(self.typical_sample, lambda block: scatter_of_block(self.setup, block, ambient))
        )

    def _fit_to_the_end(self, tile: TexelTile, settled: Settled) -> Estimates:
        """Return the estimates of a tile, with more steps for the texels that have not converged after the first."""
        found = self._fit(tile, settled, FIRST_STEPS)
        slow = np.flatnonzero(~found.converged)
        if not len(slow):
            return found
        again = self._fit(tile, settled, MORE_STEPS, slow)

        def replace_slow(all_texels: np.ndarray, of_slow: np.ndarray) -> None:
            all_texels[..., slow] = of_slow

        jax.tree.map(replace_slow, found, again)
        return found

    def _fit(
        self,
        tile: TexelTile,
        settled: Settled,
        max_steps: int,
        which: Int[np.ndarray, " m"] | None = None,
        program: Callable[..., Estimates] = estimate,
    ) -> Estimates:
        """Return the estimates of a tile, or of some of its texels."""
        options, sigma, typical, exponents = settled
        steps, scale = np.asarray(max_steps), np.asarray(sigma)

        def of_block(block: TexelBlock) -> Estimates:
            return program(self.setup, self.known, block, scale, typical, steps, options)

        return self._each(tile, of_block, exponents, which)

    def _each(
        self,
        tile: TexelTile,
        program: Callable[[TexelBlock], T],
        exponents: Exponents | None = None,
        which: Int[np.ndarray, " m"] | None = None,
    ) -> T:
        """Return what a program gives for the texels of a tile, or for some of them, at the exponents of their regions.

        log n_s and its error are the scene's where there are none.
        """
        log_n_s = np.stack([np.full(len(tile.pixels), self.log_n_s), np.zeros(len(tile.pixels))])
        if exponents is not None and self.regions is not None:
            log_n_s = np.stack(exponents)[:, self.regions[tile.pixels]]
        return self.tiles.each(lambda block, _: program(block), self.tiles.reader.pieces(tile, log_n_s, which))

    def _typical_residual(self, settled: Settled) -> TypicalResidual:
        """Return the median residual variance of some texels; infinite where none has degrees of freedom."""
        if not len(self.typical_sample.pixels):
            return unlimited()
        found = self._fit(self.typical_sample, settled, FIRST_STEPS)
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
        if not sample.counts.any():
            return sigma

        def sizes(block: TexelBlock) -> Float[np.ndarray, "views texels"]:
            return residual_sizes(self.setup, self.known, block, np.asarray(sigma), np.asarray(MORE_STEPS), options)

        for _ in range(SCALE_ROUNDS):
            new = float(np.median(self._each(sample, sizes)[sample.counts]))
            if abs(new - sigma) <= SLIGHT * new:
                break
            sigma, options = max(new, np.finfo(float).eps), self.options._replace(loss="huber")
        return sigma

    def _region_exponents(self, sigma: float) -> Exponents:
        """Return log n_s of each region: the best of the grid, then Gauss-Newton steps over all tiles."""
        assert self.regions is not None
        regions, scale, max_steps = int(self.regions.max()) + 1, np.asarray(sigma), np.asarray(MORE_STEPS)

        def costs(block: TexelBlock) -> Float[np.ndarray, "grid texels"]:
            return grid_costs(self.setup, self.known, block, self.options)

        def steps(block: TexelBlock) -> Float[np.ndarray, "4 texels"]:
            return slopes(self.setup, self.known, block, scale, max_steps, self.options)

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
            return by_region(self._each(tile, program, exponents), region_of[tile.pixels], regions)

        verb = f"n_s of the regions, {name.replace('_', ' ')}:"
        return self.tiles.sum_over_tiles(name, (rows, regions), of_tile, verb)


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

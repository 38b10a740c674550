"""Texel work: compiled programs on the texels of a tile, block by block, each with the model of its region."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

from ..between_lights import BetweenLights
from ..lighting import LightErrors, LightingSetup
from ..prediction import KnownCoefficients, TexelBlock
from ..tile_runner import TileRunner
from ..tiles import MIN_BLOCK, SQUARE, TexelPart, TexelTile
from ..unexplained import Interpolation
from .block_fits import lights_toward, lowest_state
from .learning import Fitted, ObjectModel, fitted, learned
from .observations import BlockObservations, observe
from .robust_descent import DescentState

T = TypeVar("T")
BLOCK = 1024  # texels in one call of a compiled program: their sums over the candidates stay in a core's cache
REFINING_ROUNDS = 3  # after which the shape of a highlight changes by a few percent
FEW_EVERY = 3  # one texel of so many is enough to compare lobes and to refine a shape
FEWEST_OF_REGION = 64  # texels of a sample from which a region learns a highlight of its own


class Shared(NamedTuple):
    """What the texels of an object share."""

    models: Sequence[ObjectModel]
    """One, or that of each region, by which the normals are found."""
    refined: Sequence[ObjectModel]
    """The same with the highlight's shape learned to the end, by which k_d and k_s are found."""
    brightest: Float[np.ndarray, ""]
    """Largest reflectance that was seen."""
    own_95: float
    """How many of its own spreads hold the normal of a texel 95 % of the time."""
    interpolation: Interpolation | None
    """Of what the views show beyond the model."""
    between: BetweenLights | None = None
    """What would be shown beyond it under further lights, which are interpolated between too."""

    @property
    def taken(self) -> Float[np.ndarray, "parts views"] | None:
        """What is kept of the residuals of a texel."""
        return None if self.interpolation is None else self.interpolation.taken


@dataclass
class TexelWork:
    """What is known of a scene, and the tiles of its texels."""

    setup: LightingSetup
    """The lights of the views."""
    known: KnownCoefficients
    """The coefficients that are not fitted."""
    loss: str
    """Name of the robust loss."""
    regions: Int[np.ndarray, " pixels"] | None
    """Region of each pixel, numbered from 0 without gaps; None makes the object one."""
    tiles: TileRunner
    """What reads the tiles and stores the maps."""
    stated: LightErrors | None
    """How well each view's lights are said to be known; None: nothing is said."""

    def observed(self, block: TexelBlock, model: ObjectModel) -> BlockObservations:
        """Return what the views show of a block."""
        return observe(self.setup, self.known, block, model.assumed.dark_is_shadow)

    def at_minimum(self, block: TexelBlock, model: ObjectModel) -> tuple[BlockObservations, DescentState]:
        """Return what the views show of a block, and the lowest minimum of each texel."""
        observed = self.observed(block, model)
        return observed, lowest_state(observed, model)

    def sample_at_minimum(self, sample: TexelTile, model: ObjectModel) -> Fitted:
        """Return the texels of a sample at their minimum."""

        def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Fitted:
            observed, state = self.at_minimum(block, model)
            return fitted(observed, model, state)

        return self.each(sample, program, [model])

    def refined(self, model: ObjectModel, sample: TexelTile, rounds: int = REFINING_ROUNDS) -> ObjectModel:
        """Return a model with the shape of the highlight learned to the end."""
        few = sample.part(np.arange(0, len(sample.pixels), FEW_EVERY))
        if len(few.pixels) < FEWEST_OF_REGION // FEW_EVERY:
            return model
        for _ in range(rounds):
            model = learned(model, self.sample_at_minimum(few, model), to_the_end=True)
        return model

    def each(
        self,
        tile: TexelTile,
        program: Callable[[TexelBlock, ObjectModel, np.ndarray | None], T],
        models: Sequence[ObjectModel],
        given: Float[np.ndarray, "_ n"] | None = None,
    ) -> T:
        """Return what a program gives for all texels of a tile, each by its region's model.

        Args:
            tile: The texels.
            program: Takes a block, a model, and the block's part of `given`.
            models: The model of each region, or one for all texels.
            given: Numbers of each texel.
        """
        region = self.region_of(tile.pixels) if len(models) > 1 else np.zeros(len(tile.pixels), int)
        no_exponent = np.zeros((2, len(tile.pixels)))
        pieces: list[TexelPart] = []
        for r in range(len(models)):
            which = np.flatnonzero(region == r)
            pieces += [TexelPart(tile, which[part], size, no_exponent, r) for part, size in self._blocks(tile, which)]

        def of_piece(block: TexelBlock, piece: TexelPart) -> T:
            return program(block, models[piece.region], None if given is None else given[:, piece.padded])

        found = self.tiles.each(of_piece, pieces)
        order = np.argsort(np.concatenate([piece.part for piece in pieces]), kind="stable")
        return jax.tree.map(lambda leaf: leaf[..., order], found)

    def _blocks(self, tile: TexelTile, which: Int[np.ndarray, " m"]) -> Iterator[tuple[Int[np.ndarray, " b"], int]]:
        """Yield the parts of some texels that make a block, and its size, so that bands give what a whole image does.

        Where lamps are near, whose directions to a block are searched as one, a block is a square of the image.
        """
        if not self.tiles.reader.with_position:
            starts = range(0, len(which), BLOCK)  # of one size: a texel's numbers are the same in any band
            yield from ((np.arange(i, min(i + BLOCK, len(which))), BLOCK) for i in starts)
            return
        width = self.tiles.reader.shape[1]
        row, column = np.divmod(tile.pixels[which], width)
        square = row // SQUARE * (width // SQUARE + 1) + column // SQUARE
        order = np.argsort(square, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(square[order])) + 1):
            if len(part):
                yield part, MIN_BLOCK if len(part) <= MIN_BLOCK else SQUARE * SQUARE

    def region_of(self, pixels: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return the region of each pixel, given by its index in the flattened image."""
        return np.zeros(len(pixels), int) if self.regions is None else self.regions[pixels]

    def toward(self, sample: TexelTile) -> Float[np.ndarray, "views 3"]:
        """Return the mean direction from some texels to the lights of each view."""
        pieces = self.tiles.reader.pieces(sample, np.zeros((2, len(sample.pixels))))
        mean = self.tiles.each(lambda block, _: lights_toward(self.setup, block), pieces).mean(-1)
        length = np.linalg.norm(mean, axis=-1, keepdims=True)
        return mean / np.where(length > 0.0, length, 1.0)

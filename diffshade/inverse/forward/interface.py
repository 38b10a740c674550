"""Interface of a forward model: it predicts every sample, and sums over the pixels what a Gauss-Newton step needs."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from ...core.fields import Array
from ...model.cameras import Projection
from ...model.scenes import Object
from ..data.views import Noise
from ..pixels.blocks import Block
from ..unknowns.slots import Setup, Slots
from .gram import ByView
from .losses import Likelihood
from .rounding import Rounding


class Pixels(eqx.Module):
    """Where a block's pixels are, and what of the objects comes with the pixels (`slots.apart`)."""

    row: Float[Array, "... pixels"]
    column: Float[Array, "... pixels"]
    objects: tuple[Object, ...]


class Setting(eqx.Module):
    """All that the predictions of a fit depend on, except the unknowns and the pixels."""

    setup: Setup
    slots: Slots
    projections: Projection
    lit: tuple[tuple[Int[Array, "views _"], Float[Array, "views _"]], ...]
    """For each kind of light: which of its lights are on in each view, and 1 for each, or 0 for padding."""
    grey: Float[Array, " views"]
    half_diagonal: Float[Array, " views"]
    """Half the diagonal of each view, pixels."""
    noise: Noise | None
    """The `Noise` of each view, stacked; None where it is not known."""
    rounding: Rounding
    """The steps of the views' files, once they are found."""
    shown: Int[Array, "views most"] | None
    """The unknowns that each view can show, padded with their number; None where every view shows all."""
    seeds: tuple[Float[Array, "seeds p"], Int[Array, "views most"] | None] | None
    """Directions for derivatives by all of these, and which of them has each; see `visibility.seeds_of`."""
    of_bands: tuple[Float[Array, "seeds p"], Int[Array, "bands seeds"]] | None
    """The same for the bands of a scene (`visibility.seeds_of_bands`); None where its channels are three."""
    blurred: bool = eqx.field(static=True, default=False)
    """Whether a view's sensor blurs, or may."""


class AbstractForwardModel(eqx.Module):
    """What a fit asks of the model that predicts its samples; compiled programs take it as an argument.

    A pass over the pixels calls `summary` for each chunk, adds the summaries up, and makes the Gram of the sum by
    `gram`. Memory holds one block's derivatives at a time.
    """

    setting: Setting
    likelihood: Likelihood

    @property
    def projects(self) -> bool:
        """Whether one pass gives the Gram at any linear unknowns (variable projection)."""
        return False

    @property
    def transparent(self) -> bool:
        """Whether light passes through an object: then XLA's CPU compiler is slow unless its fusion is off."""
        return any(item.material.k_t is not None for item in self.setting.setup.scene.objects)

    def seen(self, pixels: Pixels, view: Int[Array, " blocks"], counts: Bool[Array, "blocks pixels"]) -> Any:
        """Return the points that a chunk's pixels show, which are the same in all views of one camera.

        By default these are the pixels, for a model that finds the points with each prediction.
        """
        return pixels

    def lit(self, seen: Any, view: Int[Array, " blocks"]) -> Any:
        """Return what `predict` needs to know of points: `Block.points`, which known lights are a part of."""
        return seen

    def points(self, pixels: Pixels, view: Int[Array, " blocks"], counts: Bool[Array, "blocks pixels"]) -> Any:
        """Return `lit` of `seen` as a part of another program, with derivatives by the scene and the cameras."""
        return pixels

    @abstractmethod
    def predict(self, theta: Float[Array, " p"], block: Block) -> tuple[Float[Array, " pixels"], ...]:
        """Return what the samples of a block should be, unclipped, one array per channel.

        That is exposure * radiance + black, or what the view's sensor makes of it; a grey view has the channels' mean.
        """

    @abstractmethod
    def summary(self, theta: Float[Array, " p"], chunk: Block) -> Any:
        """Return the sums over a chunk from which `gram` computes the Gram of each view."""

    @abstractmethod
    def gram(self, theta: Float[Array, " p"], summary: Any) -> ByView:
        """Return the Gram of each view from the sum of the chunks' summaries."""

    def view_weights(self) -> Float[Array, " views"]:
        """Return one weight for each view (1/variance, or 1), for views whose samples all have the same weight."""
        noise = self.setting.noise
        if noise is None:
            return jnp.ones_like(self.setting.grey)
        return 1.0 / jax.vmap(lambda of_view: of_view.variance(jnp.zeros(())))(noise)

    def sample_weights(self, block: Block) -> Float[Array, "channels pixels"]:
        """Return the weight of each sample of a block; a model that projects keeps one for each view."""
        seen = block.observed
        if seen.weight is not None:
            return seen.weight
        of_view = jnp.where(block.points.counts, self.view_weights()[block.view], 0.0)
        return jnp.broadcast_to(of_view, seen.target.shape)

    def measured_weights(self, block: Block) -> Float[Array, "channels pixels"]:
        """Return the weight of each sample, 0 where it was clipped."""
        weight, clipped = self.sample_weights(block), block.observed.clipped
        return weight if clipped is None else jnp.where(clipped == 0, weight, 0.0)

    def use(self, likelihood: Likelihood) -> AbstractForwardModel:
        """Return the model with another likelihood."""
        return eqx.tree_at(lambda model: model.likelihood, self, likelihood)

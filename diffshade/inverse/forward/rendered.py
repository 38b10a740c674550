"""Rendered: the forward model of any scene, by rendering its pixels, with derivatives by `jax.linearize`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.backend import jit_quickly
from ...core.barriers import stored
from ...core.fields import Array
from ...model.bands import in_bands
from ...model.cameras import AbstractCamera, Projection
from ...model.scenes import Scene, light_kinds, together
from ...model.tracing import radiance
from ...model.vectors import Vec3
from ..data.sensors import Sensor, falloff
from ..data.views import View, camera_key, is_grey, lights_on, noises, switches
from ..pixels.blocks import Block, Observed
from ..unknowns.slots import Setup, apart, slots_of
from ..unknowns.unknown import Unknown, free_places
from ..unknowns.visibility import seeds_of, seeds_of_bands, shown_unknowns
from .gram import ByView, Gram, directions_of
from .interface import AbstractForwardModel, Setting
from .losses import Likelihood
from .rounding import no_rounding


# The mean of a function over a Gaussian of width 1, exact for polynomials of degree 7: places and weights. u = r^2 / 2
# has the density e^-u, so two rings are at the nodes of Gauss and Laguerre, with eight places on each for the angle.
# Seven places, exact for degree 5, made k_s of a highlight of two pixels' width 1.5 % too small.
def _around() -> Float[np.ndarray, "16 3"]:
    half_squares, shares = np.polynomial.laguerre.laggauss(2)
    places = 8
    angle = (np.arange(places) + np.array([[0.0], [0.5]])) * 2.0 * np.pi / places
    radius = np.sqrt(2.0 * half_squares)[:, None]
    of_place = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel(), np.repeat(shares, places) / places
    return np.stack(of_place, -1)


AROUND = _around()


class RenderedModel(AbstractForwardModel):
    """The predictions of any scene, by rendering its pixels; derivatives by `jax.linearize`."""

    steepest: Float[Array, " p"] | None = None
    """During a search, a sample counts only if |sqrt(w) dm/dtheta| is at most this for every unknown; None: always."""

    def predict(self, theta: Float[Array, " p"], block: Block) -> tuple[Float[Array, " pixels"], ...]:
        """Return what the sensor records of a block, one array a channel; of a grey view the mean of the three."""
        setting, view = self.setting, block.view
        setup = setting.slots.insert(theta, setting.setup)
        scene = setup.scene
        lights = tuple(
            _switch(jax.tree.map(lambda leaf, index=index: leaf[index[view]], stack), on[view])
            for stack, (index, on) in zip(scene.lights, setting.lit, strict=True)
        )
        scene = eqx.tree_at(lambda s: s.lights, scene, lights)
        scene = eqx.tree_at(lambda s: s.objects, scene, together(block.points.objects, scene.objects))
        projection = jax.tree.map(lambda leaf: leaf[view], setting.projections)
        row, column = block.points.row, block.points.column
        sensor = jax.tree.map(lambda leaf: leaf[view], setup.sensor)
        grey, one = setting.grey[view] > 0, len(block.observed.target) == 1
        if scene.width == 3:
            seen = self._seen(scene, projection, row, column, sensor)
            mean = (seen.x + seen.y + seen.z) / 3.0
            channels = [mean] if one else [jnp.where(grey, mean, c) for c in (seen.x, seen.y, seen.z)]
        else:
            channels = [*in_bands(lambda grey: self._seen(grey, projection, row, column, sensor), scene)]
        if sensor is None:
            return tuple(setup.exposure[view] * channel + setup.black[view] for channel in channels)
        share = setup.exposure[view] * falloff(sensor.vignetting, projection, setting.half_diagonal[view], row, column)
        gains = sensor.gains(grey | one)[: len(channels)] if scene.width == 3 else [1.0] * len(channels)
        return tuple(
            sensor.respond(gain * share * channel + setup.black[view])
            for gain, channel in zip(gains, channels, strict=True)
        )

    def _seen(self, scene: Any, projection: Projection, row: Array, column: Array, sensor: Sensor | None) -> Vec3:
        """Return the radiance of pixels; with blur its Gaussian mean, by the places and weights of `AROUND`."""
        alone = len(scene.objects) == 1
        if sensor is None or not self.setting.blurred:
            return radiance(scene, projection.rays(row, column), projection, covered=alone)
        down, right, weight = (jnp.asarray(of)[:, None] for of in AROUND.T)
        places = row[None] + sensor.blur * down, column[None] + sensor.blur * right
        seen = radiance(scene, projection.rays(*places), projection)
        return jax.tree.map(lambda c: jnp.sum(weight * c, 0), seen)

    def summary(self, theta: Float[Array, " p"], chunk: Block) -> Gram:
        """Return the Gram of each view over the blocks of a chunk: memory for one block at a time."""
        setting, p = self.setting, theta.shape[0]
        views, most = len(setting.grey), p if setting.shown is None else setting.shown.shape[1]

        def add(total: Any, block: Block) -> tuple[Gram, None]:
            m, derivative = jax.linearize(lambda q: self.predict(q, block), theta)
            view, seen = block.view, block.observed
            if setting.of_bands is None:
                unknowns, seeds = directions_of(setting.shown, view, p)
                index = jnp.broadcast_to(unknowns, (len(m), most))
                at = jnp.broadcast_to(jnp.arange(most), index.shape)
            else:  # each band shows few of the unknowns
                seeds, index = setting.of_bands
                at = index
            J = jnp.stack(stored(jax.vmap(derivative)(seeds)))  # (channels, seeds, pixels)
            weight = seen.weight if self.steepest is None else self._gentle(J, index, seen.weight)
            terms = self.likelihood.terms(jnp.stack(m), seen.target, weight, seen.clipped)
            slope = jnp.einsum("csp,cp->cs", J, terms.slope)
            curvature = jnp.einsum("csp,ctp->cst", J * terms.curvature[:, None], J)
            added = Gram(
                total.cost.at[view].add(terms.cost.sum()),
                total.gradient.at[view, at].add(slope, mode="drop"),
                total.hessian.at[view, at[:, :, None], at[:, None, :]].add(curvature, mode="drop"),
            )
            return added, None

        zero = Gram(jnp.zeros(views), jnp.zeros((views, most)), jnp.zeros((views, most, most)))
        return jax.lax.scan(add, zero, chunk)[0]

    def _gentle(self, J: Array, index: Array, weight: Array) -> Array:
        """Return the weights of samples that are not too steep, 0 of others; an index beyond the unknowns is none."""
        limit = jnp.asarray(self.steepest).at[index].get(mode="fill", fill_value=jnp.inf)[:, :, None]
        return jnp.where(jnp.all(jnp.sqrt(weight)[:, None] * jnp.abs(J) <= limit, 1), weight, 0.0)

    def gram(self, theta: Float[Array, " p"], summary: Gram) -> ByView:
        """Return the Gram of each view from the sum of the chunks' summaries."""
        return ByView(summary.cost, summary.gradient, summary.hessian, self.setting.shown)


def costs(likelihood: Likelihood, m: Sequence[Any], observed: Observed) -> list[Any]:
    """Return the likelihood's terms of predictions, channel by channel."""
    clipped = [None] * len(m) if observed.clipped is None else observed.clipped
    return [likelihood.terms(*of) for of in zip(m, observed.target, observed.weight, clipped, strict=True)]


def prepare(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Setting:
    """Gather all that predictions depend on, except the values of the unknowns and the pixels."""
    shown = shown_unknowns(scene, views, unknowns)
    over_pixels, rest = apart(scene)
    setup = Setup.of(rest, views)
    blurred = setup.sensor is not None and (
        bool((setup.sensor.blur > 0.0).any())
        or any(place.fields == ("sensor", "blur") for place in free_places(unknowns))
    )
    if blurred and jax.tree.leaves(over_pixels):
        raise ValueError(
            "Sensor.blur needs the surface between the pixels, and the scene has a GBuffer or coefficients over the "
            "pixels. Give blur=0 and leave sensor.blur out of free, or give a surface and materials that are known "
            "everywhere."
        )
    return Setting(
        setup,
        slots_of(rest, views, unknowns),
        projections_of(views),
        _lit(scene, views),
        np.array([1.0 * is_grey(view) for view in views]),
        np.array([0.5 * np.hypot(*view.camera.shape) for view in views]),
        noises(views),
        no_rounding(len(views)),
        shown,
        seeds_of(shown, len(unknowns)),
        None if len(scene.channels) == 3 or shown is not None else seeds_of_bands(scene, unknowns),
        blurred,
    )


def _switch(lights: Any, on: Array) -> Any:
    """Return the lights with every colour that is off at 0."""

    def colours(light: Any) -> list[Any]:
        return [colour for colour in (light.intensity, light.ambient, light.specular) if colour is not None]

    return eqx.tree_at(colours, lights, [colour * on[:, None] for colour in colours(lights)])


@jit_quickly
def _jitted_projection(camera: AbstractCamera) -> Projection:
    return camera.projection()


def projection_of(camera: AbstractCamera) -> Projection:
    """Return a camera's rays as NumPy numbers."""
    return jax.tree.map(np.asarray, _jitted_projection(camera))


def projections_of(views: Sequence[View]) -> Projection:
    """Return the rays of the views' cameras, stacked; equal cameras are asked once."""
    keys = [camera_key(view.camera) for view in views]
    cameras = {key: view.camera for key, view in zip(keys, views, strict=True)}
    each = {key: projection_of(camera) for key, camera in cameras.items()}
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(each[key] for key in keys))


def _lit(scene: Scene, views: Sequence[View]) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return for each kind of light which of its lights are on in each view, padded to the same number."""
    kinds = light_kinds(scene.lights)
    on = [[[of.index(i) for i in lights_on(scene, view) if i in of] for view in views] for of in kinds]
    return tuple(switches(rows) for rows in on)

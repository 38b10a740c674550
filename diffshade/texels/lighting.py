"""Lighting setup: the lights of each view and how it was exposed, which is known and the same for every texel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..inverse.data.views import Noise, View, is_grey, lights_on, noises, switches
from ..model.lights import AbstractEmitter
from ..model.lobes import AbstractPowerLobe
from ..model.reflection import stacked_emitters
from ..model.scenes import Scene, light_kinds, stack_scene


class LightErrors(NamedTuple):
    """How well the light of each view is known."""

    direction: Float[np.ndarray, "views 3 3"]
    """A root of the covariance of the unit vector to it."""
    brightness: Float[np.ndarray, " views"]
    """Relative standard deviation."""
    alike: Float[np.ndarray, "patterns views"] | None = None
    """Relative changes of the brightness that all views share, one standard deviation each; None: there are none."""

    @classmethod
    def within(cls, angle: Float[np.ndarray, " views"]) -> LightErrors:
        """Return the errors of directions known to an angle (radians) about each axis, of brightness known exactly."""
        return cls(angle[:, None, None] * np.eye(3), np.zeros(len(angle)))


class Exposures(NamedTuple):
    """How much more each photograph shows than its exposure says, found from all texels of an object, and undone."""

    factor: Float[np.ndarray, "views channels"]
    """1 in the median."""
    error: Float[np.ndarray, " views"]
    """Relative standard error of the brightness, which the channels share."""
    directions: Float[np.ndarray, "views 3"]
    """Unit vectors to the light of each view, as found together with the exposures."""


class Shifts(NamedTuple):
    """How far what each photograph shows is moved in the picture, found from all texels of an object, and undone."""

    pixels: Float[np.ndarray, "views 2"]
    """To the right and down, 0 in the median."""
    error: Float[np.ndarray, "views 2"]
    """Their standard errors."""
    undone: Bool[np.ndarray, " views"]
    """Which of them were undone: those that are clear."""


class LightingSetup(eqx.Module):
    """The lights of each view, its exposure and its noise."""

    stacks: tuple[AbstractEmitter, ...]
    """The emitters of each kind of light, stacked along a leading axis."""
    lit: tuple[tuple[Int[Array, "views _"], Float[Array, "views _"]], ...]
    """For each kind the indices of the emitters that are on in each view, and their weights: 1, or 0 for padding."""
    exposure: Float[Array, " views"]
    black: Float[Array, " views"]
    ambient: Float[Array, " channels"]
    noise: Noise | None
    """The noise of each view, stacked; None where it is not known."""
    lobe: AbstractPowerLobe
    grey_images: bool = eqx.field(static=True)
    """Whether a photograph has one channel, the mean of three."""
    grey_lights: bool = eqx.field(static=True)
    """Whether all light is grey, so that all channels have the same shading."""


def lighting_setup(scene: Scene, views: Sequence[View]) -> LightingSetup:
    """Return the lighting of the views of a scene."""
    grey = is_grey(views[0])
    stacks, lit = [], []
    for members, stack in zip(light_kinds(scene.lights), stack_scene(scene).lights, strict=True):
        on = [[members.index(i) for i in lights_on(scene, view) if i in members] for view in views]
        emitters = stacked_emitters(stack)
        each = len(jax.tree.leaves(emitters)[0]) // len(members)
        rows = [[i * each + k for i in row for k in range(each)] for row in on]
        if any(rows):
            stacks.append(emitters)
            lit.append(switches(rows))
    intensities = np.concatenate([np.reshape(stack.intensity, (-1, 3)) for stack in stacks] or [np.zeros((1, 3))])
    lobe = scene.objects[0].material.lobe
    assert isinstance(lobe, AbstractPowerLobe)  # as `checks` has seen
    return LightingSetup(
        tuple(stacks),
        tuple(lit),
        np.array([float(view.exposure) for view in views]),
        np.array([float(view.black) for view in views]),
        np.mean(scene.ambient, keepdims=True) if grey else np.asarray(scene.ambient),
        noises(views),
        lobe,
        grey_images=grey,
        grey_lights=bool((intensities == intensities[:, :1]).all()),
    )

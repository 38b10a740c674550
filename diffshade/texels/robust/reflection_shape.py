r"""Reflection shape: how bright k_d and k_s are at each angle, shared by all texels of an object or a region.

$$ S = \sum_j w_j (\cos)_+^{p_j}, \quad p_j = 4 \cdot 2^j, \quad w_j \ge 0, \quad \sum_j w_j = 1 $$

Real highlights have a narrow core and long tails, which no single exponent has, and one texel shows too little of its
highlight to say where in between it lies.

k_d reflects by a `DiffuseLaw`, which is Lambert's unless another one predicts photographs clearly better.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...core.thresholds import SLIGHT
from ...core.words import Note
from ...model.diffuse_laws import LAMBERT, DiffuseLaw
from ...model.lobes import AbstractPowerLobe, AbstractReflectance, Blinn, Phong
from ...model.vectors import Vec3

EXPONENTS = tuple(4.0 * 2.0**j for j in range(9))
FIRST = 4  # index of the exponent, 64, that learning begins with


class ReflectionShape(eqx.Module):
    """The weights of the powers of a highlight, and the law of k_d."""

    weight: Float[Array, " powers"]
    diffuse: DiffuseLaw

    def at(self, cosine: Float[Array, "..."]) -> tuple[Array, Array]:
        """Return S and its derivative by the cosine, at cosines from 0 to 1."""
        value = slope = jnp.zeros_like(cosine)
        for exponent, weight, power in zip(EXPONENTS, self.weight, powers_of(cosine), strict=True):
            value, slope = value + weight * power, slope + exponent * weight * power
        return value, slope / jnp.maximum(cosine, 1e-3)

    @property
    def of_lambert(self) -> ReflectionShape:
        """The same highlight beside Lambert's law, as the maps' scene has it."""
        return eqx.tree_at(lambda shape: shape.diffuse, self, jax.tree.map(jnp.zeros_like, self.diffuse))

    @property
    def albedo(self) -> Array:
        """The share of light from all around that it reflects, relative to a k_d of the same size, for Blinn's lobe.

        A solid angle around h is a quarter of that around l, so that a power p reflects 8 pi / (p + 2) of it.
        """
        return jnp.asarray(self.weight) @ (8.0 / (jnp.asarray(EXPONENTS, jnp.float32) + 2.0))

    @property
    def lobes(self) -> tuple[tuple[float, float], ...]:
        """The weight and the exponent of each power that takes part."""
        return tuple((float(w), p) for w, p in zip(np.asarray(self.weight), EXPONENTS, strict=True) if w > 0.0)

    @property
    def exponent(self) -> float:
        """The n_s of the single power that is half as bright as its peak at the same angle."""
        weight = np.asarray(self.weight, np.float64)
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            bright = float(weight @ middle ** np.asarray(EXPONENTS)) > 0.5
            low, high = (low, middle) if bright else (middle, high)
        return float(np.log(0.5) / np.log(high))


def powers_of(cosine: Float[Array, "..."]) -> list[Float[Array, "..."]]:
    """Return the powers of a cosine by `EXPONENTS`, by squaring again and again."""
    powers = [(cosine * cosine) ** 2]
    for _ in EXPONENTS[1:]:
        powers.append(powers[-1] * powers[-1])
    return powers


class EitherLobe(AbstractPowerLobe):
    """One of two lobes, which a number chooses, so that the programs of a fit are compiled once for both."""

    lobes: tuple[AbstractPowerLobe, AbstractPowerLobe]
    second: Bool[Array, ""] | Float[Array, ""]
    """Whether the second is taken; among the lights of a block a number, as all else is."""

    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return the cosine of the lobe that is taken."""
        first, second = (lobe.cosine(n, l, v) for lobe in self.lobes)
        return jnp.where(self.second, second, first)


def beside_blinn(lobe: AbstractPowerLobe) -> AbstractPowerLobe:
    """Return a lobe that can be exchanged for Blinn's; Blinn's, and what can be already, as it is."""
    return lobe if isinstance(lobe, Blinn | EitherLobe) else EitherLobe((Blinn(), lobe), np.array(True))


def lobe_taken(lobe: AbstractPowerLobe) -> AbstractPowerLobe:
    """Return the lobe that is taken of two, or the only one."""
    return lobe.lobes[int(lobe.second)] if isinstance(lobe, EitherLobe) else lobe


def first_shape() -> ReflectionShape:
    """Return the shape that learning begins with."""
    return shape_of(np.eye(len(EXPONENTS))[FIRST], LAMBERT)


def shape_of(weight: Float[np.ndarray, " powers"], diffuse: DiffuseLaw) -> ReflectionShape:
    """Return the shape of these weights, small ones left out, and this law of k_d."""
    kept = np.where(weight < SLIGHT * weight.sum(), 0.0, weight)
    law = DiffuseLaw(*(np.asarray(number, np.float32) for number in diffuse))
    return ReflectionShape((kept / kept.sum()).astype(np.float32), law)


def notes_on_diffuse(shapes: Sequence[ReflectionShape]) -> tuple[Note, ...]:
    """Return a note for each way in which k_d departs from Lambert's law, in one region or all."""
    r, w = (max(map(float, numbers)) for numbers in zip(*(shape.diffuse for shape in shapes), strict=True))
    most = "up to " if len(shapes) > 1 else ""
    allowed = (
        "The normals allow for this; k_d is that of a texel that faces its light. Photographs that are not quite "
        "linear look alike, and so does light from everywhere (ambient), which adds to k_d."
    )
    rough = (
        "the surface is rough, as clay, plaster and stone are: it reflects more towards the light than Lambert's law "
        f"has it (Oren and Nayar 1994: B / A is {most}{r:.2g}). {allowed}"
    )
    translucent = (
        "light enters the surface and comes out nearby, as in wax, marble and skin, or the lamps are wide: it is "
        f"lit until {most}{np.rad2deg(np.arcsin(min(w, 1.0))):.2g} degrees beyond where the light ends. {allowed}"
    )
    told = ((r, rough, "rough"), (w, translucent, "translucent"))
    return tuple(Note(why, kind) for number, why, kind in told if number > SLIGHT)


def note_on_lobe(given: AbstractReflectance, taken: AbstractReflectance) -> tuple[Note, ...]:
    """Return a note where the highlight has another lobe than the scene's."""
    if type(given) is type(taken):
        return ()
    more = ", whose n_s is about four times that of the same highlight by Phong" if isinstance(given, Phong) else ""
    return (Note(f"the highlight is {type(taken).__name__}'s (n.h){more}.", "lobe"),)

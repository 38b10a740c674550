r"""Rounding: the effect of an integer file's steps on a fit, besides noise.

A file of 8 bits holds a value v, counted in its steps, as the nearest integer. The error is a sawtooth of v, not noise:
all pixels of one value share one error, for example the whole unlit side of an object.

$$ \frac{e}{q} = \sum_{k \ge 1} \frac{(-1)^k}{\pi k} \sin 2 \pi k v $$

Where the steps lie relative to the truth is not known. Averaged over that phase, two samples have the covariance

$$ \langle e_i e_j \rangle = q_i q_j \sum_{k \ge 1} \frac{\cos 2 \pi k (v_i - v_j)}{2 \pi^2 k^2} \, d_{ik} d_{jk} $$

(Widrow and Kollar 2008, "Quantization Noise", ch. 3 to 5): q^2/12 where they are equal, and next to nothing on average
where they are many different steps apart. Noise of standard deviation s before the rounding damps each term,
d_ik = exp(-2 pi^2 k^2 s^2/q_i^2): with half a step of it the rounding errors are independent (dither; Gray and Stockham
1993), and are part of the noise that the residuals show. The gradients of a fit, J^T W e, so have the covariance
A^T A with two rows of A for each k: the sums over all samples of d_ik q_i w_i J_i times the cosine and the sine of
2 pi k v_i, over sqrt(2) pi k. Since these are sums, one pass over the pixels computes them, tile by tile if need be.
Not all programs round to the nearest: many cut off, and some add noise of one sign first. What all samples share by
that, up to half a step, is one more row: the sum of q_i w_i J_i over sqrt(12), which no noise damps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.fields import Array
from ...core.thresholds import SLIGHT
from ...io.encodings import srgb_encode
from ..data.samples import MIN_LEVELS
from ..data.views import srgb_curve

HARMONICS = 12  # terms of the sawtooth; they have 95 % of its variance
MOST_NOISE = 0.6  # steps; with more noise, rounding is just a part of it
BITS = (8, 10, 12, 14, 16)
CHANCE = 1e-9  # largest probability that values without steps come so near to them
CURVES = (False, np.asarray), (True, srgb_encode)
FINEST = 2.0**-17  # smallest step over the largest value: finer ones are those of floats


class Rounded(NamedTuple):
    """What rounding adds to the errors of a fit."""

    rounding: Rounding
    waves: Float[np.ndarray, "views p waves"]
    """See `sums.waves`; in the solver's coordinates."""
    shared: float
    """The fraction of the residuals' mean square that comes from the rounding in the waves."""


class Rounding(eqx.Module):
    """The steps of the views' files, and the noise that was there before the rounding."""

    step: Float[Array, " views"]
    """Size of a step; 0 where a view has none."""
    srgb: Float[Array, " views"]
    """1 where the steps are equal on the sRGB curve, 0 where they are in linear values."""
    noise: Float[Array, ""]
    """Standard deviation before the rounding of a sample of weight 1."""

    @property
    def exists(self) -> bool:
        """Whether any view has steps."""
        return bool(np.any(np.asarray(self.step) > 0))

    def steps(self, view: Any, m: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Return where the levels m of a view are, counted in steps, and the size of a step there; 0 without steps."""
        step, srgb = self.step[view], self.srgb[view] > 0
        encoded, slope = srgb_curve(m)
        size = jnp.where(step > 0, step, 1.0)
        return jnp.where(srgb, encoded, m) / size, jnp.where(srgb, step / slope, step)

    def __str__(self) -> str:
        """Return the steps in words."""
        pairs = zip(np.asarray(self.step).tolist(), np.asarray(self.srgb).tolist(), strict=True)
        kinds = dict.fromkeys((f"{1.0 / step:,.0f}", srgb > 0) for step, srgb in pairs if step > 0)
        return " or ".join(f"{count} {'sRGB ' if srgb else ''}steps" for count, srgb in kinds)


def no_rounding(views: int) -> Rounding:
    """Return the steps of views that have none."""
    return Rounding(np.zeros(views), np.zeros(views), np.zeros(()))


# How the steps are found


def find_steps(values: Float[np.ndarray, " n"], levels: float = 0.0) -> tuple[float, bool]:
    """Return the step between the values of a view, and whether they are equal on the sRGB curve; 0 without steps.

    The steps are those of integers of 8 to 16 bits. Otherwise, as in a scaled file, the step is the smallest gap
    between values if all other gaps are multiples of it.

    Args:
        values: Samples that are not clipped, linear.
        levels: The number of steps if it is known, else 0.
    """
    different = np.unique(values)
    if not len(different) or not np.isfinite(different).all():
        return 0.0, False
    few = different[:: 1 + len(different) // 64]  # they refuse nearly all that have no steps
    counts = np.array([levels, *(2.0**bits - 1.0 for bits in BITS)])
    for srgb, curve in CURVES:
        counted = counts[:, None] * curve(few)
        whole = np.abs(counted - np.rint(counted)).max(1) < SLIGHT
        for count in counts[whole & (counts > 0)].tolist():
            if _on_steps(curve(different) * count, least=1 if count == levels else MIN_LEVELS):
                return 1.0 / count, srgb
    for srgb, curve in CURVES:
        if step := _common_step(curve(different)):
            return step, srgb
    return 0.0, False


def find_rounding(values: Sequence[Float[np.ndarray, " _"]], levels: Sequence[float]) -> Rounding:
    """Return the steps of views, found from their values; `levels` of each as `find_steps` has them."""
    step, srgb = np.array([find_steps(*of) for of in zip(values, levels, strict=True)], float).T
    return Rounding(step, srgb, np.zeros(()))


def _on_steps(values: Float[np.ndarray, " n"], *, least: int = MIN_LEVELS) -> bool:
    """Return whether values counted in steps are whole numbers, too many and too exactly for chance."""
    values = values[np.abs(values) > SLIGHT]
    off = _furthest(values)
    chance = max(2.0 * off, 1e-12) ** min(len(values), 20)
    return off < SLIGHT and len(values) >= least and chance < CHANCE


def _furthest(values: Float[np.ndarray, " n"]) -> float:
    return float(np.max(np.abs(values - np.rint(values)), initial=0.0))


def _common_step(values: Float[np.ndarray, " n"]) -> float:
    """Return the step of which all gaps between sorted values are multiples; 0 without one."""
    largest = np.abs(values).max()
    values = values[np.diff(values, prepend=-np.inf) > 1e-3 * FINEST * largest]  # equal but for their last digits
    gaps = np.diff(values)
    if len(gaps) < 4 * MIN_LEVELS or gaps.min() < FINEST * largest:
        return 0.0
    counts = gaps / gaps.min()
    if not _on_steps(counts):
        return 0.0
    step = float((values[-1] - values[0]) / np.rint(counts).sum())
    return step if _on_steps((values - values[0]) / step) else 0.0


# What the steps do to a fit


def sawtooth(rounding: Rounding, view: Any, m: Any, weight: Any) -> Float[np.ndarray, "waves n"]:
    """Return S of some samples predicted as m, where S^T S is the covariance of their rounding errors.

    The last row is that of all samples a step too high, over the square root of 12.
    """
    where, size = rounding.steps(view, jnp.asarray(m))
    damped = damping(rounding, jnp.asarray(weight), size)
    return np.asarray(harmonics(2.0 * jnp.pi * where, size, damped))


def damping(rounding: Rounding, weight: Array, size: Array) -> Array:
    """Return by how much the noise before the rounding damps the first term of the sawtooth."""
    return jnp.exp(-2.0 * jnp.pi**2 * rounding.noise**2 / jnp.where(weight * size > 0, weight * size**2, 1.0))


def harmonics(phase: Array, size: Array, damped: Array) -> Float[Array, "waves ..."]:
    """Return size damped^(k^2) / (sqrt(2) pi k) times the cosine and the sine of k phase, for each k; by products.

    The last is size over the square root of 12, as of all samples a step too high.
    """
    c, s = jnp.cos(phase), jnp.sin(phase)

    def following(at: tuple[Array, ...], k: Array) -> tuple[tuple[Array, ...], Array]:
        cosine, sine, height, factor = at
        rotated = cosine * c - sine * s, sine * c + cosine * s
        return (*rotated, height * factor, factor * damped**2), jnp.stack([cosine, sine]) * (height / k)[None]

    first = c, s, size * damped / (jnp.sqrt(2.0) * jnp.pi), damped**3
    waves = jax.lax.scan(following, first, jnp.arange(1.0, HARMONICS + 1.0))[1]
    return jnp.concatenate([waves.reshape(-1, *size.shape), size[None] / 12.0**0.5])


def share_of_waves(noise2: float) -> float:
    """Return the fraction of the rounding's variance in the waves, given the noise's variance in squared steps."""
    k = np.arange(1.0, HARMONICS + 1.0)
    return float(6.0 / np.pi**2 * np.sum(np.exp(-4.0 * np.pi**2 * k**2 * noise2) / k**2))

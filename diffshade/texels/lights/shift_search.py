r"""Shift search: how far photographs are moved in the picture, all of them at once, by edges and texture of an object.

Under one light s_v, as long as it is bright, a matte texel shows y_v = s_v.b, with b its k_d times its normal. A
photograph moved by d_v shows, to first order, s_v.b - d_v.grad y_v. So Newton's method finds the shifts of all
photographs at once, with b of every texel eliminated, and with lights that are free in each region of the picture: a
photograph's brightness, a light that is elsewhere, and what other laws of shading change over a region, is no shift.
Edges and texture alone tell it. Photographs are blurred first, by less and less (Lucas and Kanade, "An iterative image
registration technique", IJCAI 1981). The shift that all have in common is nobody's: their median is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ...core.robust_scale import MAD, RARE
from ...core.thresholds import CLEARLY, FAR_MORE, MINOR, MOST, SINGLE, SMALL, TINY
from ...inverse.data.views import View, colours
from ...inverse.forward.losses import CAUCHY
from ...inverse.solve.elimination import eliminate
from ...io.lazy_images import rows_of_a_tile
from ..lighting import Shifts
from ..robust.calibration import GROUPS
from ..robust.choice import FIRST_ROUNDS
from ..robust.disagreement import cells_of
from ..tiles import TexelTile
from .matte import under_unequal
from .refining import ROUNDS

BLURS = 6.0, 3.0, 1.5  # standard deviations, pixels: from far to near; the first is about how far photographs are moved
PIXELS = 1 << 18  # of a photograph, of which larger ones are averages


class Pictures(NamedTuple):
    """Photographs of an object in grey, by the intensity that their lights are said to have, and where texels are."""

    grey: Float[np.ndarray, "views h w"]
    place: Float[np.ndarray, "2 texels"]
    """Row and column in them, by regions."""
    counts: Bool[np.ndarray, "views texels"]
    ends: Int[np.ndarray, " regions+1"]
    """Where the texels of each region begin."""
    mask: Bool[np.ndarray, "h w"]
    """Where the object is said to be."""
    size: int
    """Pixels of the photographs along each side of theirs."""


class ShiftState(NamedTuple):
    """Shifts, and lights by region."""

    shift: Float[np.ndarray, "views 2"]
    light: Float[np.ndarray, "regions views 3"]
    covariance: Float[np.ndarray, "2*views 2*views"]
    misfit: Float[np.ndarray, " views"]
    """What typical texels show beyond the model, relative."""


def found_shifts(pictures: Pictures, toward: Float[np.ndarray, "views 3"]) -> Shifts | None:
    """Return how far photographs are moved; None where none is moved clearly.

    A photograph is, which is moved by half a pixel and three errors, and clearly nearer to the others with it undone.
    The errors contain how the regions disagree, and what all of them share of what a matte model leaves out: how far
    shifts change with less detail and with dimmer observations. What only a clear shift needs is computed only for one.
    """
    state = before = _start(pictures, toward)
    for blur in BLURS:
        before, state = state, _aligned(pictures, state, blur, MOST)
    shift = state.shift - np.median(state.shift, 0)
    if (np.abs(shift) > MOST).any(1).mean() > MOST:  # none is where most are: the mask says where they belong
        shift = shift + _beside_mask(pictures, shift)
    if not (np.abs(shift) > MOST).any():
        return None
    dim = _aligned(pictures, state, BLURS[-1], SMALL)
    left_out = sum(np.square(other.shift - state.shift).mean() for other in (before, dim)) + SMALL**2
    of_median = 1.0 + np.pi / 2.0 / len(state.shift)  # which is where they are said to be from
    error = np.sqrt(of_median * (np.diag(state.covariance).reshape(-1, 2) + left_out))
    beyond = (np.abs(shift) > np.maximum(RARE * error, MOST)).any(1)
    if not beyond.any():
        return None
    # highlights and bounced light imitate shifts: a photograph that did not move fits, held in place, at most 1.4 times
    # worse
    still = _aligned(pictures, state._replace(shift=np.zeros_like(state.shift)), BLURS[-1], MOST, moves=False)
    clear = beyond & (still.misfit > CLEARLY * np.maximum(state.misfit, TINY))
    return Shifts(pictures.size * shift[:, ::-1], pictures.size * error[:, ::-1], clear) if clear.any() else None


def _beside_mask(pictures: Pictures, shift: Float[np.ndarray, "views 2"]) -> Float[np.ndarray, "2"]:
    """Return how much farther all photographs are moved, by where they show its outline; 0 if nowhere."""
    mask, far = pictures.mask, int(BLURS[0])
    outside = ndimage.binary_dilation(mask, iterations=far) & ~mask
    inside = mask & ndimage.binary_dilation(~mask, iterations=far)
    outside[[*range(far), *range(-far, 0)]] = outside[:, [*range(far), *range(-far, 0)]] = False
    if not outside.any() or not inside.any():
        return np.zeros(2)
    mean = np.mean(
        [ndimage.shift(one, -by, order=1, mode="nearest") for one, by in zip(pictures.grey, shift, strict=True)], 0
    )
    steps = np.arange(-far, far + 1)

    def seen_in(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "rows columns"]:
        moved = np.fft.ifft2(np.fft.fft2(mean) * np.fft.fft2(mask / mask.sum()).conj())
        return moved.real[np.ix_(steps, steps)]

    of_inside = seen_in(inside)
    contrast = of_inside - seen_in(outside)
    i, j = np.unravel_index(contrast.argmax(), contrast.shape)
    within = 0 < i < 2 * far and 0 < j < 2 * far
    if not within or contrast[i, j] < MOST * of_inside[i, j]:
        return np.zeros(2)

    def top(three: np.ndarray) -> float:
        return float((three[0] - three[2]) / (2.0 * (three[0] - 2.0 * three[1] + three[2])))

    return np.array([steps[i] + top(contrast[i - 1 : i + 2, j]), steps[j] + top(contrast[i, j - 1 : j + 2])])


def pictures_of(
    views: Sequence[View], intensity: Float[np.ndarray, "views 3"], sample: TexelTile, mask: Bool[np.ndarray, "h w"]
) -> Pictures:
    """Return the photographs around some texels, averaged over squares of pixels where they are large."""
    height, width = views[0].camera.shape
    row, column = np.divmod(sample.pixels, width)
    around = int(BLURS[0] * (BLURS[0] + 1.0))  # so far a blurred photograph that is moved shows of it
    top, left = max(row.min() - around, 0), max(column.min() - around, 0)
    high, wide = min(row.max() + 1 + around, height) - top, min(column.max() + 1 + around, width) - left
    size = int(np.ceil(np.sqrt(high * wide / PIXELS)))
    high, wide = high // size, wide // size

    def grey(view: View, of_light: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w"]:
        parts, end, step = [], top + high * size, size * max(rows_of_a_tile(width) // size, 1)
        light = float(view.exposure) * (of_light if view.image.shape[-1] >= 3 else of_light.mean())
        for start in range(top, end, step):
            seen = np.asarray(colours(view)[start : min(start + step, end)], np.float64)[:, left : left + wide * size]
            level = np.nan_to_num((seen - float(view.black)) / light, posinf=0.0, neginf=0.0).mean(-1)
            parts.append(level.reshape(-1, size, wide, size).mean((1, 3)))
        return np.concatenate(parts).astype(np.float32)

    place = (np.stack([row - top, column - left]) + 0.5) / size - 0.5
    box = int(np.ptp(row)) + 1, int(np.ptp(column)) + 1
    cell = cells_of((row - row.min()) * box[1] + column - column.min(), box)
    order = np.argsort(cell, kind="stable")
    ends = np.flatnonzero(np.diff(cell[order], prepend=-1, append=-1))
    images = np.stack([grey(*of) for of in zip(views, intensity, strict=True)])
    some = slice(top + size // 2, top + high * size, size), slice(left + size // 2, left + wide * size, size)
    return Pictures(images, place[:, order], sample.counts[:, order], ends, mask[some], size)


def _start(pictures: Pictures, toward: Float[np.ndarray, "views 3"]) -> ShiftState:
    """Return photographs that are not moved, under lights where they are said to be, as bright as most texels show."""
    level = np.array([_at(one, pictures.place) for one in pictures.grey])
    views, regions = len(level), len(pictures.ends) - 1
    light = np.broadcast_to(under_unequal(level, pictures.counts, toward)[1], (regions, views, 3))
    return ShiftState(np.zeros((views, 2)), light, np.zeros((2 * views, 2 * views)), np.ones(views))


def _at(image: Float[np.ndarray, "h w"], place: Float[np.ndarray, "2 texels"]) -> Float[np.ndarray, " texels"]:
    return ndimage.map_coordinates(image, place, output=np.float64, order=1, mode="nearest")


class _Matte(NamedTuple):
    """Texels at their minimum."""

    tilt: Float[np.ndarray, "texels 3"]
    inverse: Float[np.ndarray, "texels 3 3"]
    residual: Float[np.ndarray, "views texels"]
    weight: Float[np.ndarray, "views texels"]
    misfit: Float[np.ndarray, " views"]


def _matte(
    seen: Float[np.ndarray, "views texels"],
    inside: Bool[np.ndarray, "views texels"],
    light: Float[np.ndarray, "regions views 3"],
    ends: Int[np.ndarray, " regions+1"],
    bright: float,
) -> _Matte:
    """Return k_d n of each texel under a robust loss, by the observations that are as bright as this."""
    each = np.repeat(light, np.diff(ends), 0)  # (texels, views, 3)
    level = np.sqrt(np.square(seen).mean(0))
    plain = inside / (np.square(level) + (SMALL * np.median(level)) ** 2)
    seen_at_all = np.where(inside.any(0), plain.mean(0), 1.0)  # at a border, shifts leave a texel in no picture
    rounding = SINGLE * seen_at_all[:, None, None] * np.eye(3)
    weight, unit = plain * (seen > bright * level), 1.0

    def minimum(weight: Float[np.ndarray, "views texels"], unit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weighted = (weight.T[..., None] * each).swapaxes(1, 2)
        inverse = np.linalg.inv(weighted @ each + unit * rounding)
        tilt = inverse @ (weighted @ seen.T[..., None])
        return tilt[..., 0], inverse, (each @ tilt)[..., 0].T

    lit = relative = np.zeros(seen.shape)
    for _ in range(FIRST_ROUNDS):
        shown = minimum(weight, 1.0)[-1]
        lit = inside & (np.minimum(seen, shown) > bright * level)
        relative = np.abs(seen - shown) * np.sqrt(plain)
        scale = MAD * float(np.median(relative[lit])) + TINY
        weight = (
            plain * lit / (1.0 + np.square(relative / (CAUCHY * scale))) * (lit.sum(0) >= min(GROUPS, len(lit) - 1))
        )
        unit = scale**-2
    tilt, inverse, shown = minimum(unit * weight, unit)
    misfit = np.array([np.median(one[some]) if some.any() else 1.0 for one, some in zip(relative, lit, strict=True)])
    return _Matte(tilt, inverse, seen - shown, unit * weight, misfit)


def _aligned(pictures: Pictures, state: ShiftState, blur: float, bright: float, *, moves: bool = True) -> ShiftState:
    """Return the shifts at the minimum, of photographs that are blurred, by observations as bright as this."""
    blurred = np.stack([ndimage.gaussian_filter(image, blur) for image in pictures.grey])
    fields = [blurred, np.gradient(blurred, axis=1), np.gradient(blurred, axis=2)]
    edge = np.array(blurred.shape[1:])[:, None] - 1
    for _ in range(ROUNDS):
        places = pictures.place + state.shift[..., None]
        inside = ((places >= 0.0) & (places <= edge)).all(1) & pictures.counts
        seen, *slopes = (np.stack([*map(_at, images, places)]) for images in fields)
        texels = _matte(seen, inside, state.light, pictures.ends, bright)
        before, state = state, _stepped(state, texels, np.stack(slopes, 1), pictures.ends, FAR_MORE * blur, moves=moves)
        if moves and np.abs(state.shift - before.shift).max() < MINOR / FAR_MORE:
            break
    return state


def _stepped(
    state: ShiftState,
    texels: _Matte,
    slopes: Float[np.ndarray, "views 2 texels"],
    ends: np.ndarray,
    longest: float,
    *,
    moves: bool,
) -> ShiftState:
    """Return the state after one step of Newton's method, with all texels and then the lights eliminated."""
    regions, views, _ = state.light.shape
    mean = state.light.mean(0)
    number, loose = np.arange(5 * views).reshape(views, 5), FAR_MORE * SMALL  # how far a region's light may be off
    shifts, lights = number[:, :2].ravel(), number[:, 2:].ravel()
    H, gradient, answers = np.eye(2 * views) / BLURS[0] ** 2, np.zeros((regions, 2 * views)), []
    for r in range(regions):
        part = slice(ends[r], ends[r + 1])
        tilt, weight = texels.tilt[part], texels.weight[:, part]
        J = np.concatenate([slopes[..., part], -np.broadcast_to(tilt.T, (views, *tilt.T.shape))], 1)
        weighted = weight[:, None] * J
        side = (weighted.transpose(2, 0, 1)[:, None] * state.light[r].T[:, :, None]).reshape(len(tilt), 3, -1)
        S = -eliminate(texels.inverse[part], side, np.zeros((len(tilt), 3, 1)))[2]
        S[number[:, :, None], number[:, None]] += weighted @ J.swapaxes(1, 2)
        g = np.einsum("vat,vt->va", weighted, texels.residual[:, part]).ravel()
        of_lights = np.linalg.inv(S[np.ix_(lights, lights)] + np.eye(3 * views) / loose**2)[None]
        pull = (g[lights] + (state.light[r] - mean).ravel() / loose**2)[None, :, None]
        by_shift, alone, of_matrix, of_right = eliminate(of_lights, S[np.ix_(lights, shifts)][None], pull)
        H += S[np.ix_(shifts, shifts)] - of_matrix
        gradient[r] = g[shifts] - of_right[0, :, 0]
        answers.append((by_shift[0], alone[0, :, 0]))
    inverse = np.linalg.inv(0.5 * (H + H.T))
    step = -inverse @ (gradient.sum(0) + state.shift.ravel() / BLURS[0] ** 2) if moves else np.zeros(2 * views)
    step = np.clip(step, -longest, longest)
    light = state.light - np.stack([(by @ step + alone).reshape(views, 3) for by, alone in answers])
    light = light / np.median(np.linalg.norm(light.mean(0), axis=-1))  # texels take back what all have in common
    about_mean = np.eye(2 * views) - np.kron(np.full((views, views), 1.0 / views), np.eye(2))
    root = about_mean @ inverse
    spread = gradient.T @ gradient * regions / max(regions - 1, 1) + np.eye(2 * views) / BLURS[0] ** 2
    shift = about_mean @ (state.shift.ravel() + step)
    return ShiftState(shift.reshape(views, 2), light, root @ spread @ root.T, texels.misfit)

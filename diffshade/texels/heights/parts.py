"""Parts: texels whose heights are known relative to each other.

Two parts are apart where no pair of texels joins them, or where too few do. A jump along a whole line leaves the
relative height of its two sides undetermined, and a solution still joins them: at the offset at which the jump happens
to be 0 for some pairs along the line. A joint counts only if it is special: if clearly more pairs agree to one jump
than to any other.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array

from ...core.thresholds import FAR_MORE, TINY
from .discontinuities import MIN_PAIRS, OUTLIER, touched
from .regions import connected, joined, nearest
from .system import HeightGrid, HeightSystem

REACHES = (1, 2, 4, 8)  # texels: gaps of up to twice as many, between cuts or a cut and the border, are looked at
MIN_TEXELS = 50  # texels of a piece; the texels of smaller ones belong to the nearest larger one


def labels(grid: HeightGrid, cut: Bool[np.ndarray, " edges"]) -> Int[np.ndarray, " texels"]:
    """Return the part of each texel, joined by the pairs that are not cut; 0 is the largest part."""
    label = joined(grid.size, grid.start[~cut], grid.end[~cut])
    order = np.argsort(-np.bincount(label), kind="stable")
    return np.argsort(order)[label]


def cut_weak_joints(
    grid: HeightGrid,
    cut: Bool[np.ndarray, " edges"],
    differences: Float[np.ndarray, " edges"],
    deviations: Float[np.ndarray, " edges"],
    u: Float[np.ndarray, " texels"],
) -> Bool[np.ndarray, " edges"]:
    """Return the pairs that are cut, with those that join parts which hardly touch each other.

    Args:
        grid: The texels.
        cut: Which pairs are cut by now.
        differences: Of each pair.
        deviations: Their standard deviations.
        u: The heights that go with these cuts.
    """
    for reach in REACHES if cut.any() else ():
        piece = _pieces(grid, cut, reach)
        between = np.flatnonzero(piece[grid.start] != piece[grid.end])
        seams = _seams(piece, grid, between)
        jump = grid.step(u) - differences
        doubtful = [seam for seam in seams if np.mean(np.abs(jump[seam]) < OUTLIER * deviations[seam]) < 0.5]
        if not doubtful:
            continue
        # a joint draws both sides to each other: only without it the jumps are what the normals say
        apart = cut.copy()
        apart[np.concatenate(doubtful)] = True
        u = HeightSystem(grid, np.where(apart, TINY, 1.0) / deviations**2).solve(differences, u)
        jump = np.where(piece[grid.start] < piece[grid.end], 1.0, -1.0) * (grid.step(u) - differences)
        weak = [seam for seam in doubtful if not _determined(jump[seam], deviations[seam])]
        if weak:
            cut = _with_strips_joined(grid, cut, np.concatenate(weak))
    return cut


def _seams(
    piece: Int[np.ndarray, " texels"], grid: HeightGrid, between: Int[np.ndarray, " seam"]
) -> list[Int[np.ndarray, " pairs"]]:
    """Return the pairs between each two pieces."""
    one, other = piece[grid.start[between]].astype(np.int64), piece[grid.end[between]]
    key = np.minimum(one, other) * (piece.max(initial=0) + 1) + np.maximum(one, other)
    order = np.argsort(key, kind="stable")
    return [run for run in np.split(between[order], np.flatnonzero(np.diff(key[order])) + 1) if run.size]


def _with_strips_joined(
    grid: HeightGrid, cut: Bool[np.ndarray, " edges"], seam: Int[np.ndarray, " pairs"]
) -> Bool[np.ndarray, " edges"]:
    """Return the cuts with a seam, but for its pairs that join strips between the seam and the cuts to one side."""
    found = cut.copy()
    found[seam] = True
    new = seam[~cut[seam]]
    for _ in range(2):
        label = labels(grid, found)
        small = np.bincount(label) < MIN_TEXELS
        one, other = label[grid.start[new]], label[grid.end[new]]
        for strip, side in ((one, other), (other, one)):
            between = small[strip] & ~small[side]
            pairs = coo_array((between.astype(int), (strip, side)), (len(small), len(small)))
            most = np.asarray(pairs.tocsr().argmax(1))  # the side to which each strip has most pairs
            found[new[between & (most[strip] == side)]] = False
    return found


def _pieces(grid: HeightGrid, cut: Bool[np.ndarray, " edges"], reach: int) -> Int[np.ndarray, " texels"]:
    """Return connected pieces of the image without what is near a cut; what is near belongs to the nearest piece."""
    close = touched(grid, cut)
    group = connected(close, diagonally=True)
    close &= (np.bincount(group.ravel()) >= MIN_PAIRS)[group]  # a lone cut parts nothing
    away = np.asarray(scipy.ndimage.distance_transform_cdt(~close, "chessboard"))
    piece = connected(grid.inside & (away >= reach))
    large = np.bincount(piece.ravel()) >= MIN_TEXELS
    large[0] = False
    if not large.any():
        return np.zeros(grid.size, np.int32)
    return piece[nearest(large[piece])][grid.inside]


def _determined(jump: Float[np.ndarray, " pairs"], deviation: Float[np.ndarray, " pairs"]) -> bool:
    """Whether clearly more pairs agree to one jump than to any other."""
    order = np.argsort(jump)
    jump, width = jump[order], OUTLIER * deviation[order]

    def agreeing(jump: np.ndarray, width: np.ndarray) -> np.ndarray:
        return np.searchsorted(jump, jump + width) - np.searchsorted(jump, jump - width)

    best = int(np.argmax(number := agreeing(jump, width)))
    others = np.abs(jump - jump[best]) >= width + width[best]
    return bool(number[best] > FAR_MORE * agreeing(jump[others], width[others]).max(initial=0) + MIN_PAIRS)

"""Bands around predicted photographs of real objects: half of the photographs are fitted, the others are predicted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest
from measured import measured

import diffshade as ds

LEVEL = 0.9
SEED = 1


class Inside(NamedTuple):
    """Shares of the samples inside their bands."""

    all: float
    bright: float
    """Of those above three times the median photograph of their texel."""
    grazing: float
    """Of those where the light is within 10 degrees of the surface's plane."""
    score: float
    """Mean interval score over that of split-conformal bands of constant width."""


Fitting = Callable[[Sequence[ds.View]], ds.Fit | ds.TexelMaps]


def interval_score(image: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Width, and 2/alpha times what a sample misses it by (Gneiting and Raftery 2007, eq. 43)."""
    misses = np.maximum(lower - image, 0.0) + np.maximum(image - upper, 0.0)
    return upper - lower + 2.0 / (1.0 - LEVEL) * misses


def constant_width(fitting: Fitting, views: Sequence[ds.View]) -> tuple[ds.Fit | ds.TexelMaps, float]:
    """Split-conformal bands: a fit to half of the views, and how far 90 % of the other half's samples lie at most."""
    order = np.random.default_rng(SEED).permutation(len(views))  # every second one may be a row of lights in a plane
    half = fitting([views[i] for i in sorted(order[::2])])
    residuals = [np.abs(found.difference)[found.counts] for found in (half.predict(views[i]) for i in order[1::2])]
    return half, float(np.quantile(np.concatenate(residuals), LEVEL))


def halves(how: str) -> tuple[list[int], list[int]]:
    """Return the photographs that are fitted and the others: drawn at random, or every second one."""
    if how == "random":
        order = np.random.default_rng(SEED).permutation(48)
        return sorted(order[:24].tolist()), sorted(order[24:].tolist())
    first = ("even", "odd").index(how)
    return list(range(first, 48, 2)), list(range(1 - first, 48, 2))


def examined(name: str, fitting: Callable[[ds.Scene], Fitting], *, normals: bool, how: str) -> Inside:
    """Fit half of an object's photographs, and look at where the samples of the other half lie."""
    folder = measured(f"diligent_{name}")
    scene, views = ds.read_photographs(folder, normals=normals)
    seen, others = ([views[i] for i in part] for part in halves(how))
    fit = fitting(scene)
    bands = ds.fit_bands(fit, seen, level=LEVEL)
    half, width = constant_width(fit, seen)
    found = [bands.predict(view) for view in others]
    flat = [half.predict(view).image for view in others]
    image, lower, upper, counts = (
        np.array([getattr(p, of) for p in found]) for of in ("target", "lower", "upper", "counts")
    )
    inside = (lower <= image) & (image <= upper)
    bright = counts & (image > 3.0 * np.median([np.asarray(view.image) for view in views], 0))
    normal = np.load(folder / "normal_gt.npy")
    toward = np.loadtxt(folder / "light_directions.txt")[[light for view in others for light in view.lit or ()]]
    cosine = np.einsum("hwc,vc->vhw", normal, toward)[..., None]
    grazing = counts & (np.abs(cosine) < np.sin(np.deg2rad(10.0)))
    constant = interval_score(image, np.array(flat) - width, np.array(flat) + width)
    shares = (float(inside[part].mean()) for part in (counts, bright, grazing))
    score = float(interval_score(image, lower, upper)[counts].mean() / constant[counts].mean())
    return Inside(*shares, score=score)


def texels(scene: ds.Scene) -> Fitting:
    return lambda views: ds.fit_texels(scene, views, free=("k_d", "k_s", "n_s", "normal"))


def one_material(scene: ds.Scene) -> Fitting:
    return lambda views: ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["random", "even", "odd"])
@pytest.mark.parametrize(
    ("name", "fitting"), [("ball", texels), ("cat", texels), ("harvest", texels), ("ball", one_material)]
)
def test_bands_hold_the_other_half_of_the_photographs(name, fitting, how):
    """The even or the odd photographs leave out two of four rows of lights: one between two others, one beyond them."""
    found = examined(name, fitting, normals=fitting is one_material, how=how)
    print(name, fitting.__name__, how, found)
    assert 0.86 <= found.all <= 0.94
    assert found.bright >= 0.75
    assert found.grazing >= 0.75
    assert found.score <= 1.2

"""Whether the errors hold where all directions and intensities are fitted with the material, over many draws."""

from __future__ import annotations

import numpy as np
import pytest

import diffshade as ds
from tests.support.textured import lights_about

FREE = ("k_d", "k_s", "n_s", "direction", "intensity")
VIEWS, DRAWS = 48, 400
CAMERA = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(48, 48), height=2.2, local_viewer=False)
MATERIAL = ds.Material(k_a=0.0, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=20.0)


def lit_by(towards, intensities):
    lights = [ds.DirectionalLight(-l, intensity=i) for l, i in zip(towards, intensities, strict=True)]
    return ds.Scene(ds.Object(ds.Sphere(), MATERIAL), lights)


@pytest.mark.slow
def test_freed_lights_and_their_material_are_found_with_errors_that_cover():
    """48 lights stated 2 degrees and 5 % off, noise of .5 %: near the truth, and 95 % of it within the intervals."""
    towards, random = lights_about(VIEWS), np.random.default_rng(0)
    true = lit_by(towards, np.ones(VIEWS))
    clean = [np.asarray(ds.render(true, CAMERA, lit=i), np.float64) for i in range(VIEWS)]
    inside, near, names = [], [], np.array([])
    for _ in range(DRAWS):
        views = [ds.View(c + 0.005 * random.standard_normal(c.shape), CAMERA, lit=i) for i, c in enumerate(clean)]
        stated = lit_by(
            towards + np.deg2rad(2.0) * random.standard_normal(towards.shape),
            np.exp(0.05 * random.standard_normal(VIEWS)),
        )
        fit = ds.fit(stated, views, free=FREE, light_error=2.0, intensity_error=0.05, constraints=ds.Grey("intensity"))
        truth = fit.values_in(true)
        inside.append(np.abs(fit.values - truth) <= 1.96 * fit.errors)
        directions = np.array([-np.asarray(light.direction) for light in fit.scene.lights])  # pyright: ignore
        intensities = np.array([np.mean(light.intensity) for light in fit.scene.lights])  # pyright: ignore
        off = np.rad2deg(np.arccos(np.clip(np.sum(directions * towards, -1), -1.0, 1.0)))
        k_d = np.asarray(fit.material.k_d) / np.asarray(MATERIAL.k_d)
        near.append([np.median(off), off.max(), *np.abs(k_d * intensities.mean() - 1.0), *np.abs(k_d - 1.0)])
        near[-1].append(abs(float(fit.material.n_s) / 20.0 - 1.0))
        names = np.array(fit.names)
    share = np.mean(inside, 0)
    kinds = {kind: np.array([kind in name for name in names]) for kind in ("direction", "intensity")}
    material = ~np.any(list(kinds.values()), axis=0)
    near = np.array(near)
    print("\nwithin 1.96 errors:", dict(zip(names[material].tolist(), share[material].tolist(), strict=True)))
    print("pooled over the lights:", {kind: share[here].mean() for kind, here in kinds.items()})
    print("largest distances from the truth:", near.max(0), "median:", np.median(near, 0))
    assert ((share[material] >= 0.92) & (share[material] <= 0.98)).all()
    assert 0.93 <= share[kinds["direction"]].mean() <= 0.97
    assert 0.92 <= share[kinds["intensity"]].mean() <= 0.98  # all share one scale: as one number
    assert 0.93 <= share[~material].mean() <= 0.97
    assert np.percentile(near[:, 1], 95) < 0.1
    assert np.percentile(near[:, 2:5], 95) < 0.005
    assert np.percentile(near[:, 5:8], 95) < 0.025
    assert np.percentile(near[:, 8], 95) < 0.02

"""Rough surfaces, as of clay, drawn by NumPy: a fit by Lambert's law names them, and its errors hold."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bumpy import TO_CAMERA, oren_nayar

import diffshade as ds
from diffshade.inverse.misfit.other_scenes import _towards_light

SIDE, NOISE = 120, 0.004
TRUTH = {"k_a": (0.04, 0.03, 0.02), "k_d": (0.5, 0.4, 0.3)}


def fitted(ratio: float, k_s: float, count: int) -> tuple[ds.Fit, dict[str, float]]:
    """A fit to photographs of a sphere whose B / A is known, and the coefficients."""
    random = np.random.default_rng(count)
    row, column = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    x, y = 2.2 * column / SIDE, -2.2 * row / SIDE
    mask = x**2 + y**2 < 1.0
    normal = np.stack([x, y, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], -1) * mask[..., None]
    polar = np.deg2rad(15.0 + 45.0 * (0.618 * np.arange(count) % 1.0))
    around = 2.0 * np.pi * np.arange(count) / count + 0.4
    toward = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    camera, views = ds.OrthographicCamera((0, 0, 4), shape=(SIDE, SIDE), local_viewer=False), []
    for i, l in enumerate(toward):
        half = (l + TO_CAMERA) / np.linalg.norm(l + TO_CAMERA)
        shines = np.where(normal @ l > 0.0, k_s * np.maximum(normal @ half, 0.0) ** 40.0, 0.0)
        matte = oren_nayar(normal, l, TO_CAMERA, ratio)[..., None] * TRUTH["k_d"]
        image = mask[..., None] * (TRUTH["k_a"] + matte + shines[..., None])
        views.append(ds.View(image + NOISE * random.standard_normal(image.shape), camera, mask, lit=i))
    start = ds.Material(0.1, 0.3, 0.2, 20.0, lobe=ds.Blinn())
    lights = [ds.DirectionalLight(-l) for l in toward]
    scene = ds.Scene(ds.Object(ds.GBuffer(normal, None, mask), start), lights, ambient=(1, 1, 1))
    numbers = {f"{name}.{c}": of for name, each in TRUTH.items() for c, of in zip("rgb", each, strict=True)}
    return ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s")), numbers | {f"k_s.{c}": k_s for c in "rgb"}


@pytest.mark.thorough
@pytest.mark.parametrize("count", [1, 4, 12])
@pytest.mark.parametrize(("ratio", "k_s"), [(0.1, 0.2), (0.3, 0.0), (0.3, 0.2)])
def test_a_rough_sphere_is_named_and_its_errors_hold(ratio, k_s, count):
    fit, truth = fitted(ratio, k_s, count)
    (cause,) = [note for note in fit.notes if note.kind in ("cause", "misfit")]
    assert cause.names[0] == "rough"
    told = re.search(r"B / A is ([0-9.]*[0-9])", cause)
    assert told is not None
    assert float(told[1]) == pytest.approx(ratio, rel=0.25)
    for name, value, error, sure in zip(fit.names, fit.values, fit.errors, fit.determined, strict=True):
        if sure and name in truth and not (name.startswith("k_s") and k_s == 0.0):
            assert abs(value - truth[name]) < 2.5 * error


def test_what_a_rough_surface_adds_is_of_k_d_alone():
    camera, lights = ds.Camera((0, 0, 4), fov=35.0, shape=(24, 24)), [ds.DirectionalLight((-1, -1, -2))]
    view, added = ds.View(np.zeros((24, 24, 3)), camera), []
    chequer = ds.Chequer(0.1, 0.3, period=0.5)
    more = ds.Material(chequer, 0.5, chequer, 20.0, k_e=0.2, highlights=ds.Highlight(0.1, 200.0))
    for material in (ds.Material(0.0, 0.5, 0.0), more):
        scene = ds.Scene(ds.Object(ds.Sphere((0, 0, 0), 1.0), material), lights, ambient=(0.2, 0.2, 0.2))
        added.append(_towards_light(scene, view))
    assert added[0].max() > 0.05
    np.testing.assert_allclose(added[1], added[0], atol=1e-7)


def test_lambert_s_law_gets_no_remark():
    fit, _ = fitted(0.0, 0.2, 4)
    assert not [note for note in fit.notes if note.kind in ("cause", "misfit")]

"""Two highlights are told apart, one is not made two, and numbers of one's own parts are within their errors."""

import equinox as eqx
import numpy as np
import own_parts
import pytest
from synthetic import light_positions, noisy, one_light_each, photographs, point_lights, standard_scene

import diffshade as ds

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(64, 64))
FREE = ("k_a", "k_d", "k_s", "n_s")
LIGHTS = [ds.DirectionalLight(-l) for l in light_positions()]
COLOURS = {"k_a": 0.05, "k_d": (0.5, 0.4, 0.3), "k_s": 0.3}
TWO = ds.Material(**COLOURS, n_s=10, highlights=ds.Highlight(0.25, 100))  # pyright: ignore[reportArgumentType]
ONE = ds.Material(**COLOURS, n_s=40)  # pyright: ignore[reportArgumentType]
TOLD = ds.Material(highlights=ds.Highlight())


def fitted(truth: ds.Material, told: ds.Material, seed: int) -> ds.Fit:
    images = photographs(standard_scene(truth, LIGHTS), CAMERA)
    views = [ds.View(image, CAMERA, lit=i) for i, image in enumerate(noisy(images, 0.005, seed))]
    return ds.fit(standard_scene(told, LIGHTS), views, free=FREE)


def both_exponents(fit: ds.Fit) -> tuple[np.ndarray, np.ndarray]:
    which = [i for i, name in enumerate(fit.names) if name.endswith("n_s")]
    return fit.values[which], fit.errors[which]


@pytest.mark.parametrize("draws", [5, pytest.param(100, marks=pytest.mark.slow)])
def test_both_exponents_are_found(draws):
    inside = 0
    for seed in range(draws):
        found, errors = both_exponents(fitted(TWO, TOLD, seed))
        assert (errors < 0.15 * found).all()
        inside += bool((np.abs(found - (10, 100)) < 3 * errors).all())
    assert inside >= 0.97 * draws


@pytest.mark.slow
def test_one_highlight_fitted_to_two_is_found_out():
    examination = ds.examine(fitted(TWO, ds.Material(), 0))
    assert "second, sharper part" in examination.notes[0]
    assert "ds.Highlight" in examination.notes[0]
    assert not examination.determined[[name == "n_s" for name in examination.fit.names]].any()


def test_two_highlights_fitted_to_one_say_so():
    fit = fitted(ONE, TOLD, 0)
    one, other = (
        ("material", "highlights.0")
        if fit.determined[list(fit.names).index("material.n_s")]
        else (
            "highlights.0",
            "material",
        )
    )
    known = dict(zip(fit.names, fit.determined, strict=True))
    assert known[f"{one}.n_s"]
    assert not any(known[f"{other}.{name}"] for name in ("k_s.r", "k_s.g", "k_s.b", "n_s"))
    (note,) = [note for note in fit.notes if f"{other}.n_s is lost" in note]
    assert "one highlight fewer" in note
    assert any("listed by rising n_s" in note for note in fit.notes)


@pytest.mark.parametrize(
    "direction",
    [pytest.param((1, 0.2, 0), marks=pytest.mark.slow), (0, 1, 0), pytest.param((0, 0, 1), marks=pytest.mark.slow)],
)
def test_the_exponents_of_brushed_metal_are_found(direction):
    truth = ds.Material(0.05, 0.3, 0.4, 120, lobe=ds.Brushed(direction, 12))
    told = ds.Material(lobe=ds.Brushed((1, 0, 0)))
    images = photographs(standard_scene(truth, LIGHTS), CAMERA)
    views = [ds.View(image, CAMERA, lit=i) for i, image in enumerate(noisy(images, 0.005, 0))]
    fit = ds.fit(standard_scene(told, LIGHTS), views, free=(*FREE, "n_v", "along"))
    found = dict(zip(fit.names, zip(fit.values, fit.errors, strict=True), strict=True))
    for name, expected in (("n_s", 120), ("n_v", 12)):
        assert abs(found[name][0] - expected) < 4 * found[name][1]
        assert found[name][1] < 0.03 * expected
    along = np.array([found[f"along.{c}"][0] for c in "xyz"])
    assert np.rad2deg(np.arccos(min(abs(along @ np.array(direction)) / np.linalg.norm(direction), 1.0))) < 0.5


def own(case: str) -> tuple[ds.Scene, ds.Scene, tuple[str, ...]]:
    """The truth, what a user says, and what is free."""
    lamps = point_lights()[:3]
    if case == "Torrance and Sparrow":
        truth = standard_scene(ds.Material(0.1, 0.5, 0.2, lobe=own_parts.MicroFacets(0.2)), lamps)
        told = standard_scene(ds.Material(lobe=own_parts.MicroFacets()), lamps)
        return truth, told, ("k_a", "k_d", "k_s", "m")
    if case == "a line light":
        lines = [own_parts.TubeLight((x - 1, y, 3), (x + 1, y, 3), (0.9, 0.8, 0.7)) for x, y in ((0, 2), (2, 0))]
        truth = standard_scene(ds.Material(0.1, 0.5, 0.3, 20), lines)
        told = eqx.tree_at(lambda s: [light.end for light in s.lights], truth, [light.end + 0.05 for light in lines])
        return truth, told, ("end", "k_d")
    truth = standard_scene(ds.Material(0.1, own_parts.Marble((0.8, 0.6, 0.5), 0.2, 2.0), 0.3, 20), lamps)
    told = eqx.tree_at(lambda s: s.objects[0].material.k_d.turns, truth, np.asarray(2.05))
    return truth, told, ("k_d.a", "k_d.b", "turns", "k_s", "n_s")


@pytest.mark.slow
@pytest.mark.parametrize("case", ["Torrance and Sparrow", "a line light", "marble"])
def test_errors_of_own_numbers_cover(case):
    """20 draws, each with some ten numbers: about 95 % are within 1.96 errors."""
    truth, told, free = own(case)
    images = photographs(truth)
    expected, inside = None, []
    for seed in range(20):
        views = one_light_each(noisy(images, 0.003, seed))
        if expected is None:
            exact = ds.fit(truth, one_light_each(images), free=free, start="scene")
            expected = exact.values
        fit = ds.fit(told, views, free=free, start="search" if case == "Torrance and Sparrow" else "scene")
        inside.append(np.abs(fit.values - expected) < 1.96 * fit.errors)
    assert 0.9 <= np.mean(inside) <= 0.99, np.mean(inside, 0)

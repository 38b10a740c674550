"""Many planted faults: each is found, with its size and region, and nothing else; right data raises none."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
from measured import measured
from scenarios import PATCH, grazing, turned
from synthetic import (
    CAMERA,
    FREE,
    MATERIAL,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.diagnosis.suspicions import suspicions
from diffshade.inverse.misfit.faults import FAULTS
from diffshade.inverse.misfit.regions import GRAZING_COSINE

MATERIAL_FREE = ("k_a", "k_d", "k_s", "n_s")
MATTE = ds.Material(MATERIAL.k_a, MATERIAL.k_d, k_s=0.0, n_s=1)
BLINN = ds.Material(MATERIAL.k_a, MATERIAL.k_d, MATERIAL.k_s, n_s=50, lobe=ds.Blinn())


def fitted(images, *, scene=None, only=None, view=None, **options):
    """Fit the standard problem to these images, or the material alone to some of them."""
    views = one_light_each(images, **(view or {}))
    if only is not None:
        options = {"free": MATERIAL_FREE, **options}
        views = [views[i] for i in only]
    return ds.fit(forget(scene or standard_scene()), views, **{"free": FREE, "tied": () if only else TIED, **options})


def position(scene, light):
    lamp = scene.lights[light]
    assert isinstance(lamp, ds.PointLight)
    return np.asarray(lamp.position)


def taken_from_elsewhere(images, light, degrees):
    """The photographs, where one light stood elsewhere than the scene has it."""
    scene = standard_scene()
    there = turned(position(scene, light), degrees)
    moved = eqx.tree_at(lambda s: s.lights[light].position, scene, there)
    return [photograph(moved, CAMERA, (i,)) if i == light else image for i, image in enumerate(images)], there


def seen_from_surface(here, there):
    """Degrees between two positions from the middle of what the camera sees of the sphere."""
    buffer = seen_by(CAMERA)
    one, two = (p - np.asarray(buffer.position)[np.asarray(buffer.mask)].mean(0) for p in (here, there))
    return np.rad2deg(np.arccos(one @ two / np.linalg.norm(one) / np.linalg.norm(two)))


def shadowed(images, view):
    return [np.where(PATCH[..., None], photograph(standard_scene(), CAMERA, ()), image) if i == view else image
            for i, image in enumerate(images)]  # fmt: skip


@pytest.fixture(scope="module")
def clean():
    return photographs(standard_scene())


# --- right data raises none


@pytest.mark.parametrize("material", [MATERIAL, MATTE], ids=["glossy", "matte"])
@pytest.mark.parametrize("only", [None, (1,), pytest.param((1, 4), marks=pytest.mark.slow)], ids=str)
def test_right_data_raises_none(material, only):
    clean = photographs(standard_scene(material))
    for seed, sigma in enumerate((0.002, 0.005, 0.01, 0.02)):
        found = suspicions(fitted(noisy(clean, sigma, seed), only=only))
        assert found == (), [s.sentence for s in found]


@pytest.mark.slow
@pytest.mark.parametrize(("truth", "model"), [(BLINN, MATERIAL), (MATERIAL, BLINN)], ids=["blinn", "phong"])
@pytest.mark.parametrize("only", [None, (3,)], ids=str)
def test_a_lobe_of_the_other_form_is_named_or_within_the_noise(truth, model, only):
    clean = photographs(standard_scene(truth))
    for sigma in (0.0, 0.005, 0.02):
        found = suspicions(fitted(noisy(clean, sigma, 0), scene=standard_scene(model), only=only))
        assert {s.kind for s in found} <= {"lobe"}, [s.sentence for s in found]
        assert found or sigma > 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "options"),
    [
        ({}, {"loss": "cauchy"}),
        ({}, {"loss": "huber"}),
        ({"noise": 0.01}, {}),
        ({"noise": ds.Noise(read=0.01, shot=1e-4)}, {}),
        ({"saturation": 0.6}, {}),
        ({"saturation": 0.6}, {"clipped": "exclude"}),
        ({"saturation": 0.6, "noise": 0.01}, {"clipped": "tobit"}),
    ],
    ids=lambda options: " ".join(map(str, options)) or "plain",
)
def test_losses_noise_and_clipped_samples_raise_none(clean, view, options):
    images = noisy(clean, 0.01, 1)
    if "saturation" in view:
        images = [np.minimum(image, 0.6) for image in images]
    assert suspicions(fitted(images, view=view, **options)) == ()


@pytest.mark.slow
def test_images_that_fit_exactly_and_grey_and_8_bit_ones_raise_none(clean):
    assert suspicions(fitted(clean)) == ()
    assert suspicions(fitted([np.round(255 * image) / 255 for image in clean])) == ()
    assert suspicions(fitted([image.mean(-1) for image in noisy(clean, 0.01, 0)])) == ()


# --- encodings


@pytest.mark.parametrize("only", [None, (1,)], ids=str)
@pytest.mark.parametrize(("curve", "said"), [(ds.srgb_encode, "srgb=True"), (ds.srgb_decode, "srgb=False")])
@pytest.mark.parametrize("sigma", [0.005, pytest.param(0.02, marks=pytest.mark.slow)])
def test_an_encoding_is_found_and_nothing_else(clean, only, curve, said, sigma):
    (found,) = suspicions(fitted([curve(image) for image in noisy(clean, sigma, 1)], only=only))
    assert found.kind == "encoding"
    assert found.region is None
    assert found.views == tuple(range(1 if only else 8))
    assert said in found.sentence


@pytest.mark.parametrize(("gamma", "far"), [(1.3, 1.0), (1.0, 1.25)], ids=["gamma", "distance"])
def test_a_gamma_is_not_taken_for_lamps_at_another_distance(gamma, far):
    camera, places = ds.Camera((0, 0, 5), fov=30, shape=(48, 48)), [(2, 3, 4), (-3, 1, 4), (0, -3, 4), (3, -1, 3)]
    material = ds.Material(0.05, (0.7, 0.3, 0.2), 0.4, 30)
    told, true = (
        ds.Scene(ds.Object(ds.Sphere(), material), [ds.PointLight(np.multiply(times, p), 0.8) for p in places])
        for times in (1.0, far)
    )
    random, views = np.random.default_rng(0), []
    for i in range(4):
        image = np.asarray(ds.render(true, camera, lit=i), float) ** (1.0 / gamma)
        views.append(ds.View(image + random.normal(0.0, 0.004, image.shape), camera, lit=i))
    (cause, *_) = [n for n in ds.fit(told, views, free=("k_a", "k_d", "k_s", "n_s")).notes if "not noise" in n]
    assert ("(gamma)" in cause, "times as far away" in cause) == (gamma > 1.0, far > 1.0)


def test_an_encoding_is_found_by_a_robust_loss(clean):
    images = [ds.srgb_encode(image) for image in noisy(clean, 0.005, 1)]
    assert [s.kind for s in suspicions(fitted(images, loss="cauchy"))] == ["encoding"]


# --- exposures


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 0.94, 1.2, 2.0])
@pytest.mark.parametrize("options", [{}, {"loss": "cauchy"}], ids=["squares", "cauchy"])
def test_an_exposure_is_found_with_its_factor(clean, factor, options):
    images = [factor * image if i == 2 else image for i, image in enumerate(clean)]
    (found,) = suspicions(fitted(noisy(images, 0.005, 0), **options))
    assert (found.kind, found.views, found.region) == ("exposure", (2,), None)
    number = float(found.sentence.split(" is ")[1].split()[0])
    np.testing.assert_allclose(number, factor, rtol=0.02)
    assert "'views.2.exposure'" in found.sentence


@pytest.mark.slow
def test_of_two_views_it_is_said_that_either_may_be_wrong(clean):
    images = [clean[2], 1.2 * clean[3]]
    scene = standard_scene(lights=point_lights()[2:4])
    (found,) = suspicions(ds.fit(forget(scene), one_light_each(noisy(images, 0.005, 0)), free=MATERIAL_FREE))
    assert found.kind == "exposure"
    assert "or the other view is wrong by the inverse" in found.sentence


@pytest.mark.slow
def test_views_that_all_disagree_are_told_as_one(clean):
    """Lamps that fade, and a fit that does not know of it."""
    scene = standard_scene(lights=point_lights(ds.RadialAttenuation(1.0, 0.0, 0.0)))
    (found,) = suspicions(ds.fit(forget(scene), one_light_each(noisy(clean, 0.005, 0)), free=MATERIAL_FREE))
    assert found.kind == "exposure"
    assert len(found.views) > 4
    assert "attenuation" in found.sentence


# --- lights


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [4, 8, 20])
@pytest.mark.parametrize("only", [None, (3,)], ids=str)
def test_a_light_is_found_with_its_tilt(clean, degrees, only):
    images, there = taken_from_elsewhere(clean, 3, degrees)
    (found,) = suspicions(fitted(noisy(images, 0.005, 0), only=only))
    assert (found.kind, found.views) == ("light", (3,) if only is None else (0,))
    assert "lights.3 is" in found.sentence
    expected = seen_from_surface(position(standard_scene(), 3), there)
    np.testing.assert_allclose(float(found.sentence.split(" is ")[1].split()[0]), expected, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("grey", [False, True], ids=["colour", "grey"])
def test_a_direction_is_found_from_normals_alone(grey):
    camera = ds.OrthographicCamera((0, 0, 1), shape=CAMERA.shape, local_viewer=False)
    buffer = seen_by(CAMERA)
    surface = ds.GBuffer(buffer.normal, mask=buffer.mask)
    directions = [-np.asarray(light.position) for light in point_lights()]
    scene = lambda directions: ds.Scene(ds.Object(surface, MATERIAL), [ds.DirectionalLight(d) for d in directions])  # noqa: E731
    true = [turned(d, 6) if i == 5 else d for i, d in enumerate(directions)]
    for taken, expected in ((directions, []), (true, [(5,)])):
        images = noisy(photographs(scene(taken), camera), 0.005, 0)
        views = one_light_each([image.mean(-1) for image in images] if grey else images, camera)
        found = suspicions(ds.fit(forget(scene(directions)), views, free=MATERIAL_FREE))
        assert [s.views for s in found] == expected
        if expected:
            assert found[0].kind == "light"
            np.testing.assert_allclose(float(found[0].sentence.split(" is ")[1].split()[0]), 6, rtol=0.1)


# --- regions


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.005, 0.02])
@pytest.mark.parametrize("only", [None, (4,)], ids=str)
def test_a_cast_shadow_is_found_with_its_region(clean, sigma, only):
    (found,) = suspicions(fitted(noisy(shadowed(clean, 4), sigma, 0), only=only))
    assert (found.kind, found.views) == ("shadow", (4,) if only is None else (0,))
    assert found.region is not None
    (region,) = found.region
    assert (region & PATCH).sum() / (region | PATCH).sum() > 0.8
    assert "36 pixels" in found.sentence
    assert "row 12, column 10" in found.sentence


@pytest.mark.slow
def test_a_bright_rim_is_found(clean):
    extra = 0.15 * grazing()[..., None] ** 4 * np.array([0.6, 0.4, 0.25])
    for only in (None, (1,)):
        (found,) = suspicions(fitted(noisy([image + extra for image in clean], 0.005, 0), only=only))
        assert found.kind == "rim"
        expected = grazing() > 1.0 - GRAZING_COSINE
        assert found.region is not None
        assert all((region == expected).mean() > 0.95 for region in found.region)
        assert f"{sum(region.sum() for region in found.region):,} pixels" in found.sentence
        assert ("8 views (views[0] to views[7])" in found.sentence) == (only is None)


# --- several objects


@pytest.mark.slow
def test_two_objects_under_two_lights_at_a_time():
    camera = ds.Camera(eye=(0, 0, 5), fov=40, shape=(24, 40))
    other = ds.Material(k_a=0.05, k_d=(0.2, 0.3, 0.6), k_s=0.3, n_s=20)
    objects = (ds.Object(ds.Sphere((-0.9, 0, 0), 0.8), MATERIAL), ds.Object(ds.Sphere((0.9, 0, 0), 0.8), other))
    scene = ds.Scene(objects, point_lights())
    lit = [(0, 1), (2, 3), (4, 5), (6, 7), (1, 6)]
    moved = eqx.tree_at(lambda s: s.lights[4].position, scene, turned(position(scene, 4), 8))
    dimmed = (1, 1, 1, 0.85, 1)
    for true, factors, expected in (
        (scene, (1,) * 5, []),
        (moved, (1,) * 5, [("light", (2,))]),
        (scene, dimmed, [("exposure", (3,))]),
    ):
        images = noisy([f * photograph(true, camera, on) for f, on in zip(factors, lit, strict=True)], 0.005, 0)
        views = [ds.View(image, camera, lit=on) for image, on in zip(images, lit, strict=True)]
        found = suspicions(ds.fit(forget(scene), views, free=MATERIAL_FREE))
        assert [(s.kind, s.views) for s in found] == expected


# --- photographs


@pytest.mark.slow
def test_the_real_ball_has_two_dim_photographs_and_a_highlight_of_another_form():
    """Its third and fourth lights, nearest the camera's axis, are 5 % dimmer in every diffuse pixel than the others."""
    scene, views = ds.read_photographs(measured("diligent_ball"))
    found = suspicions(ds.fit(scene, views[:8], free=MATERIAL_FREE))
    unnamed = {fault.kind for fault in FAULTS if fault.unnamed}  # it has its own texture
    of_views = {(s.kind, s.views) for s in found if s.kind not in {*unnamed, "lobe", "highlight"}}
    assert of_views <= {("exposure", (3,)), ("exposure", (4,))}


def test_the_real_ball_read_as_srgb_is_found():
    scene, views = ds.read_photographs(measured("diligent_ball"))
    views = [eqx.tree_at(lambda v: v.image, view, ds.srgb_encode(view.image)) for view in views[:8]]
    assert [s.kind for s in suspicions(ds.fit(scene, views, free=MATERIAL_FREE))] == ["encoding"]

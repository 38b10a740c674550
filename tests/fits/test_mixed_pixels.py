"""Photographs that average over pixels: what they mix along edges is left out, and the errors allow for the rest."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy import ndimage

import diffshade as ds
from diffshade.inverse.data.mixed_pixels import SeenEdges
from diffshade.model.rendering import visible_points

BALL, BOX = ds.Sphere(), ds.Box((0, 0, 0), (1.2, 1.2, 1.2))
CAMERA = ds.Camera((1, 1.5, 4), target=(0, 0, 0), fov=32, shape=(96, 96))
SMALL = ds.OrthographicCamera((0, 0, 4), shape=(48, 48))
LIGHTS = [ds.DirectionalLight(d) for d in ((-0.5, -0.3, -1), (0.6, -0.2, -1), (0, 0.7, -1), (-0.2, -0.8, -1))]
FREE = ("k_a", "k_d", "k_s", "n_s")
WRONG = {"blur", "ellipsoid", "uneven light", "outliers", "vignetting"}


def scene_of(surface, lights):
    material = ds.Material(k_a=0.05, k_d=(0.6, 0.4, 0.2), k_s=0.3, n_s=30)
    return ds.Scene(ds.Object(surface, material), LIGHTS[:lights])


def photographed(scene, samples=1, blur=0.0, seed=0, **options):
    """A photograph under each light, each pixel the mean of rays, through a lens, with noise."""
    random, views = np.random.default_rng(seed), []
    for i in range(len(scene.lights)):
        key = jax.random.key(i) if samples > 1 else None
        image = np.asarray(ds.render(scene, CAMERA, lit=i, samples=samples, key=key), np.float64)
        image = ndimage.gaussian_filter(image, (blur, blur, 0))
        views.append(ds.View(image + 0.003 * random.standard_normal(image.shape), CAMERA, lit=i, **options))
    return views


def told_nothing(scene):
    return dataclasses.replace(scene, objects=ds.Object(scene.objects[0].surface, ds.Material(0.1, 0.3, 0.2, 10)))


@pytest.mark.parametrize(
    ("surface", "lights", "samples", "blur"),
    [
        (BALL, 1, 16, 0.0),
        (BOX, 4, 16, 0.0),
        *(
            pytest.param(*of, marks=pytest.mark.thorough)
            for of in (
                (BALL, 4, 16, 0.5),
                (BALL, 4, 16, 0.0),
                (BALL, 1, 16, 0.5),
                (BOX, 4, 16, 0.5),
                (BALL, 4, 64, 1.0),
            )
        ),
    ],
)
def test_fits_of_renders_with_many_rays_a_pixel_hold_without_a_mask(surface, lights, samples, blur):
    scene = scene_of(surface, lights)
    fit = ds.fit(told_nothing(scene), photographed(scene, samples, blur), free=FREE)
    assert fit.determined.all()
    np.testing.assert_array_less(np.abs(fit.values - fit.values_in(scene)), 3.0 * fit.errors)
    wrong = WRONG - {"blur"} if blur else WRONG
    assert not [note for note in fit.notes if note.kind == "cause" and note.names[0] in wrong]
    (note,) = [note for note in fit.notes if note.kind == "edges"]
    assert f"{fit.counts.mixed:,} pixels" in note


def test_noise_of_paths_that_a_filter_spreads_is_no_uneven_light():
    matte = ds.Scene(ds.Object(BALL, ds.Material(k_a=0.05, k_d=(0.6, 0.4, 0.2))), LIGHTS[:1])
    (sharp,), random, off, uneven = photographed(matte, 4), np.random.default_rng(0), [], 0
    for _ in range(6):
        light = sharp.image * (1.0 + 0.05 * random.standard_normal((96, 96, 1)))  # the same paths light all colours
        view = dataclasses.replace(sharp, image=ndimage.gaussian_filter(light, (0.5, 0.5, 0)))
        fit = ds.fit(told_nothing(matte), [view], free=FREE)
        off.extend(((fit.values - fit.values_in(matte)) / fit.errors)[fit.determined])
        uneven += any("uneven light" in note.names for note in fit.notes)
    assert uneven <= 1
    assert np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.thorough
def test_a_sensor_whose_blur_is_that_of_the_pixels_has_no_fault_left():
    scene = scene_of(BALL, 1)
    fit = ds.fit(told_nothing(scene), photographed(scene, 16, sensor=ds.Sensor(blur=12**-0.5)), free=FREE)
    np.testing.assert_array_less(np.abs(fit.values - fit.values_in(scene)), 3.0 * fit.errors)
    assert not [note for note in fit.notes if note.kind in ("cause", "misfit")]


@pytest.mark.parametrize("surface", [BALL, BOX])
def test_renders_of_one_ray_a_pixel_keep_all_pixels(surface):
    scene = scene_of(surface, 4)
    fit = ds.fit(scene, photographed(scene), free=FREE)
    assert (fit.counts.mixed, sum(len(view.image[0]) for view in fit.views)) == (0, 4 * 96)
    assert not [note for note in fit.notes if note.kind in ("edges", "cause", "misfit")]


def test_a_mask_that_keeps_away_from_edges_loses_nothing_more():
    scene = scene_of(BALL, 1)
    inside = ndimage.binary_erosion(np.asarray(SeenEdges(scene.objects, CAMERA).inside), iterations=6)
    fit = ds.fit(scene, photographed(scene, 16, mask=inside), free=FREE)
    assert (fit.counts.mixed, fit.counts.pixels) == (0, inside.sum())


def test_edges_are_outlines_creases_and_borders_between_objects():
    box = SeenEdges((ds.Object(BOX),), CAMERA)
    assert np.array_equal(box.inside & (box.depths[0] == 1), box.inside & _beside_another(_faces(BOX)))
    halves = tuple(ds.Object(ds.Box((x, 0, 0), (0.6, 1.2, 1.2))) for x in (-0.3, 0.3))
    both = SeenEdges(halves, CAMERA)
    assert np.array_equal(both.inside, box.inside)
    assert (both.depths[0] <= box.depths[0]).all()
    assert (both.inside & (both.depths[0] == 1) & (box.depths[0] > 1)).sum() > 100


ROW, COLUMN = (np.mgrid[:96, :96] - 47.5) / 48.0
OUT_OF_THE_CENTRE = np.hypot(ROW, COLUMN)
SEEN = SeenEdges(scene_of(BALL, 1).objects, CAMERA)
BESIDE = ~SEEN.inside[..., None]
NO_MIXING = {
    "nothing": lambda image: image,
    "a hot pixel": lambda image: np.where(np.arange(96 * 96).reshape(96, 96, 1) == SEEN.rings.beside[0][5], 1.0, image),
    "a contact shadow": lambda image: (
        image + BESIDE * (0.2 - 0.15 * np.exp(-((_away() / 5.0) ** 2)))[..., None]  # darker than the object
    ),
    "a lit backdrop": lambda image: image + BESIDE * (0.05 - 0.02 * OUT_OF_THE_CENTRE)[..., None],
    "vignetting": lambda image: (image + 0.3 * BESIDE) * (1.0 - 0.3 * OUT_OF_THE_CENTRE**2)[..., None],
    "a veil": lambda image: image + 0.03 * ndimage.gaussian_filter(image, (10, 10, 0)),
    "no number": lambda image: np.where(BESIDE, np.nan, image),
    "no limit": lambda image: np.where(BESIDE, np.inf, image),
}


def _away():
    return np.asarray(ndimage.distance_transform_edt(~SEEN.inside))


@pytest.mark.parametrize("change", NO_MIXING.values(), ids=NO_MIXING)
def test_what_else_is_beside_an_outline_is_no_mixing(change):
    (view,) = photographed(scene_of(BALL, 1))
    assert SEEN.reach(change(view.image)) == 0


@pytest.mark.parametrize("change", ["nothing", "a lit backdrop", "a veil"])
@pytest.mark.parametrize(("blur", "reach"), [(0.0, 1), (1.0, 3)])
def test_mixing_is_seen_beside_it(change, blur, reach):
    (view,) = photographed(scene_of(BALL, 1), 16, blur)
    assert abs(SEEN.reach(NO_MIXING[change](view.image)) - reach) <= (change != "nothing")


def test_fine_relief_loses_what_lies_along_its_outline_alone():
    row, column = np.mgrid[:48, :48]
    normal = np.stack([np.sin(2.0 * row), np.sin(2.0 * column), np.ones((48, 48))], -1)
    inside = np.hypot(row - 23.5, column - 23.5) < 20.0
    edges = SeenEdges(
        (ds.Object(ds.GBuffer(normal / np.linalg.norm(normal, axis=-1)[..., None], None, inside)),), SMALL
    )
    np.testing.assert_array_equal(edges.unmixed(inside, 1), ndimage.binary_erosion(inside, np.ones((3, 3))))


def _faces(box):
    """The number of the face that each pixel shows, 0 beside the box."""
    normal = np.asarray(visible_points((ds.Object(box),), CAMERA)[0])
    return np.round(normal @ np.array([1, 3, 9])).astype(int)


def _beside_another(number):
    return ndimage.maximum_filter(number, 3) != ndimage.minimum_filter(number, 3)


def test_a_highlight_that_no_pixel_shows_may_be_of_any_size_whatever_the_noise():
    scene = scene_of(BOX, 1)
    for seed in range(20):
        fit = ds.fit(told_nothing(scene), photographed(scene, seed=seed), free=FREE)
        off = np.abs(fit.values - fit.values_in(scene))
        np.testing.assert_array_less(off[fit.determined], 4.0 * fit.errors[fit.determined])

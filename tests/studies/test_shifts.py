"""Photographs that a hand or a shaken tripod shifted in the picture: found from the object, said, and moved back."""

import dataclasses

import numpy as np
import pytest
import scipy.ndimage
from bumpy import MATERIALS, bumpy, degrees_between, under
from measured import measured
from plates import metal_plate
from test_exposures import disturbed
from test_few_photographs import FREE, MIDDLE, RADIUS

import diffshade as ds
from diffshade.core.backend import in_float64
from diffshade.texels.lights.shifts import undone_shifts
from diffshade.texels.tiles import ViewReader

SLACK = 0.7  # degrees by which normals may be worse than those of photographs that are not shifted


def shifted(views, seed=1, most=4.0):
    """The photographs, each moved by up to so many pixels, and by how much, to the right and down."""
    by = np.random.default_rng(seed).uniform(-most, most, (len(views), 2))
    images = [scipy.ndimage.shift(np.asarray(v.image)[..., :3], (y, x, 0)) for v, (x, y) in zip(views, by, strict=True)]
    return [dataclasses.replace(view, image=image) for view, image in zip(views, images, strict=True)], by


def some_of(name, count):
    folder = measured(name)
    scene, views = ds.read_photographs(folder, normals=False)
    which = np.unique(np.linspace(0, len(views) - 1, count).round().astype(int))
    return scene, [views[i] for i in which], folder


def grey_ball():
    folder = measured("uw_spheres")
    lights = np.loadtxt(folder / "lights_from_chrome_highlight.txt", usecols=(-3, -2, -1))
    part = np.s_[20:270, 120:370]
    images = [np.asarray(ds.read_image(folder / "gray" / f"gray.{i}.tga", srgb=False))[part] for i in range(12)]
    row, column = np.mgrid[part]
    x, y = (column - MIDDLE[0]) / RADIUS, (MIDDLE[1] - row) / RADIUS
    z2 = 1.0 - x**2 - y**2
    return under(list(lights), images, np.stack([x, y, np.sqrt(np.maximum(z2, 0.0))], -1), z2 > 0.15)


def found_in(scene, views):
    with in_float64((scene, views)) as (scene, views):
        return undone_shifts(scene, views, ViewReader(scene, views).sample(2048))[1]


def of(name):
    """A scene and its photographs."""
    if name == "grey":
        ball = grey_ball()
        return ball.scene, ball.views
    if name in MATERIALS:
        drawn = bumpy(name, 12, 60.0, off=1.0, cast=True)
        return drawn.scene, drawn.views
    return some_of(name, 12)[:2]


EVERY = (*MATERIALS[:-1], "grey", "diligent_cat", "diligent_ball", "diligent_harvest")


def slowly(names, but):
    """The names as parameters, of which only some are of the thorough tier."""
    return [name if name in but else pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize("name", slowly([*EVERY, "metal", "rti_dome"], ("matte", "diligent_cat", "rti_dome")))
def test_photographs_that_did_not_move_are_left(name):
    scene, views = of(name)
    assert found_in(scene, views) is None
    assert found_in(scene, disturbed(views)[0]) is None


@pytest.mark.parametrize("exposed", slowly([False, True], (True,)))
@pytest.mark.parametrize("name", slowly(EVERY, ("matte", "diligent_cat")))
def test_shifts_are_found_within_their_errors(name, exposed):
    scene, views = of(name)
    views, by = shifted(disturbed(views)[0] if exposed else views)
    found = found_in(scene, views)
    assert found is not None
    off = found.pixels - by
    off = np.abs(off - off.mean(0))
    print(name, exposed, f"off {np.sqrt(np.square(off).mean()):.3f} stated {np.median(found.error):.3f}", found.undone)
    assert found.undone.sum() >= len(by) / 2
    assert (off <= found.error).mean() >= 0.5
    assert (off <= 2.0 * found.error).mean() >= 0.85


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("diligent_cat", 12), ("grey", 12), ("diligent_cat", 48)])
def test_normals_of_shifted_photographs_are_those_of_right_ones(name, count):
    if name == "grey":
        ball = grey_ball()
        scene, views, normal, mask = ball.scene, ball.views, ball.normal, ball.mask
    else:
        scene, views, folder = some_of(name, count)
        normal, mask = np.load(folder / "normal_gt.npy"), ds.read_mask(folder / "mask.png")
    still, moved = (ds.fit_texels(scene, one, free=FREE) for one in (views, shifted(views)[0]))
    assert still.shifts is None
    assert moved.shifts is not None
    assert "shifted" in moved.notes[0]
    before, after = (degrees_between(maps.values["normal"], normal)[mask].mean() for maps in (still, moved))
    assert after < before + SLACK


def test_highlights_that_cover_a_plate_are_neither_shifts_nor_turned_lights():
    """The search for shifts is deceived by them; what left-out photographs show is not."""
    of = metal_plate(24)
    assert found_in(of.scene, of.views) is not None
    maps = ds.fit_texels(of.scene, of.views, free=FREE)
    assert maps.shifts is None
    assert not [note for note in maps.notes if "shifted" in note or "said to be" in note]
    assert degrees_between(maps.values["normal"], of.normal)[maps.determined].mean() < 0.5

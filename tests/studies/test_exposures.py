"""Exposures and white balances that vary from photograph to photograph: found from the object, said, and undone."""

import dataclasses

import numpy as np
import pytest
from bumpy import bumpy, degrees_between
from measured import measured
from test_few_photographs import FREE

import diffshade as ds

SLACK = 0.7  # degrees by which normals may be worse than those of photographs that are exposed alike


def disturbed(views, seed=1, brighter=0.35, colour=0.1):
    """The photographs by a camera that chose its exposure and its white balance anew for each, and these."""
    random = np.random.default_rng(seed)
    factor = random.uniform(1 - brighter, 1 + brighter, (len(views), 1)) * random.uniform(
        1 - colour, 1 + colour, (len(views), 3)
    )
    images = [np.asarray(view.image)[..., :3] * of for view, of in zip(views, factor, strict=True)]
    return [dataclasses.replace(view, image=image) for view, image in zip(views, images, strict=True)], factor


def check(scene, views, normal, mask):
    """Compare normals of photographs that are exposed alike with those of the same, exposed differently."""
    alike = ds.fit_texels(scene, views, free=FREE)
    assert alike.exposures is None
    changed, factor = disturbed(views)
    maps = ds.fit_texels(scene, changed, free=FREE)
    assert maps.exposures is not None
    assert "exposures" in maps.notes[0]
    off = np.log(maps.exposures.factor / factor)
    off = np.abs((off - off.mean(0)).mean(-1))  # k_d takes what all photographs have in common
    assert np.mean(off <= 2.0 * maps.exposures.error) > 0.6, (off, maps.exposures.error)
    before, after = (degrees_between(of.values["normal"], normal)[mask].mean() for of in (alike, maps))
    assert after < before + SLACK
    sure = maps.known & mask
    inside = degrees_between(maps.values["normal"], normal) <= maps.errors["normal"][..., 0]
    assert inside[sure].mean() > 0.5  # what the exposures' errors have in common turns all normals alike


@pytest.mark.slow
@pytest.mark.parametrize(("material", "count"), [("matte", 12), ("two", 20)])
def test_exposures_of_a_bumpy_sphere_are_undone(material, count):
    of = bumpy(material, count, 60.0, off=1.0, cast=True)
    check(of.scene, of.views, of.normal, of.mask)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [("diligent_cat", 12), ("diligent_cat", 48), ("diligent_ball", 48)])
def test_exposures_of_real_photographs_are_undone(name, count):
    folder = measured(name)
    scene, views = ds.read_photographs(folder, normals=False)
    which = np.unique(np.linspace(0, len(views) - 1, count).round().astype(int))
    normal, mask = np.load(folder / "normal_gt.npy"), ds.read_mask(folder / "mask.png")
    check(scene, [views[i] for i in which], normal, mask)

"""Texels from few photographs: never worse than least squares, without patches, and with errors that hold.

The grey ball has lights on one side, known to some 3 degrees; its table stands in docs/studies/2026-11-27-texels.md.
`pytest -m slow -s` prints that of the spheres with bumps.
"""

import dataclasses

import numpy as np
import pytest
import scipy.ndimage
from bumpy import MATERIALS, bumpy, degrees_between, jumps, under
from measured import measured

import diffshade as ds
from diffshade.core.words import Note

FREE = ("k_d", "k_s", "n_s", "normal")
GREY = {12: range(12), 9: [i for i in range(12) if i % 4 != 3], 8: [i for i in range(12) if i % 3], 6: range(0, 12, 2)}
MIDDLE, RADIUS = (244.5, 144.5), 108.0  # of the grey ball, pixels


@pytest.fixture(scope="module")
def grey_ball():
    """The images, the lights, the normals and the mask of a ball that is nearly matte."""
    folder = measured("uw_spheres")
    lights = np.loadtxt(folder / "lights_from_chrome_highlight.txt", usecols=(-3, -2, -1))
    images = [ds.read_image(folder / "gray" / f"gray.{i}.tga", srgb=False) for i in range(12)]
    row, column = np.mgrid[: images[0].shape[0], : images[0].shape[1]]
    x, y = (column - MIDDLE[0]) / RADIUS, (MIDDLE[1] - row) / RADIUS
    z2 = 1.0 - x**2 - y**2
    normal, part = np.stack([x, y, np.sqrt(np.maximum(z2, 0.0))], -1), np.s_[36:254, 136:354]
    return [np.asarray(image)[part] for image in images], lights, normal[part], (z2 > 0.15)[part]


@pytest.mark.parametrize("count", [*(pytest.param(n, marks=pytest.mark.slow) for n in (12, 9, 8)), 6])
def test_a_grey_ball_has_no_patches(grey_ball, count):
    images, lights, normal, mask = grey_ball
    of = under([lights[i] for i in GREY[count]], [images[i] for i in GREY[count]], normal, mask)
    maps = ds.fit_texels(of.scene, of.views, free=FREE)
    off = degrees_between(maps.values["normal"], normal)[mask]
    assert off.mean() < degrees_between(of.least_squares(), normal)[mask].mean() + 0.2
    assert jumps(maps.values["normal"], normal, mask) <= 0.001
    known = maps.known[mask]
    assert off[known].mean() < off.mean() + 0.2


def check(material: str, count: int, cone: float, **how) -> None:
    """Compare the maps with both least squares, and the errors with what is off."""
    of = bumpy(material, count, cone, **how)
    maps = ds.fit_texels(of.scene, of.views, free=FREE)
    found, sure = maps.values["normal"], maps.known[of.mask]
    off = degrees_between(found, of.normal)[of.mask]
    plain, trimmed = (degrees_between(of.least_squares(share), of.normal)[of.mask].mean() for share in (0.0, 0.2))
    held = off <= maps.errors["normal"][of.mask][:, 0]
    seam, far = jumps(found, of.normal, of.mask), float(np.mean(off[sure] > 10.0)) if sure.any() else 0.0
    numbers = (off.mean(), plain, trimmed, seam, held.mean(), far)
    print(material, count, cone, how, *(f"{number:.3f}" for number in numbers))
    assert maps.exposures is None  # they were as the views say
    best = min(plain, trimmed)
    assert off.mean() <= max(best + 0.3, 1.05 * best)
    assert far <= 0.01
    assert seam <= 0.02
    assert held.mean() >= 0.5


@pytest.mark.parametrize(
    ("material", "count"),
    [("matte", 6), *(pytest.param(m, n, marks=pytest.mark.slow) for m, n in (("two", 8), ("metal", 12)))],
)
def test_few_photographs_beat_least_squares(material, count):
    check(material, count, 60.0, off=1.0, cast=True)


@pytest.mark.parametrize(
    ("material", "count", "seed"),
    [("two", 6, 1), ("matte", 12, 3), *(pytest.param(m, 6, 3, marks=pytest.mark.slow) for m in ("matte", "glossy"))],
)
def test_what_errors_of_the_lights_explain_is_no_highlight_no_shadow_and_no_exposure(material, count, seed):
    """Under lights that stand together photographs that were left out choose by chance: up to 20 degrees off."""
    of = bumpy(material, count, 20.0, off=3.0, cast=True, seed=seed)
    maps = ds.fit_texels(of.scene, of.views, free=FREE, light_error=3.0)
    off, plain = (degrees_between(n, of.normal)[of.mask] for n in (maps.values["normal"], of.least_squares()))
    assert off.mean() <= plain.mean() + 0.35
    assert np.mean(off <= maps.errors["normal"][of.mask][:, 0]) > 0.68
    assert maps.exposures is None


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("count", "cone"), [(12, 60.0), *(pytest.param(*of, marks=pytest.mark.slow) for of in ((6, 40.0), (24, 80.0)))]
)
def test_a_rough_surface_is_told_and_its_normals_hold(count, cone):
    """Plain and trimmed least squares: 6 to 9 degrees."""
    of = bumpy("clay", count, cone, cast=True, seed=3)
    maps = ds.fit_texels(of.scene, of.views, free=FREE, light_error=0.0)
    off = degrees_between(maps.values["normal"], of.normal)[of.mask]
    assert off.mean() < 0.8
    assert np.mean(off <= maps.errors["normal"][of.mask][:, 0]) > 0.6
    assert np.mean(off <= maps.errors_95["normal"][of.mask][:, 0]) > 0.9
    kinds = [note.kind for note in maps.notes if isinstance(note, Note)]
    assert "rough" in kinds
    assert "disagrees" not in kinds


def notes_of(of, views, scene=None) -> list[str]:
    notes = ds.fit_texels(scene or of.scene, views, free=FREE).notes
    return [
        note
        for note in notes
        if "exposures say" in note or "said to be" in note or "swapped" in note or "shifted" in note
    ]


def levels_of(maps: ds.TexelMaps) -> list[str]:
    return [note for note in maps.notes if isinstance(note, Note) and note.kind == "black"]


def test_a_level_that_all_photographs_share_is_told_and_undone(tmp_path):
    of = bumpy("glossy", 12, 50.0)
    hazy = [dataclasses.replace(view, image=np.asarray(view.image) + 0.01) for view in of.views]
    right, undone = (ds.fit_texels(of.scene, views, free=FREE) for views in (of.views, hazy))
    assert levels_of(right) == []
    (note,) = levels_of(undone)
    assert "show 0.01 where no light reaches" in note
    np.testing.assert_allclose(undone.values["normal"], right.values["normal"], atol=1e-3)
    np.testing.assert_allclose(undone.errors["normal"][of.mask], right.errors["normal"][of.mask], rtol=0.05)
    np.testing.assert_allclose(undone.relative_errors(hazy), right.relative_errors(of.views), rtol=0.05)
    undone.write(tmp_path)
    assert ds.read_maps(tmp_path).black == undone.black == pytest.approx(0.01, rel=0.02)


def test_where_light_reaches_everything_no_level_is_told():
    """Under six lights near the camera the darkest is seen at grazing light, and without it the texels agree better."""
    of = bumpy("matte", 6, 20.0, cast=True)
    assert levels_of(ds.fit_texels(of.scene, of.views, free=FREE)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["diligent_ball", "diligent_cat"])
def test_a_level_added_to_real_photographs_moves_nothing(name):
    scene, views = ds.read_photographs(measured(name))
    truth, some = np.load(measured(name) / "normal_gt.npy"), np.linspace(0, len(views) - 1, 12).round().astype(int)
    level = 0.01 * max(float(np.quantile(views[i].image, 0.999)) for i in some)
    found = [
        ds.fit_texels(scene, [dataclasses.replace(views[i], image=views[i].image + add) for i in some], free=FREE)
        for add in (0.0, level)
    ]
    known = found[0].known & found[1].known
    off = [degrees_between(maps.values["normal"], truth)[known].mean() for maps in found]
    assert off[1] < off[0] + 0.1
    assert len(levels_of(found[1])) == 1


@pytest.mark.parametrize(
    ("material", "count"),
    [("glossy", 12), *(pytest.param(m, n, marks=pytest.mark.slow) for m in ("matte", "metal") for n in (12, 48))],
)
def test_a_light_that_is_off_and_swapped_photographs_are_named(material, count):
    of = bumpy(material, count, 50.0)
    assert notes_of(of, of.views) == []
    l = -of.to_light[5]
    across = np.cross(l, (0.3, 0.5, 0.8))
    off = np.cos(np.deg2rad(20.0)) * l + np.sin(np.deg2rad(20.0)) * across / np.linalg.norm(across)
    lights = [ds.DirectionalLight(off) if i == 5 else light for i, light in enumerate(of.scene.lights)]
    (note,) = notes_of(of, of.views, ds.Scene(of.scene.objects[0], lights))
    assert any(f"views[5] by {degrees} degrees" in note for degrees in (19, 20, 21)), note
    swapped = [
        dataclasses.replace(view, image=of.views[{3: 8, 8: 3}.get(i, i)].image) for i, view in enumerate(of.views)
    ]
    (note,) = notes_of(of, swapped)
    assert "views[3]" in note
    assert "views[8]" in note


@pytest.mark.parametrize(
    ("material", "count"), [("glossy", 12), *(pytest.param("matte", n, marks=pytest.mark.slow) for n in (12, 48))]
)
@pytest.mark.parametrize(
    "how",
    [
        lambda image: scipy.ndimage.shift(image, (3, 0, 0), order=1),
        pytest.param(ds.srgb_encode, marks=pytest.mark.slow),
    ],
    ids=["shifted", "sRGB"],
)
def test_one_photograph_that_is_shifted_or_encoded_otherwise_is_named(material, count, how):
    of = bumpy(material, count, 50.0)
    views = [dataclasses.replace(v, image=np.asarray(how(v.image))) if i == 4 else v for i, v in enumerate(of.views)]
    notes = [note for note in notes_of(of, views) if "views[4]" in note]
    assert notes
    assert all(note.index("views[4]") < 130 for note in notes)  # as the first


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("cone", [20.0, 40.0, 80.0])
@pytest.mark.parametrize("count", [6, 8, 12, 20, 60])
@pytest.mark.parametrize("material", MATERIALS)
def test_so_do_those_of_every_material_and_rig(material, count, cone, off):
    check(material, count, cone, off=off, cast=off > 0.0)

"""Resumed fits of texels, and arguments that are refused before anything is written."""

from __future__ import annotations

import numpy as np
import pytest
from textured import textured_ball

import diffshade as ds
from diffshade.texels import fitting


def test_only_the_same_run_resumes(tmp_path):
    ball = textured_ball(16)
    first = ds.fit_texels(ball.scene, ball.views, free="k_d", out=tmp_path / "maps")
    assert isinstance(first.values["k_d"], np.memmap)
    again = ds.fit_texels(ball.scene, ball.views, free="k_d", out=tmp_path / "maps")  # nothing is left to do
    np.testing.assert_array_equal(first.values["k_d"], again.values["k_d"])
    with pytest.raises(ValueError, match=r"another run.*another folder"):
        ds.fit_texels(ball.scene, ball.views[1:], free="k_d", out=tmp_path / "maps")
    (tmp_path / "maps" / "k_d.npy").unlink()
    with pytest.raises(ValueError, match=r"k_d\.npy.*is missing"):
        ds.fit_texels(ball.scene, ball.views, free="k_d", out=tmp_path / "maps")
    (tmp_path / "maps" / "run.json").write_text("{}")
    with pytest.raises(ValueError, match=r"run\.json is damaged.*Give out the name of a new folder"):
        ds.fit_texels(ball.scene, ball.views, free="k_d", out=tmp_path / "maps")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(ValueError, match=r"mine holds other files.*Give out the name of a new folder"):
        ds.fit_texels(ball.scene, ball.views, out=tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["letter.txt"]


def test_a_run_of_another_version_is_refused_and_left_as_it_is(tmp_path, monkeypatch):
    ball, folder = textured_ball(16), tmp_path / "maps"

    def fit():
        return ds.fit_texels(ball.scene, ball.views, free="k_d", out=folder)

    with monkeypatch.context() as earlier:
        earlier.setattr(fitting, "FORMAT", fitting.FORMAT - 1)
        fit()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ValueError, match=r"maps of another run, .* version of diffshade differ\. .*remove this one\.$"):
        fit()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


SPHERE = ds.Object(ds.Sphere(), ds.Material(k_s=0.0))
CAMERA = ds.Camera(eye=(0, 0, 4), shape=(8, 8))
LAMP = ds.PointLight((2, 3, 4))
SCENE = ds.Scene(SPHERE, LAMP)
VIEW = ds.View(np.full((8, 8, 3), 0.5), CAMERA)
GREY = ds.View(np.full((8, 8), 0.5), CAMERA)
COLOURED = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=(0.5, 0.4, 0.3))), ds.PointLight((2, 3, 4), (1, 0.5, 0.2)))


def of(material: ds.Material) -> ds.Scene:
    return ds.Scene(ds.Object(ds.Sphere(), material), LAMP)


@pytest.mark.parametrize(
    ("scene", "views", "more", "words"),
    [
        (SCENE, [VIEW], {}, "at least two views; got 1"),
        (SCENE, [VIEW] * 3, {"free": ("k_d", "kd")}, "got 'kd'. Did you mean 'k_d'?"),
        (SCENE, [VIEW] * 3, {"free": ()}, "free must name at least one map"),
        (SCENE, [VIEW] * 3, {"free": ("k_d", "n_s")}, "k_s is neither free nor above 0. Add 'k_s'"),
        (SCENE, [VIEW] * 3, {"loss": "l1"}, "loss must be one of squares, huber"),
        (ds.Scene(SPHERE), [VIEW] * 3, {}, "without lights"),
        (ds.Scene([SPHERE, SPHERE], LAMP), [VIEW] * 3, {}, "one object; got 2"),
        (ds.Scene(SPHERE, LAMP, atmosphere=ds.Fog(0.1)), [VIEW] * 3, {}, "atmosphere"),
        (ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_t=0.5)), LAMP), [VIEW] * 3, {}, "k_t"),
        (ds.Scene(SPHERE, LAMP, ambient=0.0), [VIEW] * 3, {"free": ("k_a", "k_d")}, "ambient"),
        (SCENE, [VIEW, ds.View(VIEW.image, ds.Camera(eye=(0, 1, 4), shape=(8, 8)))], {}, "another camera"),
        (SCENE, [VIEW, ds.View(VIEW.image[..., :1], CAMERA)], {}, "both be grey or both be colour"),
        (SCENE, [VIEW, ds.View(VIEW.image, CAMERA, noise=0.1)], {}, "Give noise for all or none"),
        (SCENE, [VIEW, ds.View(VIEW.image, CAMERA, lit=(3,))], {}, r"views\[1\].lit.*got 3"),
        (of(ds.Material(fresnel=ds.Schlick())), [VIEW] * 3, {}, "fresnel"),
        (of(ds.Material(k_d=ds.Chequer(0.2, 0.6))), [VIEW] * 3, {}, "a pattern"),
        (of(ds.Material(n_s=(1, 2, 3))), [VIEW] * 3, {}, "an n_s for each channel"),
        (of(ds.Material(n_s=0.01, k_s=0.5)), [VIEW] * 3, {"free": ("k_d",)}, "n_s must be at least 0.1"),
        (of(ds.Material(k_d=0.0)), [VIEW] * 3, {"free": ("normal",)}, "k_d is neither free nor above 0"),
        (SCENE, [VIEW] * 3, {"free": ("k_d", "n_s"), "memory": 0}, "memory"),
        (COLOURED, [GREY] * 2, {"free": ("k_s",)}, "grey photographs under coloured lights.*k_d"),
        (SCENE, [ds.View(VIEW.image, CAMERA, np.zeros((8, 8), bool))] * 2, {}, "no pixel is left to fit"),
        (SCENE, [VIEW] * 3, {"regions": np.full((8, 8), -1)}, "regions must be whole numbers"),
        (SCENE, [VIEW] * 3, {"regions": np.zeros((4, 4), int)}, "regions must be whole numbers"),
        (SCENE, [VIEW] * 3, {"regions": np.zeros((8, 8), int), "free": ("k_d",)}, "regions share n_s"),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(scene, views, more, words, tmp_path):
    with pytest.raises((ValueError, TypeError), match=words) as refused:
        ds.fit_texels(scene, views, out=tmp_path / "maps", **more)
    assert "\n" not in str(refused.value)
    assert "no pixel is left" in words or not (tmp_path / "maps").exists()


def test_a_sample_that_is_not_finite_is_named():
    image = np.full((8, 8, 3), 0.5)
    image[4, 5] = np.nan
    views = [VIEW, ds.View(image, CAMERA), VIEW]
    with pytest.raises(ValueError, match=r"views\[1\].*row 4, column 5"):
        ds.fit_texels(SCENE, views)

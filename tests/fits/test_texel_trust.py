"""What a fit of texels calls determined: not normals under lights in one plane, nor a highlight that is not known."""

import logging
import tomllib

import numpy as np
import pytest
from textured import Ball, angle, facing_us, lights_about, textured_ball

import diffshade as ds

FREE = ("k_d", "k_s", "n_s", "normal")
COUNT = 20
AROUND = np.linspace(-1.1, 1.1, COUNT)
ARC = np.stack([np.sin(AROUND), 0.4 * np.cos(AROUND), 0.9 * np.cos(AROUND)], -1)


def half_lit() -> Ball:
    """A ball under an arc of lights that lie within half a degree of one plane, as people set them up by hand."""
    return textured_ball(24, noise=0.005, to_light=ARC + 0.005 * np.random.default_rng(3).standard_normal((COUNT, 3)))


@pytest.fixture(scope="module")
def arc() -> tuple[ds.TexelMaps, list[str]]:
    """The maps of that ball, and what was said before."""
    ball, said = half_lit(), []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())
    logger = logging.getLogger("diffshade")
    logger.addHandler(handler)
    try:
        return ds.fit_texels(facing_us(ball), ball.views, free=FREE), said
    finally:
        logger.removeHandler(handler)


def test_under_lights_in_one_plane_no_normal_is_called_determined(arc):
    maps, _ = arc
    assert not maps.known.any()
    assert (maps.status == maps.STATUS.index("not determined")).sum() > 300
    assert np.isinf(maps.errors["normal"][maps.status > 0]).mean() > 0.9


def test_it_is_said_before_the_fit_and_with_the_maps_with_the_remedy(arc):
    maps, said = arc
    assert len(said) == len(maps.notes) == 1
    assert said[0] == maps.notes[0]
    for words in ("lights of the texels lie in one plane", "Add photographs under lights out of the plane"):
        assert words in maps.notes[0]
    assert maps.notes[0] in f"{maps}"


def test_what_is_not_determined_has_no_highlight_and_no_error_beyond_a_right_angle(arc):
    maps, _ = arc
    doubted = maps.status != maps.STATUS.index("determined")
    for name in ("k_s", "n_s"):
        assert (maps.values[name][doubted] == 0).all()
        assert np.isinf(maps.errors[name][doubted & (maps.status > 0)]).all()
    error = maps.errors["normal"]
    assert ((error <= 90.0) | np.isinf(error)).all()


def test_lights_all_about_are_no_cause_for_a_note():
    """As many lights, not in a plane: the same program, and most of the ball is known."""
    ball = textured_ball(24, noise=0.005)
    maps = ds.fit_texels(facing_us(ball), ball.views, free=FREE)
    assert maps.notes == ()
    assert maps.known.sum() > 0.7 * ball.mask.sum()
    off = angle(maps.values["normal"], ball.truth["normal"])
    assert np.mean((off > 5.0 * maps.errors["normal"][..., 0])[maps.known]) <= 0.01


def test_one_wild_texel_does_not_scale_a_map(tmp_path):
    """Nor its preview, which is there to be looked at; units stand beside."""
    rng = np.random.default_rng(0)
    k_s = rng.uniform(0.2, 0.6, (40, 40, 1)).astype(np.float32)
    k_s[7, 9] = 31.0
    normal = np.broadcast_to(np.float32((0, 0, 1)), (40, 40, 3))
    values = {"k_s": k_s, "n_s": 10.0 * k_s, "normal": normal}
    errors = {"k_s": 0.1 * k_s, "n_s": k_s, "normal": k_s}
    ball = textured_ball(40, lights=2)
    status = np.ones((40, 40), np.uint8)
    maps = ds.TexelMaps(values, errors, status, k_s[..., 0], ball.scene, ball.views[0].camera, ("a note",))
    written = maps.write(tmp_path, suffix=".png")
    about = tomllib.loads((tmp_path / "maps.toml").read_text())
    assert about["scale"]["k_s"] == 1.0
    assert about["scale"]["n_s"] == pytest.approx(6.0, rel=0.05)
    assert about["units"]["normal_error"] == "degrees"
    assert about["units"]["n_s_error"] == "those of n_s"
    assert about["notes"] == ["a note"]
    assert tmp_path / "k_s_preview.png" in written
    preview = ds.read_image(tmp_path / "k_s_preview.png")
    assert np.median(preview) > 0.5
    kept = ds.read_image(tmp_path / "n_s.png", srgb=False) * about["scale"]["n_s"]
    np.testing.assert_allclose(np.delete(kept, 7 * 40 + 9), np.delete(10.0 * k_s, 7 * 40 + 9), atol=0.05)


def test_the_folder_of_a_run_says_its_units(tmp_path):
    ball = textured_ball(24, noise=0.005)
    ds.fit_texels(ball.scene, ball.views, free=("k_d",), out=tmp_path / "maps")
    about = tomllib.loads((tmp_path / "maps" / "maps.toml").read_text())
    assert about["units"]["k_d_error"] == "those of k_d"
    assert about["status"]["3"] == "not determined"


def test_lights_about_one_texel_count_where_they_reach_it():
    """Half of the lights lie in a plane, and where a mask leaves those alone nothing is known."""
    l = np.where((np.arange(COUNT) % 2 == 0)[:, None], ARC, lights_about(COUNT))
    ball = textured_ball(24, noise=0.005, to_light=l)
    left = np.zeros((24, 24), bool)
    left[:, 12:] = True
    views = [v if i % 2 == 0 else ds.View(v.image, v.camera, left, lit=v.lit) for i, v in enumerate(ball.views)]
    maps = ds.fit_texels(facing_us(ball), views, free=FREE)
    assert not maps.known[:, :12].any()
    assert maps.known[:, 12:].mean() > 0.4
    assert len(maps.notes) == 1
    assert "% of the texels" in maps.notes[0]

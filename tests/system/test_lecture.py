"""The figures of a lecture: they are drawn by the model, whole, without a warning, and say what they should."""

from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from figures import coarse, pictures, texts  # noqa: F401
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

import diffshade as ds


def curve(line):
    """The x and y of a curve."""
    return np.asarray(line.get_xdata(), np.float64), np.asarray(line.get_ydata(), np.float64)


@pytest.mark.thorough
def test_ambient_light_is_the_same_all_over_the_ball():
    matte = pictures(ds.lecture.draw_figure("ambient_and_diffuse"))[5]  # k_a = 0.1, k_d = 0
    np.testing.assert_allclose(matte[40:128, 40:128], 0.1, atol=1e-6)


def test_snell_says_18_09_degrees():
    said = [words for words, _ in texts(ds.lecture.draw_figure("snell"))]
    assert "30°" in said
    assert "18.09°" in said


def test_the_ray_leaves_the_slab_parallel_and_the_steep_one_not_at_all():
    _, slab, leaving = ds.lecture.draw_figure("snell").axes
    solid = [np.column_stack(curve(line)) for line in slab.lines if line.get_linestyle() == "-"]
    first, _, last = (part[1] - part[0] for part in solid)
    np.testing.assert_allclose(first / np.linalg.norm(first), last / np.linalg.norm(last), atol=1e-6)
    ends = [curve(line)[1][1] for line in leaving.lines if line.get_linestyle() == "-"][1::2]
    assert [y > 0 for y in ends] == [True, True, False]  # 20 and 36 degrees, and 50


def test_the_curves_are_those_of_the_formulas():
    powers = ds.lecture.draw_figure("cosine_powers").axes[0].lines
    phi, power = curve(powers[3])
    np.testing.assert_allclose(power, np.cos(np.deg2rad(phi)) ** 27, atol=1e-5)
    radial, angular = ds.lecture.draw_figure("attenuation_curves").axes
    d, f = curve(radial.lines[2])
    np.testing.assert_allclose(f, d**-2, rtol=1e-5)
    phi, f = curve(angular.lines[1])
    np.testing.assert_allclose(f, np.where(phi < 40.05, np.cos(np.deg2rad(phi)) ** 2, 0), atol=1e-5)
    _, exact = curve(ds.lecture.draw_figure("fresnel_weight").axes[0].lines[1])
    assert exact[0] == pytest.approx(0.04, abs=1e-6)
    assert exact[-1] == pytest.approx(1.0, abs=1e-5)
    z, s = curve(ds.lecture.draw_figure("visibility").axes[0].lines[0])
    np.testing.assert_allclose(s, np.interp(z, [2, 9], [1, 0.15]), atol=1e-5)


def test_rays_end_where_the_light_falls():
    """On the floor at y = -1, or on the ball; the left lamp's rays start at it."""
    lamp, sun = ds.lecture.draw_figure("rays_of_light").axes
    for axes in (lamp, sun):
        tips = np.array([note.xy for note in axes.texts if isinstance(note, Annotation)])
        assert len(tips) > 10
        on_ball = np.abs(np.hypot(tips[:, 0] - 0.9, tips[:, 1] + 0.4) - 0.6) < 1e-6
        on_floor = np.abs(tips[:, 1] + 1) < 1e-6
        assert (on_ball | on_floor).sum() == len(tips) - 3  # but for the arrows l
        assert on_ball.any()
        assert on_floor.any()


def test_r_ends_as_high_as_l_on_the_other_side():
    _, built = ds.lecture.draw_figure("mirror_direction").axes
    tips = {tuple(np.round(np.asarray(note.xy, float), 6)) for note in built.texts if isinstance(note, Annotation)}
    x, y = np.round([np.sin(np.deg2rad(38)), np.cos(np.deg2rad(38))], 6)
    assert {(x, y), (-x, y), (0.0, y)} <= tips


def test_half_of_white_is_as_bright_as_the_stripes():
    patches = pictures(ds.lecture.draw_figure("half_of_white"))[0]
    means = [patches[:, i * 220 : (i + 1) * 220].mean() for i in range(3)]
    np.testing.assert_allclose(means, [0.5, 0.5, 0.2140], atol=1e-4)


@pytest.mark.thorough
def test_only_some(tmp_path):
    paths = ds.lecture.write_figures(str(tmp_path), only=("visibility", "cosine_powers"))
    assert [path.name for path in paths] == ["06_cosine_powers.png", "32_visibility.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["06_cosine_powers.png", "32_visibility.png"]
    assert ds.lecture.write_figures(tmp_path / "one", only="cosine_powers") == (
        tmp_path / "one" / "06_cosine_powers.png",
    )


def test_an_unknown_name_or_a_file_is_one_sentence_and_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"no figure is named 'snel'. Did you mean 'snell'\?"):
        ds.lecture.write_figures(tmp_path / "out", only=("lobes", "snel"))
    with pytest.raises(ValueError, match=r"no figure is named 'zzz'. Known names: ambient_and_diffuse, "):
        ds.lecture.draw_figure("zzz")
    with pytest.raises(ValueError, match=r"figures are written as \.png, \.pdf and \.svg; got 'jpg'"):
        ds.lecture.write_figures(tmp_path / "out", suffix="jpg")
    with pytest.raises(ValueError, match="scale must be 1, 2, 3 or 4; got 0"):
        ds.lecture.write_figures(tmp_path / "out", scale=0)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("kept")
    with pytest.raises(NotADirectoryError, match="it is not a folder"):
        ds.lecture.write_figures(tmp_path / "file", only="cosine_powers")
    assert (tmp_path / "file").read_text() == "kept"


def test_t_is_a_unit_vector_and_the_sum_of_its_parts():
    _, built = ds.lecture.draw_figure("transmission_vector").axes
    arrows = [(note.xyann, note.xy) for note in built.texts if isinstance(note, Annotation)]
    (_, l), (_, T), (_, part), (start, end) = [np.array(arrow, float) for arrow in arrows[1:]]
    np.testing.assert_allclose(part, -l / 1.61, atol=1e-6)
    np.testing.assert_allclose((start, end), (part, T), atol=1e-6)
    assert end[0] == pytest.approx(start[0], abs=1e-6)  # along n
    assert np.hypot(*T) == pytest.approx(1, abs=1e-6)


def test_nothing_is_brighter_than_the_lamp_with_a_clamp():
    figure = ds.lecture.draw_figure("attenuation_at_most_1")
    without, clamped = (image.max((0, 1)) for image in pictures(figure))
    np.testing.assert_allclose(without, 1, atol=1e-6)  # burnt out
    np.testing.assert_allclose(clamped, (0.8, 0.62, 0.4), atol=0.002)
    np.testing.assert_allclose(curve(figure.axes[0].lines[1])[1].max(), 1)


def test_the_highlight_of_plastic_is_white_and_that_of_a_metal_has_its_colour():
    plastic, metal, _ = pictures(ds.lecture.draw_figure("object_colours"))[:3]  # of red
    of_white = (plastic - metal) / (1 - np.array((0.9, 0.1, 0.06)))  # the highlight, three times
    whole = (plastic < 1).all(-1) & (of_white[..., 0] > 0.1)
    assert whole.sum() > 30
    np.testing.assert_allclose(of_white[whole], of_white[whole][:, :1] * np.ones(3), rtol=1e-3)


@pytest.mark.thorough
def test_twice_the_scale_is_four_times_the_pixels_of_the_same_figure(tmp_path):
    """Words, curves and pictures, also what is drawn on a picture in its pixels."""
    for name in ("half_of_white", "warn_flaps"):
        (small,), (large,) = (
            ds.lecture.write_figures(tmp_path / str(scale), only=name, scale=scale) for scale in (1, 2)
        )
        small, large = (iio.imread(path)[..., :3].astype(float) for path in (small, large))
        height, width, _ = small.shape
        assert np.abs(np.subtract(large.shape[:2], (2 * height, 2 * width))).max() <= 1  # pages end within a pixel
        shrunk = large[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3).mean((1, 3))
        assert np.abs(shrunk - small).mean() < 5, name  # words are hinted
    stripes = pictures(ds.lecture.draw_figure("half_of_white", scale=2))[0]
    assert stripes.shape == (240, 1320, 3)
    ds.write_figure(tmp_path / "one.png", ds.lecture.draw_figure("half_of_white", scale=2))
    (drawn,) = (tmp_path / "2").glob("*half_of_white.png")
    assert (tmp_path / "one.png").read_bytes() == drawn.read_bytes()
    np.testing.assert_allclose(stripes[:8, 660, 0], [0, 0, 0, 0, 1, 1, 1, 1])


@pytest.mark.thorough
def test_a_dark_figure_has_light_words_and_the_same_pictures():
    for name in ("kinds_of_light", "half_of_white", "mirror_direction"):
        light, dark = (ds.lecture.draw_figure(name, dark=dark) for dark in (False, True))
        for one, other in zip(pictures(light), pictures(dark), strict=True):
            np.testing.assert_array_equal(one, other)
        assert max(to_rgb(dark.get_facecolor())) < 0.2
        found: list[Any] = [text for text in dark.findobj(Text) if text.get_text().strip()]
        assert len(found) >= 5
        for text in found:
            assert max(to_rgb(text.get_color())) > 0.5, (name, text.get_text())


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".svg", ".pdf"])
def test_svg_and_pdf_hold_the_picture_and_the_curves(suffix, tmp_path):
    (path,) = ds.lecture.write_figures(tmp_path, only="coloured_glass", suffix=suffix, dark=True)
    assert path.name == f"30_coloured_glass{suffix}"
    data = path.read_bytes()
    assert data.startswith(b"<?xml" if suffix == ".svg" else b"%PDF")
    assert data.count(b"<image" if suffix == ".svg" else b"/Subtype /Image") == 4
    assert len(list(tmp_path.iterdir())) == 1


def test_a_figure_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    (old,) = ds.lecture.write_figures(tmp_path, only="cosine_powers")
    before = old.read_bytes()

    def fail(figure, path):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(KeyboardInterrupt):
        ds.lecture.write_figures(tmp_path, only="cosine_powers")
    assert old.read_bytes() == before
    assert list(tmp_path.iterdir()) == [old]

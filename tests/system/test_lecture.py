"""The figures of a lecture: they are drawn by the model, whole, without a warning, and say what they should."""

import numpy as np
import pytest
from figures import coarse, pictures, texts  # noqa: F401
from matplotlib.figure import Figure
from matplotlib.text import Annotation

import diffshade as ds
from diffshade.report.lecture import draw_figure


def curve(line):
    """The x and y of a curve."""
    return np.asarray(line.get_xdata(), np.float64), np.asarray(line.get_ydata(), np.float64)


@pytest.mark.thorough
def test_ambient_light_is_the_same_all_over_the_ball():
    matte = pictures(draw_figure("ambient_and_diffuse"))[5]  # k_a = 0.1, k_d = 0
    np.testing.assert_allclose(matte[40:128, 40:128], 0.1, atol=1e-6)


def test_snell_says_18_09_degrees():
    said = [words for words, _ in texts(draw_figure("snell"))]
    assert "30°" in said
    assert "18.09°" in said


def test_the_ray_leaves_the_slab_parallel_and_the_steep_one_not_at_all():
    _, slab, leaving = draw_figure("snell").axes
    solid = [np.column_stack(curve(line)) for line in slab.lines if line.get_linestyle() == "-"]
    first, _, last = (part[1] - part[0] for part in solid)
    np.testing.assert_allclose(first / np.linalg.norm(first), last / np.linalg.norm(last), atol=1e-6)
    ends = [curve(line)[1][1] for line in leaving.lines if line.get_linestyle() == "-"][1::2]
    assert [y > 0 for y in ends] == [True, True, False]  # 20 and 36 degrees, and 50


def test_the_curves_are_those_of_the_formulas():
    powers = draw_figure("cosine_powers").axes[0].lines
    phi, power = curve(powers[3])
    np.testing.assert_allclose(power, np.cos(np.deg2rad(phi)) ** 27, atol=1e-5)
    radial, angular = draw_figure("attenuation_curves").axes
    d, f = curve(radial.lines[2])
    np.testing.assert_allclose(f, d**-2, rtol=1e-5)
    phi, f = curve(angular.lines[1])
    np.testing.assert_allclose(f, np.where(phi < 40.05, np.cos(np.deg2rad(phi)) ** 2, 0), atol=1e-5)
    _, exact = curve(draw_figure("fresnel_weight").axes[0].lines[1])
    assert exact[0] == pytest.approx(0.04, abs=1e-6)
    assert exact[-1] == pytest.approx(1.0, abs=1e-5)
    z, s = curve(draw_figure("visibility").axes[0].lines[0])
    np.testing.assert_allclose(s, np.interp(z, [2, 9], [1, 0.15]), atol=1e-5)


def test_rays_end_where_the_light_falls():
    """On the floor at y = -1, or on the ball; the left lamp's rays start at it."""
    lamp, sun = draw_figure("rays_of_light").axes
    for axes in (lamp, sun):
        tips = np.array([note.xy for note in axes.texts if isinstance(note, Annotation)])
        assert len(tips) > 10
        on_ball = np.abs(np.hypot(tips[:, 0] - 0.9, tips[:, 1] + 0.4) - 0.6) < 1e-6
        on_floor = np.abs(tips[:, 1] + 1) < 1e-6
        assert (on_ball | on_floor).sum() == len(tips) - 3  # but for the arrows l
        assert on_ball.any()
        assert on_floor.any()


def test_r_ends_as_high_as_l_on_the_other_side():
    _, built = draw_figure("mirror_direction").axes
    tips = {tuple(np.round(np.asarray(note.xy, float), 6)) for note in built.texts if isinstance(note, Annotation)}
    x, y = np.round([np.sin(np.deg2rad(38)), np.cos(np.deg2rad(38))], 6)
    assert {(x, y), (-x, y), (0.0, y)} <= tips


def test_half_of_white_is_as_bright_as_the_stripes():
    patches = pictures(draw_figure("half_of_white"))[0]
    means = [patches[:, i * 220 : (i + 1) * 220].mean() for i in range(3)]
    np.testing.assert_allclose(means, [0.5, 0.5, 0.2140], atol=1e-4)


@pytest.mark.thorough
def test_only_some(tmp_path):
    paths = ds.lecture.write_figures(str(tmp_path), only=("visibility", "cosine_powers"))
    assert [path.name for path in paths] == ["06_cosine_powers.png", "29_visibility.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["06_cosine_powers.png", "29_visibility.png"]
    assert ds.lecture.write_figures(tmp_path / "one", only="cosine_powers") == (
        tmp_path / "one" / "06_cosine_powers.png",
    )


def test_an_unknown_name_or_a_file_is_one_sentence_and_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"no figure is named 'snel'. Did you mean 'snell'\?"):
        ds.lecture.write_figures(tmp_path / "out", only=("lobes", "snel"))
    with pytest.raises(ValueError, match=r"no figure is named 'zzz'. Known names: ambient_and_diffuse, "):
        draw_figure("zzz")
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("kept")
    with pytest.raises(NotADirectoryError, match="it is not a folder"):
        ds.lecture.write_figures(tmp_path / "file", only="cosine_powers")
    assert (tmp_path / "file").read_text() == "kept"


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

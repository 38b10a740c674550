"""The figures of a lecture: they are drawn by the model, whole, without a warning, and say what they should."""

import dataclasses
from unittest import mock

import imageio.v3 as iio
import jax
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

import diffshade as ds
from diffshade import backend, rendering
from diffshade.report.lecture import FIGURES, draw_figure
from diffshade.report.lecture import pictures as pictures_module

NAMES = tuple(FIGURES)
PALE = ("terms", "diffuse_over_theta")  # a line drawing, and a white tile


QUICK_RENDER = jax.jit(rendering._image, compiler_options=backend.QUICKLY)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """One ray a pixel, compiled without optimisation: faster, and the programs of one test serve the others."""
    monkeypatch.setattr(pictures_module, "RAYS", 1)
    monkeypatch.setattr(rendering, "_render", QUICK_RENDER)


def texts(figure):
    """The words that are drawn, and where they are."""
    drawn, renderer = [], FigureCanvasAgg(figure).get_renderer()
    with mock.patch.object(Text, "draw", autospec=True, side_effect=lambda text, _: drawn.append(text)):
        figure.draw(renderer)
    return [
        (text.get_text(), Text.get_window_extent(text, renderer))
        for text in drawn
        if text.get_visible() and text.get_text().strip()
    ]


def pictures(figure):
    """The rendered pictures of a figure, as linear radiance."""
    return [ds.srgb_decode(np.asarray(image.get_array())) for axes in figure.axes for image in axes.get_images()]


def curve(line):
    """The x and y of a curve."""
    return np.asarray(line.get_xdata(), np.float64), np.asarray(line.get_ydata(), np.float64)


def rendered(scene, camera):
    """What `ds.render` gives, the mean of 3 x 3 rays a pixel, clipped."""
    height, width = camera.shape
    fine = np.asarray(ds.render(scene, dataclasses.replace(camera, shape=(3 * height, 3 * width))), np.float64)
    return fine.reshape(height, 3, width, 3, 3).mean((1, 3)).clip(0, 1)


def test_all_are_written_and_each_is_whole(tmp_path, monkeypatch):
    """One test, so that each picture is rendered once."""
    drawn, save = [], Figure.savefig

    def saving(figure, path):
        drawn.append(figure)
        save(figure, path)

    monkeypatch.setattr(Figure, "savefig", saving)
    folder = tmp_path / "made" / "here"
    paths = ds.write_figures(folder)
    assert [path.name for path in paths] == [f"{i:02}_{name}.png" for i, name in enumerate(NAMES, 1)]
    assert sorted(folder.iterdir()) == sorted(paths)
    for name, path, figure in zip(NAMES, paths, drawn, strict=True):
        check_file(path)
        check_words(figure, name)
        check_pictures(figure, name)


def check_file(path):
    image = iio.imread(path)
    assert image.shape[0] > 250, path.name
    assert 600 < image.shape[1] < 1400, path.name
    assert image[..., :3].std() > 10, path.name


def check_words(figure, name):
    """No word is cut off, and none covers another."""
    found = texts(figure)
    width, height = figure.bbox.size
    assert found
    for i, (words, box) in enumerate(found):
        assert 0 <= box.x0 < box.x1 <= width, (name, words)
        assert 0 <= box.y0 < box.y1 <= height, (name, words)
        covered = [other for other, there in found[i + 1 :] if box.padded(-1).overlaps(there.padded(-1))]
        assert not covered, (name, words)


def check_pictures(figure, name):
    """No two pictures of a figure are the same, and none is clipped where it should show something."""
    images = pictures(figure)
    for i, image in enumerate(images):
        assert all(image.shape != other.shape or np.abs(image - other).max() > 0.005 for other in images[:i]), (name, i)
        assert (image >= 1).all(-1).mean() < 0.2 or name in PALE, (name, i)


def test_a_ball_is_what_render_gives(monkeypatch):
    monkeypatch.setattr(pictures_module, "RAYS", 3)
    figure = draw_figure("diffuse_over_k_d")
    scene = ds.Scene(
        ds.Object(ds.Sphere(), ds.Material(k_d=0.6)), ds.PointLight((3, 4, 6)), background=(0.055, 0.06, 0.075)
    )
    np.testing.assert_allclose(
        pictures(figure)[3], rendered(scene, ds.Camera((0, 0, 5), fov=26, shape=(168, 168))), atol=1e-6
    )
    assert figure.axes[3].get_title() == "$k_d$ = 0.6"


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


def test_the_angle_to_h_is_half_the_angle_to_r():
    assert any("= 32.0°" in words and "= 16.0°" in words for words, _ in texts(draw_figure("phong_and_blinn")))


def test_two_faces_are_one_without_attenuation():
    without, attenuated = pictures(draw_figure("parallel_faces"))
    near, far = (110, 150), (40, 220)
    np.testing.assert_allclose(without[near], without[far], rtol=0.02)
    np.testing.assert_allclose(attenuated[far], 0.5 * attenuated[near], rtol=0.03)  # twice as far, 1/d


def test_a_blue_ball_is_black_in_red_light():
    _, red = pictures(draw_figure("colour_of_light"))
    np.testing.assert_allclose(red[60:120, 220:280], 0.0, atol=1e-6)
    assert red[90, 90, 0] > 0.3


def test_at_k_t_1_there_is_only_the_wall_and_at_0_only_the_ball():
    opaque, *_, invisible = pictures(draw_figure("transmission"))
    assert len(np.unique(np.round(invisible[120:200, 60:160], 3).reshape(-1, 3), axis=0)) < 16  # two colours and edges
    assert len(np.unique(np.round(opaque[120:200, 60:160], 3).reshape(-1, 3), axis=0)) > 300


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


def test_only_some(tmp_path):
    paths = ds.write_figures(str(tmp_path), only=("visibility", "cosine_powers"))
    assert [path.name for path in paths] == ["05_cosine_powers.png", "23_visibility.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["05_cosine_powers.png", "23_visibility.png"]
    assert ds.write_figures(tmp_path / "one", only="lobes") == (tmp_path / "one" / "04_lobes.png",)


def test_an_unknown_name_or_a_file_is_one_sentence_and_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"no figure is named 'snel'. Did you mean 'snell'\?"):
        ds.write_figures(tmp_path / "out", only=("lobes", "snel"))
    with pytest.raises(ValueError, match=r"no figure is named 'zzz'. Known names: ambient_and_diffuse, "):
        draw_figure("zzz")
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("kept")
    with pytest.raises(NotADirectoryError, match="it is no folder"):
        ds.write_figures(tmp_path / "file", only="lobes")
    assert (tmp_path / "file").read_text() == "kept"


def test_a_figure_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    (old,) = ds.write_figures(tmp_path, only="lobes")
    before = old.read_bytes()

    def fail(figure, path):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(KeyboardInterrupt):
        ds.write_figures(tmp_path, only="lobes")
    assert old.read_bytes() == before
    assert list(tmp_path.iterdir()) == [old]

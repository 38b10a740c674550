"""All figures of a lecture: each is whole, and none is like another."""

import dataclasses

import imageio.v3 as iio
import numpy as np
import pytest
from figures import coarse, pictures, texts  # noqa: F401
from matplotlib.figure import Figure

import diffshade as ds
from diffshade.report.lecture import FIGURES, draw_figure
from diffshade.report.lecture import pictures as pictures_module

NAMES = tuple(FIGURES)
PALE = ("terms", "diffuse_over_theta")  # a line drawing, and a white tile


@pytest.mark.parametrize("names", [NAMES[::3], pytest.param(NAMES, marks=pytest.mark.slow)], ids=["some", "all"])
def test_they_are_written_and_each_is_whole(names, tmp_path, monkeypatch):
    """One test, so that each picture is rendered once."""
    drawn, save = [], Figure.savefig

    def saving(figure, path):
        drawn.append(figure)
        save(figure, path)

    monkeypatch.setattr(Figure, "savefig", saving)
    folder = tmp_path / "made" / "here"
    paths = ds.lecture.write_figures(folder, only=None if names == NAMES else names)
    assert [path.name for path in paths] == [f"{NAMES.index(name) + 1:02}_{name}.png" for name in names]
    assert sorted(folder.iterdir()) == sorted(paths)
    for name, path, figure in zip(names, paths, drawn, strict=True):
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


def rendered(scene, camera):
    """What `ds.render` gives, the mean of 3 x 3 rays a pixel, clipped."""
    height, width = camera.shape
    fine = np.asarray(ds.render(scene, dataclasses.replace(camera, shape=(3 * height, 3 * width))), np.float64)
    return fine.reshape(height, 3, width, 3, 3).mean((1, 3)).clip(0, 1)


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


def test_the_highlight_grows_into_the_window_in_the_mirror():
    """What is brighter than half of the brightest overlaps ever more with what the ideal mirror shows."""
    images = [image[..., 0] - image[..., 0].min() for image in pictures(draw_figure("ideal_mirror"))]
    *highlights, mirror = (image > 0.5 * image.max() for image in images)
    overlap = [(bright & mirror).sum() / (bright | mirror).sum() for bright in highlights]
    assert overlap[0] < 0.6
    assert overlap[-1] > 0.9
    assert (np.diff(overlap) > -0.01).all()


def test_light_beyond_a_flap_is_dark():
    air = pictures(draw_figure("warn_flaps"))[1]  # x from -0.35 to 0.2 of 2.2 across 170 pixels
    lit = air[160, :, 0] > 0.1
    np.testing.assert_allclose(np.flatnonzero(lit)[[0, -1]] + 0.5, 85 + 170 / 2.2 * np.array([-0.35, 0.2]), atol=1)


def test_two_panes_pass_the_product_of_what_each_passes():
    panes = pictures(draw_figure("coloured_glass"))[-1]
    np.testing.assert_allclose(panes[10, 10], 0.95, atol=1e-5)
    cyan, magenta = panes[50, 110], panes[150, 45]
    np.testing.assert_allclose(cyan, 0.95 * np.array([0.08, 0.95, 0.95]), atol=1e-5)
    np.testing.assert_allclose(magenta, 0.95 * np.array([0.95, 0.08, 0.95]), atol=1e-5)
    np.testing.assert_allclose(panes[100, 75], cyan * magenta / 0.95, atol=1e-5)


def test_the_angle_to_h_is_half_the_angle_to_r():
    assert any("= 32.0°" in words and "= 16.0°" in words for words, _ in texts(draw_figure("phong_and_blinn")))

"""The picture of photograph, fit and difference."""

import imageio.v3 as iio
import numpy as np
import pytest
import synthetic

import diffshade as ds


@pytest.fixture(scope="module")
def fitted():
    scene = synthetic.standard_scene()
    views = synthetic.one_light_each([image + 0.01 for image in synthetic.photographs(scene)])
    return ds.fit(scene, views, free=synthetic.FREE, tied=synthetic.TIED), views[0]


def test_it_is_one_picture_with_a_row_a_view(fitted, tmp_path):
    fit, view = fitted
    ds.write_figure(tmp_path / "one.png", ds.draw_comparison(fit, view))
    ds.write_figure(tmp_path / "two.png", ds.draw_comparison(fit, [view, view], titles=["first", "second"]))
    one, two = iio.imread(tmp_path / "one.png"), iio.imread(tmp_path / "two.png")
    assert two.shape[1] == one.shape[1]
    assert two.shape[0] > 1.7 * one.shape[0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "two.png"]


def test_the_panels_hold_the_photograph_the_fit_and_their_difference(fitted):
    fit, view = fitted
    panels = []
    for axes in ds.draw_comparison(fit, view).axes[:3]:
        array = axes.get_images()[0].get_array()
        assert array is not None
        panels.append(array)
    photograph, image, difference = panels
    prediction = fit.predict(view)
    inside = prediction.counts.any(-1)
    np.testing.assert_allclose(difference[inside], prediction.difference.mean(-1)[inside])
    assert np.ma.getmaskarray(difference)[~inside].all()
    np.testing.assert_allclose(photograph[~inside], 1.0, atol=1e-12)  # white where nothing is compared
    white = np.quantile(prediction.target[prediction.counts], 0.995)
    np.testing.assert_allclose(
        ds.srgb_decode(image.data)[inside], np.clip(prediction.image / white, 0, 1)[inside], atol=1e-6
    )


def test_titles_must_match_the_views(fitted):
    fit, view = fitted
    with pytest.raises(ValueError, match="titles must be one for each of the 1 views; got 2"):
        ds.draw_comparison(fit, view, titles=["a", "b"])


def test_nothing_is_left_behind_by_a_suffix_that_no_one_knows(fitted, tmp_path):
    fit, view = fitted
    with pytest.raises(ValueError, match="xyz"):
        ds.write_figure(tmp_path / "picture.xyz", ds.draw_comparison(fit, view))
    assert not list(tmp_path.iterdir())

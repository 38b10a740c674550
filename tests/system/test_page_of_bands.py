"""The page and the figure of a fit of bands: their names, their spectra, and what its pictures show, in words."""

import dataclasses

import numpy as np
import pytest
from report_pages import Page

import diffshade as ds

pytestmark = pytest.mark.thorough
CAMERA = ds.Camera(eye=(0, 0, 4), fov=35, shape=(20, 20))
NM = (450.0, 550.0, 610.0, 850.0)
NAMES = [f"{k}.{nm:g}nm" for k in ("k_a", "k_d", "k_s") for nm in NM]


@pytest.fixture(scope="module")
def fit() -> ds.Fit:
    material = ds.Material(0.1, (0.2, 0.3, 0.4, 0.9), 0.4, 20)
    scene = ds.Scene(ds.Object(ds.Sphere(), material), ds.PointLight((2, 3, 4)), bands=NM)
    image = np.array(ds.render(scene, CAMERA), float)
    image[..., 3] += np.random.default_rng(0).normal(0, 0.02, CAMERA.shape)  # the worst band
    image[..., :3] += np.random.default_rng(1).normal(0, 0.005, (*CAMERA.shape, 3))
    return ds.fit(scene, ds.View(image, CAMERA), free=("k_a", "k_d", "k_s", "n_s"))


@pytest.fixture(scope="module")
def page(fit, tmp_path_factory) -> Page:
    path = tmp_path_factory.mktemp("page") / "bands.html"
    ds.write_report(path, fit, plan=ds.plan(fit, ds.Shot(ds.PointLight((0, 3, 4)))))
    return Page(path)


def test_every_band_has_its_row_under_its_name(page):
    names = [text.replace("\n", "").strip() for attributes, text in page.all("th") if attributes.get("scope") == "row"]
    assert names[: len(NAMES) + 1] == [*NAMES, "n_s"]


def test_spectra_are_drawn_with_every_band(page):
    tips = [text for _, text in page.all("title")]
    assert all(any(tip.startswith(f"{name} = ") for tip in tips) for name in NAMES)
    labels = [a["aria-label"] for a, _ in page.all("svg") if "aria-label" in a]
    assert [label.split(":")[0] for label in labels if "over wavelength" in label] == ["k_a", "k_d", "k_s"]
    assert any(label.startswith("Each band: ") and "(850nm)" in label for label in labels)


def test_it_says_which_bands_its_pictures_show(page):
    said = [text for _, text in page.all("p") if "610nm as red, 550nm as green, 450nm as blue" in text]
    assert len(said) == 2  # beside the ball and above the photographs


def test_a_band_that_is_not_determined_is_left_out_of_the_spectrum(fit, tmp_path):
    lost = np.array([name == "k_s.850nm" for name in fit.names])
    ds.write_report(tmp_path / "fit.html", dataclasses.replace(fit, determined=~lost))
    page = Page(tmp_path / "fit.html")
    assert not any(text.startswith("k_s.850nm = ") for _, text in page.all("title"))
    assert any("1 of the 4 bands are not determined" in text for _, text in page.all("p"))


def test_the_figure_shows_three_bands_and_says_which(fit):
    (view,) = fit.views
    figure = ds.draw_comparison(fit, view)
    assert "610nm as red, 550nm as green, 450nm as blue" in figure.get_suptitle()
    prediction = fit.predict(view)
    inside = prediction.counts.any(-1)
    (shown,) = figure.axes[1].get_images()
    array = shown.get_array()
    assert array is not None
    drawn = prediction.image[..., [2, 1, 0]][inside]
    white = np.quantile(prediction.target[..., [2, 1, 0]][inside], 0.995)
    np.testing.assert_allclose(ds.srgb_decode(array.data)[inside], np.clip(drawn / white, 0, 1), atol=1e-6)

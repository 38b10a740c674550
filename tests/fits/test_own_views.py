"""Own views: an unknown of one block held elsewhere costs what it costs all views, in a time of its own views."""

from __future__ import annotations

from functools import cache

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.diagnosis import intervals as module
from diffshade.diagnosis.intervals import LikelihoodProfile, intervals
from diffshade.diagnosis.patches import find_clusters
from diffshade.inverse.laid_out import LaidOut
from diffshade.inverse.own_views import OwnViews
from tests.support.textured import lights_about

CAMERA = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(20, 20), height=2.2, local_viewer=False)
LEVELS = (0.68, 0.95)


@cache
def fitted(count: int = 8, loss: str = "squares") -> ds.Fit:
    """A fit of a ball under lights stated 2 degrees off, with the lights' directions."""
    random, towards = np.random.default_rng(0), lights_about(count)
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.0, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=20.0))
    true = ds.Scene(ball, [ds.DirectionalLight(-l) for l in towards])
    images = [np.asarray(ds.render(true, CAMERA, lit=i)) for i in range(count)]
    views = [ds.View(i + 0.02 * random.standard_normal(i.shape), CAMERA, lit=k) for k, i in enumerate(images)]
    stated = towards + np.deg2rad(2.0) * random.standard_normal(towards.shape)
    scene = ds.Scene(ball, [ds.DirectionalLight(-l) for l in stated])
    return ds.fit(scene, views, free=("k_d", "k_s", "n_s", "direction"), light_error=2.0, loss=loss)


SCALES: dict[str, dict] = {"intensity": {"intensity_error": 0.05}, "exposure": {"priors": {"exposure": (1.0, 0.05)}}}


@cache
def scaled(name: str, *more: str, count: int = 16, k_s: float = 0.3, noise: float = 0.01, seed: int = 0) -> ds.Fit:
    """A fit of a ball with the intensities of its lights, or the exposures of its views, stated to 5 %."""
    random, towards = np.random.default_rng(seed), lights_about(count)
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.0, k_d=(0.5, 0.4, 0.3), k_s=k_s, n_s=20.0))
    sent = np.exp(0.05 * random.standard_normal(count))
    lamps: list = [ds.DirectionalLight(-l, intensity=s) for l, s in zip(towards, sent, strict=True)]
    stated: list = [ds.DirectionalLight(-l) for l in towards]
    if "attenuation" in more:
        fade = ds.RadialAttenuation(1.0, 0.1, 0.03)
        lamps = [ds.PointLight(3.0 * l, intensity=s, attenuation=fade) for l, s in zip(towards, sent, strict=True)]
        stated = [ds.PointLight(3.0 * l, attenuation=fade) for l in towards]
    images = [np.asarray(ds.render(ds.Scene(ball, lamps), CAMERA, lit=i)) for i in range(count)]
    views = [ds.View(i + noise * random.standard_normal(i.shape), CAMERA, lit=k) for k, i in enumerate(images)]
    tied = [of for of in more if of == "attenuation"]
    return ds.fit(ds.Scene(ball, stated), views, free=("k_d", "k_s", *more, name), tied=tied, **SCALES[name])


def found(fit: ds.Fit, *, alone: bool = True) -> tuple[np.ndarray, LikelihoodProfile]:
    with jax.enable_x64(True), pytest.MonkeyPatch.context() as patch:
        if not alone:
            patch.setattr(module, "blocks", lambda *_: [])
        profile = LikelihoodProfile(fit, find_clusters(fit))
        return intervals(profile, LEVELS), profile


@cache
def by_all_views() -> np.ndarray:
    return found(fitted(), alone=False)[0]


@pytest.mark.thorough
@pytest.mark.parametrize("loss", ["squares", "cauchy"])
def test_intervals_by_own_views_are_those_by_all_views(loss, monkeypatch):
    monkeypatch.setattr(module, "ACCURATE", 1e-7)
    monkeypatch.setattr(module, "CLOSE", 1e-5)
    fit = fitted(8, loss)
    by_own, profile = found(fit)
    by_all, _ = found(fit, alone=False)
    reach = np.abs(by_all - fit.values[:, None]).max((0, 2))
    assert np.all(np.abs(by_own - by_all).max((0, 2)) < 1e-4 * reach)
    np.testing.assert_allclose(by_own, by_all, rtol=1e-6 if loss == "squares" else 3e-6)
    assert all(len(points) >= 4 for points in profile.evaluated)


@pytest.mark.thorough
def test_passes_over_all_views_do_not_become_more_with_the_views(monkeypatch):
    calls = dict.fromkeys(("all", "own"), 0)
    whole, own = LaidOut.minimise, OwnViews.rise

    def counted(name, method):
        def call(*of, **options):
            calls[name] += 1
            return method(*of, **options)

        return call

    monkeypatch.setattr(LaidOut, "minimise", counted("all", whole))
    monkeypatch.setattr(OwnViews, "rise", counted("own", own))
    numbers = []
    for count in (8, 16):
        fit = fitted(count)
        calls.update({"all": 0, "own": 0})
        found(fit)
        numbers.append(dict(calls))
    few, many = numbers
    assert many["all"] <= few["all"] + 8
    assert many["own"] <= 2.3 * few["own"]


def by_own_views_alone(fit: ds.Fit, monkeypatch) -> np.ndarray:
    """Return the intervals without the comparison with all views."""
    with monkeypatch.context() as patch:
        patch.setattr(module, "SAME", np.inf)
        return found(fit)[0]


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "near", "most"), [("intensity", 2.5e-3, 80), ("exposure", 4e-3, 125)])
def test_the_scale_that_all_reflections_share_with_the_lights_is_followed(name, near, most, monkeypatch):
    """Three errors of an intensity move the scale of all by 3 %, far beyond where other views are quadratic in k_d.

    If they were taken as quadratic, intervals would differ by 7e-3 and 15e-3 of their widths.
    """
    monkeypatch.setattr(module, "CLOSE", 1e-4)
    fit, asked = scaled(name, "n_s"), []
    by_all, _ = found(fit, alone=False)
    away = np.abs(by_own_views_alone(fit, monkeypatch) - by_all).max(-1)
    assert np.all(away <= near * np.ptp(by_all, axis=-1))
    monkeypatch.undo()
    whole = LaidOut.minimise
    monkeypatch.setattr(LaidOut, "minimise", lambda *of, **options: asked.append(of) or whole(*of, **options))
    found(fit)
    assert len(asked) <= most  # of the border, and of the farthest few


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("more", "k_s", "noise", "seed", "near"), [((), 0.0, 0.02, 4, 6e-3), (("attenuation",), 0.3, 0.03, 1, 0.03)]
)
def test_reflections_lost_in_the_noise_have_no_logarithm(more, k_s, noise, seed, near, monkeypatch):
    """A highlight that is not there, and reflections that attenuation leaves open.

    With inverses the intervals of the second would be 1.6 widths off.
    """
    monkeypatch.setattr(module, "CLOSE", 1e-3)
    fit = scaled("exposure", *more, k_s=k_s, noise=noise, seed=seed)
    by_all, _ = found(fit, alone=False)
    away = np.abs(by_own_views_alone(fit, monkeypatch) - by_all).max(-1)
    assert np.all(away <= near * np.ptp(by_all, axis=-1))


@pytest.mark.thorough
def test_where_other_views_are_quadratic_in_nothing_all_views_are_asked(monkeypatch):
    """Attenuation leaves reflections open to 60 %."""
    monkeypatch.setattr(module, "CLOSE", 1e-3)
    fit = scaled("exposure", "attenuation", noise=0.03, seed=4)
    by_all, _ = found(fit, alone=False)
    assert np.all(np.abs(found(fit)[0] - by_all).max(-1) <= 0.01 * np.ptp(by_all, axis=-1))


def test_a_rise_that_is_no_number_is_not_believed(monkeypatch):
    fit, j = fitted(), 20
    of = OwnViews.rise
    monkeypatch.setattr(OwnViews, "rise", lambda self, k, *on: (np.nan, 0.0) if k == j else of(self, k, *on))
    by_own = found(fit)[0]
    assert np.isfinite(by_own).all()
    np.testing.assert_allclose(by_own[:, j], by_all_views()[:, j], rtol=1e-9)
    reach = np.abs(by_all_views() - fit.values[:, None]).max((0, 2))
    assert np.all(np.abs(by_own - by_all_views()).max((0, 2)) < 2.0 * module.CLOSE * reach)


def test_where_own_views_say_something_else_all_views_are_asked(monkeypatch):
    fit = fitted()
    monkeypatch.setattr(OwnViews, "rise", lambda self, j, t, start, least: (1e3 * least, 0.0))
    np.testing.assert_allclose(found(fit)[0], by_all_views(), rtol=1e-12)
    monkeypatch.setattr(module, "ALIKE", 0)
    assert np.abs(found(fit)[0] - by_all_views()).max() > 1e-4

"""The report page: what is in it, and that nothing in it is code but its own; its ball is in studies."""

import base64
import dataclasses
import json
import re

import equinox as eqx
import imageio.v3 as iio
import jax
import numpy as np
import pytest
from changed_fits import with_problem
from report_pages import LIGHTS, Page
from synthetic import photograph

import diffshade as ds
from diffshade.core.progress import silent
from diffshade.diagnosis.model_choice import ModelChoice
from diffshade.report.page.ball import ball_scene
from diffshade.report.page.residuals import collect_residuals, curve
from diffshade.report.page.writing import MOST_SHOTS, MOST_VIEWS

HOSTILE = "</script><img src=x onerror=alert(1)>'\"&{{7*7}}"
CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(24, 24))


@pytest.fixture(scope="module")
def fit():
    random = np.random.default_rng(0)
    lights = [ds.DirectionalLight(towards) for towards in ((-1, -1, -1), (1, -1, -1), (0, 1, -2))]
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 20)), lights)
    images = [photograph(scene, CAMERA, (i,)) for i in range(3)]
    views = [ds.View(image + random.normal(0, 0.002, image.shape), CAMERA, lit=(i,)) for i, image in enumerate(images)]
    return ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))


@pytest.fixture
def page(fit, tmp_path):
    ds.write_report(tmp_path / "fit.html", fit)
    assert [path.name for path in tmp_path.iterdir()] == ["fit.html"]
    return Page(tmp_path / "fit.html")


def test_every_number_stands_in_it_with_its_error(fit, page):
    (table,) = [i for i, (tag, a, _) in enumerate(page.elements) if tag == "table" and a.get("class") == "parameters"]
    cells = ["".join(text).strip() for tag, _, text in page.elements[table:] if tag in ("th", "td")]
    for name, value, error in zip(fit.names, fit.values, fit.errors, strict=True):
        at = cells.index(name)
        assert float(cells[at + 1]) == pytest.approx(value, abs=0.06 * error)
        assert float(cells[at + 2].lstrip("±+−")) == pytest.approx(error, rel=0.06)


def test_what_is_not_known_is_said_in_words(fit, tmp_path):
    lost = np.array([name == "n_s" for name in fit.names])
    dull = dataclasses.replace(fit, determined=~lost, notes=("n_s < 3 is lost in the noise.",), converged=False)
    ds.write_report(tmp_path / "fit.html", dull)
    page = Page(tmp_path / "fit.html")
    assert [text for _, text in page.all("td")].count("not determined") == 1
    assert dull.notes[0] in [text for _, text in page.all("li")]
    assert any("not determined: n_s." in text for _, text in page.all("p"))
    (lead,) = [text for attributes, text in page.all("p") if attributes.get("class") == "lead"]
    assert "did not converge" in lead
    assert "9 of the 10 parameters" in lead


def test_a_page_of_a_camera_with_a_sensor_says_that_it_shows_linear_light(fit, page, tmp_path):
    assert not any("they show linear light" in text for _, text in page.all("p"))
    views = tuple(dataclasses.replace(view, sensor=ds.Sensor(gamma=1.8)) for view in fit.views)
    ds.write_report(tmp_path / "sensor.html", with_problem(fit, views=views))
    assert any("they show linear light" in text for _, text in Page(tmp_path / "sensor.html").all("p"))


def test_it_runs_nothing_but_its_own_scripts_and_asks_for_nothing(page):
    page.assert_it_runs_its_own_scripts_alone()
    assert (len(page.scripts()), len(page.all("style"))) == (3, 1)
    assert "http" not in "".join(text for tag in ("style", "script") for _, text in page.all(tag))


def choice_of(name):
    one, number = np.ones(2), np.ones(2, int)
    return ModelChoice((name, "other"), one, one, number, 0 * one, one, one, one > 2, one, 3, "3 views", (name,))


@pytest.mark.thorough
def test_whatever_is_shown_is_escaped(fit, tmp_path):
    shot = ds.Shot(name=HOSTILE)
    scene = ds.Scene(ds.Object(ds.Sphere(), fit.material, name="bällchen"), fit.scene.lights)
    named = with_problem(
        dataclasses.replace(fit, notes=(HOSTILE,)),
        scene=scene,
        unknowns=tuple(dataclasses.replace(u, quantity=f"{u.quantity}{HOSTILE}") for u in fit.unknowns),
    )
    choice, plan = choice_of(HOSTILE), dataclasses.replace(ds.plan(fit, shot), unknowns=named.unknowns)
    names = ["first", HOSTILE, "third"]
    ds.write_report(tmp_path / "fit.html", named, titles=names, choice=choice, plan=plan)
    page = Page(tmp_path / "fit.html")
    ds.write_report(tmp_path / "plain.html", fit, choice=choice_of("plain"), plan=ds.plan(fit, shot))
    plain = Page(tmp_path / "plain.html")
    assert len(page.all("script")) == len(plain.all("script")) == 5
    assert len(page.all("img")) == len(plain.all("img")) == 9
    assert not [a for _, a, _ in page.elements if "onerror" in a]
    text = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "{{7*7}}" in text
    assert "<img src=x" not in text
    (told,) = [json.loads(t) for a, t in page.all("script") if a.get("id") == "ball-scene"]
    assert [view["name"] for view in told["views"]] == names
    assert told["objects"][0]["name"] == "bällchen"
    seen = [text for tag in ("li", "strong", "option", "th") for _, text in page.all(tag)]
    assert sum(HOSTILE in words for words in seen) >= 5


def test_the_pictures_are_the_photograph_and_the_fit(fit, page):
    files = {a["alt"]: base64.b64decode(a["src"].split(",")[1]) for a, _ in page.all("img")}
    images = {alt: iio.imread(file, mode="RGBA") for alt, file in files.items()}
    predictions = [fit.predict(view) for view in fit.views]
    white = max(np.quantile(p.target[p.counts], 0.995) for p in predictions)
    for i, p in enumerate(predictions):
        shown = images[f"The fit of view {i}"][..., :3] / 255
        assert np.abs(shown - ds.srgb_encode(np.clip(p.image / white, 0, 1))).mean() < 0.02
        (difference,) = [image for alt, image in images.items() if alt.startswith(f"Fit minus photograph of view {i}")]
        np.testing.assert_array_equal(difference[..., 3] > 0, p.counts.any(-1))


@pytest.mark.thorough
def test_large_photographs_are_shown_smaller_and_of_many_views_some(fit, tmp_path):
    camera = dataclasses.replace(CAMERA, shape=(30, 1000))
    image = np.broadcast_to(np.linspace(0, 1, 1000)[:, None], (30, 1000, 3))
    large = with_problem(fit, views=(ds.View(image, camera, lit=(0,)),) * (MOST_VIEWS + 3))
    ds.write_report(tmp_path / "fit.html", large)
    page = Page(tmp_path / "fit.html")
    assert {(a["width"], a["height"]) for a, _ in page.all("img")} == {("800", "24")}
    assert len(page.all("img")) == 3 * MOST_VIEWS
    assert f"{MOST_VIEWS} of the {MOST_VIEWS + 3} views" in " ".join(text for _, text in page.all("p"))


def test_of_many_photographs_to_take_the_best_are_shown_and_the_others_on_demand(fit, tmp_path):
    shots = [ds.Shot(exposure=0.1 * (i + 1), name=f"number {i}") for i in range(MOST_SHOTS + 3)]
    plan = ds.plan(fit, shots)
    ds.write_report(tmp_path / "fit.html", fit, plan=plan)
    text = (tmp_path / "fit.html").read_text(encoding="utf-8")
    shown, hidden = text.split("<summary>The other 3</summary>")
    names = [plan.names[i] for i in plan.order]
    assert [name for name in names if f">{name}<" in shown] == names[:MOST_SHOTS]
    assert [name for name in names if f">{name}<" in hidden] == names[MOST_SHOTS:]


def test_a_wrong_model_shows_over_the_angle_of_the_highlight(fit):
    with jax.enable_x64(True):
        residuals = collect_residuals(fit, silent)
        dull = eqx.tree_at(lambda s: s.objects[0].material.k_s, fit.scene, np.zeros(3))
        wrong = collect_residuals(with_problem(fit, scene=dull), silent)
    right, off = curve(residuals, residuals.to_mirror), curve(wrong, wrong.to_mirror)
    assert right is not None
    assert off is not None
    assert np.abs(right.mean).max() < 0.002
    assert off.mean[0] < -0.05  # the highlight is missing where v is r
    assert abs(off.mean[-1]) < 0.002
    n_l = np.cos(np.deg2rad(residuals.to_light))
    assert n_l.max() > 0.99
    assert np.isnan(residuals.to_mirror[n_l < -1e-9]).all()


REFUSED = {
    "another suffix": (lambda fit, path: ds.write_report(path / "fit.pdf", fit), r"has the suffix '\.pdf'.*Use \.html"),
    "titles of other views": (lambda fit, path: ds.write_report(path / "a.html", fit, titles=["one"]), "got 1"),
    "a plan of another fit": (
        lambda fit, path: ds.write_report(
            path / "a.html", dataclasses.replace(fit, values=fit.values + 1), plan=ds.plan(fit, ds.Shot())
        ),
        "plan must belong to the fit",
    ),
    "no folder": (lambda fit, path: ds.write_report(path / "none" / "a.html", fit), "there is no folder"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_belong_together_is_refused_before_anything_is_written(name, fit, tmp_path):
    call, words = REFUSED[name]
    with pytest.raises((ValueError, FileNotFoundError), match=words):
        call(fit, tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_the_ball_does_not_show_is_said(fit):
    scene = ds.Scene(
        [
            ds.Object(ds.Box(), ds.Material(k_d=ds.Chequer(0.2, 0.6))),
            ds.Object(ds.Sphere((3, 0, 0)), ds.Material(k_s=0.2, k_t=0.5)),
        ],
        LIGHTS,
        atmosphere=ds.Fog(0.1),
    )
    view = ds.View(np.full((24, 24, 3), 0.5), dataclasses.replace(CAMERA, fov=90.0))
    with jax.enable_x64(True):
        told, missing = ball_scene(with_problem(fit, scene=scene, views=(view,)), ["view 0"], 1.0)
    said = "; ".join(missing)
    for words in ("shape", "more than one object", "k_t", "patterns", "atmosphere"):
        assert words in said
    assert told["objects"][0]["material"]["k_d"] == pytest.approx([0.4] * 3)
    assert 0.3 < told["objects"][0]["radius"] < 0.8
    assert re.fullmatch(r"objects\.\d", told["objects"][1]["name"])

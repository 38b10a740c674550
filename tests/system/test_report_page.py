"""The report page: what is in it, that nothing in it is code but its own, and that its ball is what `render` draws."""

import base64
import dataclasses
import hashlib
import io
import json
import re
from html.parser import HTMLParser

import equinox as eqx
import imageio.v3 as iio
import jax
import numpy as np
import pytest
from browser import chromium
from scipy import ndimage
from synthetic import photograph

import diffshade as ds
from diffshade.progress import silent
from diffshade.report.page import MOST_SHOTS, MOST_VIEWS
from diffshade.report.page.ball import ball_scene, ball_shape
from diffshade.report.page.residuals import curve, look_at_residuals

HOSTILE = "</script><img src=x onerror=alert(1)>'\"&{{7*7}}"
CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(24, 24))
FADING = ds.RadialAttenuation(0.5, 0.1, 0.05, clamp=True)
LIGHTS = (
    ds.PointLight((2, 2, 3), 9.0, ds.RadialAttenuation(1.0, 0.1, 0.5)),
    ds.DirectionalLight((1, -1, -1), (0.7, 0.6, 0.5)),
    ds.SpotLight((0.5, 1.5, 3), (0, -0.5, -1), 1.2, cutoff=25, exponent=3, softness=8, attenuation=FADING),
    ds.AreaLight((-2, 1, 2), (1, 0, 0), (0, -0.6, 0.8), 0.8, samples=(3, 2)),
)


@pytest.fixture(scope="module")
def fit():
    random = np.random.default_rng(0)
    lights = [ds.DirectionalLight(towards) for towards in ((-1, -1, -1), (1, -1, -1), (0, 1, -2))]
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 20)), lights)
    images = [photograph(scene, CAMERA, (i,)) for i in range(3)]
    views = [ds.View(image + random.normal(0, 0.002, image.shape), CAMERA, lit=(i,)) for i, image in enumerate(images)]
    return ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))


class Page(HTMLParser):
    """A page taken apart: its elements with their attributes, and the text in each."""

    def __init__(self, path):
        super().__init__()
        self.elements, self.open = [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), []))
        if tag not in ("meta", "link", "img", "input", "wbr"):
            self.open.append(self.elements[-1])

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        if self.open:
            self.open[-1][2].append(data)

    def all(self, tag):
        return [(attributes, "".join(text)) for name, attributes, text in self.elements if name == tag]


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
    assert any("these are not determined: n_s." in text for _, text in page.all("p"))
    (lead,) = [text for attributes, text in page.all("p") if attributes.get("class") == "lead"]
    assert "did not converge" in lead
    assert "9 of the 10 numbers" in lead


def test_it_runs_nothing_but_its_own_scripts_and_asks_for_nothing(page):
    (policy,) = [a["content"] for a, _ in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; img-src data:;")
    assert "unsafe" not in policy
    scripts = [text for attributes, text in page.all("script") if "type" not in attributes]
    styles = [text for _, text in page.all("style")]
    assert (len(scripts), len(styles)) == (2, 1)
    for text in scripts + styles:
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    for tag, attributes, _ in page.elements:
        assert not [name for name in attributes if name.startswith("on") or name == "style"]
        for name in ("src", "href"):
            assert attributes.get(name, "data:").startswith("data:"), tag
    assert "http" not in "".join(text for tag in ("style", "script") for _, text in page.all(tag))


def choice_of(name):
    one, number = np.ones(2), np.ones(2, int)
    return ds.ModelChoice((name, "other"), one, one, number, 0 * one, one, one, one > 2, one, 3, "3 views", (name,))


def test_whatever_is_shown_is_escaped(fit, tmp_path):
    shot = ds.Shot(name=HOSTILE)
    scene = ds.Scene(ds.Object(ds.Sphere(), fit.material, name="bällchen"), fit.scene.lights)
    named = dataclasses.replace(
        fit,
        scene=scene,
        notes=(HOSTILE,),
        unknowns=tuple(dataclasses.replace(u, name=f"{u.name}{HOSTILE}") for u in fit.unknowns),
    )
    choice, plan = choice_of(HOSTILE), dataclasses.replace(ds.plan(fit, shot), unknowns=named.unknowns)
    names = ["first", HOSTILE, "third"]
    ds.write_report(tmp_path / "fit.html", named, titles=names, choice=choice, plan=plan)
    page = Page(tmp_path / "fit.html")
    ds.write_report(tmp_path / "plain.html", fit, choice=choice_of("plain"), plan=ds.plan(fit, shot))
    plain = Page(tmp_path / "plain.html")
    assert len(page.all("script")) == len(plain.all("script")) == 4
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


def test_large_photographs_are_shown_smaller_and_of_many_views_some(fit, tmp_path):
    camera = dataclasses.replace(CAMERA, shape=(30, 1000))
    image = photograph(fit.scene, camera, (0,))
    large = dataclasses.replace(fit, views=(ds.View(image, camera, lit=(0,)),) * (MOST_VIEWS + 3))
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
        residuals = look_at_residuals(fit, silent)
        dull = eqx.tree_at(lambda s: s.objects[0].material.k_s, fit.scene, np.zeros(3))
        wrong = look_at_residuals(dataclasses.replace(fit, scene=dull), silent)
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
        "plan must be of the fit",
    ),
    "no folder": (lambda fit, path: ds.write_report(path / "none" / "a.html", fit), "there is no folder"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_belong_together_is_refused_before_anything_is_written(name, fit, tmp_path):
    call, words = REFUSED[name]
    with pytest.raises((ValueError, FileNotFoundError), match=words):
        call(fit, tmp_path)
    assert not list(tmp_path.iterdir())


# The live ball

OBJECTS = (
    ds.Object(ds.Sphere(), ds.Material(0.1, (0.6, 0.4, 0.2), (0.5, 0.4, 0.3), n_s=(50, 40, 30)), name="phong"),
    ds.Object(
        ds.Sphere((0.1, -0.2, 0.3), 0.8), ds.Material(0.1, 0.5, 0.2, 200, ds.Blinn(), ds.Schlick()), name="schlick"
    ),
    ds.Object(
        ds.Sphere(radius=0.9),
        ds.Material(0.02, 0.1, n_s=5000, fresnel=ds.Dielectric(), eta=1.5, k_e=0.05),
        name="dielectric",
    ),
)
AROUND = ds.OrthographicCamera(
    (3e3, 1e3, 4e3), height=2.6, shape=(24, 32), local_viewer=False
)  # far: what float32 could lose
VIEWS = (
    ds.View(np.full((24, 24, 3), 0.5), CAMERA, lit=(0, 1, 3)),
    ds.View(np.full((24, 32, 3), 0.5), AROUND, lit=(1, 2), exposure=0.8, black=0.03),
)


def turned(vector, camera, turn, tilt):
    """What the ball's sliders do to where a light is, seen from the centre."""
    backward = unit(camera.eye - camera.target)
    right = unit(np.cross(camera.up, backward))
    up = np.cross(backward, right)
    for axis, angle in ((up, np.deg2rad(turn)), (right, np.deg2rad(tilt))):
        c, s = np.cos(angle), np.sin(angle)
        vector = vector * c + np.cross(axis, vector) * s + axis * (axis @ vector) * (1 - c)
    return vector


def moved(light, center, camera, turn, tilt):
    def about(vector, from_center):
        origin = center if from_center else 0.0
        return origin + turned(np.asarray(vector) - origin, camera, turn, tilt)

    places = [
        (name, name in ("position", "corner")) for name in ("position", "corner", "direction", "edge_u", "edge_v")
    ]
    changed = {name: about(getattr(light, name), at) for name, at in places if hasattr(light, name)}
    return dataclasses.replace(light, **changed)


def on_one_side(scene, camera):
    """Pixels that lie, with their eight neighbours, on one side of the silhouette and of every light's gates."""
    seen = ds.intersect(scene, camera)
    n, p, inside = map(np.asarray, (seen.normal, seen.position, seen.mask))
    backward = unit(camera.eye - camera.target)
    v = unit(camera.eye - p) if camera.local_viewer else backward
    sides = [inside]
    for light in scene.lights:
        for place, axis, cutoff in emitters(light):
            l = unit(-np.asarray(axis)) if place is None else unit(place - p)
            n_l = np.sum(n * l, -1)
            sides += [n_l > 0, np.sum(v * (2 * n_l[..., None] * n - l), -1) > 0]
            if cutoff is not None:
                sides.append(np.sum(-l * unit(np.asarray(axis)), -1) > np.cos(np.deg2rad(cutoff)))
    sides, around = np.stack([side & inside for side in sides]), (1, 3, 3)
    return (ndimage.minimum_filter(sides, around) == ndimage.maximum_filter(sides, around)).all(0)


def emitters(light):
    """The position, axis and cutoff of each of a light's emitters, None for what it has not."""
    if isinstance(light, ds.AreaLight):
        (rows, columns), axis = light.samples, np.cross(light.edge_u, light.edge_v)
        cells = [((i + 0.5) / rows, (j + 0.5) / columns) for i in range(rows) for j in range(columns)]
        return [(light.corner + u * light.edge_u + v * light.edge_v, axis, light.cutoff) for u, v in cells]
    return [tuple(getattr(light, name, None) for name in ("position", "direction", "cutoff"))]


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def expected(told, item, view, lights):
    """What `render` draws of one object in a view, as the page shows it, and where it may be compared."""
    camera = dataclasses.replace(view.camera, shape=ball_shape(view.camera.shape))
    scene = ds.Scene(dataclasses.replace(item, name=""), lights)
    with jax.enable_x64(True):
        radiance, where = np.asarray(ds.render(scene, camera)), on_one_side(scene, camera)
    return ds.srgb_encode(np.clip(told["gain"] * radiance + told["black"], 0, 1)), where


DRAWN = """
const [object, view, values, done] = arguments, ball = document.getElementById("ball");
const set = (name, value) => {
  const control = ball.querySelector(`[name="${name}"]`);
  control.value = value;
  control.dispatchEvent(new Event("input", {bubbles: true}));
};
set("object", object);
set("view", view);
for (const [name, value] of Object.entries(values)) set(name, value);
done([ball.querySelector("canvas").toDataURL(), ball.querySelector(".as-code").textContent]);
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as running:
        yield running


@pytest.fixture(scope="module")
def ball(fit, browser, tmp_path_factory):
    """A page whose ball has every kind of light, lobe and Fresnel term, open in a browser."""
    path = tmp_path_factory.mktemp("page") / "ball.html"
    ds.write_report(path, dataclasses.replace(fit, scene=ds.Scene(OBJECTS, LIGHTS), views=VIEWS))
    browser.get(path.as_uri())
    (told,) = [json.loads(t) for a, t in Page(path).all("script") if a.get("id") == "ball-scene"]
    return told


def draw(browser, object_, view, **values):
    uri, code = browser.execute_async_script(DRAWN, object_, view, values)
    return iio.imread(io.BytesIO(base64.b64decode(uri.split(",")[1])))[..., :3] / 255, code


CASES = ((0, 0, 70.0, -35.0), (1, 1, -25.0, 15.0), (2, 0, 0.0, 0.0))
EVERY = [(i, j, turn, tilt) for i in range(3) for j in range(2) for turn, tilt in ((0.0, 0.0), (-160.0, 20.0))]


@pytest.mark.parametrize("cases", [CASES, pytest.param(EVERY, marks=pytest.mark.slow)], ids=["some", "every"])
def test_the_live_ball_is_what_render_draws(cases, ball, browser):
    worst = 0.0
    for i, j, turn, tilt in cases:
        item, view = OBJECTS[i], VIEWS[j]
        lights = [moved(LIGHTS[k], item.surface.center, view.camera, turn, tilt) for k in view.lit]
        image, where = expected(ball["views"][j], item, view, lights)
        drawn, _ = draw(browser, i, j, turn=turn, tilt=tilt)
        assert drawn.shape == image.shape
        assert where.mean() > 0.7
        assert np.ptp(image[where]) > 0.2
        worst = max(worst, np.abs(drawn - image)[where].max())
    print(f"largest difference of the live ball from render: {255 * worst:.3f}/255")
    assert worst <= 1 / 255
    assert browser.get_log("browser") == []


def test_the_sliders_of_the_ball_change_the_material(ball, browser):
    view, item, lit = VIEWS[0], OBJECTS[0], (0, 1, 3)
    drawn, code = draw(browser, 0, 0, k_d=0.3, k_s=0.25, n_s=2.0)
    k_d, k_s, n_s = (np.array(of) for of in ((0.3, 0.2, 0.1), (0.25, 0.2, 0.15), (100, 80, 60)))
    changed = dataclasses.replace(item.material, k_d=k_d, k_s=k_s, n_s=n_s)
    image, where = expected(ball["views"][0], ds.Object(item.surface, changed), view, [LIGHTS[k] for k in lit])
    assert np.abs(drawn - image)[where].max() <= 1 / 255
    assert code == (
        "ds.Material(k_a=0.1, k_d=(0.3, 0.2, 0.1), k_s=(0.25, 0.2, 0.15), k_e=0, n_s=(100, 80, 60), lobe=ds.Phong())"
    )


def test_dragging_moves_the_light_and_a_wipe_the_line(ball, browser):
    from selenium.webdriver import ActionChains

    draw(browser, 0, 0, turn=0.0, tilt=0.0)
    canvas = browser.find_element("css selector", "canvas")
    ActionChains(browser).click_and_hold(canvas).move_by_offset(canvas.size["width"] // 4, -20).release().perform()
    turn, tilt = (float(browser.find_element("name", name).get_attribute("value")) for name in ("turn", "tilt"))
    assert turn == pytest.approx(45, abs=2)
    assert -20 < tilt < -5
    moved_line = """
        const slider = document.querySelector(".wipe input");
        slider.value = 80;
        slider.dispatchEvent(new Event("input"));
        return getComputedStyle(slider.parentElement).getPropertyValue("--at");"""
    assert browser.execute_script(moved_line) == "80%"


def test_every_control_has_a_name_and_nothing_is_wider_than_a_phone(ball, browser):
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 360, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    )
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    nodes = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    kinds = ("slider", "combobox", "radio", "button", "image")
    controls = [node for node in nodes if node.get("role", {}).get("value") in kinds]
    assert len(controls) > 15
    assert all(node["name"]["value"].strip() for node in controls)


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
        told, missing = ball_scene(dataclasses.replace(fit, scene=scene, views=(view,)), ["view 0"], 1.0)
    said = "; ".join(missing)
    for words in ("shape", "more than one object", "k_t", "patterns", "atmosphere"):
        assert words in said
    assert told["objects"][0]["material"]["k_d"] == pytest.approx([0.4] * 3)
    assert 0.3 < told["objects"][0]["radius"] < 0.8
    assert re.fullmatch(r"objects\.\d", told["objects"][1]["name"])

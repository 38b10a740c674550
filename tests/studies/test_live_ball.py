"""The ball of a report page, in a browser: it is what `render` draws, and can be handled."""

import base64
import dataclasses
import io
import json

import imageio.v3 as iio
import jax
import numpy as np
import own_parts
import pytest
from changed_fits import with_problem
from directions import unit
from report_pages import LIGHTS, Page
from scipy import ndimage
from synthetic import photograph

import diffshade as ds
from diffshade.report.page.ball import ball_shape

CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(24, 24))


@pytest.fixture(scope="module")
def fit():
    lights = [ds.DirectionalLight(towards) for towards in ((-1, -1, -1), (1, -1, -1), (0, 1, -2))]
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 20)), lights)
    views = [ds.View(photograph(scene, CAMERA, (i,)) + 1e-3, CAMERA, lit=(i,)) for i in range(3)]
    return ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))


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
    ds.Object(ds.Sphere(), ds.Material(0.1, 0.3, 0.4, 120, ds.Brushed((1, 0.3, 0.1), 12)), name="brushed"),
    ds.Object(ds.Sphere(), ds.Material(0.1, 0.3, 0.2, lobe=own_parts.MicroFacets(0.2)), name="own"),
)
AROUND = ds.OrthographicCamera(
    (3e3, 1e3, 4e3), height=2.6, shape=(24, 32), local_viewer=False
)  # far: what float32 could lose
LAMPS = (*LIGHTS, ds.PointLight((-2, 2, 3), 0.9, own_parts.HazyAttenuation(0.3)))
VIEWS = (
    ds.View(np.full((24, 24, 3), 0.5), CAMERA, lit=(0, 1, 3, 4)),
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
            l = unit(-np.asarray(axis)) if place is None else unit(np.asarray(place) - p)
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


def expected(told, item, view, lights):
    """What `render` draws of one object in a view, as the page shows it, and where it may be compared."""
    camera = dataclasses.replace(view.camera, shape=ball_shape(view.camera.shape))
    scene = ds.Scene(dataclasses.replace(item, name=""), lights)
    with jax.enable_x64(True), jax.disable_jit():  # to compile takes longer
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
def ball(fit, browser, tmp_path_factory):
    """A page whose ball has every kind of light, lobe and Fresnel term, open in a browser."""
    path = tmp_path_factory.mktemp("page") / "ball.html"
    ds.write_report(path, with_problem(fit, scene=ds.Scene(OBJECTS, LAMPS), views=VIEWS))
    browser.get(path.as_uri())
    (told,) = [json.loads(t) for a, t in Page(path).all("script") if a.get("id") == "ball-scene"]
    return told


def draw(browser, object_, view, **values):
    uri, code = browser.execute_async_script(DRAWN, object_, view, values)
    return iio.imread(io.BytesIO(base64.b64decode(uri.split(",")[1])))[..., :3] / 255, code


CASES = ((0, 0, 70.0, -35.0), (1, 1, -25.0, 15.0), (2, 0, 0.0, 0.0), (3, 0, 0.0, 0.0), (4, 1, 30.0, 0.0))
EVERY = [(i, j, turn, tilt) for i in range(5) for j in range(2) for turn, tilt in ((0.0, 0.0), (-160.0, 20.0))]


@pytest.mark.parametrize("cases", [CASES, pytest.param(EVERY, marks=pytest.mark.slow)], ids=["some", "every"])
def test_the_live_ball_is_what_render_draws(cases, ball, browser):
    worst = 0.0
    for i, j, turn, tilt in cases:
        item, view = OBJECTS[i], VIEWS[j]
        lights = [moved(LAMPS[k], item.surface.center, view.camera, turn, tilt) for k in view.lit]
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
    view, item, lit = VIEWS[0], OBJECTS[0], (0, 1, 3, 4)
    drawn, code = draw(browser, 0, 0, k_d=0.3, k_s=0.25, n_s=2.0)
    k_d, k_s, n_s = (np.array(of) for of in ((0.3, 0.2, 0.1), (0.25, 0.2, 0.15), (100, 80, 60)))
    changed = dataclasses.replace(item.material, k_d=k_d, k_s=k_s, n_s=n_s)
    image, where = expected(ball["views"][0], ds.Object(item.surface, changed), view, [LAMPS[k] for k in lit])
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

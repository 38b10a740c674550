"""The picture of a page of maps, in a browser: it is what `shade` returns, pixel by pixel, and can be handled."""

import dataclasses
import re
import time

import handmade_maps
import made_maps
import numpy as np
import pytest
from maps_stage import Stage
from report_pages import Page
from scipy import ndimage

import diffshade as ds

HEIGHT, WIDTH = made_maps.SHAPE
KINDS = ("slider", "combobox", "radio", "button", "checkbox", "image")


@pytest.fixture(scope="module")
def bumpy():
    return made_maps.bumpy()


@pytest.fixture
def stage(bumpy, browser, tmp_path):
    maps, heights, views = bumpy
    ds.write_report(tmp_path / "maps.html", maps, views=views[:5], held_out=views[5:], heights=heights, full=True)
    yield Stage(browser, tmp_path / "maps.html")
    assert browser.get_log("browser") == []


def toward(azimuth, elevation):
    a, e = np.deg2rad((azimuth, elevation))
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def off(drawn, expected, where):
    difference = 255 * np.abs(drawn - expected)[where]
    print(f"off by {difference.max():.3f}/255 at most, {difference.mean():.3f} in the mean")
    assert np.ptp(expected[where]) > 0.2
    return difference.max()


def test_the_picture_is_what_shade_returns_in_each_photographs_light(stage, bumpy):
    maps, _, views = bumpy
    inside = maps.status > 0
    for i in (0, 3, 5):
        assert off(stage.draw(view=str(i)), stage.shown(maps.shade(lit=views[i].lit), i), inside) < 1
        assert not stage.draw()[~inside].any()
    alone = np.asarray(ds.render(maps.as_scene(), maps.camera, lit=5))
    assert off(stage.draw(shadows="none"), stage.shown(alone, 5), inside) < 1


def test_reset_takes_back_what_was_set(stage):
    before = {name: stage.value(name) for name in ("azimuth", "elevation", "specular", "exposure")}
    picture = stage.draw()
    stage.draw(elevation=20.0, specular=4.0, exposure=1.0, diffuse=False)
    stage.browser.find_element("name", "reset").click()
    stage.wait()
    stage.set("compare", False)
    assert {name: stage.value(name) for name in before} == pytest.approx(before)
    np.testing.assert_array_equal(stage.draw(), picture)


def test_a_light_moved_by_hand_gives_what_shade_returns_in_it(stage, bumpy):
    maps, _, _ = bumpy
    intensity = maps.scene.lights[2].intensity
    drawn = stage.draw(view="2", azimuth=35.0, elevation=50.0, exposure=-1.0)
    image = maps.shade(ds.DirectionalLight(-toward(35.0, 50.0), intensity=intensity))
    assert off(drawn, stage.shown(image, 2, 0.5), maps.status > 0) < 1


def test_controls_of_the_material_do_what_they_say(stage, bumpy):
    maps, _, _ = bumpy
    drawn = stage.draw(view="1", shadows="none", diffuse=False, specular=3.0)
    values = {**maps.values, "k_d": 0 * maps.values["k_d"], "k_s": 3.0 * maps.values["k_s"]}
    shiny = dataclasses.replace(maps, values=values).as_scene()
    image = np.asarray(ds.render(shiny, maps.camera, lit=1))
    assert off(drawn, stage.shown(image, 1), maps.status > 0) < 1.5


def test_maps_of_known_normals_are_drawn_without_heights(browser, bumpy, tmp_path):
    maps, _, views = bumpy
    values, errors = ({name: of[name] for name in ("k_d", "k_s", "n_s")} for of in (maps.values, maps.errors))
    item = maps.scene.objects[0]
    surface = ds.GBuffer(maps.values["normal"], item.surface.position, maps.status > 0)
    scene = dataclasses.replace(maps.scene, objects=(dataclasses.replace(item, surface=surface),))
    known = dataclasses.replace(maps, values=values, errors=errors, scene=scene)
    ds.write_report(tmp_path / "known.html", known, views=views, full=True)
    stage = Stage(browser, tmp_path / "known.html")
    assert stage.told["heights"] is None
    assert off(stage.draw(view="3"), stage.shown(known.shade(lit=3), 3), known.status > 0) < 1
    assert browser.get_log("browser") == []


def test_regions_and_lamps_nearby_are_drawn_as_shade_does(browser, tmp_path):
    maps, heights, views = made_maps.bumpy(regions=True)
    ds.write_report(tmp_path / "regions.html", maps, views=views, heights=heights, full=True)
    stage = Stage(browser, tmp_path / "regions.html")
    assert off(stage.draw(view="4"), stage.shown(maps.shade(lit=4), 4), maps.status > 0) < 1
    maps, views = made_maps.ball_nearby()
    ds.write_report(tmp_path / "ball.html", maps, views=views, full=True)
    stage = Stage(browser, tmp_path / "ball.html")
    for i, view in enumerate(views):
        assert off(stage.draw(view=str(i)), stage.shown(maps.shade(lit=view.lit), i), maps.status > 0) < 1
    assert browser.get_log("browser") == []


def test_the_heights_cast_the_shadows_of_a_ridge(stage, bumpy):
    """A ridge along the columns: what it hides from a light on the left is known from each row's horizon."""
    maps, heights, _ = bumpy
    elevation, pixel = 20.0, 2.2 / HEIGHT
    drawn = stage.draw(view="0", azimuth=180.0, elevation=elevation, shadows="cast")
    free = stage.draw(shadows="none")
    row, slope = heights.height[HEIGHT // 2], np.tan(np.deg2rad(elevation))
    inside = maps.status[HEIGHT // 2] > 0
    horizon = [
        max([(row[i] - row[j]) / (pixel * (j - i)) for i in range(j) if inside[i]], default=-1) for j in range(WIDTH)
    ]
    hidden, lit = (inside & (np.array(horizon) > slope + 0.12)), inside & (np.array(horizon) < slope - 0.05)
    faces = maps.values["normal"][HEIGHT // 2] @ toward(180.0, elevation) > 0.05
    assert (hidden & faces).sum() >= 4
    own = stage.shown(np.full(3, 0.03), 0)  # k_e + k_a I_a
    np.testing.assert_allclose(drawn[HEIGHT // 2][hidden], np.broadcast_to(own, (hidden.sum(), 3)), atol=1 / 255)
    np.testing.assert_allclose(drawn[HEIGHT // 2][lit], free[HEIGHT // 2][lit], atol=2 / 255)


def test_a_spike_of_one_texel_casts_no_slit(bumpy, browser, tmp_path):
    maps, heights, views = bumpy
    raised = np.array(heights.height)
    row, column = HEIGHT // 2, WIDTH // 5  # before the ridge
    raised[row, column] += 0.3
    drawn = []
    for name, height in (("flat", heights.height), ("spike", raised)):
        given = dataclasses.replace(heights, height=height)
        ds.write_report(tmp_path / f"{name}.html", maps, views=views, heights=given, full=True)
        stage = Stage(browser, tmp_path / f"{name}.html")
        drawn.append(stage.draw(view="0", azimuth=180.0, elevation=20.0, shadows="cast"))
    beside = np.s_[row - 4 : row + 5, column + 2 : column + 6]
    assert drawn[0][beside].max() > 0.3
    assert np.abs(drawn[1] - drawn[0])[beside].max() < 0.05


def test_a_silhouette_is_sharp_and_without_steps_where_texels_are_wide(stage, bumpy):
    maps, wide = bumpy[0], 4
    kinds = [overlay["kind"] for overlay in stage.told["overlays"]]
    stage.set("overlay", str(kinds.index(1)))  # normals: one channel is half of white or more
    stage.resize(wide)
    stage.height, stage.width = wide * stage.height, wide * stage.width
    bright = stage.draw(shadows="none").max(-1)
    texels = np.kron(maps.status > 0, np.ones((wide, wide))) > 0
    inside = np.asarray(bright > 0.25, bool)
    grown, shrunk = (
        np.asarray(of(texels, iterations=wide)) for of in (ndimage.binary_dilation, ndimage.binary_erosion)
    )
    assert not (inside > grown).any()
    assert not (shrunk > inside).any()
    assert 0 < (inside != texels).sum() < 0.5 * wide * (texels[:, 1:] != texels[:, :-1]).sum()  # corners are cut
    between = ((bright > 0.02) & (bright < 0.45)).sum(1)
    assert between.mean() < 2 * (texels[:, 1:] != texels[:, :-1]).sum(1).mean()


def test_overlays_show_the_numbers(stage, bumpy):
    maps, _, _ = bumpy
    inside = maps.status > 0
    names = [overlay["name"] for overlay in stage.told["overlays"]]
    normals = stage.draw(overlay=str(names.index("normals")))
    np.testing.assert_allclose(normals[inside], 0.5 + 0.5 * maps.values["normal"][inside], atol=1.5 / 255)
    colours = np.array([level["colour"] for level in stage.told["status"]]) / 255
    status = stage.draw(overlay=str(names.index("status")))
    np.testing.assert_allclose(status[inside], colours[maps.status[inside]], atol=1 / 255)
    unknown = stage.draw(overlay=str(names.index("error of k_s")))[:5][inside[:5]]
    assert np.ptp(unknown, axis=-1).max() == 0  # grey
    legends = stage.browser.find_elements("css selector", "[data-legend]")
    assert [names[i] for i, of in enumerate(legends) if of.is_displayed()] == ["error of k_s"]


def test_dragging_and_keys_move_the_light_and_the_wipe_shows_the_photograph(stage, bumpy):
    from selenium.webdriver import ActionChains, Keys

    maps, _, views = bumpy
    browser = stage.browser
    stage.set("view", "0")
    canvas = browser.find_element("css selector", "#object canvas")
    place = stage.told["views"][0]["toward"]
    stage.resize(10)  # the buttons leave some of it free
    ActionChains(browser).click_and_hold(canvas).move_by_offset(80, -40).release().perform()
    stage.resize()
    moved = np.array(place[:2]) + 2 * np.array([8, 4]) / HEIGHT
    expected = np.append(moved, np.sqrt(1 - moved @ moved))
    here = toward(stage.value("azimuth"), stage.value("elevation"))
    np.testing.assert_allclose(here, expected, atol=0.02)
    image = maps.shade(ds.DirectionalLight(-here, intensity=maps.scene.lights[0].intensity))
    assert off(stage.draw(), stage.shown(image, 0), maps.status > 0) < 1.5
    before = toward(stage.value("azimuth"), stage.value("elevation"))
    browser.execute_script("document.querySelector('.dome').focus()")
    ActionChains(browser).send_keys(Keys.ARROW_LEFT).perform()
    stage.wait()
    after = toward(stage.value("azimuth"), stage.value("elevation"))
    np.testing.assert_allclose((after - before)[:2], (-0.03, 0.0), atol=1e-3)
    stage.set("view", "3")
    wiped = stage.draw(compare=True, wipe=100)
    shown = ds.srgb_encode(
        np.clip(np.asarray(views[3].image) * stage.told["views"][3]["gain"] / float(views[3].exposure), 0, 1)
    )
    assert np.abs(wiped - shown).mean() < 0.03  # a JPEG of noise


def test_zoom_keeps_the_texel_under_the_middle_and_all_shows_all(stage):
    browser = stage.browser
    before = stage.draw(shadows="none")
    browser.execute_script("document.querySelector('[name=closer]').click()")
    stage.wait()
    assert np.abs(stage.draw() - before).mean() > 0.01
    browser.execute_script("document.querySelector('[name=whole]').click()")
    stage.wait()
    np.testing.assert_array_equal(stage.draw(), before)


def test_every_control_has_a_name_and_nothing_is_wider_than_a_phone(stage):
    browser = stage.browser
    size = {"width": 360, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    nodes = browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    controls = [node for node in nodes if node.get("role", {}).get("value") in KINDS and not node["ignored"]]
    assert len(controls) > 15
    assert all(node["name"]["value"].strip() for node in controls)


@pytest.mark.parametrize("name", ["bumpy", *handmade_maps.JUDGED])
def test_a_light_page_is_as_near_as_it_says(name, bumpy, browser, tmp_path):
    maps, heights, views = bumpy if name == "bumpy" else handmade_maps.judged(name, 48)
    ds.write_report(tmp_path / "light.html", maps, views=views, heights=heights)
    stage, inside = Stage(browser, tmp_path / "light.html"), maps.status > 0
    every = [stage.draw(view=str(i)) - stage.shown(maps.shade(lit=views[i].lit), i) for i in (0, 2, 5)]
    drawn = np.quantile(255 * np.abs(np.stack(every)[:, inside]), (0.9, 0.99))
    (said,) = [text for _, text in Page(tmp_path / "light.html").all("td") if "steps of 255" in text]
    told = np.array(re.findall(r"([\d.]+)(?: steps of 255)? at", said), float)
    # the browser rounds to whole steps, and the page's figure is of other lights
    np.testing.assert_allclose(drawn, told, atol=0.5, rtol=0.25)
    assert name == "bumpy" or drawn[1] < 1.5  # that one has light beyond the model, which a light page leaves out
    assert browser.get_log("browser") == []


def test_a_vertical_swipe_scrolls_and_a_drag_across_lights(bumpy, browser, tmp_path):
    maps, heights, views = bumpy
    ds.write_report(tmp_path / "phone.html", maps, views=views, heights=heights)
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        stage = Stage(browser, tmp_path / "phone.html")
        stage.resize(5)
        top = "const at = document.querySelector('.frame canvas').getBoundingClientRect(); return [at.left, at.top]"

        def touch(kind, *places):
            points = [{"x": x, "y": y} for x, y in places]
            browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        def swiped(x, y):  # from within the picture; returns by how much the page and the light moved
            time.sleep(1.0)  # until the page has come to rest
            browser.execute_script("scrollTo(0, 0)")
            place = stage.value("azimuth"), stage.value("elevation")
            left, up = browser.execute_script(top)
            start = np.array([left + WIDTH, up + 3 * HEIGHT])
            touch("touchStart", start.tolist())
            for k in range(1, 11):
                touch("touchMove", (start + 0.1 * k * np.array([x, y])).tolist())
            touch("touchEnd")
            stage.wait()
            light = np.hypot(stage.value("azimuth") - place[0], stage.value("elevation") - place[1])
            return browser.execute_script("return window.scrollY"), light

        scrolled, turned = swiped(0, -150)
        assert scrolled > 100
        assert turned < 1e-6
        scrolled, turned = swiped(60, 0)
        assert scrolled == 0
        assert turned > 5.0
    finally:
        browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_page_for_a_frame_is_the_picture_and_its_dial(bumpy, browser, tmp_path):
    maps, heights, views = bumpy
    ds.write_report(tmp_path / "embed.html", maps, views=views, heights=heights, embed=True)
    browser.get((tmp_path / "embed.html").as_uri())
    seen = [of.tag_name for of in browser.find_elements("css selector", "main *") if of.is_displayed()]
    assert {"canvas", "svg", "button"} <= set(seen)
    assert not {"p", "h2", "h3", "label", "table", "img"} & set(seen)
    box = browser.execute_script(
        "const of = document.querySelector('canvas').getBoundingClientRect();"
        "return [of.width - window.innerWidth, of.height - window.innerHeight]"
    )
    assert box == [0, 0]
    assert browser.get_log("browser") == []

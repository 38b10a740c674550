"""The page of maps: what is in it, how finely, and what it refuses; its picture is in studies."""

import base64
import dataclasses
import json

import imageio.v3 as iio
import made_maps
import numpy as np
import pytest
from click.testing import CliRunner
from report_pages import Page

import diffshade as ds
from diffshade.cli.commands import diffshade
from diffshade.report.page.maps import layers
from diffshade.report.page.maps import numbers as numbers_of_maps
from diffshade.report.page.maps.layers import Channel, folded, layers_of, unfolded
from diffshade.report.page.maps.numbers import numbers_of

HOSTILE = "</script><img src=x onerror=alert(1)>'\"&{{7*7}}"


@pytest.fixture(scope="module")
def bumpy():
    return made_maps.bumpy()


@pytest.fixture(scope="module")
def page(bumpy, tmp_path_factory):
    maps, heights, views = bumpy
    path = tmp_path_factory.mktemp("page") / "maps.html"
    titles = ["first", HOSTILE, "third", "fourth", "fifth", "sixth"]
    noted = dataclasses.replace(maps, notes=(HOSTILE,))
    ds.write_report(path, noted, views=views[:4], held_out=views[4:], heights=heights, titles=titles)
    assert [file.name for file in path.parent.iterdir()] == ["maps.html"]
    return Page(path)


def told(page):
    (text,) = [text for attributes, text in page.all("script") if attributes.get("id") == "maps-scene"]
    return json.loads(text)


def test_it_runs_nothing_but_its_own_scripts_and_asks_for_nothing(page):
    page.assert_it_runs_its_own_scripts_alone()


def test_photographs_lights_and_whatever_is_said_are_in_it(page, bumpy):
    maps, _, views = bumpy
    scene = told(page)
    assert [view["name"] for view in scene["views"]][1] == HOSTILE
    assert [view["held_out"] for view in scene["views"]] == [False] * 4 + [True] * 2
    for view, light in zip(scene["views"], maps.scene.lights, strict=True):
        np.testing.assert_allclose(view["toward"], -light.direction, atol=1e-9)
        np.testing.assert_allclose(view["arriving"], light.intensity, rtol=1e-6)
    gains = np.array([view["gain"] for view in scene["views"]])
    np.testing.assert_allclose(gains / gains[0], [float(view.exposure) for view in views], rtol=1e-6)
    assert HOSTILE in [text for _, text in page.all("li")]
    assert HOSTILE in [text for _, text in page.all("option")]
    assert sum(a.get("class") == "difference" for a, _ in page.all("img")) == 2  # those that were left out
    assert "Each of these photographs" in [text for _, text in page.all("figcaption")]
    photographs = [a["id"] for a, _ in page.all("script") if a.get("id", "").startswith("photograph-")]
    assert len(photographs) == 6


def test_every_overlay_has_a_legend_in_words(page):
    overlays = told(page)["overlays"]
    names = [overlay["name"] for overlay in overlays]
    assert {"normals", "status", "heights", "error of the normal", "error of k_d", "residual"} <= set(names)
    legends = [a for tag, a, _ in page.elements if tag == "div" and "data-legend" in a]
    assert len(legends) == len(overlays)
    assert all(overlay["words"].endswith(".") for overlay in overlays)
    (status,) = [overlay for overlay in overlays if overlay["name"] == "status"]
    assert [level["name"] for level in status["levels"]] == ["determined", "no highlight seen"]


def test_layers_hold_the_numbers_as_finely_as_they_say(bumpy):
    maps, heights, _ = bumpy
    numbers = numbers_of(maps, heights)
    kept = {layer.name: layer.numbers for layer in layers_of(numbers, None)[0]}
    inside = numbers.inside
    np.testing.assert_allclose(unfolded(kept["geometry"][..., :2])[inside], numbers.normal[inside], atol=1e-4)
    np.testing.assert_allclose(kept["geometry"][..., 2][inside], heights.height[inside], atol=1e-5)
    for name in ("k_d", "k_s", "own"):
        np.testing.assert_allclose(kept[name][inside], getattr(numbers, name)[inside], atol=2e-4)
    np.testing.assert_allclose(kept["index"][..., 0][inside], 30.0, rtol=1e-3)
    np.testing.assert_array_equal(kept["index"][..., 1], maps.status)
    assert numbers.beyond is not None
    for k in range(4):
        np.testing.assert_allclose(kept[f"beyond{k}"][inside], numbers.beyond[inside][..., k], atol=2e-4)
    np.testing.assert_allclose(numbers.own[inside], 0.01 + 0.1 * 0.2, rtol=1e-6)


def test_all_parts_of_the_light_beyond_the_model_are_kept_where_they_fit(bumpy, monkeypatch):
    maps, heights, _ = bumpy
    given = maps.unexplained.interpolation
    many = ds.TexelMaps(**{**vars(maps), "unexplained": maps.unexplained._replace(
        interpolation=given._replace(taken=np.tile(given.taken, (5, 1)), given=np.tile(given.given, 5)),
        parts=np.tile(maps.unexplained.parts.reshape(40, 56, 3, 4), 5).reshape(40, 56, 60),
    )})  # fmt: skip
    numbers = numbers_of(many, heights)
    kept, files = layers_of(numbers, None)
    assert sum(layer.name.startswith("beyond") for layer in kept) == 20
    size = sum(len(base64.b64decode(file)) for of in files.values() for file in of)
    monkeypatch.setattr(layers, "LIMIT", size - 1)
    assert sum(layer.name.startswith("beyond") for layer in layers_of(numbers, None)[0]) == 19


def test_light_beyond_the_model_is_rounded_to_even_steps_until_nothing_is_left(bumpy):
    maps, heights, _ = bumpy
    parts = maps.unexplained.parts.reshape(40, 56, 3, 4) * np.array([1.0, 0.5, 0.1, 0.01], np.float16)
    faint = dataclasses.replace(maps, unexplained=maps.unexplained._replace(parts=parts.reshape(40, 56, 12)))
    numbers, step = numbers_of(faint, heights), 0.02
    assert numbers.beyond is not None
    kept = {layer.name: layer.numbers for layer in layers_of(numbers, step)[0]}
    assert [name for name in kept if name.startswith("beyond")] == ["beyond0", "beyond1", "beyond2"]
    for k in range(3):
        off = np.abs(kept[f"beyond{k}"] - numbers.beyond[..., k])[numbers.inside]
        assert off.max() <= 0.5 * step * (1.0 + 1e-6)
    assert np.abs(numbers.beyond[numbers.inside][..., 3]).max() < 0.5 * step


def test_a_page_is_light_unless_it_is_to_be_full(bumpy, tmp_path):
    maps, heights, views = bumpy
    size, said = {}, {}
    for full in (False, True):
        path = tmp_path / f"{full}.html"
        ds.write_report(path, maps, views=views, heights=heights, full=full)
        size[full] = sum(len(text) for a, text in Page(path).all("script") if a.get("id", "").startswith("beyond"))
        (words,) = [text for _, text in Page(path).all("td") if "steps of 255" in text]
        said[full] = float(words.split()[0])
    assert size[False] < 0.6 * size[True]
    assert said[True] <= 0.1 < said[False] < 4.0  # all that is beyond the model is noise here


def test_a_page_has_its_title_and_a_still_picture(bumpy, tmp_path):
    maps, heights, _ = bumpy
    ds.write_report(tmp_path / "maps.html", maps, heights=heights, title=HOSTILE)
    page = Page(tmp_path / "maps.html")
    assert [text for tag in ("title", "h1") for _, text in page.all(tag)] == [HOSTILE] * 2
    (still,) = [a["src"] for a, _ in page.all("img") if a["src"].startswith("data:image/jpeg")]
    picture = iio.imread(base64.b64decode(still.partition(",")[2]))
    shown = maps.shade(lit=told(page)["first"])
    assert picture.shape[:2] == maps.status.shape
    assert np.corrcoef(picture[..., 0].ravel(), shown[..., 0].ravel())[0, 1] > 0.8  # a JPEG of noise


def test_a_page_for_a_frame_has_neither_tables_nor_photographs(bumpy, tmp_path):
    maps, heights, views = bumpy
    ds.write_report(tmp_path / "maps.html", maps, views=views, heights=heights, embed=True)
    page = Page(tmp_path / "maps.html")
    assert not page.all("table")
    assert not page.all("h1")
    assert not [a for a, _ in page.all("script") if a.get("id", "").startswith("photograph-")]


def test_unit_vectors_of_every_direction_are_unfolded_again():
    random = np.random.default_rng(0)
    vectors = random.normal(size=(50, 40, 3))
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    np.testing.assert_allclose(unfolded(folded(vectors)), vectors, atol=1e-12)


@pytest.mark.parametrize(("curve", "low", "high"), [(0, -2.0, 3.0), (1, 0.0, 3.0), (2, 0.0, 3.0), (3, 0.1, 300.0)])
def test_integers_become_the_nearest_numbers(curve, low, high):
    channel = Channel(curve, 254, low, high)
    every = np.arange(255, dtype=np.uint16)
    np.testing.assert_array_equal(channel.quantised(channel.number(every)), every)
    ends = channel.number(np.array([0, 254], np.uint16))
    np.testing.assert_allclose(ends, [-high if curve == 2 else low, high], rtol=1e-12)


def test_large_maps_are_reduced_by_means(bumpy, monkeypatch):
    maps, heights, _ = bumpy
    whole = numbers_of(maps, heights)
    monkeypatch.setattr(numbers_of_maps, "MOST_TEXELS", 40 * 56 // 4)
    half = numbers_of(maps, heights)
    assert (half.factor, half.status.shape) == (2, (20, 28))
    np.testing.assert_allclose(half.k_d[10, 14], whole.k_d[20:22, 28:30].mean((0, 1)), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(half.normal[half.inside], axis=-1), 1.0, rtol=1e-6)


def test_regions_have_shapes_of_their_own():
    maps, heights, _ = made_maps.bumpy(regions=True)
    numbers = numbers_of(maps, heights)
    assert numbers.first_power == 8.0
    weights = np.array(numbers.shapes)[numbers.region]
    np.testing.assert_allclose(weights[20, [5, 50]], [[0.7, 0, 0, 0.3], [0.3, 0, 0, 0.7]])


OTHER = ds.OrthographicCamera((0, 0, 1), shape=(8, 8))
REFUSED = {
    "a view of another shape": ({"views": [ds.View(np.zeros((8, 8, 3)), OTHER)]}, r"views\[0\].*\(40, 56\).*\(8, 8\)"),
    "heights of another shape": (
        {"heights": ds.heights.integrate_normals(np.broadcast_to((0.0, 0.0, 1.0), (8, 8, 3)), OTHER)},
        r"heights.*\(40, 56\)",
    ),
    "titles of other views": ({"titles": ["one"]}, "titles.*got 1"),
    "an examination": ({"examination": object()}, "examination belongs to a report of a Fit"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_does_not_belong_to_the_maps_is_refused(what, bumpy, tmp_path):
    given, message = REFUSED[what]
    with pytest.raises(ValueError, match=message):
        ds.write_report(tmp_path / "maps.html", bumpy[0], **given)
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_page_of_a_folder_of_maps(bumpy, tmp_path):
    bumpy[0].write(tmp_path / "maps", suffix=".npy")
    page = tmp_path / "object.html"
    done = CliRunner().invoke(diffshade, ["report", str(tmp_path / "maps"), "-o", str(page), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["page"] == str(page)
    assert len(told(Page(page))["views"]) == len(bumpy[0].scene.lights)
    assert [text for _, text in Page(page).all("title")] == ["maps"]  # the folder's name
    arguments = ["report", str(tmp_path / "maps"), "-o", str(page), "--title", "A bronze", "--embed"]
    assert CliRunner().invoke(diffshade, arguments).exit_code == 0
    assert [text for _, text in Page(page).all("title")] == ["A bronze"]
    assert not Page(page).all("table")
    refused = CliRunner().invoke(diffshade, ["report", str(tmp_path / "maps"), "--hold-out", "2", "-o", str(page)])
    assert "photographs --hold-out 4" in str(refused.exception)
    for option in (["--free", "k_d"], ["--loss", "huber"], ["--quick"]):
        refused = CliRunner().invoke(diffshade, ["report", str(tmp_path / "maps"), *option, "-o", str(page)])
        assert f"{option[0]} belong to a fit" in str(refused.exception)


def test_exponents_that_do_not_double_are_refused(bumpy, tmp_path):
    maps = bumpy[0]
    odd = dataclasses.replace(maps, highlights=(maps.highlights[0], maps.highlights[1]._replace(n_s=9.0)))
    with pytest.raises(ValueError, match=r"highlights.*\[8.0, 9.0\].*fit_texels"):
        ds.write_report(tmp_path / "maps.html", odd)


def test_parts_of_no_known_height_stand_beside_each_other(bumpy):
    """Wherever the integration put them, the heights of the page have no jump between them that casts a shadow."""
    maps, heights, _ = bumpy
    left = np.arange(maps.status.shape[1])[None] < 20
    torn = dataclasses.replace(
        heights,
        height=np.where(left, heights.height - 0.4, heights.height),
        part=np.where(heights.mask, np.where(left, 1, 0), -1),
    )
    found, inside = numbers_of(maps, torn).height, heights.mask
    assert found is not None
    np.testing.assert_allclose(found[inside], heights.height[inside], atol=0.02)  # a texel of the slope

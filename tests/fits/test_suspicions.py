"""Examination: all that can be said of a fit; each planted fault is found, with its size and place, and no other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from scenarios import clean_fit, clean_images, noisy_fit, noisy_images, standard_fit
from synthetic import CAMERA, noisy, photograph, seen_by, standard_scene

import diffshade as ds
from diffshade.core.words import Note
from diffshade.diagnosis.examination import summarise
from diffshade.diagnosis.misfit import explanations
from diffshade.diagnosis.misfit.explanations import Explanation, MisfitSearch, matters
from diffshade.diagnosis.misfit.regions import Seen, cast_shadows, center_of, level, measure_rim, rims
from diffshade.diagnosis.misfit.suspicions import Suspicion, _views, _where, describe, suspicions
from diffshade.diagnosis.patches import find_clusters
from diffshade.inverse.verdicts.stability import FitWithout

PATCH = np.zeros(CAMERA.shape, bool)
PATCH[9:15, 8:14] = True


@cache
def examined() -> ds.Examination:
    return ds.examine(noisy_fit())


# --- an examination


def test_of_the_model_itself_all_is_determined_and_nothing_suspected():
    fit, examination = noisy_fit(), examined()
    assert examination.determined.all()
    assert examination.suspicions == ()
    assert not any(refit.moved.any() for refit in examination.refits)
    np.testing.assert_array_equal(examination.errors, find_clusters(fit).wide_errors())
    for within, outer in (
        (fit.values[:, None], examination.interval_68),
        (examination.interval_68, examination.interval_95),
    ):
        assert np.all((outer[:, 0] < within.min(1)) & (within.max(1) < outer[:, 1]))
    truth = fit.values_in(standard_scene())
    assert np.all(np.abs(truth - fit.values) < 4 * examination.errors)
    assert len(examination.profiles) == len(fit.names)
    for points, value in zip(examination.profiles, fit.values, strict=True):
        assert np.all(np.diff(points[:, 0]) > 0)
        np.testing.assert_allclose(points[points[:, 1] == 0.0, 0], value)
    together = {note.split(" are strongly")[0] for note in examination.notes if "strongly correlated" in note}
    pairs = np.argwhere(np.triu(np.abs(fit.correlation) > 0.95, 1))
    quantity = [unknown.quantity for unknown in fit.unknowns]
    assert together == {f"{quantity[i]} and {quantity[j]}" for i, j in pairs if quantity[i] != quantity[j]}
    assert "linear and quadratic" in together
    assert any("the 8 views" in note for note in examination.notes)
    assert not any("depends on which" in note for note in examination.notes)


def test_the_table_has_every_number_with_its_intervals():
    title, head, *rows = str(examined()).splitlines()
    fit = noisy_fit()
    assert "8 views" in title
    assert f"{fit.counts.pixels:,} pixels" in title
    assert head.split() == ["parameter", "value", "error", "68", "%", "95", "%"]
    for name, row, value, (low, high) in zip(fit.names, rows, fit.values, examined().interval_95, strict=False):
        cells = row.split()
        assert cells[:2] == [name, f"{value:.6g}"]
        assert cells[-3:] == [f"{low:.5g}", "to", f"{high:.5g}"]
    assert [row.removeprefix("- ") for row in rows[len(fit.names) :]] == list(examined().notes)
    with pytest.raises(TypeError, match="fit"):
        ds.examine("fit")  # pyright: ignore[reportArgumentType]


def said(
    interval_95: np.ndarray | None = None, again: Any = (), shifted: Any = None, fit: ds.Fit | None = None, suspected=()
):
    """An examination of these intervals and refits."""
    fit = noisy_fit() if fit is None else fit
    interval_95 = examined().interval_95 if interval_95 is None else interval_95
    shifted = np.zeros(len(fit.names), bool) if shifted is None else shifted
    found: Any = np.stack([examined().interval_68, interval_95])
    return summarise(fit, find_clusters(fit), found, examined().profiles, list(again), shifted, suspected)


def test_what_may_be_anything_or_much_is_not_determined():
    fit, interval_95 = noisy_fit(), examined().interval_95.copy()
    names = list(fit.names)
    j, n_s, linear = names.index("k_d.g"), names.index("n_s"), names.index("linear")
    interval_95[j] = 0.0, np.inf
    interval_95[n_s] = 50 / np.e, 50 * np.e  # half a unit of the logarithm, and a little
    interval_95[linear] = 0.0, 0.02
    examination = said(interval_95)
    assert np.flatnonzero(~examination.determined).tolist() == [j, n_s]
    assert any("do not constrain k_d.g:" in note for note in examination.notes)
    (lost,) = [note for note in examination.notes if "lost in the noise, by the 95 %" in note]
    assert "n_s in 18.4 to 136" in lost
    assert "Fix n_s" in lost
    (most,) = [note for note in examination.notes if "upper limits (95 %)" in note]
    assert "linear 0.02" in most
    row = next(line for line in str(examination).splitlines() if line.startswith("n_s "))
    assert row.split() == ["n_s", "not", "determined"]
    interval_95[n_s] = 50 / np.exp(0.97), 50 * np.exp(0.97)
    assert said(interval_95).determined[n_s]
    interval_95[0] = 0.1 - 0.3 * 1.9 * fit.values[0], 0.1 + 0.3 * 1.9 * fit.values[0]  # 29 % of the value
    assert said(interval_95).determined[0]
    interval_95[0] = 0.1 - 0.3 * 2.1 * fit.values[0], 0.1 + 0.3 * 2.1 * fit.values[0]
    assert not said(interval_95, fit=dataclasses.replace(fit, scales=0.0 * fit.scales)).determined[0]


def test_what_depends_on_the_data_kept_is_said_with_what_was_left_out():
    fit = noisy_fit()
    n_s = np.array([name == "n_s" for name in fit.names])
    there = [dataclasses.replace(fit, values=np.where(n_s, value, fit.values)) for value in (60.0, 99.0, 200.0)]
    again = [
        FitWithout("this", there[0], n_s),
        FitWithout("that", there[1], n_s),
        FitWithout("the rest", there[2], ~n_s),
    ]
    examination = said(again=again, shifted=n_s)
    assert np.flatnonzero(~examination.determined).tolist() == np.flatnonzero(n_s).tolist()
    (note,) = [note for note in examination.notes if "depends on which data" in note]
    assert note.startswith("n_s depends")
    assert "99 without that" in note
    assert "Fix n_s" in note
    assert any("with these held" in note for note in examination.notes)
    every = said(again=[FitWithout("this", there[0], n_s | True)], shifted=n_s | True)
    assert not any("with these held" in note for note in every.notes)


def test_what_is_suspected_and_what_the_fit_said_is_said_too():
    fit = dataclasses.replace(
        noisy_fit(), notes=(Note("0 within the noise.", "0 within noise"), Note("other.", "other"))
    )
    notes = said(fit=fit, suspected=(Suspicion("rim", (0,), None, "a rim."),)).notes
    assert notes[0] == "a rim."
    assert "other." in notes
    assert "0 within the noise." not in notes
    gamma = Suspicion("gamma", (0,), None, "other.", ("n_s", "k_d.r"))
    examination = said(fit=fit, suspected=(gamma,))
    assert examination.notes[0] == "other."
    assert examination.notes[1] == "k_d.r and n_s are not determined until this is corrected."
    assert examination.notes.count("other.") == 1
    assert [n for n, known in zip(fit.names, examination.determined, strict=True) if not known] == ["k_d.r", "n_s"]


# --- faults


def turned(vector, degrees):
    """A vector turned about an axis at right angles to it."""
    axis = np.cross(vector, (0, 1, 0))
    axis /= np.linalg.norm(axis)
    angle = np.deg2rad(degrees)
    return vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle)


def test_images_that_fit_exactly_raise_no_suspicion():
    assert suspicions(clean_fit()) == ()


@pytest.mark.thorough
def test_faults_of_several_kinds_are_told_apart_with_their_sizes_and_places():
    scene, images = standard_scene(), list(clean_images())
    there = turned(np.asarray(scene.lights[3].position), 6)  # pyright: ignore[reportAttributeAccessIssue]
    images[3] = photograph(eqx.tree_at(lambda s: s.lights[3].position, scene, there), CAMERA, (3,))
    images[4] = np.where(PATCH[..., None], photograph(scene, CAMERA, ()), images[4])
    images[2], images[6] = 1.2 * images[2], 0.8 * images[6]
    found = {(s.kind, s.views): s for s in suspicions(standard_fit(noisy(images, 0.005, 0)))}
    assert set(found) == {("exposure", (2,)), ("exposure", (6,)), ("light", (3,)), ("shadow", (4,))}
    for view, factor in ((2, 1.2), (6, 0.8)):
        sentence = found["exposure", (view,)].sentence
        assert f"'views.{view}.exposure'" in sentence
        np.testing.assert_allclose(float(sentence.split(" is ")[1].split()[0]), factor, rtol=0.02)
    light = found["light", (3,)].sentence
    assert "lights.3 is" in light
    assert "views[3]" in light
    assert "'lights.3.position'" in light
    middle = center_of(scene.objects, CAMERA)
    one, two = np.asarray(scene.lights[3].position) - middle, there - middle  # pyright: ignore[reportAttributeAccessIssue]
    tilt = np.rad2deg(np.arccos(one @ two / np.linalg.norm(one) / np.linalg.norm(two)))
    np.testing.assert_allclose(float(light.split(" is ")[1].split()[0]), tilt, rtol=0.1)
    shadow = found["shadow", (4,)]
    assert shadow.region is not None
    (region,) = shadow.region
    assert (region & PATCH).sum() / (region | PATCH).sum() > 0.8
    assert "views[4]" in shadow.sentence
    assert "row 12, column 10" in shadow.sentence
    assert "View.mask" in shadow.sentence


@pytest.mark.parametrize(("curve", "words"), [(ds.srgb_encode, "srgb=True"), (ds.srgb_decode, "srgb=False")])
def test_an_encoding_is_found_and_nothing_else(curve, words):
    (found,) = suspicions(standard_fit([curve(image) for image in noisy_images()]))
    assert (found.kind, found.region, found.views) == ("encoding", None, tuple(range(8)))
    assert words in found.sentence


def grazing():
    """1 - n.v of every pixel that shows the sphere, else 0."""
    buffer = seen_by(CAMERA)
    to_eye = np.array([0.0, 0.0, 4.0]) - np.asarray(buffer.position)
    n_v = np.sum(np.asarray(buffer.normal) * to_eye, -1) / np.linalg.norm(to_eye, axis=-1)
    return np.where(np.asarray(buffer.mask), 1.0 - n_v, 0.0)


@pytest.mark.slow
def test_a_bright_rim_is_found():
    extra = 0.15 * grazing()[..., None] ** 4 * np.array([0.6, 0.4, 0.25])
    (found,) = suspicions(standard_fit([image + extra for image in noisy_images()]))
    assert found.kind == "rim"
    expected = grazing() > 0.65
    assert found.region is not None
    assert len(found.region) == 8
    assert all((region == expected).mean() > 0.95 for region in found.region)
    assert "8 views (views[0] to views[7])" in found.sentence
    assert f"{sum(region.sum() for region in found.region):,} pixels" in found.sentence


def test_faults_of_all_views_are_named_with_their_size_and_what_they_move_is_not_determined():
    row, column = np.mgrid[:24, :24] - 11.5
    rho2 = (row**2 + column**2) / (2 * 12**2)
    dim = [image * (1 - 0.3 * rho2[..., None]) for image in clean_images()]
    fit = standard_fit(noisy(dim, 0.003, 0))
    (found,) = suspicions(fit)
    assert (found.kind, found.region, found.views) == ("vignetting", None, tuple(range(8)))
    assert float(found.sentence.split(" by about ")[1].split("%")[0]) == pytest.approx(30, abs=5)
    assert "Divide them by" in found.sentence
    assert set(found.affected) <= set(fit.names)
    moved = np.abs(fit.values - noisy_fit().values) > 3 * fit.errors
    assert moved.any()
    assert not (moved & fit.determined & ~np.isin(fit.names, found.affected)).any()
    scene = standard_scene()
    for i, light in enumerate(scene.lights):
        x, y, z = np.asarray(light.position)  # pyright: ignore[reportAttributeAccessIssue]
        there = np.array([x * np.cos(0.05) - y * np.sin(0.05), x * np.sin(0.05) + y * np.cos(0.05), z])
        scene = eqx.tree_at(lambda s, i=i: s.lights[i].position, scene, there)
    images = [photograph(scene, CAMERA, (i,)) for i in range(8)]
    (found,) = suspicions(standard_fit(noisy(images, 0.003, 0)))
    assert found.kind == "rotation"
    assert "2.9 degrees around the axis (" in found.sentence
    assert "'position'" in found.sentence


# --- regions


FULL = np.ones((20, 20), bool)
PART = np.full((20, 20), 0.5)


def dark(shown: float, rows: slice = slice(5, 10), columns: slice = slice(5, 10), noise: float = 0.0) -> Seen:
    """A photograph of a part of .5 over .1, of which a region shows so much."""
    photograph = 0.1 + PART
    photograph[rows, columns] = 0.1 + shown * 0.5
    return Seen(photograph + noise * np.resize([1.0, -1.0], (20, 20)), 0.1 + PART, FULL)


@pytest.mark.parametrize(
    ("seen", "found"),
    [
        (dark(0.0), 25),
        (dark(0.2), 25),
        (dark(0.3), 0),  # a half shadow is none
        (dark(0.0, slice(5, 8), slice(5, 9)), 12),
        (dark(0.0, slice(5, 8), slice(5, 8)), 0),  # too few pixels
        (dark(0.0, slice(5, 7), slice(0, 20)), 0),  # too narrow
        (dark(0.0, noise=0.05), 25),
        (dark(0.0, noise=0.06), 0),  # 6 standard deviations, 1.48 times the median, are more than the light's part
    ],
)
def test_a_shadow_is_a_region_that_shows_little_of_a_light(seen, found):
    shadows = cast_shadows(seen, {(0,): np.full((20, 20), 0.1)})
    assert [int(shadow.mask.sum()) for shadow in shadows] == [found] * (found > 0)
    assert cast_shadows(seen, {(0,): seen.predicted}) == []  # the light shines nowhere


def test_where_a_light_hardly_shines_darkness_is_no_shadow():
    part = np.where(np.arange(20)[:, None] < 12, 1.0, 0.09) * np.ones((20, 20))
    photograph = 0.1 + part
    photograph[14:18, 5:12] = 0.1
    assert cast_shadows(Seen(photograph, 0.1 + part, FULL), {(0,): np.full((20, 20), 0.1)}) == []
    part[12:] = 0.11
    assert len(cast_shadows(Seen(photograph, 0.1 + part, FULL), {(0,): np.full((20, 20), 0.1)})) == 1
    large = Seen(np.zeros((80, 80)), np.ones((80, 80)), np.ones((80, 80), bool))
    large.photograph[:] = 1.0
    large.photograph[10:14, 10:14] = 0.0  # 16 of 6,400 pixels
    assert cast_shadows(large, {(0,): np.zeros((80, 80))}) == []
    large.photograph[10:15, 10:14] = 0.0
    assert len(cast_shadows(large, {(0,): np.zeros((80, 80))})) == 1


def test_the_shadow_of_one_of_several_lights_is_told_from_the_others():
    part = np.linspace(0.3, 0.6, 144).reshape(12, 12)
    unlit = {(0,): 0.1 + 0 * part, (1,): 0.1 + part - 0.25, (0, 1): 0.05 + 0 * part}
    photograph = 0.1 + part
    photograph[3:8, 3:8] -= 0.25
    (shadow,) = cast_shadows(Seen(photograph, 0.1 + part, np.ones((12, 12), bool)), unlit)
    assert shadow.lights == (1,)
    assert shadow.mask.sum() == 25


def test_a_level_is_the_median_of_the_bright_pixels():
    seen = Seen(0.05 + 0.8 * PART, 0.05 + PART, FULL)
    assert level(seen, 0.05) == pytest.approx(0.8)
    half = np.where(np.arange(20)[:, None] < 10, PART, 0.14)
    photograph = np.where(np.arange(20)[:, None] < 10, 0.8 * PART, 0.0)
    assert level(Seen(photograph, half, FULL), 0.0) == pytest.approx(0.8)
    half[10:] = 0.16  # bright enough to count
    assert level(Seen(np.where(np.arange(20)[:, None] < 9, 0.8 * PART, 0.0), half, FULL), 0.0) == pytest.approx(1e-9)
    assert level(Seen(photograph, 0.05 + 0 * half, FULL), 0.05) == 1.0
    assert level(Seen(photograph, half, ~FULL), 0.0) == 1.0
    assert seen.noise == pytest.approx(1.4826 * 0.1)
    assert Seen(photograph, half, ~FULL).noise == 0.0


def test_a_rim_is_where_the_surface_turns_away_and_its_sectors_are_eighths():
    rim, sector = rims(standard_scene().objects, CAMERA)
    np.testing.assert_array_equal(rim, grazing() > 0.65)
    row, column = np.mgrid[:24, :24] - 11.5
    assert set(np.unique(sector)) == set(range(8))
    for k in range(8):
        towards = np.deg2rad(45 * k + 22.5) - np.pi
        inside = np.abs(np.angle(np.exp(1j * (np.arctan2(row, column) - towards)))) < np.deg2rad(22)
        assert (sector[inside] == k).all()


def test_how_bright_a_rim_is_and_how_certain():
    rim, sector = rims(standard_scene().objects, CAMERA)
    by_sector = 0.1 + 0.02 * np.array([1, -1, 1, -1, 1, -1, 1, -1.0])
    photograph = np.full(CAMERA.shape, 0.5)
    views = [
        (Seen(photograph + sign * by_sector[sector] * rim, photograph, np.ones(CAMERA.shape, bool)), rim, sector)
        for sign in (1, 1, -1)
    ]
    found = measure_rim(views[:1])
    assert found is not None
    assert found.excess == pytest.approx(0.1)
    assert found.errors == pytest.approx(0.1 / (by_sector.std(ddof=1) / np.sqrt(8)))
    assert found.positive == 1.0
    assert found.relative == pytest.approx(0.1 / views[0][0].photograph.mean())
    every = measure_rim(views)
    assert every is not None
    assert every.positive == pytest.approx(2 / 3)
    assert every.excess == pytest.approx(0.1 / 3)
    few = rim & (sector < 3)
    assert measure_rim([(views[0][0], few, sector)]) is None
    assert measure_rim([(views[0][0], rim & (sector < 4), sector)]) is not None
    assert measure_rim([]) is None


# --- words


class Of(SimpleNamespace):
    """What the sentences need of a search: a fit of so many views, with the factor or the tilt of each."""

    def factor(self, end, i):
        return self.effects[i]

    def views_of(self, key):
        return (key[1],)

    def effect(self, end, key):
        return self.effects[key[1]]


def search_of(effects: Sequence[float]) -> Any:
    views = [SimpleNamespace(exposure=2.0)] * len(effects)
    fit = SimpleNamespace(views=views, scene=SimpleNamespace(lights=[None] * len(effects)))
    return Of(effects=effects, fit=fit, alternatives=Of(effects=effects))


def explained(kind: str, i: int) -> Explanation:
    nothing: Any = None
    return Explanation(kind, 0.5, nothing, nothing, key=(kind, i), own_share=0.8)


def test_an_exposure_is_said_beside_the_other_views():
    nothing: Any = None
    for effects, words in (
        (
            [1.0, 0.5, 1.0, 1.0],
            ("views[1] is 0.5 times", "the other views predict", "80%", "exposure=1 or", "'views.1.exposure'"),
        ),
        ([1.0, 0.5], ("views[0] predicts (or the other view is wrong by the inverse factor)",)),
    ):
        (found,) = describe(search_of(effects), nothing, [explained("exposure", 1)])
        assert (found.kind, found.views) == ("exposure", (1,))
        assert all(word in found.sentence for word in words), found.sentence
    (found,) = describe(search_of([0.5]), nothing, [explained("exposure", 0)])
    assert "the scene predicts" in found.sentence
    assert describe(search_of([1.02, 1.0, 1.0]), nothing, [explained("exposure", 0)]) == ()


def test_views_or_lights_that_all_disagree_are_told_as_one():
    nothing: Any = None
    dark = [0.5, 0.6, 0.7, 1.4, 1.0]
    (found,) = describe(search_of(dark), nothing, [explained("exposure", i) for i in (3, 1, 0, 2)])
    assert (found.kind, found.views) == ("exposure", (0, 1, 2, 3))
    assert "4 of the 5 views" in found.sentence
    assert "0.5 to 1.4" in found.sentence
    assert "attenuation" in found.sentence
    assert len(describe(search_of(dark), nothing, [explained("exposure", i) for i in (0, 1)])) == 2
    assert matters(("light", 0), 2.6)
    assert not matters(("light", 0), 2.4)
    assert matters(("exposure", 0), 0.96)
    assert not matters(("exposure", 0), 1.02)
    assert matters(("exposure", 0), 1.02, 0.5)


def test_a_factor_is_over_the_median_of_three_or_more():
    end: Any = None
    for effects, expected in (([0.5, 2.0, 4.0, 2.0], 0.25), ([0.5, 2.0], 0.5), ([0.5], 0.5)):
        of, like = MisfitSearch.__new__(MisfitSearch), search_of(effects)
        of.fit, of.alternatives = like.fit, like.alternatives
        assert of.factor(end, 0) == expected


@pytest.mark.parametrize(
    ("cost", "rival", "change", "believed"),
    [
        (1.04, 0.2, {}, False),  # nothing beyond noise that a curve could explain
        (1.06, 0.2, {}, True),
        (2.0, 0.2, {"explained": 0.49}, False),
        (2.0, 0.3, {}, False),  # something else explains more than half as much
        (2.0, 0.3, {"explained": 0.71}, True),
        (2.0, 0.6, {"explained": 0.99}, False),
        (2.0, 0.2, {"errors": 9.0}, False),
        (2.0, 0.2, {"agreed": 0.7}, False),
    ],
)
def test_when_another_encoding_is_believed(monkeypatch, cost, rival, change, believed):
    other = SimpleNamespace(**{"share": 0.5, "explained": 0.6, "errors": 11.0, "agreed": 0.8} | change)
    monkeypatch.setattr(explanations, "cost_and_noise", lambda fit: (cost, 1.0))
    monkeypatch.setattr(explanations, "other_encoding", lambda fit, noise, *, decoded: other)
    of: Any = MisfitSearch.__new__(MisfitSearch)
    of.fit = None
    assert len(of.encodings([SimpleNamespace(share=rival)])) == 2 * believed


def test_places_are_said_in_words():
    assert _where(PATCH) == "around row 12, column 10"
    assert _views((0, 3)) == "views[0] and views[3]"
    assert _views((0, 1, 2, 3)).count("views[") == 4
    assert _views(tuple(range(5))) == "5 views (views[0] to views[4])"

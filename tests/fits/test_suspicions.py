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
from scenarios import PATCH, clean_fit, clean_images, grazing, noisy_fit, noisy_images, standard_fit, turned
from synthetic import CAMERA, noisy, photograph, standard_scene

import diffshade as ds
from diffshade.core.backend import in_float64
from diffshade.core.tables import rounded
from diffshade.core.words import Note
from diffshade.diagnosis.examination import Examination, summarise
from diffshade.diagnosis.patches import find_clusters
from diffshade.diagnosis.suspicions import Suspicion, _as_suspicions, corrected_for, suspicions
from diffshade.inverse.misfit.changes import Case, Move
from diffshade.inverse.misfit.directions import changes_of
from diffshade.inverse.misfit.explained import explained
from diffshade.inverse.misfit.faults import FAULTS
from diffshade.inverse.misfit.found import Fault, Found
from diffshade.inverse.misfit.linearised import linearise
from diffshade.inverse.misfit.regions import MeanPrediction, cast_shadows, center_of, measure_rim, rims
from diffshade.inverse.misfit.set_up import SetUp
from diffshade.inverse.unknowns.places import Place
from diffshade.inverse.verdicts.stability import FitWithout
from diffshade.io.lazy_images import LazyImage


@cache
def examined() -> Examination:
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
    numbers = zip(fit.values, examined().errors, *examined().interval_95.T, strict=True)
    for name, row, (value, error, low, high) in zip(fit.names, rows, numbers, strict=False):
        cells = row.split()
        assert cells[:3] == [name, rounded(value, error), rounded(error, error)]
        assert cells[-3:] == [rounded(low, error), "to", rounded(high, error)]
    assert [row.removeprefix("- ") for row in rows[len(fit.names) :]] == list(examined().notes)
    with pytest.raises(TypeError, match="fit"):
        ds.examine("fit")  # pyright: ignore[reportArgumentType]


def said(interval_95: np.ndarray | None = None, again: Any = (), fit: ds.Fit | None = None, suspected=()):
    """An examination of these intervals and refits."""
    fit = noisy_fit() if fit is None else fit
    interval_95 = examined().interval_95 if interval_95 is None else interval_95
    found: Any = np.stack([examined().interval_68, interval_95])
    return summarise(fit, find_clusters(fit), found, examined().profiles, list(again), suspected)


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
    examination = said(again=again)
    assert np.flatnonzero(~examination.determined).tolist() == np.flatnonzero(n_s).tolist()
    (note,) = [note for note in examination.notes if "depends on which data" in note and note.startswith("n_s")]
    assert "99 without that" in note
    assert "Fix n_s" in note
    assert "allows for this" not in note
    little = said(again=again[:1])  # 60 for 50, which is determined within that
    assert little.determined.all()
    assert np.hypot(said().errors, np.abs(60.0 - fit.values))[n_s] == pytest.approx(little.errors[n_s])
    (note,) = [note for note in little.notes if "depends on which data" in note]
    assert note.endswith("Its error allows for this.")


def test_what_is_suspected_and_what_the_fit_said_is_said_too():
    fit = dataclasses.replace(
        noisy_fit(), notes=(Note("0 within the noise.", "0 within noise"), Note("other.", "other"))
    )
    notes = said(fit=fit, suspected=(Suspicion("rim", (0,), None, "a rim."),)).notes
    assert notes[0] == "a rim."
    assert "other." in notes
    assert "0 within the noise." not in notes
    examination = said(fit=fit, suspected=(Suspicion("gamma", (0,), None, "other."),))
    assert examination.notes[0] == "other."
    assert examination.notes.count("other.") == 1


def test_what_faults_add_to_the_errors_of_a_fit_widens_errors_and_intervals():
    fit = noisy_fit()
    n_s = fit.names.index("n_s")
    added = np.where(np.arange(len(fit.names)) == n_s, 5.0, 0.0)
    wide = said(fit=dataclasses.replace(fit, errors=np.hypot(fit.errors, added)))
    right = said()
    np.testing.assert_allclose(wide.errors, np.hypot(right.errors, added))
    for of_wide, of_right, errors in (
        (wide.interval_68, right.interval_68, 0.994),
        (wide.interval_95, right.interval_95, 1.96),
    ):
        away = of_wide[n_s] - fit.values[n_s], of_right[n_s] - fit.values[n_s]
        np.testing.assert_allclose(np.abs(away[0]), np.hypot(away[1], errors * 5.0), rtol=1e-3)
        np.testing.assert_allclose(np.delete(of_wide, n_s, 0), np.delete(of_right, n_s, 0))


# --- faults


def test_images_that_fit_exactly_raise_no_suspicion():
    assert suspicions(clean_fit()) == ()


@pytest.mark.slow
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


def test_a_fault_of_all_views_is_named_with_its_size_and_the_errors_contain_what_it_moves():
    """By the fit itself; what an examination says of it is in studies/test_wrong_set_ups.py."""
    row, column = np.mgrid[:24, :24] - 11.5
    rho2 = (row**2 + column**2) / (2 * 12**2)
    dim = [image * (1 - 0.3 * rho2[..., None]) for image in clean_images()]
    fit = standard_fit(noisy(dim, 0.003, 0))
    (note,) = [note for note in fit.notes if note.kind == "cause"]
    assert note.names == ("vignetting",)
    assert float(note.split(" by about ")[1].split("%")[0]) == pytest.approx(30, abs=5)
    assert "Divide them by" in note
    off = np.abs(fit.values - fit.values_in(standard_scene()))
    assert np.any(fit.determined & (off > 3 * fit.plain_errors))
    assert np.all(off[fit.determined] < 3 * fit.errors[fit.determined])


# --- regions


FULL = np.ones((20, 20), bool)
PART = np.full((20, 20), 0.5)


def dark(shown: float, rows: slice = slice(5, 10), columns: slice = slice(5, 10), noise: float = 0.0) -> MeanPrediction:
    """A photograph of a part of .5 over .1, of which a region shows so much."""
    photograph = 0.1 + PART
    photograph[rows, columns] = 0.1 + shown * 0.5
    return MeanPrediction(photograph + noise * np.resize([1.0, -1.0], (20, 20)), 0.1 + PART, FULL)


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
    assert cast_shadows(MeanPrediction(photograph, 0.1 + part, FULL), {(0,): np.full((20, 20), 0.1)}) == []
    part[12:] = 0.11
    assert len(cast_shadows(MeanPrediction(photograph, 0.1 + part, FULL), {(0,): np.full((20, 20), 0.1)})) == 1
    large = MeanPrediction(np.zeros((80, 80)), np.ones((80, 80)), np.ones((80, 80), bool))
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
    (shadow,) = cast_shadows(MeanPrediction(photograph, 0.1 + part, np.ones((12, 12), bool)), unlit)
    assert shadow.lights == (1,)
    assert shadow.mask.sum() == 25


def test_the_noise_of_a_photograph_is_by_the_median():
    seen = MeanPrediction(0.05 + 0.8 * PART, 0.05 + PART, FULL)
    assert seen.noise == pytest.approx(1.4826 * 0.1)
    assert MeanPrediction(0.8 * PART, PART, ~FULL).noise == 0.0


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
        (
            MeanPrediction(photograph + sign * by_sector[sector] * rim, photograph, np.ones(CAMERA.shape, bool)),
            rim,
            sector,
        )
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


# --- the table of faults

BY_KIND = {fault.kind: fault for fault in FAULTS}
NOTHING: Any = None


def test_each_fault_has_cases_or_regions():
    assert len(BY_KIND) == len(FAULTS)
    for fault in FAULTS:
        assert (fault.cases is None) == (fault.regions is not None), fault.kind
        assert fault.plausible[0] < fault.plausible[1]


@pytest.mark.thorough
def test_of_photographs_that_are_read_by_rows_all_is_asked_that_needs_no_neighbours():
    by_rows = [LazyImage(lambda a, b, i=i: i[a:b], i.shape, i.dtype) for i in noisy_images()]
    found = []
    for fit in (noisy_fit(), standard_fit(by_rows)):
        with in_float64(fit) as own:
            set_up = SetUp(own, (place for fault in FAULTS for place in fault.numbers(own)))
            at = linearise(set_up, set_up.given)
            found.append({(f.kind, case.which): change for f in FAULTS for case, change in changes_of(at, f)})
    whole, rows = found
    assert {kind for kind, _ in whole.keys() - rows.keys()} == {"blur", "shift", "chroma"}
    for key in rows:
        np.testing.assert_allclose(rows[key], whole[key], rtol=1e-5, atol=1e-6 * np.abs(whole[key]).max())


@pytest.mark.thorough
def test_a_new_fault_is_one_entry_and_is_found_without_an_examination():
    ramp = np.broadcast_to(np.linspace(0.0, 1.0, 24)[None, :, None], (24, 24, 3))
    stray = Fault(
        "stray light",
        "stray light adds up to {f.size:.2g} on the right",
        "Draw the curtains.",
        lambda at: [Case(0, ramp.reshape(-1, 3)[at.set_up.pixel, at.set_up.channel][None])],
        plausible=(0.0, np.inf),
    )
    fit = standard_fit(noisy([image + 0.02 * ramp for image in clean_images()], 0.003, 0))
    with in_float64(fit) as own:
        set_up = SetUp(own, ())
        seen = explained(linearise(set_up, set_up.given), [stray])
    (found,) = seen.found
    assert found.size == pytest.approx(0.02, rel=0.1)
    assert str(found).startswith(f"stray light adds up to {found.size:.2g} on the right; this explains")
    assert str(found).endswith("errors. Draw the curtains.")
    np.testing.assert_allclose(seen.errors, np.abs(found.moves), rtol=0.05)  # it is well known how far it moves them


@pytest.mark.thorough
def test_a_fault_that_moves_numbers_is_an_entry_too_and_is_corrected():
    levels = [Place("views", i, ("black",)) for i in range(8)]

    def cases(at):
        for i, place in enumerate(levels):
            yield Case(i, Move.shift(at.set_up.places[place], len(at.state.theta)), (i,))

    black = Fault(
        "black",
        "black of views[{f.which}] is {f.size:.2g} too low",
        "Photograph with the lens cap on.",
        cases,
        lambda fit: levels,
    )
    images = [image + 0.02 * (i == 3) for i, image in enumerate(clean_images())]
    fit = standard_fit(noisy(images, 0.003, 0))
    with in_float64(fit) as own:
        set_up = SetUp(own, black.numbers(own))
        at = linearise(set_up, set_up.base)
        again = corrected_for(at, explained(at, [black]).found[0])
    assert again is not None
    assert again.which == 3
    assert again.views == (3,)
    assert again.size == pytest.approx(0.02, rel=0.05)
    assert again.share > 0.3
    assert again.after is not None
    np.testing.assert_allclose(again.after.fit.values - fit.values, -again.moves, atol=1e-4)


def test_a_move_adds_to_numbers_or_turns_places_by_degrees():
    theta = np.array([2.0, 1.0, 0.0, 3.0])
    shift = Move.shift([0], 4, 0.5)
    np.testing.assert_allclose(shift.along(theta, np.array([2.0])), [3.0, 1.0, 0.0, 3.0])
    turn = Move.turn([([1, 2, 3], np.array([0.0, 0.0, 1.0]))], np.eye(3)[1:], theta)
    np.testing.assert_allclose(turn.along(theta, np.array([0.0, 90.0])), [2.0, 0.0, 1.0, 3.0], atol=1e-12)
    for k, amount in enumerate(1e-6 * np.eye(2)):
        np.testing.assert_allclose(turn.along(theta, amount) - theta, 1e-6 * turn.rows[k], atol=1e-12)


# --- words


def at_end(kind: str, effects: Sequence[float], which: Sequence[int]) -> tuple[Suspicion, ...]:
    """What is said of some views or lights, where these are the factors or degrees of all."""
    views = [SimpleNamespace(exposure=2.0)] * len(effects)
    scene = SimpleNamespace(lights=[ds.DirectionalLight((0, 0, -1))] * len(effects))
    none = np.zeros(0)
    fit: Any = SimpleNamespace(views=views, scene=scene, names=(), determined=none > 0, plain_errors=none)
    set_up: Any = SimpleNamespace(fit=fit, lit=[()] * len(effects))
    amounts = {(kind, i): np.array([e - (kind == "exposure")]) for i, e in enumerate(effects)}
    end: Any = SimpleNamespace(amounts=amounts, fit=fit)
    return _as_suspicions(set_up, end, [Found(BY_KIND[kind], fit, i, (i,), 0.8, after=end) for i in which])


def test_an_exposure_is_said_beside_the_other_views():
    for effects, words in (
        (
            [1.0, 0.5, 1.0, 1.0],
            ("views[1] is 0.5 times", "the other views predict", "80%", "exposure=1 or", "'views.1.exposure'"),
        ),
        ([1.0, 0.5], ("views[0] predicts (or the other view is wrong by the inverse factor)",)),
    ):
        (found,) = at_end("exposure", effects, [1])
        assert (found.kind, found.views) == ("exposure", (1,))
        assert all(word in found.sentence for word in words), found.sentence
    (found,) = at_end("exposure", [0.5], [0])
    assert "the scene predicts" in found.sentence
    (found,) = at_end("exposure", [0.5, 2.0, 4.0, 2.0], [0])
    assert "views[0] is 0.25 times" in found.sentence


def test_views_or_lights_that_all_disagree_are_told_as_one():
    dark = [0.5, 0.6, 1.0, 1.4, 1.3]
    (found,) = at_end("exposure", dark, (3, 1, 0, 4))
    assert (found.kind, found.views) == ("exposure", (0, 1, 3, 4))
    assert "4 of the 5 views" in found.sentence
    assert "0.5 to 1.4" in found.sentence
    assert "attenuation" in found.sentence
    assert len(at_end("exposure", dark, (0, 1))) == 2
    (found,) = at_end("light", [3.0, 4.0, 5.0], (0, 1, 2))
    assert "3 of the 3 lights are 3 to 5 degrees off" in found.sentence


def test_views_are_said_in_words():
    said = [Found(BY_KIND["rim"], NOTHING, 0, views, 0.8).views_in_words for views in ((0, 3), (0, 1, 2, 3))]
    assert said[0] == "views[0] and views[3]"
    assert said[1].count("views[") == 4
    many = Found(BY_KIND["rim"], NOTHING, 0, tuple(range(5)), 0.8)
    assert many.views_in_words == "5 views (views[0] to views[4])"

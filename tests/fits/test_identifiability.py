"""Identifiability: what views cannot tell is said in three grades, by name and with a remedy, and never as a number."""

import dataclasses

import numpy as np
import pytest
from scenarios import OF_MATERIAL, assert_undetermined, clean_images, row, standard_fit
from synthetic import (
    CAMERA,
    FREE,
    MATERIAL,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    standard_scene,
)

import diffshade as ds
from diffshade.inverse.data.view_sets import Counts, ViewSet
from diffshade.inverse.statistics.identifiability import (
    condition_number,
    relative_errors,
    remedy,
    singular_notes,
    vague,
    vague_notes,
    weak_directions,
    weak_notes,
)
from diffshade.inverse.summary import (
    _at_bounds,
    _clipped,
    _noise_contradicted,
    _repeated,
    _scales,
    _too_bright,
    _Values,
)
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.unknown import Unknown

SCENE = standard_scene()


def unknowns_of(*free: str, tied: tuple[str, ...] = ()) -> list[Unknown]:
    return find_unknowns(SCENE, one_light_each(clean_images()), free, tied)


# --- the sentences


@pytest.mark.parametrize(
    ("free", "direction", "words"),
    [
        (
            ("k_d", "intensity"),
            (1, -1),
            ("separate k_d from intensity", "former up", "latter down", "example intensity"),
        ),
        (("k_a", "ambient"), (1, -1), ("k_a from ambient", "Fix one, for example ambient")),
        (("k_d", "constant", "linear"), (1, 1, 1), ("k_d from constant and linear", "together", "example constant")),
        (("linear", "quadratic"), (1, 1), ("linear and quadratic: scaling all", "example quadratic")),
        (("linear", "quadratic"), (1, -1), ("linear and quadratic", "changed together", "other distances")),
        (("linear", "quadratic"), (1, 1.1), ("changed together",)),
        (("linear", "quadratic"), (1, 1.0005), ("scaling all",)),
        (("intensity", "constant", "linear"), (1, 1, 1), ("intensity from constant and linear", "together")),
        (("intensity", "constant"), (1, -1), ("changed together",)),
        (("k_d", "linear", "intensity"), (1, 1, -1), ("changed together",)),  # half of each pixel is left
    ],
)
def test_a_gauge_is_said_with_what_scales_up_and_what_down(free, direction, words):
    """A direction is given by the logarithmic change of each unknown."""
    tied = tuple(name for name in free if name in ("intensity", "constant", "linear", "quadratic"))
    unknowns = unknowns_of(*free, tied=tied)
    values = np.linspace(0.2, 0.9, len(unknowns))
    change = np.array([direction[free.index(u.kind)] for u in unknowns])
    (said,) = singular_notes(np.zeros(len(unknowns), bool), (change * values)[None], unknowns, values)
    assert said.startswith("these views cannot separate ")
    assert all(word in said for word in words), said


def test_what_no_pixel_shows_is_said_by_channel_or_as_a_whole():
    unknowns = unknowns_of("k_d", "n_s")
    none = np.zeros((0, 4))
    for zero, words in (
        ([0, 0, 0, 1], ("do not determine n_s", "changes with it", "Fix it", "shows it.")),
        ([1, 1, 1, 0], ("do not determine k_d:", "Fix it")),
        ([1, 0, 1, 0], ("do not determine k_d.r and k_d.b", "changes with them", "shows them.")),
    ):
        (said,) = singular_notes(np.array(zero, bool), none, unknowns, np.ones(4))
        assert all(word in said for word in words), said
    assert singular_notes(np.zeros(4, bool), none, unknowns, np.ones(4)) == []


def test_the_remedy_is_of_what_is_lost():
    free = ("k_a", "k_d", "k_s", "n_s", "linear", "constant", "lights.0.position")
    unknowns = unknowns_of(*free, tied=("linear", "constant"))
    for names, words in (
        (["k_d", "linear", "n_s"], ("Fix one, for example linear,", "three distances")),
        (["linear", "constant", "k_s"], ("Fix one, for example constant,", "three distances")),
        (["k_d", "n_s"], ("Fix n_s,", "whole highlight", "not clipped")),
        (["k_s"], ("Fix k_s,", "whole highlight")),
        (["lights.0.position"], ("Fix lights.0.position,", "other sides")),
        (["k_a", "k_d"], ("Fix k_d,", "shows more of it")),
    ):
        assert all(word in remedy(names, unknowns) for word in words), names


def test_what_is_hardly_separated_is_said_by_name():
    """Two columns of the Jacobian apart by an angle between a millionth and a thousandth, in units of any size."""
    J = np.random.default_rng(0).standard_normal((50, 5))
    J[:, 3] = 3.0 * J[:, 1] + 1e-4 * J[:, 3]
    J *= [1e-4, 1e3, 1.0, 1e2, 10.0]
    (which,) = weak_directions(J.T @ J)
    assert which.tolist() == [1, 3]
    assert np.isfinite(condition_number(J.T @ J))
    unknowns = unknowns_of("k_d", "linear", "quadratic", tied=TIED)
    (said,) = weak_notes([which, which], unknowns)
    assert "hardly separate k_d and linear: changed together" in said
    assert said.endswith(remedy(["k_d", "linear"], unknowns))
    assert "hardly separate the parts of k_d" in weak_notes([np.array([0, 1])], unknowns)[0]
    for apart, count in ((1e-2, 0), (1e-8, 0)):  # well separated; not at all
        K = np.random.default_rng(0).standard_normal((50, 2))
        K[:, 1] = K[:, 0] + apart * K[:, 1]
        assert len(weak_directions(K.T @ K)) == count


def test_an_error_is_relative_to_what_it_should_be_small_against():
    unknowns = find_unknowns(
        SCENE, one_light_each(clean_images()), ("k_d", "n_s", "lights.0.position", "views.0.black")
    )
    names = [u.name for u in unknowns]
    values, errors = np.full(len(names), 2.0), np.full(len(names), 0.3)
    relative = dict(zip(names, relative_errors(unknowns, values, errors, np.zeros(len(names))), strict=True))
    assert relative["k_d.r"] == 0.15
    assert relative["n_s"] == 0.15  # the error of n_s is 0.3, of its logarithm 0.15
    assert relative[next(n for n in names if n.endswith("position.x"))] == pytest.approx(0.3 / np.sqrt(12.0))
    assert relative[next(n for n in names if "black" in n)] == 0.0  # may be on both sides of 0
    assert relative_errors(unknowns[:1], np.zeros(1), np.ones(1), np.zeros(1))[0] > 1e100
    by_size = relative_errors(unknowns, 1e-3 * values, errors, np.full(len(names), 6.0))  # next to the origin
    assert by_size[next(j for j, n in enumerate(names) if n.endswith("position.x"))] == pytest.approx(0.05)
    unknowns = unknowns_of("k_d", "n_s", "linear", tied=TIED)
    scales = _scales(SCENE, unknowns, np.array([1.0, 1, 1, 1, 4.0]), 36.0)
    np.testing.assert_allclose(scales, [0.6, 0.6, 0.6, 0.0, 0.5])


def test_what_is_lost_in_the_noise_is_said_with_its_error_and_what_is_small_is_not_lost():
    unknowns = unknowns_of("k_d", "k_s", "n_s")
    values = np.array([0.5, 0.5, 0.5, 0.01, 0.15, 0.0, 50.0])
    errors, none = np.array([0.14, 0.16, 0.05, 0.02, 0.07, 0.6, 24.0]), np.zeros(7)
    lost, small = vague(unknowns, values, errors, np.array([1.0] * 6 + [0.0]))
    assert lost.tolist() == [False, True, False, False, False, True, False]
    assert small.tolist() == [False, False, False, True, True, False, False]
    k_d, k_s, zero = vague_notes(lost, small, unknowns, values, errors, none)
    assert "k_d.g is lost in the noise: its error is 32% of the value. Fix k_d" in k_d
    assert "k_s.b is lost in the noise: its error is 0.6 with the value at 0" in k_s
    assert zero.startswith("0 within the noise")
    assert "k_s.r 0.05" in zero
    for error, expected in ((24.9, False), (25.1, True)):  # half a unit of the logarithm
        assert vague(unknowns[-1:], values[-1:], np.array([error]), np.zeros(1))[0].tolist() == [expected]
    every = np.ones(7, bool)
    *_, n_s = vague_notes(every, ~every, unknowns, values, np.array([0.2] * 6 + [50 * np.log(8.0)]), none)
    assert n_s.startswith("n_s is lost in the noise: its error is a factor of 8.")
    assert "k_s are" not in n_s
    assert (
        "k_d is lost in the noise: its error is 40% of"
        in vague_notes(every, ~every, unknowns, values, 0.2 + 0 * values, none)[0]
    )
    two = vague_notes(np.array([1, 1, 0, 0, 0, 0, 0], bool), ~every, unknowns, values, errors, none)[0]
    assert "k_d.r and k_d.g are lost in the noise: the largest error is 32% of the value" in two


def test_what_stands_at_a_bound_is_said_with_it():
    unknowns = unknowns_of("k_d", "n_s")

    def at(at_bound: np.ndarray, at_lower: np.ndarray) -> _Values:
        values = np.array([(u.lower if low else u.upper) for u, low in zip(unknowns, at_lower, strict=True)])
        return _Values(values, at_bound, at_lower, np.zeros((0, 3), int))

    every = np.ones(4, bool)
    lower = np.array([1, 0, 1, 0], bool)
    assert list(_at_bounds(unknowns, every, at(lower, lower))) == ["k_d.r and k_d.b are at their lower bound 0."]
    upper = np.array([0, 0, 0, 1], bool)
    (said,) = _at_bounds(unknowns, every, at(upper, ~every))
    assert said == f"n_s is at its upper bound {unknowns[3].upper:g}."
    assert not list(_at_bounds(unknowns, ~upper, at(upper, ~every)))


def test_what_else_a_fit_says():
    unknowns = unknowns_of("k_d", "k_s")
    values, known = np.array([1.2, 0.5, 1.1, 3.0, 0.1, 0.1]), np.ones(6, bool)
    assert "k_d.r and k_d.b are above 1" in next(_too_bright(unknowns, values, known))
    assert "k_d.b is above 1: more light leaves" in next(_too_bright(unknowns, values, known & (np.arange(6) > 0)))
    assert not list(_too_bright(unknowns, np.ones(6), known))
    assert not [note for rmse in (0.7, 1.4, 1e-6) for note in _noise_contradicted(rmse, 1000.0, 1.0)]
    assert not list(_noise_contradicted(0.6, 10.0, 1.0))  # as few samples happen to have
    assert "1.6 times the given noise" in next(_noise_contradicted(1.6, 1000.0, 1.0))
    by = [str(next(_noise_contradicted(1.6, 1000.0, sigma2))) for sigma2 in (1.0, 2.56)]
    assert ["from the residuals" in said for said in by] == [False, True]
    assert "0.6 times the given noise: it is stated too large" in next(_noise_contradicted(0.6, 1000.0, 1.0))
    assert not list(_clipped(Counts(1, 9, 27, 0, 0)))
    assert "uses 1 clipped sample as limits" in next(_clipped(Counts(1, 9, 27, 1, 0)))
    assert "excludes 1,200 clipped samples" in next(_clipped(Counts(1, 9, 27, 3, 1200)))


# --- the same photographs again


@pytest.mark.parametrize("lit", [None, (0, 1), (1, 0)])
def test_how_a_view_says_which_lights_are_on_does_not_hide_that_it_is_one_again(lit):
    scene = standard_scene(lights=SCENE.lights[:2])
    image, noise = clean_images()[0], clean_images()[1]
    views = [ds.View(image, CAMERA), ds.View(noise, CAMERA), ds.View(image, CAMERA, lit=lit)]
    data = ViewSet.of(scene, views)
    assert list(_repeated([*data.repeats.items()])) == ["views[2] repeats views[0] and is not counted again."]
    assert data.setups == [[0, 1, 2]]
    other = [*views, ds.View(image, CAMERA, lit=(1,)), ds.View(image, ds.Camera((0, 0.1, 4), fov=32, shape=(24, 24)))]
    assert ViewSet.of(scene, other).setups == [[0, 1, 2], [3], [4]]
    assert len(ViewSet.of(scene, other).repeats) == 1


# --- fits and forecasts


@pytest.mark.thorough
def test_two_gauges_are_two_sentences_and_touch_nothing_else():
    """By the light that all views share; the exponent is known as well as ever."""
    fit = ds.fit(
        forget(SCENE),
        one_light_each(noisy(clean_images(), 0.005, 0)),
        free=(*OF_MATERIAL, "intensity", "ambient"),
        tied="intensity",
    )
    assert_undetermined(fit, "k_a", "ambient", "k_d", "k_s", "intensity")
    assert abs(fit.values[fit.names.index("n_s")] - 50) < 4 * fit.plain_errors[fit.names.index("n_s")]
    gauges = [note for note in fit.notes if "cannot separate" in note]
    (ambient,) = [note for note in gauges if "k_a" in note]
    (light,) = [note for note in gauges if "k_d" in note]
    assert len(gauges) == 2
    assert "k_s" in light
    assert "intensity" in light
    assert "ambient" in ambient
    assert "intensity" not in ambient
    unknown = ~fit.determined
    assert not fit.correlation[unknown].any()


@pytest.mark.thorough
def test_n_s_of_a_ball_without_a_highlight_is_not_determined():
    """A highlight that takes light away drives every channel of k_s to its bound, whatever the noise."""
    matte, glossy = (
        photographs(standard_scene(ds.Material(MATERIAL.k_a, MATERIAL.k_d, k_s, 20))) for k_s in (0.0, 0.05)
    )
    images = noisy([2 * m - g for m, g in zip(matte, glossy, strict=True)], 0.005, 0)
    fit = standard_fit(images, bounds={"n_s": (1, 200)})  # a narrower one might lie between pixels
    assert fit.at_bound[[name.startswith("k_s") for name in fit.names]].all()
    assert not fit.determined[fit.names.index("n_s")]
    seen, held_back = fit.notes[2:]  # no model of this kind takes light away: what is nearest, is chance
    assert seen.kind in ("misfit", "cause")
    assert held_back.kind == "not determined"
    assert "do not determine n_s" in fit.notes[0]
    assert "k_s.r, k_s.g and k_s.b are at their lower bound 0" in fit.notes[1]


def test_what_is_hardly_separated_is_told_apart_from_what_cannot_be():
    """A known noise of almost nothing: the numbers are good, and hang on the model."""
    scene = standard_scene(lights=[ds.PointLight((6, 6, 14), 10.0, ds.RadialAttenuation(1.0, 0.09, 0.032))])
    image = photograph(scene)
    foresight = ds.forecast(scene, ds.View(image, CAMERA, noise=1e-7), free=FREE)
    assert foresight.determined.all()
    (note,) = foresight.notes
    assert note.startswith("these views hardly separate k_d")
    assert "Fix one, for example quadratic" in note
    noisy_one = ds.forecast(scene, ds.View(image, CAMERA), free=FREE, noise=0.01)
    assert row(noisy_one, "linear").endswith("not determined")
    assert any("linear is lost in the noise: its error is" in note for note in noisy_one.notes)


def test_one_view_has_no_jackknife_and_a_number_lost_at_its_bound_is_not_known():
    """Of one view alone linear is at 0 and lost there: with it held k_d would look ten times as good as it is."""
    fit = ds.fit(forget(SCENE), one_light_each(noisy(clean_images(), 0.01, 0))[:1], free=FREE, tied=TIED)
    np.testing.assert_allclose(fit.errors, fit.plain_errors, rtol=5e-3)
    assert "for independent noise; 1 view cannot show" in str(fit)
    linear = fit.names.index("linear")
    assert fit.at_lower[linear]
    assert not fit.evidence.at_bound[linear]
    held = dataclasses.replace(fit.evidence, at_bound=fit.at_bound)
    k_d = fit.names.index("k_d.r")
    assert fit.plain_errors[k_d] > 2 * held.plain_errors()[k_d]
    assert abs(fit.values[k_d] - fit.values_in(SCENE)[k_d]) < 3 * fit.plain_errors[k_d]


@pytest.mark.parametrize(("alike", "condition"), [(1e-6, np.sqrt((2 - 1e-6) / 1e-6)), (1.5e-12, np.inf), (0.0, np.inf)])
def test_a_jacobian_is_singular_by_its_largest_singular_value(alike, condition):
    """Two columns alike but for this much, and a third at right angles: the eigenvalues are alike, 1 and 2 - alike."""
    H = np.array([[1, 1 - alike, 0], [1 - alike, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(condition_number(H), condition, rtol=1e-6)

"""Planning: the errors it promises are those of what a photograph adds, and what it ranks first is the best."""

import dataclasses
import inspect
from typing import Any

import numpy as np
import own_parts
import pytest
from changed_fits import with_problem
from grams import by_view
from scenarios import noisy_fit
from shots import with_shot
from synthetic import CAMERA, FREE, TIED, photograph, seen_by

import diffshade as ds
from diffshade.diagnosis.planning import (
    Plan,
    add_shot,
    find_aim,
    information,
    percent,
    plan_notes,
    rank_shots,
    reference_sizes,
)
from diffshade.diagnosis.shots import unknowns_of_lamp
from diffshade.inverse.data.samples import SensorRange, find_samples
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.places import Place
from diffshade.inverse.unknowns.slots import put_back

FRONT = ds.Shot(light=ds.PointLight((0, 0, 3)), name="in front")  # its attenuation is what the fit finds
BELOW = ds.Shot(
    light=ds.PointLight((3, 3, 4)),
    camera=ds.Camera((0, -3, 3), fov=32, shape=(24, 24)),
    exposure=0.7,
    name="from below",
)
AGAIN = ds.Shot(name="the first again")


@pytest.mark.parametrize("shot", [FRONT, BELOW], ids=lambda shot: shot.name)
def test_the_information_of_a_shot_is_that_of_a_jacobian_by_finite_differences(shot):
    fit = noisy_fit()
    plan = ds.plan(fit, shot)
    scene, view = with_shot(fit.scene, shot)
    unknowns = find_unknowns(scene, [*fit.views, view], FREE, TIED)
    assert [u.name for u in unknowns] == list(fit.names)

    def predict(values):
        changed, _ = put_back(scene, (), unknowns, values)
        inside = find_samples(scene, view).inside
        return float(view.exposure) * photograph(changed, view.camera, view.lit)[inside].ravel()

    h = 1e-5 * np.diag(fit.values)
    J = np.stack([(predict(fit.values + e) - predict(fit.values - e)) / (2 * e.sum()) for e in h], -1)
    covariance = fit.evidence.sigma2 * np.linalg.inv(fit.evidence.total + J.T @ J)
    np.testing.assert_allclose(plan.errors[0], np.sqrt(np.diag(covariance)), rtol=1e-4)
    gain = np.linalg.slogdet(fit.evidence.total + J.T @ J)[1] - np.linalg.slogdet(fit.evidence.total)[1]
    np.testing.assert_allclose(plan.gain[0], gain, rtol=1e-4)
    np.testing.assert_array_equal(plan.now, fit.plain_errors)
    assert plan.rank.tolist() == [0]
    assert plan.clipped.tolist() == [0.0]


def test_the_table_has_the_shots_from_the_best_on():
    fit = noisy_fit()
    far = ds.Shot(light=ds.PointLight((0, 0, 8)), name="far")
    plan = ds.plan(fit, [far, FRONT, AGAIN, dataclasses.replace(FRONT, name="an earlier name")], aim="n_s")
    assert plan.order[:2] == (3, 1)  # that tell the same: by their names
    n_s = fit.names.index("n_s")
    assert np.all(np.diff(plan.errors[list(plan.order), n_s]) >= 0)
    assert plan.best.name == "an earlier name"
    lines = str(plan).splitlines()
    assert lines[0] == "plan of 4 photographs, ranked by the error of n_s: standard errors with each"
    assert lines[1].split() == ["shot", "k_a", "k_d", "k_s", "n_s", "linear", "quadratic", "gain"]
    assert lines[2].startswith("now ")
    for place, i in enumerate(plan.order):
        assert lines[3 + place].startswith(plan.names[i])
        assert lines[3 + place].endswith(f" {plan.gain[i]:.2f}")
    assert any(note.startswith("with an earlier name, the errors of n_s are 0.") for note in plan.notes)
    every = ds.plan(fit, [far, FRONT])
    assert every.order == tuple(np.argsort(-every.gain))
    assert "ranked by all errors together" in str(every)
    k_d = [j for j, name in enumerate(fit.names) if name.startswith("k_d")]
    worst = max(100 * fit.plain_errors[k_d] / fit.values[k_d])
    assert f"{worst:.2g} %" in lines[2]


def test_a_shot_as_the_first_view_was_counts_as_that_did():
    fit = noisy_fit()
    first = next(fit.evidence.clusters.parts(np.ones(12, bool)))[1]
    plan = ds.plan(fit, AGAIN)
    expected = np.sqrt(np.diag(fit.evidence.sigma2 * np.linalg.inv(fit.evidence.total + first)))
    np.testing.assert_allclose(plan.errors[0], expected, rtol=1e-6)
    weighed = dataclasses.replace(fit.evidence, spread=fit.evidence.spread * [1, 1, 1, 1, 0.5])  # as a robust loss does
    plan = ds.plan(dataclasses.replace(fit, clusters=dataclasses.replace(fit.clusters, evidence=weighed)), AGAIN)
    expected = np.sqrt(np.diag(fit.evidence.sigma2 * np.linalg.inv(fit.evidence.total + 0.5 * first)))
    np.testing.assert_allclose(plan.errors[0], expected, rtol=1e-6)


@pytest.mark.thorough
def test_clipped_pixels_do_not_count():
    fit = noisy_fit()
    data = fit.solved.problem.data
    first = dataclasses.replace(data.samples[0], sensor_range=SensorRange(-np.inf, 0.6))
    data = dataclasses.replace(data, samples=(first, *data.samples[1:]))
    fit = dataclasses.replace(fit, solved=fit.solved.changed(data=data))
    shots = [dataclasses.replace(FRONT, exposure=e, name=f"{e:g}") for e in (0.5, 1.4, 5.0)]
    plan = ds.plan(fit, shots)
    scene, _ = with_shot(fit.scene, FRONT)
    image = photograph(scene, CAMERA, (8,))
    inside = image.any(-1)
    for share, shot in zip(plan.clipped, shots, strict=True):
        np.testing.assert_allclose(share, (float(shot.exposure) * image[inside] >= 0.6).any(-1).mean(), atol=0.01)
    assert plan.clipped[0] < 0.05 < plan.clipped[1] < plan.clipped[2]
    assert any(note.startswith("5 would have") and "clipped" in note for note in plan.notes)
    assert not any(note.startswith("0.5 would have") for note in plan.notes)
    assert plan.gain[1] < ds.plan(noisy_fit(), shots[1]).gain[0]


# --- whose unknowns a lamp has


def test_the_same_lamp_moved_has_the_fits_attenuation_and_not_its_own():
    fit = noisy_fit()
    lamp = ds.PointLight((0, 0, 8), 1.0, ds.RadialAttenuation(1.0, 3.0, 0.5))
    of = {place.path: unknowns for place, unknowns in unknowns_of_lamp(fit, lamp).items()}
    names = list(fit.names)
    assert of["attenuation.linear"] == {names.index("linear")}
    assert of["attenuation.quadratic"] == {names.index("quadratic")}
    assert of["intensity"] == of["attenuation.constant"] == {None}
    assert not {"position", "direction"} & set(of)
    spot = ds.SpotLight((0, 0, 8), (0, 0, -1), 1.0, 60.0)
    assert not any(unknowns_of_lamp(fit, spot).values())  # of another kind
    absorbed = dataclasses.replace(lamp, attenuation=own_parts.HazyAttenuation())
    assert not any(unknowns_of_lamp(fit, absorbed).values())  # of another law


def test_numbers_of_each_lamp_or_view_alone_are_known_of_a_shot_and_that_is_said():
    fit = noisy_fit()
    unknowns = list(fit.unknowns)
    unknowns[0] = dataclasses.replace(unknowns[0], places=(Place("lights", 1, ("intensity",), 0),))
    unknowns[1] = dataclasses.replace(unknowns[1], places=(Place("views", 0, ("exposure",), 0),))
    (note,) = [n for n in notes_of(with_problem(fit, unknowns=tuple(unknowns))) if n.startswith("assumed known")]
    assert "exposure of a view and intensity" in note


# --- the order, the information, and the words


def notes_of(fit: ds.Fit, aim: Any = None, **change: Any) -> list[str]:
    """What a plan of one shot says, of errors half as large as now but for a change."""
    now = fit.plain_errors
    given = {"now": now, "errors": 0.5 * now[None], "rank": np.array([0]), "clipped": np.array([0.0])} | change
    of_fit = {"unknowns": fit.unknowns, "values": fit.values, "scales": fit.scales, "aim": find_aim(fit.unknowns, aim)}
    plan = Plan(shots=(FRONT,), names=(FRONT.name,), order=(0,), gain=np.zeros(1), notes=(), **of_fit, **given)
    return list(plan_notes(fit, plan))


def test_what_the_first_choice_does_is_said():
    fit = noisy_fit()
    n_s = np.array(fit.names) == "n_s"
    said = notes_of(fit)
    assert said[0] == "with in front, the errors of what the views determine are 0.5 times the present ones."
    assert len(said) == 2
    assert "independent noise" in said[-1]
    assert (
        "the errors of n_s are 0.25 times"
        in notes_of(fit, "n_s", errors=np.where(n_s, 0.25, 1.0) * fit.plain_errors[None])[0]
    )
    unknown = np.where(n_s, np.inf, fit.plain_errors)
    said = notes_of(fit, now=unknown, rank=np.array([1]))
    assert said[0] == "in front determines n_s, which the views do not."
    assert any("a dash marks an unknown" in note for note in said)
    assert any(note.startswith("'new'") for note in said)
    said = notes_of(fit, now=unknown, errors=unknown[None])
    assert any("none of these shots determines n_s (-). Fix it, or plan with other lights" in note for note in said)
    lost = dataclasses.replace(fit, determined=~n_s)
    for share, count in ((0.45, 0), (0.55, 1)):  # of the value, which is the error of the logarithm
        vague = np.where(n_s, share * fit.values, fit.plain_errors)[None]
        assert sum("with in front, n_s would be lost" in note for note in notes_of(lost, errors=vague)) == count
    for share, count in ((0.04, 0), (0.06, 1)):
        assert sum("of its pixels clipped" in note for note in notes_of(fit, clipped=np.array([share]))) == count


def test_shots_are_ranked_by_rank_then_by_the_aim_or_the_gain_and_ties_by_name():
    fit = noisy_fit()
    n_s = np.array(fit.names) == "n_s"
    names, none = ("b", "a", "c"), np.zeros(12, bool)
    errors = np.ones((3, 12))
    rank, gain = np.zeros(3, int), np.array([1.0, 1.0 + 1e-12, 2.0])
    assert rank_shots(names, none, errors, rank, gain) == (2, 1, 0)
    assert rank_shots(names, none, errors, np.array([1, 0, 0]), gain) == (0, 2, 1)
    errors[1, n_s] *= 0.5
    assert rank_shots(names, n_s, errors, rank, gain) == (1, 0, 2)
    errors[1, 0] = np.inf
    assert rank_shots(names, n_s | (np.arange(12) == 0), errors, rank, gain) == (0, 2, 1)


def test_information_is_of_relative_errors_and_its_rank_of_what_is_determined():
    fit, p = noisy_fit(), len(noisy_fit().values)
    np.testing.assert_allclose(reference_sizes(fit), fit.values)
    rank, log = information(fit.evidence, fit.values)
    relative = fit.covariance / np.outer(fit.values, fit.values)
    assert rank == p
    np.testing.assert_allclose(log, -np.linalg.slogdet(relative)[1], rtol=1e-6)
    H = np.diag(1.0 / fit.values**2)  # of each number its own error, but of the first
    H[0, 0] = 0.0
    blind = dataclasses.replace(
        fit.evidence, clusters=by_view(H[None], np.zeros((1, p))), known_hessian=0 * H, sigma2=4.0,
        regular=np.arange(p) > 0,
    )  # fmt: skip
    assert information(blind, fit.values) == (p - 1, pytest.approx(-(p - 1) * np.log(4.0)))
    more = add_shot(blind, np.diag(np.arange(p) == 0) / fit.values[0] ** 2)
    assert more.regular.all()
    assert information(more, fit.values) == (p, pytest.approx(-p * np.log(4.0)))
    assert more.count == 2
    held = dataclasses.replace(more, at_bound=np.arange(p) == 1)
    assert information(held, fit.values)[0] == p - 1


def test_where_something_is_open_the_table_says_how_many_directions_are_new():
    fit = noisy_fit()
    known = np.arange(12) > 0
    plan = Plan(
        (FRONT,), ("in front",), (0,), fit.unknowns, fit.values, fit.scales, np.where(known, fit.plain_errors, np.inf),
        fit.plain_errors[None], np.array([2.0]), np.array([1]), np.array([0.0]), ~known, ("a note.",),
    )  # fmt: skip
    title, head, now, first, note = str(plan).splitlines()
    assert title.startswith("plan of 1 photograph, ranked by the error of k_a")
    assert head.split()[-2:] == ["new", "gain"]
    assert now.split()[1] == "-"
    assert first.split()[-2:] == ["1", "2.00"]
    assert note == "- a note."
    assert [percent(share) for share in (0.0123, 0.994, 0.996, 12.3, 1e5)] == [
        "1.2 %",
        "99 %",
        "100 %",
        "1230 %",
        "1e+07 %",
    ]


def test_an_aim_is_any_run_of_a_name():
    unknowns = noisy_fit().unknowns
    names = np.array([u.name for u in unknowns])
    assert names[find_aim(unknowns, "k_d")].tolist() == ["k_d.r", "k_d.g", "k_d.b"]
    assert names[find_aim(unknowns, ["k_d.g", "material.n_s"])].tolist() == ["k_d.g", "n_s"]
    assert names[find_aim(unknowns, "attenuation")].tolist() == ["linear", "quadratic"]
    assert not find_aim(unknowns, None).any()


@pytest.mark.parametrize(
    ("shots", "options", "error", "words"),
    [
        ([], {}, ValueError, ("plan needs at least one shot", "Give for example")),
        ([ds.PointLight((0, 0, 3))], {}, TypeError, ("shots[0]", "Shot", "got PointLight")),
        (FRONT, {"aim": "ns"}, ValueError, ("aim names 'ns'", "not an unknown", "Did you mean 'n_s'?")),
        (FRONT, {"aim": "intensity"}, ValueError, ("aim names 'intensity'", "not an unknown")),
        (FRONT, {"aim": [3]}, TypeError, ("aim must hold names", "got 3")),
        (
            [FRONT, ds.Shot(camera=ds.Camera((0, 0, 4), target=(0, 0, 8), shape=(24, 24)))],
            {},
            ValueError,
            ("shots[1] sees no object", "(0, 0, 4)", "Set the camera's target"),
        ),
    ],
)
def test_messages(shots, options, error, words):
    with pytest.raises(error) as caught:
        inspect.unwrap(ds.plan)(noisy_fit(), shots, **options)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_shot_says_what_is_wrong_with_it():
    with pytest.raises(ValueError, match=r"Shot\.exposure must be above 0; got 0\.0"):
        ds.Shot(exposure=0.0)
    wrong: Any = ({"light": "lamp"}, "Shot.light"), ({"camera": 3}, "Shot.camera"), ({"name": 3}, "Shot.name")
    for given, word in wrong:
        with pytest.raises(TypeError, match=word):
            ds.Shot(**given)


def test_a_surface_known_from_one_camera_alone_is_seen_by_no_other():
    scene = ds.Scene(ds.Object(seen_by(CAMERA), noisy_fit().material), noisy_fit().scene.lights)
    fit = with_problem(noisy_fit(), scene=scene)
    with pytest.raises(ValueError, match=r"from below has a camera of its own.*GBuffer") as caught:
        ds.plan(fit, BELOW)
    assert "Leave Shot.camera out" in str(caught.value)

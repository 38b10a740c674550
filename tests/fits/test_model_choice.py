"""Model choice: a verdict where there is one, never where there is none, and errors that fits without a view have."""

import dataclasses
import inspect
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from changed_fits import with_problem
from scenarios import noisy_fit, noisy_images
from synthetic import CAMERA, FREE, MATERIAL, TIED, forget, one_light_each, standard_scene
from unexplained import unexplained  # noqa: F401

import diffshade as ds
from diffshade.diagnosis.model_choice import (
    ModelChoice,
    _check_comparable,
    _remarks,
    count_determined,
    least_ratio,
    paired_difference,
    verdict,
)

MATTE = standard_scene(dataclasses.replace(MATERIAL, k_s=np.zeros(3)))


@cache
def fitted(name: str) -> ds.Fit:
    """Of a shiny ball: the model that it is of, that model with the first photograph's exposure, or a matte one."""
    views = one_light_each(noisy_images())
    if name == "an exposure":
        told = forget(standard_scene())
        return ds.fit(told, views, free=(*FREE, "views.0.exposure"), tied=TIED, start="scene")
    return noisy_fit() if name == "Phong" else ds.fit(MATTE, views, free=("k_a", "k_d"), tied=())


@cache
def choice(*names: str) -> ModelChoice:
    return ds.compare({name: fitted(name) for name in names})


ALL = ("Phong", "an exposure", "matte")


@pytest.mark.usefixtures("unexplained")
def test_a_matte_model_of_a_shiny_ball_loses():
    found = choice("matte", "Phong")
    assert found.best == "Phong"
    assert tuple(found.names) == ("Phong", "matte")
    assert found.worse.tolist() == [False, True]
    assert found.differences[1] > 10 * found.difference_errors[1]
    np.testing.assert_allclose(found.bic, 8 * np.log(found.rmse**2) + found.unknowns * np.log(8))


@pytest.mark.thorough
def test_a_term_that_is_not_needed_gets_no_verdict():
    found = choice(*ALL)
    assert found.best is None  # of two that are as good
    assert set(found.names) == set(ALL)
    assert found.names[2] == "matte"
    assert found.worse.tolist() == [False, False, True]
    assert found.held_out == "8 views"
    assert found.folds == 8
    assert found.differences[0] == 0.0
    assert found.differences[2] > 10 * found.difference_errors[2]
    assert found.image_differences[1] < 0.5 / 255 < found.image_differences[2]
    assert any(note.startswith(found.names[0]) and "better than matte" in note for note in found.notes)
    assert any(f"undecided between {found.names[0]} and {found.names[1]}" in note for note in found.notes)
    assert any("less than half a grey level, 0.002" in note for note in found.notes)
    assert any("exposure, determined by one view only, kept the fitted value" in note for note in found.notes)
    alone = choice("matte", "Phong")
    np.testing.assert_allclose(alone.errors, found.errors[[found.names.index("Phong"), 2]], rtol=1e-9)


@pytest.mark.thorough
def test_the_table_has_all_models_and_a_footnote():
    found = choice(*ALL)
    unknowns = dict(zip(found.names, found.unknowns, strict=True))
    assert unknowns == {"Phong": 12, "an exposure": 13, "matte": 6}
    lines = str(found).splitlines()
    assert lines[0] == "3 models by their held-out error: 8 views, held out one at a time"
    for line, name, error in zip(lines[2:5], found.names, found.errors, strict=True):
        assert line.startswith(name)
        assert f"{error:.4g}" in line
    assert "+-" not in lines[2]
    assert "+-" in lines[3]
    assert "n = 8 folds" in lines[-1]
    np.testing.assert_allclose(found.rmse, [fitted(name).rmse for name in found.names], rtol=1e-9)
    seen = [[fitted(name).predict(view) for view in fitted(name).views] for name in found.names]
    apart = [
        np.sqrt(
            sum(np.sum(((a.image - b.image) * a.counts) ** 2) for a, b in zip(of, seen[0], strict=True))
            / sum(a.counts.sum() for a in of)
        )
        for of in seen
    ]
    np.testing.assert_allclose(found.image_differences, apart, rtol=1e-6, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.usefixtures("unexplained")
def test_the_errors_are_those_of_fits_without_each_view():
    views, squares, samples = list(noisy_fit().views), [], []
    for k, view in enumerate(views):
        seen = ds.fit(MATTE, views[:k] + views[k + 1 :], free=("k_a", "k_d"), tied=(), start="scene").predict(view)
        squares.append(np.sum(seen.difference**2))
        samples.append(seen.counts.sum())
    np.testing.assert_allclose(choice("matte", "Phong").errors[1] ** 2, np.sum(squares) / np.sum(samples), rtol=1e-7)


@pytest.mark.thorough
def test_patches_of_one_view_are_left_out_and_a_fit_is_not_told_from_itself():
    view = one_light_each(noisy_images())[:1]
    (matte,) = (ds.fit(MATTE, view, free=("k_a", "k_d")),)
    found = ds.compare({"one": matte, "other": matte})
    assert found.held_out.endswith("pixels")
    assert found.folds > 6
    assert found.best is None
    assert found.differences[1] == 0.0
    assert "Add photographs under other lights." in str(found)
    assert found.errors[0] > 0.9 * found.rmse[0]


def test_the_jackknife_of_equal_clusters_is_that_of_a_mean():
    d = np.random.default_rng(0).standard_normal(8)
    mean, error = paired_difference(50 * d, np.full(8, 50.0))
    np.testing.assert_allclose((mean, error), (d.mean(), d.std(ddof=1) / np.sqrt(8)), rtol=1e-12)
    count = np.array([1.0, 3.0, 2.0])
    without = [2.0, 7 / 3, 1.75]  # the ratios of the others' sums
    error = np.sqrt(2 / 3 * np.sum((np.array(without) - np.mean(without)) ** 2))
    np.testing.assert_allclose(paired_difference(np.array([2.0, 5.0, 5.0]), count), (2.0, error))


@pytest.mark.parametrize(
    ("errors", "of_best", "ratio"),
    [
        ((1e-4, 3e-4), (1e-15, 1e-9), 1e-4 / 6e-8),  # a best error below the rounding counts as it
        ((1e-4, 3e-4), (1e-5, 1e-4), 3.0),
        ((1e-4, 5e-7), (1e-5, 1e-9), 10.0),  # in the second fold both are within ten roundings
        ((1e-9, 5e-7), (1e-15, 1e-15), 0.0),
    ],
)
def test_the_ratio_is_that_of_the_fold_that_tells_the_models_least_apart(errors, of_best, ratio):
    samples = np.array([100.0, 300.0])
    one, best = (
        SimpleNamespace(squares=samples * np.square(of), samples=samples, rounding=6e-8**2) for of in (errors, of_best)
    )
    found: Any = least_ratio
    np.testing.assert_allclose(found(one, best), ratio)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("views", "scale"), [*(pytest.param(5, of, marks=pytest.mark.slow) for of in (1.0, 1e-3)), (1, 1.0)]
)
def test_renders_without_noise_are_told_apart_however_little_the_models_differ(views, scale):
    """A highlight so weak that the best Blinn one is 1.6e-5 away, far less than a grey level; and dark photographs."""
    lights = [ds.DirectionalLight(d) for d in ((1, -1, -1), (-1, -1, -1), (0, 1, -1), (0.3, -0.2, -1), (-0.7, 0.5, -1))]
    camera = ds.Camera((0, 0, 4), fov=35, shape=(32, 32))

    def of(k_s: float, lobe: Any) -> ds.Scene:
        return ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, k_s, 20, lobe)), lights)

    shown = [
        ds.View(scale * np.asarray(ds.render(of(0.002, ds.Phong()), camera, lit=i)), camera, lit=i)
        for i in range(views)
    ]
    fits = {
        lobe: ds.fit(of(0.002, getattr(ds, lobe)()), shown, free=("k_a", "k_d", "k_s", "n_s"))
        for lobe in ("Phong", "Blinn")
    }
    fits["matte"] = ds.fit(of(0.0, ds.Phong()), shown, free=("k_a", "k_d"))
    found = ds.compare(fits)
    assert found.best == "Phong"
    assert "whose errors are at least" in str(found)
    same = ds.compare({"one": fits["Phong"], "other": fits["Phong"]})
    assert same.best is None
    assert set(same.undecided) == {"one", "other"}


# --- words


def verdict_on(
    difference: float, error: float, apart: float, worse: bool = False, rmse: float = 0.01, ratio: float = 1.0
) -> str:
    differences, errors, images = (np.array([0.0, x]) for x in (difference, error, apart))
    found: Any = SimpleNamespace(
        names=["a", "b"], differences=differences, difference_errors=errors, image_differences=images,
        rmse=[rmse, rmse], worse=[False, worse],
    )  # fmt: skip
    return verdict(found, 1, ratio)


def test_a_verdict_says_why():
    for said, words, not_said in (
        (
            verdict_on(3.0, 1.0, 0.1, worse=True),
            ("a predicts", "better than b", "3.0 standard errors", "0.1"),
            "undecided",
        ),
        (verdict_on(1e-9, 1e-9, 1e-5, worse=True, ratio=230.0), ("a predicts", "better than b", "2.3e+02"), "standard"),
        (verdict_on(0.5, 0.0, 0.1, worse=True), ("inf standard errors",), "undecided"),
        (verdict_on(1.9, 1.0, 0.1), ("undecided between a and b", "1.9 standard errors", "needs 1.96"), "grey level"),
        (verdict_on(3.0, 1.0, 0.0019), ("half a grey level",), "needs"),
        (verdict_on(3.0, 1.0, 0.0021, rmse=0.1), ("less than 10% of the residuals",), "grey level"),
        (verdict_on(1.0, 1.0, 0.0), ("needs 1.96", "grey level"), "residuals"),
        (verdict_on(0.0, 0.0, 0.0), ("0.0 standard errors", "needs 1.96"), "inf"),
    ):
        assert all(word in said for word in words), said
        assert not_said not in said, said


def remarks(*, worse=True, by_view=True, held=(), converged=(True, True)) -> list[str]:
    """What is said below the verdicts of two models but for the last line."""
    choice: Any = SimpleNamespace(names=["b", "a"], worse=np.array([False, worse]), folds=8)
    scores: Any = [SimpleNamespace(held=(), converged=True), SimpleNamespace(held=held, converged=converged[0])]
    fits: Any = {"b": SimpleNamespace(converged=converged[1]), "a": SimpleNamespace(converged=True)}
    *said, last = _remarks(choice, fits, scores, by_view=by_view)
    assert "n = 8 folds" in last
    return said


def test_what_is_said_of_few_views_and_of_numbers_of_one():
    assert remarks() == remarks(worse=False) == remarks(by_view=False) == []
    (few,) = remarks(by_view=False, worse=False)
    assert "Add photographs under other lights." in few
    (held,) = remarks(held=("exposure",))
    assert held.startswith("exposure, determined by one view only")
    for converged, names in (((False, True), "a"), ((True, False), "b"), ((False, False), "a and b")):
        (failed,) = remarks(converged=converged)
        assert failed.startswith(f"a fit of {names} did not converge")


def test_the_unknowns_are_those_that_a_fit_determines():
    fit = noisy_fit()
    some = dataclasses.replace(fit.evidence, regular=np.arange(12) > 0)
    changed = dataclasses.replace(
        fit, clusters=dataclasses.replace(fit.clusters, evidence=some), at_bound=np.arange(12) == 11
    )
    assert count_determined(changed) == 10


def changed(**options: Any) -> ds.Fit:
    """The noisy fit with something of its last view other than it is."""
    fit = noisy_fit()
    return with_problem(fit, views=(*fit.views[:7], dataclasses.replace(fit.views[7], **options)))


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (lambda: with_problem(noisy_fit(), views=noisy_fit().views[:7]), ("got 8 and 7", "Fit both to all")),
        (lambda: changed(image=noisy_images(1)[7]), ("views[7] differs in its image",)),
        (lambda: changed(mask=np.ones(CAMERA.shape, bool)), ("views[7] differs in its mask",)),
        (lambda: changed(saturation=0.9), ("views[7] differs in its saturation",)),
        (
            lambda: with_problem(noisy_fit(), [dataclasses.replace(view, noise=0.1) for view in noisy_fit().views]),
            ("views[0] differs in its noise",),
        ),
        (lambda: with_problem(noisy_fit(), clipped="tobit"), ("same clipped", "'hinge' and 'tobit'")),
        (
            lambda: with_problem(
                noisy_fit(),
                model=noisy_fit().solved.problem.model.use(dataclasses.replace(noisy_fit().likelihood, loss="huber")),
            ),
            ("the same loss", "'squares' and 'huber'", "Fit both with one"),
        ),
    ],
)
def test_fits_of_other_photographs_or_losses_are_refused(other, words):
    with pytest.raises(ValueError, match="fits\\['a'\\] and fits\\['b'\\]") as caught:
        ds.compare({"a": noisy_fit(), "b": other()})
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_fits_of_the_same_photographs_in_other_scenes_are_not_refused_but_of_other_pixels_are():
    fit = noisy_fit()
    _check_comparable("a", fit, "b", with_problem(fit, scene=MATTE))
    data = fit.solved.problem.data
    first, *others = data.samples
    fewer = dataclasses.replace(data, samples=(first.at(first.pixels[:9]), *others))
    problem = dataclasses.replace(fit.solved.problem, data=fewer)
    of_fewer = dataclasses.replace(fit, solved=dataclasses.replace(fit.solved, problem=problem))
    with pytest.raises(ValueError, match="must use the same pixels") as caught:
        _check_comparable("a", of_fewer, "b", fit)
    words = ("views[0]", f"9 and {len(first.pixels):,}", "Give the view a mask")
    assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (lambda fit: {"Phong": fit}, ValueError, ("at least two fits", "got 1")),
        (lambda fit: [fit, fit], TypeError, ("fits must be a Mapping", "got list")),
        (lambda fit: {"a": fit, "c": MATERIAL}, TypeError, ("fits['c']", "Fit", "got Material")),
        (lambda fit: {"a": fit, 3: fit}, TypeError, ("got 3", "Give for example 'Phong'")),
    ],
)
def test_messages(given, error, words):
    with pytest.raises(error) as caught:
        inspect.unwrap(ds.compare)(given(noisy_fit()))
    assert all(word in str(caught.value) for word in words), str(caught.value)

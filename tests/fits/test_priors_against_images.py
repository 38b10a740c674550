"""A prior that the images contradict is named, and what it moves is withdrawn; one that they do not is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenarios import noisy_fit, noisy_images, standard_fit
from synthetic import CAMERA, noisy, photograph

import diffshade as ds
from diffshade.inverse.statistics.gauges import taken_as_exact
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.places import Place
from diffshade.inverse.verdicts.contradictions import check_priors


@pytest.mark.thorough
@pytest.mark.parametrize(("mean", "contradicts"), [(60.0, True), (50.0, False)])
def test_a_prior_of_n_s(mean, contradicts):
    fit = standard_fit(noisy_images(), priors={"n_s": (mean, 0.005)})
    notes = [note for note in fit.notes if "contradicts the images" in note]
    assert bool(notes) == contradicts
    if contradicts:
        free = noisy_fit()
        j = free.names.index("n_s")
        (note,) = notes
        assert "n_s is 60 by the prior" in note
        said = float(note.split(" by the images alone")[0].split()[-1])
        assert said == pytest.approx(free.values[j], rel=0.05)
        assert "widen the prior" in note
        moved = np.abs(fit.values - free.values) > 3 * fit.errors
        assert not fit.determined[j]
        assert not (moved & fit.determined).any()


@pytest.mark.thorough
def test_priors_that_contradict_each_other_are_not_laid_to_the_images():
    """Of k_d and the intensity the images show the product alone, so that two wrong priors leave neither known."""
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.0, 0.5)), ds.DirectionalLight((-1, -1, -2), 1.0))
    (image,) = noisy([photograph(scene)], 0.003, 0)
    told = {"k_d": (0.5, 0.01), "intensity": (2.0, 0.02)}
    fit = ds.fit(scene, ds.View(image, CAMERA), free=("k_d", "intensity"), priors=told)
    assert not fit.determined.any()
    assert any("contradicts the images and the other priors" in note for note in fit.notes)
    assert not any("alone" in note for note in fit.notes)


def test_a_prior_of_a_direction_may_have_any_length():
    scene = ds.Scene(ds.Object(ds.Sphere()), ds.DirectionalLight((0, -3, -4)))
    view = ds.View(np.zeros((*CAMERA.shape, 3)), CAMERA)
    found = find_unknowns(scene, [view], ("direction",), priors={"direction": ((0, -3, -4), 0.02)})
    assert [unknown.prior for unknown in found] == [(0.0, 0.02), (-0.6, 0.02), (-0.8, 0.02)]


def test_without_a_prior_nothing_is_asked():
    fit = noisy_fit()
    assert check_priors(fit) is fit


def test_that_intensities_are_taken_as_exact_is_said_where_they_are():
    fit = noisy_fit()
    sentence = taken_as_exact(fit.unknowns, 8, 8)
    assert sentence.startswith("k_a, k_d and k_s scale inversely with the lights' intensities")
    assert sentence in str(fit)
    (k_d,) = [u for u in fit.unknowns if u.name == "k_d.r"]
    (n_s,) = [u for u in fit.unknowns if u.name == "n_s"]
    assert taken_as_exact([n_s], 2, 2) == ""
    for owner, name in (("lights", "intensity"), ("views", "exposure")):
        senders = [dataclasses.replace(k_d, places=(Place(owner, i, (name,), 0),)) for i in range(2)]
        assert taken_as_exact([k_d, *senders], 2, 2) == ""
        assert taken_as_exact([k_d, senders[0]], 2, 2).startswith("k_d scales")  # the other one is still exact

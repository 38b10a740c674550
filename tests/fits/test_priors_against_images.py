"""A prior that the images contradict is named, and what it moves is withdrawn; one that they do not is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenarios import noisy_fit, noisy_images, standard_fit

from diffshade.inverse.contradictions import check_priors
from diffshade.inverse.intensities import taken_as_exact


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
        assert moved[j]
        assert not (moved & fit.determined).any()


def test_without_a_prior_nothing_is_asked():
    fit = noisy_fit()
    assert check_priors(fit) is fit


def test_that_intensities_are_taken_as_exact_is_said_where_they_are():
    fit = noisy_fit()
    sentence = taken_as_exact(fit.unknowns)
    assert sentence.startswith("k_a, k_d and k_s scale inversely with the lights' intensities")
    assert sentence in str(fit)
    (k_d,) = [u for u in fit.unknowns if u.name == "k_d.r"]
    assert taken_as_exact([k_d]).startswith("k_d scales")
    for quantity in ("lights.0.intensity", "views.1.exposure", "ambient"):
        assert taken_as_exact([k_d, dataclasses.replace(k_d, quantity=quantity)]) == ""
    (n_s,) = [u for u in fit.unknowns if u.name == "n_s"]
    assert taken_as_exact([n_s]) == ""

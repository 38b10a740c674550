"""Random set-ups with one fault each: named, or what it corrupts is not determined; right ones get no remark."""

from __future__ import annotations

import numpy as np
import pytest
from wrong_set_ups import FAULTS, KINDS, faulty, fitted, set_up

import diffshade as ds
from diffshade.core.backend import in_float64
from diffshade.diagnosis.suspicions import suspicions


def remarks(fit: ds.Fit) -> list[str]:
    """The kinds of fault that a fit and an examination of its residuals name."""
    of_fit = [kind for kind in ("outline", "prior") if any(f"the {kind}" in note for note in fit.notes)]
    return [*of_fit, *(found.kind for found in suspicions(fit))]


def judge(right: ds.Fit, fit: ds.Fit, fault: str) -> tuple[bool, bool, bool]:
    """Whether a fault moves a number by more than two of its errors, is named, and what it moves is withdrawn."""
    found = suspicions(fit)
    named = bool(set(remarks(fit)) & set(KINDS[fault]))
    moved = np.abs(fit.values - right.values) > 2.0 * fit.errors  # what the fit's own checks withdraw counts as well
    left = moved & fit.determined & ~np.isin(fit.names, [name for of in found for name in of.affected])
    return bool((moved & fit.evidence.regular).any()), named, not left.any()


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("seed", [0, pytest.param(7, marks=pytest.mark.slow)])
def test_a_fault_is_named_with_what_to_do(seed, fault):
    of = set_up(seed)
    fit = fitted(of, fault)
    assert set(remarks(fit)) & set(KINDS[fault]), [*fit.notes, *(s.sentence for s in suspicions(fit))]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 7])
def test_a_right_set_up_gets_no_remark(seed):
    assert remarks(fitted(set_up(seed), None)) == []


def test_an_examination_names_it_and_withdraws_what_it_moves():
    of = set_up(0)
    examination = ds.examine(fitted(of, "gamma"))
    assert "gamma" in examination.notes[0]
    assert "not determined" in examination.notes[1]
    assert not examination.determined.all()
    assert len(set(examination.notes)) == len(examination.notes)


def test_a_fit_without_a_mask_says_that_the_background_is_inside():
    fit = fitted(set_up(0), "radius large")
    assert not fit.determined.any()
    assert "inside the outline" in fit.notes[0]
    told, views, _ = faulty(set_up(0), "radius large")
    masked = [ds.View(v.image, v.camera, np.asarray(v.image).mean(-1) > 0.02, lit=v.lit) for v in views]
    assert "outline" not in "".join(ds.fit(told, masked, free=("k_d",)).notes)


@pytest.mark.slow
def test_faults_of_fifty_set_ups_are_named_or_what_they_corrupt_is_withdrawn():
    moved = dict.fromkeys(FAULTS, 0)
    seen = dict.fromkeys(FAULTS, 0)
    for seed in range(50):
        of = set_up(seed)
        right = fitted(of, None)
        for fault in FAULTS:
            corrupts, named, withdrawn = judge(right, fitted(of, fault), fault)
            moved[fault] += corrupts
            seen[fault] += corrupts and (named or withdrawn)
    assert all(seen[fault] >= 0.9 * moved[fault] for fault in FAULTS), (seen, moved)
    assert all(moved.values())


@pytest.mark.slow
def test_of_five_hundred_right_set_ups_hardly_any_gets_a_remark():
    """Without what looks for one view's or one light's faults, whose own tests count their alarms."""
    alarms = []
    for seed in range(1000, 1500):
        fit = fitted(set_up(seed), None)
        with in_float64(fit) as own:
            found = [str(fault) for fault in of_all_views(at_minimum(own))[0]]
            alike = [side for side in CELL_SIDES if cell_correlation(residuals(own)[0], side).errors > CERTAIN_ERRORS]
        if found or alike or any("outline" in note or "the prior" in note for note in fit.notes):
            alarms.append((seed, found, alike))
    assert len(alarms) <= 5, alarms

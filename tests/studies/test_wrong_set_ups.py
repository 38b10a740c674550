"""Random set-ups with one fault each: named, and within the errors of what is determined; right ones get no remark."""

from __future__ import annotations

import numpy as np
import pytest
from wrong_set_ups import FAULTS, KINDS, SetUp, faulty, fitted, set_up

import diffshade as ds
from diffshade.diagnosis.suspicions import suspicions


def remarks(fit: ds.Fit) -> list[str]:
    """The kinds of fault that a fit and an examination of its residuals name."""
    of_fit = [kind for kind in ("outline", "prior") if any(f"the {kind}" in note for note in fit.notes)]
    return [*of_fit, *(found.kind for found in suspicions(fit))]


def judge(of: SetUp, right: ds.Fit, fit: ds.Fit, fault: str) -> tuple[bool, bool, bool]:
    """Whether a fault moves a number by more than two plain errors, is named, and is within the errors."""
    named = bool(set(remarks(fit)) & set(KINDS[fault]))
    moved = np.abs(fit.values - right.values) > 2.0 * right.plain_errors
    off = np.abs(fit.values - fit.values_in(of.truth)) > 3.0 * fit.errors
    return bool((moved & right.determined).any()), named, not bool((off & fit.determined).any())


SEEN_ELSEWHERE = ("vignetting", "gamma", "blur", "lights turned", "lobe")  # by fits alone: test_wrong_photographs.py


@pytest.mark.parametrize(
    "fault", [pytest.param(of, marks=[pytest.mark.slow] * (of in SEEN_ELSEWHERE)) for of in FAULTS]
)
@pytest.mark.parametrize("seed", [0, pytest.param(7, marks=pytest.mark.slow)])
def test_a_fault_is_named_with_what_to_do(seed, fault):
    of = set_up(seed)
    fit = fitted(of, fault)
    assert set(remarks(fit)) & set(KINDS[fault]), [*fit.notes, *(s.sentence for s in suspicions(fit))]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 7])
def test_a_right_set_up_gets_no_remark(seed):
    assert remarks(fitted(set_up(seed), None)) == []


def test_fit_and_examination_name_it_and_their_errors_contain_what_it_moves():
    of = set_up(0)
    fit = fitted(of, "gamma")
    examination = ds.examine(fit)
    assert any("gamma" in note.names for note in fit.notes if note.kind == "cause")
    assert "gamma" in examination.notes[0]
    off = np.abs(fit.values - fit.values_in(of.truth))
    assert np.any(off > 3.0 * fit.plain_errors)
    assert np.all((off < 3.0 * fit.errors)[fit.determined])
    assert np.all((off < 3.0 * examination.errors)[examination.determined])
    assert not np.any(examination.determined & ~fit.determined)
    assert len(set(examination.notes)) == len(examination.notes)


def test_a_fit_without_a_mask_says_that_the_background_is_inside():
    fit = fitted(set_up(0), "radius large")
    assert not fit.determined.any()
    assert "inside the outline" in fit.notes[0]
    told, views, _ = faulty(set_up(0), "radius large")
    masked = [ds.View(v.image, v.camera, np.asarray(v.image).mean(-1) > 0.02, lit=v.lit) for v in views]
    assert "outline" not in "".join(ds.fit(told, masked, free=("k_d",)).notes)


@pytest.mark.slow
def test_faults_of_fifty_set_ups_are_named_or_within_the_errors():
    moved, seen, true = (dict.fromkeys(FAULTS, 0) for _ in range(3))
    for seed in range(50):
        of = set_up(seed)
        right = fitted(of, None)
        for fault in FAULTS:
            corrupts, named, within = judge(of, right, fitted(of, fault), fault)
            moved[fault] += corrupts
            seen[fault] += corrupts and named
            true[fault] += corrupts and within
    assert all(seen[fault] >= 0.8 * moved[fault] for fault in FAULTS), (seen, moved)
    assert all(true[fault] >= 0.9 * moved[fault] for fault in FAULTS), (true, moved)
    assert all(moved.values())


@pytest.mark.slow
def test_of_five_hundred_right_set_ups_hardly_any_gets_a_remark():
    alarms = []
    for seed in range(1000, 1500):
        fit = fitted(set_up(seed), None)
        said = [note for note in fit.notes if note.kind in ("cause", "misfit", "outline", "prior")]
        if said:
            alarms.append((seed, said))
    assert len(alarms) <= 5, alarms

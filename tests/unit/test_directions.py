"""Directions on linear problems, where least squares with the fault among the unknowns says the same."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refusals import untyped
from scipy import sparse

import diffshade as ds
from diffshade.inverse.misfit.changes import Case, Move
from diffshade.inverse.misfit.directions import Directions, changes_of
from diffshade.inverse.misfit.found import Fault
from diffshade.inverse.misfit.other_scenes import with_materials, with_other_lobe

pytestmark = untyped  # what stands for a set-up is a namespace
RANDOM = np.random.default_rng(0)
J = RANDOM.standard_normal((3, 600))
FAULTS = RANDOM.standard_normal((2, 600)) + 0.5 * J[:2]
WEIGHT = RANDOM.uniform(50.0, 200.0, J.shape[1])
SAMPLES = np.array([1.0, -2.0, 0.5]) @ J + np.array([0.3, -0.2]) @ FAULTS + 0.1 * RANDOM.standard_normal(600)
EVERY = np.arange(3)
PRIOR = np.array([5e4, 0.0, 0.0]), np.array([1.05, 0.0, 0.0])
NO_PRIOR = np.zeros(3), np.zeros(3)


def least_squares(jacobian: np.ndarray, prior: tuple[np.ndarray, np.ndarray] = NO_PRIOR) -> tuple[np.ndarray, float]:
    """The minimum of a weighted problem with a prior's weight and mean on each unknown, and twice its cost."""
    more = np.zeros(len(jacobian) - 3)
    weight, mean = (np.concatenate([of, more]) for of in prior)
    H = (jacobian * WEIGHT) @ jacobian.T + np.diag(weight)
    theta = np.linalg.solve(H, (jacobian * WEIGHT) @ SAMPLES + weight * mean)
    cost = np.sum(WEIGHT * (jacobian.T @ theta - SAMPLES) ** 2)
    return theta, float(cost + np.sum(weight * (theta - mean) ** 2))


def linearised(theta: np.ndarray, prior: tuple[np.ndarray, np.ndarray] = NO_PRIOR, part: float = 1.0) -> Any:
    """The problem at these values; its samples are a part of those of the whole fit."""
    weight, mean = prior
    fit = SimpleNamespace(evidence=SimpleNamespace(spread=np.array([600 / part])))
    return SimpleNamespace(
        jacobian=sparse.csr_array(J),
        weight=WEIGHT,
        slope=WEIGHT * (J.T @ theta - SAMPLES),
        count=600,
        known_hessian=np.diag(weight),
        known_gradient=weight * (theta - mean),
        set_up=SimpleNamespace(own=3),
        fit=fit,
    )


@pytest.mark.parametrize("prior", [NO_PRIOR, PRIOR], ids=["no prior", "prior"])
@pytest.mark.parametrize("away", [0.0, 0.7], ids=["at the minimum", "away from it"])
def test_amounts_moves_and_squares_are_those_of_a_fit_with_the_faults_among_its_unknowns(prior, away):
    (theta, cost), (both, less) = least_squares(J, prior), least_squares(np.concatenate([J, FAULTS]), prior)
    here = theta + away * np.array([1.0, -1.0, 0.5])
    directions = Directions(linearised(here, prior), FAULTS, EVERY)
    information, score = directions.evidence()
    amount = np.linalg.solve(information, score)
    np.testing.assert_allclose(amount, both[3:], rtol=1e-8)
    np.testing.assert_allclose(here + directions.step, theta, rtol=1e-8)
    np.testing.assert_allclose(here + directions.step - amount @ directions.moves_inside, both[:3], rtol=1e-8)
    np.testing.assert_allclose(directions.moves(), directions.moves_inside, rtol=1e-8)
    np.testing.assert_allclose(amount @ score, cost - less, rtol=1e-8)
    if prior is NO_PRIOR:
        np.testing.assert_allclose(directions.squares, cost, rtol=1e-8)


def test_an_unknown_at_a_bound_stays_for_the_others_and_moves_with_them():
    theta, _ = least_squares(J)
    held = Directions(linearised(theta), FAULTS, np.array([0, 2]))
    whole = Directions(linearised(theta), FAULTS, EVERY).moves()
    some = (FAULTS * WEIGHT) @ J[[0, 2]].T @ np.linalg.inv((J[[0, 2]] * WEIGHT) @ J[[0, 2]].T)
    np.testing.assert_allclose(held.moves()[:, [0, 2]], some, rtol=1e-8)
    np.testing.assert_allclose(held.moves()[:, 1], whole[:, 1], rtol=1e-8)
    J1 = J[[0, 2]]
    left = FAULTS - some @ J1
    np.testing.assert_allclose(held.evidence()[0], (FAULTS * WEIGHT) @ left.T, rtol=1e-8)


def test_a_prior_weighs_as_much_beside_a_part_of_the_samples_as_beside_all():
    theta, _ = least_squares(J, PRIOR)
    weight = np.diag(PRIOR[0])
    for part in (1.0, 0.25):
        directions = Directions(linearised(theta, PRIOR, part), FAULTS, EVERY)
        expected = (FAULTS * WEIGHT) @ J.T @ np.linalg.inv((J * WEIGHT) @ J.T + part * weight)
        np.testing.assert_allclose(directions.moves(), expected, rtol=1e-8)


def test_errors_are_by_the_scatter_of_each_sample():
    theta, _ = least_squares(J)
    at = linearised(theta)
    C = np.linalg.inv((J * WEIGHT) @ J.T)
    expected = np.sqrt(np.diag(C @ (J * at.slope**2) @ J.T @ C))
    np.testing.assert_allclose(Directions(at, FAULTS[:0], EVERY).errors(), expected, rtol=1e-8)
    part = linearised(theta, part=0.25)  # four times as many samples have half the errors
    np.testing.assert_allclose(Directions(part, FAULTS[:0], EVERY).errors(), 0.5 * expected, rtol=1e-8)


def test_what_the_unknowns_imitate_has_no_information():
    theta, _ = least_squares(J)
    information, _ = Directions(linearised(theta), (2.0 * J[0] - J[2])[None], EVERY).evidence()
    assert 0.0 <= information[0, 0] < 1e-9 * np.sum(WEIGHT * J[0] ** 2)


def test_changes_are_of_each_sample_and_left_out_where_they_are_not_linear_or_not_there():
    at: Any = SimpleNamespace(jacobian=sparse.csr_array(J), at_rims=np.arange(600) < 100)

    def cases(of: Any) -> list[Case]:
        assert of is at
        moved = Move.shift([1], 3, 2.0)
        return [Case(0, FAULTS), Case(1, 0.0 * FAULTS), Case(2, np.inf * FAULTS), Case(3, moved)]

    found = changes_of(at, Fault("some", "", "", cases))
    assert [case.which for case, _ in found] == [0, 3]
    np.testing.assert_allclose(found[1][1], 2.0 * J[1:2])
    ((_, inner), _) = changes_of(at, Fault("some", "", "", cases, at_rims=False))
    assert not inner[:, :100].any()
    np.testing.assert_array_equal(inner[:, 100:], FAULTS[:, 100:])
    assert changes_of(at, Fault("some", "", "")) == []


def test_the_other_lobe_of_a_patterned_highlight():
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_s=ds.Chequer(0.1, 0.4), n_s=20)))
    other = with_materials(scene, with_other_lobe)
    assert other is not None
    assert isinstance(other.objects[0].material.lobe, ds.Blinn)
    assert float(other.objects[0].material.n_s) == 80.0
    matte = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_s=0.0)))
    assert with_materials(matte, with_other_lobe) is None

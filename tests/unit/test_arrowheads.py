"""Inverses of arrowheads: those of the dense matrix, or None where that is not certain."""

import numpy as np
import pytest

from diffshade.inverse.statistics.arrowheads import regular_inverse
from diffshade.inverse.statistics.uncertainty import SINGULAR, inverse, scaled


def arrowhead(random: np.random.Generator) -> np.ndarray:
    """J^T J of residuals that each know the border and one block, of one to four unknowns, in any order."""
    sizes = [*random.integers(1, 5, 40)]
    p = 5 + sum(sizes)
    J, first = np.zeros((12 * len(sizes), p)), 5
    for k, size in enumerate(sizes):
        rows = slice(12 * k, 12 * k + 12)
        J[rows, :5] = random.standard_normal((12, 5))
        J[rows, first : first + size] = random.standard_normal((12, size))
        first += size
    order = random.permutation(p)
    return (J.T @ J)[np.ix_(order, order)]


@pytest.mark.parametrize("seed", range(3))
def test_an_arrowhead_has_the_inverse_of_the_dense_matrix(seed):
    H = arrowhead(np.random.default_rng(seed))
    A, _ = scaled(H)
    found = regular_inverse(A, SINGULAR**2)
    assert found is not None
    np.testing.assert_allclose(found, np.linalg.inv(A), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(inverse(H) @ H, np.eye(len(H)), atol=1e-9)


def test_what_is_no_regular_arrowhead_has_none():
    random = np.random.default_rng(0)
    A, _ = scaled(arrowhead(random))
    full = random.standard_normal((200, 100))
    assert regular_inverse(scaled(full.T @ full)[0], SINGULAR**2) is None
    assert regular_inverse(A[:20, :20], SINGULAR**2) is None
    singular = A.copy()
    singular[7], singular[:, 7] = 0.0, 0.0
    assert regular_inverse(singular, SINGULAR**2) is None
    assert regular_inverse(A, 0.5) is None  # no smallest eigenvalue is half of the largest


def test_many_inverses_are_those_of_each_and_leave_null_directions_out():
    random = np.random.default_rng(0)
    J = random.standard_normal((5, 9, 4))
    J[3, :, 1] = 2.0 * J[3, :, 0]
    H = np.swapaxes(J, 1, 2) @ J
    for found, each in zip(inverse(H), H, strict=True):
        np.testing.assert_allclose(found, inverse(each), rtol=1e-10)
    for k in (0, 1, 2, 4):
        np.testing.assert_allclose(inverse(H)[k] @ H[k], np.eye(4), atol=1e-10)
    assert np.abs(inverse(H)[3]).max() < 1e3

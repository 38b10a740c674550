"""Jacobian: the derivatives of samples by unknowns, of each view by those alone that it can show."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class Jacobian:
    """The derivatives of n samples by p unknowns, without the zeros: linear in the views where each shows few of them.

    The samples stand in the order of their views.
    """

    rows: Float[np.ndarray, "m n"]
    index: Int[np.ndarray, "views m"]
    """The unknown of each row, in the samples of each view; p where a row is padded."""
    first: Int[np.ndarray, " views+1"]
    """The first sample of each view, and n."""
    p: int

    def _views(self) -> Iterator[tuple[Int[np.ndarray, " s"], Float[np.ndarray, "s of_view"], slice]]:
        """Yield for each view the unknowns that it shows, their rows, and where its samples are."""
        for index, start, end in zip(self.index, self.first[:-1], self.first[1:], strict=True):
            shown, here = index < self.p, slice(start, end)
            yield index[shown], self.rows[shown, here], here

    def of(self, which: Bool[np.ndarray, " p"]) -> Jacobian:
        """Return the derivatives by some of the unknowns."""
        number = np.where(which, np.cumsum(which) - 1, which.sum())
        return dataclasses.replace(self, index=np.append(number, which.sum())[self.index], p=int(which.sum()))

    def beside(self, more: Float[np.ndarray, "k n"]) -> Jacobian:
        """Return the derivatives by further unknowns too, which all views show; they follow the others."""
        k = len(more)
        padded = np.where(self.index < self.p, self.index, self.p + k)
        index = np.concatenate([padded, np.tile(self.p + np.arange(k), (len(padded), 1))], 1)
        return Jacobian(np.concatenate([self.rows, more]), index, self.first, self.p + k)

    def gram(self, weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, "p p"]:
        """Return J W J^T."""
        H = np.zeros((self.p, self.p))
        for index, J, here in self._views():
            H[np.ix_(index, index)] += (J * weight[here]) @ J.T
        return H

    def times(self, samples: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k p"]:
        """Return the products of rows of samples with J^T."""
        found = np.zeros((len(samples), self.p))
        for index, J, here in self._views():
            found[:, index] += samples[:, here] @ J.T
        return found

    def moved(self, steps: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "k n"]:
        """Return how steps of the unknowns change the samples, to first order."""
        found = np.zeros((len(steps), self.rows.shape[1]))
        for index, J, here in self._views():
            found[:, here] = steps[:, index] @ J
        return found

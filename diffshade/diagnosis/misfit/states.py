"""States: the minima of a fit with some faults corrected, and how faults move the numbers of a set-up."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...core.masks import Mask
from ...inverse.data.view_sets import Masks
from ...inverse.result import Fit
from ...inverse.statistics.uncertainty import Vector

MasksOf = Mapping[int, Mask]  # of some views, by their indices


@dataclass(frozen=True, eq=False)
class State:
    """The minimum over a fit's own unknowns, with numbers of the set-up changed and some pixels left out."""

    theta: Vector
    """The fit's unknowns and, after them, the numbers that faults move, in the solver's coordinates."""
    fit: Fit
    """The fit with the scene, the views and the values of this minimum; its other fields are unchanged."""
    costs: Float[np.ndarray, " views"]
    """The cost of each view; a pixel that is left out counts with the mean cost of its view."""
    excluded: Masks
    """The pixels of each view that are left out."""
    amounts: Mapping[tuple[str, int], Vector]
    """By how much each fault was corrected: of which kind, and which case of it."""

    def share(self, after: State, views: Iterable[int] | None = None) -> float:
        """Return the fraction of the cost that another state explains, in some views or in all."""
        which = slice(None) if views is None else list(views)
        cost = float(self.costs[which].sum())
        return 1.0 - float(after.costs[which].sum()) / cost if cost > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Move:
    """How a fault of one amount or several moves the numbers of a set-up."""

    rows: Float[np.ndarray, "k p"]
    """To first order."""
    along: Callable[[Vector, Vector], Vector]
    """The numbers after a move, from those before and the amount."""

    @staticmethod
    def shift(index: Sequence[int], p: int, scale: float = 1.0) -> Move:
        """Return the move that adds amounts to some numbers."""
        rows = scale * np.eye(p)[list(index)]
        return Move(rows, lambda theta, amount: theta + amount @ rows)

    @staticmethod
    def turn(arms: Sequence[tuple[list[int], Vector]], axes: Float[np.ndarray, "k 3"], theta: Vector) -> Move:
        """Return the move that turns places about their centres, by degrees about each axis."""
        rows = np.zeros((len(axes), len(theta)))
        for index, center in arms:
            rows[:, index] = np.deg2rad(np.cross(axes, theta[index] - center))

        def along(theta: Vector, amount: Vector) -> Vector:
            there, turned = theta.copy(), Rotation.from_rotvec(np.deg2rad(amount @ axes))
            for index, center in arms:
                there[index] = center + turned.apply(theta[index] - center)
            return there

        return Move(rows, along)

"""Found: what a fault of a set-up is, and one that the residuals show, with its size and in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.robust_scale import GAUSS_95
from ...core.words import listing
from ...model.scenes import Scene
from ..result import Fit
from ..statistics.uncertainty import Vector
from ..unknowns.places import Place
from .changes import Case
from .linearised import Linearised
from .set_up import Corrected, MasksOf, SetUp


@dataclass(frozen=True, eq=False)
class Fault:
    """Something that may be wrong with a set-up. It has `cases`, which are looked for, or `regions`, to be left out."""

    kind: str
    what: str
    """What it is and how large: a sentence that names `{f}`, what was found, and `words`."""
    remedy: str
    """As `what`."""
    cases: Callable[[Linearised], Iterable[Case]] | None = None
    """What it changes: of each view, light, object or width that it may concern."""
    numbers: Callable[[Fit], Iterable[Place]] = lambda fit: ()
    """The places of the numbers of the set-up that it moves, if any."""
    words: Callable[[Found], Mapping[str, Any]] = lambda f: {}
    """What else the sentences name."""
    size: Callable[[int, Vector], float] = lambda which, amount: float(amount[0])
    """Its size in the units of the sentence, from which case it is and its amount."""
    plausible: tuple[float, float] = (-np.inf, np.inf)
    """Between these is its size: an image is darker at its corners, and blurred, not sharpened."""
    unnamed: bool = False
    """Whether it is a change of so many numbers that many causes have it: its sentence says what is seen, not why."""
    beside: bool = False
    """Whether samples beside the objects show its amount too."""
    at_rims: bool = True
    """Whether its change is linear at grazing rims too."""
    inexact: bool = False
    """Whether its change is known roughly: what it moves is then uncertain by as much."""
    relative: bool = False
    """Whether its size counts relative to that of the other views, if there are several."""
    of_most: str = ""
    """What is said where it is found in most views or of most lights, which probably has one cause: a sentence with
    `{count}`, `{of}` how many, and the `{smallest}` and `{largest}` size."""
    mended: Callable[[Found], Scene] | None = None
    """The scene with it corrected, if it looks so much like a gamma that only refits tell them apart."""
    regions: Callable[[SetUp, Corrected], MasksOf] | None = None
    """The pixels of each view that it spoils."""
    confirmed: Callable[[SetUp, Corrected, Corrected, MasksOf], MasksOf] | None = None
    """Of which views to believe it, by the states before and after it is corrected."""
    described: Callable[[SetUp, Corrected, MasksOf], tuple[str, MasksOf]] | None = None
    """Where its pixels are and how dark or bright, in words, and which they are, when all else is corrected."""


@dataclass(frozen=True, eq=False)
class Found:
    """A fault that the residuals show."""

    fault: Fault
    given: Fit
    which: int
    """The index of its case."""
    views: tuple[int, ...]
    share: float
    """The fraction of the residuals' squares that it explains."""
    amount: Float[np.ndarray, " amounts"] = field(default_factory=lambda: np.zeros(1))
    moves: Vector = field(default_factory=lambda: np.zeros(0))
    """How far it moves the values, in their own units."""
    after: Corrected | None = None
    """The minimum with it corrected, if it was refitted."""
    masks: MasksOf = field(default_factory=dict)
    """The pixels that are left out."""
    where: str = ""
    """Of a region, in words: how dark or bright it is, and where."""

    @property
    def views_in_words(self) -> str:
        """Its views as a phrase."""
        names = [f"views[{i}]" for i in self.views]
        return listing(names) if len(names) <= 4 else f"{len(names)} views ({names[0]} to {names[-1]})"

    @property
    def size(self) -> float:
        """Its size, in the units of the sentence."""
        return self.fault.size(self.which, self.amount)

    @property
    def length(self) -> float:
        """The length of its amount."""
        return float(np.linalg.norm(self.amount))

    @property
    def affected(self) -> Bool[np.ndarray, " p"]:
        """The values that it moves by more than `GAUSS_95`."""
        return self.given.determined & (np.abs(self.moves) > GAUSS_95 * self.given.plain_errors)

    @property
    def words(self) -> tuple[str, str]:
        """What it is, with its size, and the remedy."""
        words = self.fault.words(self)
        return self.fault.what.format(f=self, **words), self.fault.remedy.format(f=self, **words)

    def __str__(self) -> str:
        """Return what it is, its size, what it explains and moves, and the remedy."""
        fit, (what, remedy) = self.given, self.words
        if self.fault.regions:
            return f"{what}. {remedy}"
        share = f"{self.share:.0%}" if self.share >= 0.01 else "less than 1%"
        away = np.where(fit.determined, np.abs(self.moves) / np.where(fit.determined, fit.plain_errors, 1.0), 0.0)
        worst = int(np.argmax(away)) if len(away) else 0
        moves = f" and moves {fit.names[worst]} by {away[worst]:.2g} errors" if len(away) and away[worst] > 0 else ""
        return f"{what}; this explains {share} of the residuals{moves}. {remedy}"

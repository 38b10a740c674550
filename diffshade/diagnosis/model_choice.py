"""Model choice: which of several fits predicts held-out photographs best, or that this is undecided."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import in_float64
from ..core.fields import check_kind
from ..core.progress import showing
from ..core.robust_scale import GAUSS_95, jackknife_error
from ..core.tables import as_text, with_error
from ..core.thresholds import GREY_LEVEL, SMALL
from ..core.words import listing
from ..inverse.result import Fit
from .cross_validation import Scores, cross_validate, make_folds
from .patches import Parts

MIN_RATIO = 1.0 / SMALL  # the least ratio of the errors in every fold for a verdict by this ratio alone
HALF_LEVEL = GREY_LEVEL / 2  # the least visible difference


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """Fits of the same photographs, ranked by their held-out error; `print` it for the table.

    Every array is NumPy float64, one entry per fit, the best first.
    """

    names: tuple[str, ...]
    errors: Float[np.ndarray, " fits"]
    """Root mean square error of the held-out samples; in units of the noise if that is given."""
    rmse: Float[np.ndarray, " fits"]
    """Root mean square residual of the fitted samples, in the images' units."""
    unknowns: Int[np.ndarray, " fits"]
    differences: Float[np.ndarray, " fits"]
    """Mean square error of the held-out samples, minus that of the best fit."""
    difference_errors: Float[np.ndarray, " fits"]
    """Its standard error, by jackknife over the folds."""
    image_differences: Float[np.ndarray, " fits"]
    """Root mean square difference between the fitted images and the best fit's."""
    worse: Bool[np.ndarray, " fits"]
    """Whether a fit is worse than the best one; otherwise it is undecided between the two."""
    bic: Float[np.ndarray, " fits"]
    folds: int
    """How many views or patches were held out, one at a time."""
    held_out: str
    """What was held out, in words."""
    notes: tuple[str, ...]

    @property
    def undecided(self) -> tuple[str, ...]:
        """The names of the fits that are not worse than the best one, and its own first."""
        return tuple(name for name, worse in zip(self.names, self.worse, strict=True) if not worse)

    @property
    def best(self) -> str | None:
        """The name of the best fit; None if it is undecided."""
        return self.names[0] if len(self.undecided) == 1 else None

    @property
    def columns(self) -> dict[str, Any]:
        """The columns of the table, by their heads."""
        return {
            "model": self.names,
            "unknowns": self.unknowns,
            "held out": self.errors,
            "fitted": self.rmse,
            "difference of MSE": ["-", *map(with_error, self.differences[1:], self.difference_errors[1:])],
            "verdict": ["", *np.where(self.worse[1:], "worse", "undecided")],
            "BIC": [f"{bic:.1f}" for bic in self.bic],
        }

    def __str__(self) -> str:
        """Return the table of fits, the best first, and the verdicts below it."""
        title = f"{len(self.names)} models by their held-out error: {self.held_out}, held out one at a time"
        return as_text(title, self.columns, notes=self.notes)


def compare(fits: Mapping[str, Fit], *, progress: bool = False) -> ModelChoice:
    """Choose between several fits of the same photographs, or report that the choice is undecided.

    Leave-one-out cross-validation (Stone 1974): each photograph is held out in turn, each model is fitted to the
    others, starting at its fit, and predicts it. The mean square error penalises a term that only follows the noise.
    With one or two photographs, patches are held out that are wider than the correlation length of the best fit's
    residuals.

    A verdict needs all of these: the paired errors differ by 1.96 standard errors (jackknife); the fitted images differ
    by a tenth of the residuals; and they differ by half a grey level of 8 bits, all root mean square and for images in
    [0, 1]. A smaller difference may come from the lens, the lamp or the file.

    In renders, and in photographs with hardly any noise, the best fit's own errors show that they have no such
    difference: a fit whose error is ten times as large in every photograph or patch is worse, however small both are.
    Errors within the rounding of float32 count as none.

    Args:
        fits: Name to fit, two or more, all of the same views and with the same loss.
        progress: Show a progress line on the terminal.

    Returns:
        The fits, the best first, with the verdicts.

    Raises:
        ValueError: If there are fewer than two fits, or they differ in views, pixels, loss or treatment of clipping.
        TypeError: If `fits` does not map strings to fits.
    """
    check_kind("fits", fits, Mapping, "{'Phong': fit_a, 'Blinn': fit_b}")
    if len(fits) < 2:
        raise ValueError(
            f"compare needs at least two fits; got {len(fits)}. Give for example {{'Phong': a, 'Blinn': b}}."
        )
    for name, fit in fits.items():
        if not isinstance(name, str):
            raise TypeError(f"fits must have strings as names; got {name!r}. Give for example 'Phong'.")
        check_kind(f"fits['{name}']", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    names = sorted(fits)  # independent of the order of the mapping
    with (
        showing("compare", show=progress) as report_progress,
        in_float64(dict(fits)) as fits,
    ):
        for name in names[1:]:
            _check_comparable(names[0], fits[names[0]], name, fits[name])
        folds = make_folds(fits[min(names, key=lambda name: (fits[name].rmse, name))])
        scale = min(float(fits[name].likelihood.sigma) for name in names)
        scores = {
            name: cross_validate(
                fits[name].solved.laid_out(),
                folds,
                scale,
                lambda share, k=k: report_progress("holding out", (k + share) / len(names)),
            )
            for k, name in enumerate(names)
        }
    names.sort(key=lambda name: (scores[name].error, name))
    return _choice({name: fits[name] for name in names}, [scores[name] for name in names], folds)


def _choice(fits: Mapping[str, Fit], scores: Sequence[Scores], folds: Parts) -> ModelChoice:
    """Return the verdicts on fits, of which the first has the least error."""
    best, n = scores[0], len(folds)
    pairs = [paired_difference(of.squares - best.squares, best.samples) for of in scores]
    differences, their_errors = (np.array(column) for column in zip(*pairs, strict=True))
    rmse, apart = _residuals_and_differences([*fits.values()])
    ratios = np.array([least_ratio(of, best) for of in scores])
    visible = apart >= max(SMALL * rmse[0], HALF_LEVEL)
    number = np.array([count_determined(fit) for fit in fits.values()])
    found = ModelChoice(
        names=tuple(fits),
        errors=np.sqrt([of.error for of in scores]),
        rmse=rmse,
        unknowns=number,
        differences=differences,
        difference_errors=their_errors,
        image_differences=apart,
        worse=((differences > 0) & (differences >= GAUSS_95 * their_errors) & visible) | (ratios >= MIN_RATIO),
        bic=n * np.log(np.maximum(rmse**2, 1e-300)) + number * np.log(n),
        folds=n,
        held_out=folds.words,
        notes=(),
    )
    verdicts = [verdict(found, i, float(ratio)) for i, ratio in enumerate(ratios) if i]
    return replace(found, notes=(*verdicts, *_remarks(found, fits, scores, by_view=folds.by_view)))


def _residuals_and_differences(fits: Sequence[Fit]) -> Float[np.ndarray, "2 fits"]:
    """Return the root mean squares of each fit's residuals, and of how its images differ from the first one's."""
    squares, number = np.zeros((2, len(fits))), 0
    for i, samples in enumerate(fits[0].solved.problem.data.samples):
        if len(samples.pixels):  # a view that repeats an earlier one has none
            seen = [fit.predict(fit.views[i]) for fit in fits]
            counts = seen[0].counts
            squares[0] += [np.sum(of.difference**2) for of in seen]
            squares[1] += [np.sum((of.image - seen[0].image)[counts] ** 2) for of in seen]
            number += counts.sum()
    return np.sqrt(squares / number)


def _check_comparable(one: str, a: Fit, other: str, b: Fit) -> None:
    """Refuse fits of different photographs or pixels, or with different weights. Runs in float64."""
    both = f"fits['{one}'] and fits['{other}']"
    if len(a.views) != len(b.views):
        raise ValueError(f"{both} must be of the same views; got {len(a.views)} and {len(b.views)}. Fit both to all.")
    for i, (v, w) in enumerate(zip(a.views, b.views, strict=True)):
        for what in ("image", "mask", "saturation", "floor", "noise"):
            if not eqx.tree_equal(getattr(v, what), getattr(w, what)):
                raise ValueError(
                    f"{both} must be of the same views; views[{i}] differs in its {what}. Fit both to the same views."
                )
    for what, x, y in (("loss", a.likelihood.loss, b.likelihood.loss), ("clipped", a.clipped, b.clipped)):
        if x != y:
            raise ValueError(f"{both} must have the same {what}; got '{x}' and '{y}'. Fit both with one of them.")
    for i, (s, t) in enumerate(zip(a.solved.problem.data.samples, b.solved.problem.data.samples, strict=True)):
        if not np.array_equal(s.pixels, t.pixels):
            raise ValueError(
                f"{both} must use the same pixels; in views[{i}] they use {len(s.pixels):,} and {len(t.pixels):,}. "
                "Give the view a mask inside both silhouettes."
            )


def count_determined(fit: Fit) -> int:
    """Return how many parameters a fit determines."""
    return int(np.sum(fit.evidence.regular & ~fit.at_bound)) - len(fit.evidence.units)


def paired_difference(
    difference: Float[np.ndarray, " folds"], count: Float[np.ndarray, " folds"]
) -> tuple[float, float]:
    """Return the mean of paired sums over all samples, and its standard error by jackknife over the folds.

    It is the jackknife of a ratio (Efron and Tibshirani 1993, ch. 11); for folds of one size, that of a mean.
    """
    without = (difference.sum() - difference) / (count.sum() - count)
    return float(difference.sum() / count.sum()), float(jackknife_error(without))


def least_ratio(one: Scores, best: Scores) -> float:
    """Return the least ratio of the errors of a model to those of the best one, of all folds; 0 if all are rounding."""
    rounding = best.rounding * best.samples
    told = one.squares >= MIN_RATIO**2 * rounding
    if not told.any():
        return 0.0
    return float(np.sqrt(np.min(one.squares[told] / np.maximum(best.squares, rounding)[told])))


def verdict(choice: ModelChoice, i: int, ratio: float) -> str:
    """Return whether a model is worse than the best, or why this is undecided; `ratio` is that of `least_ratio`."""
    best, other, rmse, apart = choice.names[0], choice.names[i], choice.rmse[0], choice.image_differences[i]
    difference, error = choice.differences[i], choice.difference_errors[i]
    times = difference / error if error > 0 else np.inf if difference > 0 else 0.0
    if choice.worse[i] and ratio >= MIN_RATIO:
        return (
            f"{best} predicts held-out samples better than {other}, whose errors are at least {ratio:.2g} times as "
            "large, whatever is held out."
        )
    if choice.worse[i]:
        return (
            f"{best} predicts held-out samples better than {other}: the mean square errors differ by {times:.1f} "
            f"standard errors, and the fitted images by {apart:.2g}, with residuals of {rmse:.2g}."
        )
    why = []
    if times < GAUSS_95:
        why.append(f"their mean square errors differ by {times:.1f} standard errors; a verdict needs {GAUSS_95:g}")
    if apart < HALF_LEVEL:
        why.append(f"their fitted images differ by {apart:.2g}, less than half a grey level, {HALF_LEVEL:.2g}")
    elif apart < SMALL * rmse:
        why.append(f"their fitted images differ by {apart:.2g}, less than {SMALL:.0%} of the residuals, {rmse:.2g}")
    return f"undecided between {best} and {other}: {'; '.join(why)}."


def _remarks(choice: ModelChoice, fits: Mapping[str, Fit], scores: Sequence[Scores], *, by_view: bool) -> Iterator[str]:
    """Yield what limits the verdicts, and what BIC counts."""
    if not (by_view or choice.worse[1:].all()):
        yield "patches of so few photographs do not decide between the models. Add photographs under other lights."
    of_fits = sorted(zip(choice.names, fits.values(), scores, strict=True), key=lambda of: of[0])
    if held := dict.fromkeys(quantity for _, _, of in of_fits for quantity in of.held):
        yield f"{listing(list(held))}, determined by one view only, kept the fitted value when that view was held out."
    if failed := [name for name, fit, of in of_fits if not (of.converged and fit.converged)]:
        yield f"a fit of {listing(failed)} did not converge, so its held-out error may be too large."
    yield (
        f"BIC = n log(fitted^2) + unknowns log n, with n = {choice.folds} folds and not the samples, which are "
        "correlated; the verdicts do not use it."
    )

"""Model choice: which of several fits predicts held-out photographs best, or that this is undecided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import in_float64
from ..core.fields import check_kind
from ..core.progress import showing
from ..core.words import listing
from ..inverse.data.views import is_grey
from ..inverse.laid_out import LaidOut
from ..inverse.result import Fit
from .cross_validation import Folds, Scores, cross_validate, make_folds

ERRORS = 2.0  # jackknife errors: the least difference of mean square errors for a verdict
SHARE = 0.1  # the least difference of the fitted images for a verdict, over the residuals
TIMES = 1.0 / SHARE  # the least ratio of the errors in every fold for a verdict by this ratio alone
GREY_LEVEL = 1.0 / 255.0  # half a grey level is the least visible difference in a file of 8 bits


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

    def __str__(self) -> str:
        """Return the table of fits, the best first, and the verdicts below it."""
        wide = max(len("model"), *map(len, self.names))
        lines = [
            f"{len(self.names)} models by their held-out error: {self.held_out}, held out one at a time",
            f"{'model':<{wide}} {'unknowns':>8} {'held out':>10} {'fitted':>10} {'difference of MSE':>22} {'BIC':>10}",
        ]
        for i, name in enumerate(self.names):
            difference = f"{self.differences[i]:.2e} +- {self.difference_errors[i]:.1e}" if i else "-"
            lines.append(
                f"{name:<{wide}} {self.unknowns[i]:>8d} {self.errors[i]:>10.4g} {self.rmse[i]:>10.4g} {difference:>22} "
                f"{self.bic[i]:>10.1f}"
            )
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


def compare(fits: Mapping[str, Fit], *, progress: bool = False) -> ModelChoice:
    """Choose between several fits of the same photographs, or report that the choice is undecided.

    Leave-one-out cross-validation (Stone 1974): each photograph is held out in turn, each model is fitted to the
    others, starting at its fit, and predicts it. The mean square error penalises a term that only follows the noise.
    With one or two photographs, patches are held out that are wider than the correlation length of the best fit's
    residuals.

    A verdict needs all of these: the paired errors differ by two standard errors (jackknife); the fitted images differ
    by a tenth of the residuals; and they differ by half a grey level of 8 bits, all root mean square and for images in
    [0, 1]. A smaller difference may come from the lens, the lamp or the file.

    In renders, and in photographs with hardly any noise, the best fit's own errors show that no such thing is in them:
    a fit whose error is ten times as large in every photograph or patch is worse, however small both are. Errors
    within the rounding of float32 count as none.

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
    for name in names[1:]:
        _check_same_photographs(names[0], fits[names[0]], name, fits[name])
    with (
        showing("compare", show=progress) as report_progress,
        in_float64(dict(fits)) as fits,
    ):
        laid = {name: fits[name].solved.laid_out() for name in names}
        for name in names[1:]:
            _check_same_pixels(names[0], laid[names[0]], name, laid[name])
        tightest = min(names, key=lambda name: (fits[name].rmse, name))
        folds = make_folds(fits[tightest])
        scale = min(float(fits[name].likelihood.sigma) for name in names)
        scores = {
            name: cross_validate(
                laid[name], folds, scale, lambda share, k=k: report_progress("holding out", (k + share) / len(names))
            )
            for k, name in enumerate(names)
        }
        errors = {name: float(s.squares.sum() / s.samples.sum()) for name, s in scores.items()}
        names.sort(key=lambda name: (errors[name], name))
        best = scores[names[0]]
        image_differences = np.array([_image_difference(scores[name], best) for name in names])
    pairs = [paired_difference(scores[name].squares - best.squares, best.samples) for name in names]
    rmse = np.array([scores[name].rmse for name in names])
    differences, their_errors = (np.array(column) for column in zip(*pairs, strict=True))
    visible = image_differences >= max(SHARE * rmse[0], 0.5 * GREY_LEVEL)
    ratios = np.array([least_ratio(scores[name], best) for name in names])
    worse = ((differences > 0) & (differences >= ERRORS * their_errors) & visible) | (ratios >= TIMES)
    number = np.array([count_determined(fits[name]) for name in names])
    bic = folds.count * np.log(np.maximum(rmse**2, 1e-300)) + number * np.log(folds.count)
    notes = [
        *(
            verdict(names, i, differences, their_errors, image_differences, rmse, worse, ratios)
            for i in range(1, len(names))
        ),
        *_of_few_views(folds, worse),
        *_of_single_views(names, scores),
        *_of_convergence(names, scores, fits),
        f"BIC = n log(fitted^2) + unknowns log n, with n = {folds.count} folds and not the samples, which are "
        "correlated; the verdicts do not use it.",
    ]
    return ModelChoice(
        tuple(names),
        np.sqrt([errors[name] for name in names]),
        rmse,
        number,
        differences,
        their_errors,
        image_differences,
        worse,
        bic,
        folds.count,
        folds.words,
        tuple(notes),
    )


def _check_same_photographs(one: str, a: Fit, other: str, b: Fit) -> None:
    """Refuse fits of different photographs, or with different weights."""
    both = f"fits['{one}'] and fits['{other}']"
    if len(a.views) != len(b.views):
        raise ValueError(f"{both} must be of the same views; got {len(a.views)} and {len(b.views)}. Fit both to all.")
    for i, (v, w) in enumerate(zip(a.views, b.views, strict=True)):
        fields = [(name, getattr(v, name), getattr(w, name)) for name in ("image", "mask", "saturation", "floor")]
        fields += [("channels", is_grey(v), is_grey(w)), ("noise", *map(_numbers, (v.noise, w.noise)))]
        for what, x, y in fields:
            if (x is None) != (y is None) or not (x is None or np.array_equal(x, y)):
                raise ValueError(
                    f"{both} must be of the same views; views[{i}] differs in its {what}. Fit both to the same views."
                )
    for what, x, y in (("loss", a.likelihood.loss, b.likelihood.loss), ("clipped", a.clipped, b.clipped)):
        if x != y:
            raise ValueError(f"{both} must have the same {what}; got '{x}' and '{y}'. Fit both with one of them.")


def _numbers(noise: Any) -> np.ndarray | None:
    return None if noise is None else np.array(jax.tree.leaves(noise), float)


def _check_same_pixels(one: str, a: LaidOut, other: str, b: LaidOut) -> None:
    """Refuse fits that use different pixels, because of other surfaces, cameras or clipping."""
    for i, (s, t) in enumerate(zip(a.problem.data.samples, b.problem.data.samples, strict=True)):
        if not np.array_equal(s.pixels, t.pixels):
            raise ValueError(
                f"fits['{one}'] and fits['{other}'] must use the same pixels; in views[{i}] they use "
                f"{len(s.pixels):,} and {len(t.pixels):,}. Give the view a mask inside both silhouettes."
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
    G = len(count)
    without = (difference.sum() - difference) / (count.sum() - count)
    error = np.sqrt((G - 1) / G * np.sum((without - without.mean()) ** 2))
    return float(difference.sum() / count.sum()), float(error)


def least_ratio(one: Scores, best: Scores) -> float:
    """Return the least ratio of the errors of a model to those of the best one, of all folds; 0 if all are rounding."""
    rounding = best.rounding * best.samples
    told = one.squares >= TIMES**2 * rounding
    if not told.any():
        return 0.0
    return float(np.sqrt(np.min(one.squares[told] / np.maximum(best.squares, rounding)[told])))


def _image_difference(one: Scores, other: Scores) -> float:
    """Return the root mean square difference of two fitted images where samples count."""
    squares = 0.0
    for c in range(len(one.chunks)):
        (a, weight), (b, _) = one.predicted(c), other.predicted(c)
        squares += float(np.sum(((a - b) ** 2)[weight > 0]))
    return float(np.sqrt(squares / one.samples.sum()))


def verdict(
    names: Sequence[str],
    i: int,
    differences: np.ndarray,
    errors: np.ndarray,
    image_differences: np.ndarray,
    rmse: np.ndarray,
    worse: np.ndarray,
    ratios: np.ndarray,
) -> str:
    """Return whether a model is worse than the best, or why this is undecided."""
    best, other, apart = names[0], names[i], image_differences[i]
    times = differences[i] / errors[i] if errors[i] > 0 else np.inf if differences[i] > 0 else 0.0
    if worse[i] and ratios[i] >= TIMES:
        return (
            f"{best} predicts held-out samples better than {other}, whose errors are at least {ratios[i]:.2g} times as "
            "large, whatever is held out."
        )
    if worse[i]:
        return (
            f"{best} predicts held-out samples better than {other}: the mean square errors differ by {times:.1f} "
            f"standard errors, and the fitted images by {apart:.2g}, with residuals of {rmse[0]:.2g}."
        )
    why = []
    if not differences[i] >= ERRORS * errors[i] or differences[i] <= 0:
        why.append(f"their mean square errors differ by {times:.1f} standard errors; a verdict needs {ERRORS:g}")
    if apart < 0.5 * GREY_LEVEL:
        why.append(f"their fitted images differ by {apart:.2g}, less than half a grey level, {0.5 * GREY_LEVEL:.2g}")
    elif apart < SHARE * rmse[0]:
        why.append(f"their fitted images differ by {apart:.2g}, less than {SHARE:.0%} of the residuals, {rmse[0]:.2g}")
    return f"undecided between {best} and {other}: {'; '.join(why)}."


def _of_few_views(folds: Folds, worse: np.ndarray) -> list[str]:
    """Return a remedy if patches leave the choice undecided."""
    if folds.by_view or worse[1:].all():
        return []
    return ["patches of so few photographs do not decide between the models. Add photographs under other lights."]


def _of_single_views(names: Sequence[str], scores: Mapping[str, Scores]) -> list[str]:
    """Name what was held when the only view that determines it was held out."""
    held = list(dict.fromkeys(quantity for name in sorted(names) for quantity in scores[name].held))
    if not held:
        return []
    return [f"{listing(held)}, determined by one view only, kept the fitted value when that view was held out."]


def _of_convergence(names: Sequence[str], scores: Mapping[str, Scores], fits: Mapping[str, Fit]) -> list[str]:
    """Name the models with a fit that did not converge."""
    failed = [name for name in sorted(names) if not (scores[name].converged and fits[name].converged)]
    if not failed:
        return []
    return [f"a fit of {listing(failed)} did not converge, so its held-out error may be too large."]

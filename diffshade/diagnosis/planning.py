"""Planning: which photograph to take next, by the errors that a fit would have with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import in_float64
from ..core.fields import check, check_kind
from ..core.progress import showing
from ..core.tables import as_text
from ..core.thresholds import MINOR
from ..core.words import count, did_you_mean, listing
from ..inverse.result import Fit
from ..inverse.statistics.evidence import Evidence
from ..inverse.statistics.identifiability import null_directions, relative_errors, some_channels, vague
from ..inverse.statistics.uncertainty import SINGULAR, Matrix, Vector, scaled
from ..inverse.unknowns.names import is_named
from ..inverse.unknowns.unknown import Unknown, by_quantity
from ..model.scenes import as_tuple
from .shots import Shot, information_of_shot, unknowns_of_lamp


@dataclass(frozen=True, eq=False)
class Plan:
    """The errors to expect with each photograph that could be taken; `print` it for the table.

    Every array is NumPy float64.
    """

    shots: tuple[Shot, ...] = field(repr=False)
    names: tuple[str, ...]
    """The name of each shot: its own, or its index."""
    order: tuple[int, ...]
    """The indices of the shots, best first."""
    unknowns: tuple[Unknown, ...] = field(repr=False)
    values: Float[np.ndarray, " p"]
    scales: Float[np.ndarray, " p"]
    """The scale that each value may be small against, as in the fit."""
    now: Float[np.ndarray, " p"]
    """Standard errors of the fit for independent noise; infinite where a value is not determined."""
    errors: Float[np.ndarray, "shots p"]
    """The standard errors to expect with each shot added to the views."""
    gain: Float[np.ndarray, " shots"]
    """What each shot adds to log det of the information, in relative units: all errors together shrink by
    e^(-gain/2)."""
    rank: Int[np.ndarray, " shots"]
    """How many directions each shot determines that the views do not."""
    clipped: Float[np.ndarray, " shots"]
    """The fraction of each shot's pixels that the sensor would clip; they do not count."""
    aim: Bool[np.ndarray, " p"]
    """The unknowns whose errors rank the shots; none if the shots are ranked by all errors together."""
    notes: tuple[str, ...]

    @property
    def best(self) -> Shot:
        """The shot to take first."""
        return self.shots[self.order[0]]

    @property
    def columns(self) -> dict[str, Any]:
        """The columns of the table, by their heads: what is known now, and the shots, the best first."""
        order, quantities = list(self.order), list(by_quantity(self.unknowns))
        errors = [self.cells(of, quantities) for of in (self.now, *self.errors[order])]
        columns: dict[str, Any] = {"shot": ["now", *(self.names[i] for i in order)]}
        columns |= dict(zip(quantities, zip(*errors, strict=True), strict=True))
        if self.rank.any():
            columns["new"] = ["", *self.rank[order]]
        columns["gain"] = ["", *(f"{gain:.2f}" for gain in self.gain[order])]
        return columns

    def __str__(self) -> str:
        """Return the table of shots, the best first, and the notes below it."""
        aim = listing(some_channels(self.aim, self.unknowns)) if self.aim.any() else ""
        by = f"the error of {aim}" if aim else "all errors together"
        title = f"plan of {count(len(self.shots), 'photograph')}, ranked by {by}: standard errors with each"
        return as_text(title, self.columns, notes=self.notes)

    def cells(self, errors: Vector, quantities: Sequence[str]) -> list[str]:
        """Return the largest error of each quantity.

        It is a percentage of the value, or an absolute error for a value without a scale; - marks an unknown that is
        not determined.
        """
        relative = relative_to_values(self.unknowns, self.values, errors, self.scales)
        members = by_quantity(self.unknowns)
        cells = []
        for quantity in quantities:
            worst = max(members[quantity], key=lambda j: errors[j] if relative[j] == 0 else relative[j])
            size = percent(relative[worst]) if relative[worst] > 0 else f"{errors[worst]:.2g}"
            cells.append(size if np.isfinite(errors[worst]) else "-")
        return cells


def plan(
    fit: Fit, shots: Sequence[Shot] | Shot, *, aim: Sequence[str] | str | None = None, progress: bool = False
) -> Plan:
    r"""Rank photographs that could be taken by the errors that the fit would have with each of them.

    $$ Cov = (F + J^T J / \sigma^2)^{-1} $$

    is the covariance to expect. F is the Fisher information of the views and J the Jacobian of the shot at the fitted
    scene (Fedorov 1972; Pukelsheim 1993), for independent noise of the fit's own size. Unknowns at a bound stay there.
    Only pixels count that show an object and that the first view's sensor would not clip. If the views leave something
    undetermined, the shots are ranked first by how many of these directions they determine.

    Args:
        fit: The fit of the photographs there are.
        shots: The photographs that could be taken, at least one.
        aim: Names of unknowns, as in `fit`. The shots are ranked by the expected relative error of these (the root mean
            square of several). By default they are ranked by the gain in log det of the information (D-optimal design).
        progress: Show a progress line on the terminal.

    Returns:
        The shots in order, with the errors to expect.

    Raises:
        ValueError: If there is no shot, a shot sees no object, or `aim` names no unknown of the fit.
        TypeError: If an argument has another type.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    shots = as_tuple(shots)
    if not shots:
        raise ValueError("plan needs at least one shot; got none. Give for example Shot(light=PointLight((0, 0, 3))).")
    for i, shot in enumerate(shots):
        check_kind(f"shots[{i}]", shot, Shot, "Shot(light=PointLight((0, 0, 3)))")
    check(shots)
    aimed = find_aim(fit.unknowns, aim)
    names = tuple(shot.name or f"shots[{i}]" for i, shot in enumerate(shots))
    added = []
    with (
        showing("plan", show=progress) as report_progress,
        in_float64((fit, shots)) as (own, own_shots),
    ):
        for i, (shot, name) in enumerate(zip(own_shots, names, strict=True)):
            report_progress(name, i / len(shots))
            added.append(information_of_shot(own, shot, name))
    # An unknown that is not determined is at a bound by chance only.
    evidence = dataclasses.replace(fit.evidence, at_bound=fit.at_bound & fit.evidence.regular)
    after = [add_shot(evidence, hessian) for hessian, _ in added]
    errors = np.array([e.plain_errors() for e in after])
    sizes = reference_sizes(fit)
    (rank_now, log_now), *found = (information(e, sizes) for e in (evidence, *after))
    ranks, logs = np.array(found).T
    rank, gain = ranks.astype(int) - rank_now, logs - log_now
    found = Plan(
        shots=shots,
        names=names,
        order=rank_shots(names, aimed, errors / sizes, rank, gain),
        unknowns=fit.unknowns,
        values=fit.values,
        scales=fit.scales,
        now=evidence.plain_errors(),
        errors=errors,
        gain=gain,
        rank=rank,
        clipped=np.array([clipped for _, clipped in added]),
        aim=aimed,
        notes=(),
    )
    return dataclasses.replace(found, notes=tuple(plan_notes(fit, found)))


def find_aim(unknowns: Sequence[Unknown], aim: Sequence[str] | str | None) -> Bool[np.ndarray, " p"]:
    """Return the unknowns that `aim` names; a name is any run of whole segments of a path, with or without channel."""
    found = np.zeros(len(unknowns), bool)
    for name in () if aim is None else as_tuple((aim,) if isinstance(aim, str) else aim):
        if not isinstance(name, str):
            raise TypeError(f"aim must hold names of unknowns; got {name!r}. Give for example 'n_s'.")
        named = np.array([is_named(name, unknown) for unknown in unknowns])
        if not named.any():
            known = {word for u in unknowns for word in (u.name, u.quantity, u.kind)}
            raise ValueError(f"aim names '{name}', which is not an unknown of this fit. {did_you_mean(name, known)}")
        found |= named
    return found


def add_shot(evidence: Evidence, hessian: Matrix) -> Evidence:
    """Return the evidence with one more cluster; its gradient is 0, since the expected image is the fitted one."""
    zero, directions = null_directions(evidence.total + hessian)
    return evidence.with_cluster(hessian, ~zero & ~directions.any(0))


def information(evidence: Evidence, sizes: Vector) -> tuple[int, float]:
    """Return the rank of the information about the unknowns inside their bounds, and its log det in relative units.

    For a singular matrix the log det uses the largest eigenvalues, as many as the rank.
    """
    inside = ~evidence.at_bound
    H = evidence.total[np.ix_(inside, inside)] / max(evidence.sigma2, 1e-300)
    A, lengths = scaled(H)
    w = np.linalg.eigvalsh(A)
    rank = int(np.sum(w > SINGULAR**2 * w.max(initial=0.0)))
    if rank == len(w):  # the scaled matrix has the better condition
        return rank, float(np.log(w).sum() + 2.0 * np.log(lengths * sizes[inside]).sum())
    largest = np.linalg.eigvalsh(H * np.outer(sizes[inside], sizes[inside]))[len(w) - rank :]
    return rank, float(np.log(np.maximum(largest, 1e-300)).sum())


def rank_shots(
    names: Sequence[str],
    aim: Bool[np.ndarray, " p"],
    relative: Float[np.ndarray, "shots p"],
    rank: Int[np.ndarray, " shots"],
    gain: Float[np.ndarray, " shots"],
) -> tuple[int, ...]:
    """Return the shots' indices, best first: by rank gained, then by the aim's relative error or else by log det.

    If the views determine everything, no shot gains rank. Values that differ by rounding alone are tied; ties are
    broken by name.
    """

    def key(i: int) -> tuple:
        undetermined, score = 0, -gain[i]
        if aim.any():
            known = np.isfinite(relative[i, aim])
            undetermined, score = int(np.sum(~known)), float(np.linalg.norm(relative[i, aim][known]))
        return (-int(rank[i]), undetermined, float(f"{score:.9g}"), names[i], i)

    return tuple(sorted(range(len(names)), key=key))


def reference_sizes(fit: Fit) -> Vector:
    """Return what each error is relative to (see `relative_errors`); 1 for a value without a scale."""
    share = relative_to_values(fit.unknowns, fit.values, np.ones(len(fit.values)), fit.scales)
    return np.where(share > 0, 1.0 / np.where(share > 0, share, 1.0), 1.0)


def relative_to_values(unknowns: Sequence[Unknown], values: Vector, errors: Vector, scales: Vector) -> Vector:
    """Return errors relative to their values; 0 for a bounded value that is 0 and so has no scale."""
    without_scale = (values == 0) & np.array([np.isfinite(u.lower) for u in unknowns])  # a vector's component has one
    nonzero = np.where(without_scale, 1.0, values)
    return np.where(without_scale, 0.0, relative_errors(unknowns, nonzero, errors, scales))


def plan_notes(fit: Fit, plan: Plan) -> Iterator[str]:
    """Yield the sentences below a plan's table."""
    best, now, then = plan.names[plan.order[0]], plan.now, plan.errors[plan.order[0]]

    def names_of(which: Bool[np.ndarray, " p"]) -> str:
        return listing(some_channels(which, plan.unknowns))

    new = ~np.isfinite(now) & np.isfinite(then)
    if new.any():
        yield f"{best} determines {names_of(new)}, which the views do not."
    both = np.isfinite(now) & np.isfinite(then) & (now > 0) & (plan.aim if plan.aim.any() else True)
    if both.any():
        ratio = float(np.exp(np.mean(np.log(then[both] / now[both]))))
        what = names_of(both) if plan.aim.any() else "what the views determine"
        yield f"with {best}, the errors of {what} are {ratio:.2g} times the present ones."
    never = np.array(~np.isfinite(plan.errors).any(0))
    if never.any():
        fix = "it" if never.sum() == 1 else "one"
        yield (
            f"none of these shots determines {names_of(never)} (-). Fix {fix}, or plan with other lights, distances or "
            "cameras."
        )
    elif not (np.isfinite(plan.errors).all() and np.isfinite(now).all()):
        yield "a dash marks an unknown that is not determined."
    lost = ~fit.determined & np.isfinite(then) & vague(plan.unknowns, plan.values, then, plan.scales)[0]
    if lost.any():
        yield f"even with {best}, {names_of(lost)} would be lost in the noise."
    if plan.rank.any():
        yield "'new' counts the directions that a shot determines and the views do not; such shots rank first."
    for i in plan.order:
        if plan.clipped[i] > MINOR:
            yield (
                f"{plan.names[i]} would have {plan.clipped[i]:.0%} of its pixels clipped; they do not count. Give it a "
                "shorter exposure."
            )
    if own := _own_numbers(fit, plan.shots):
        yield f"assumed known for each shot, though unknown in the views: {listing(own)}."
    yield "errors assume independent noise as large as the fit's; use them only to compare shots with each other."


def _own_numbers(fit: Fit, shots: Sequence[Shot]) -> list[str]:
    """Name the parameters that differ from lamp to lamp, or from view to view: a shot's own are taken as known."""
    lamps = [unknowns_of_lamp(fit, shot.light) for shot in shots if shot.light is not None]
    own = {place.path for lamp in lamps for place, unknowns in lamp.items() if len(unknowns) > 1}
    own |= {f"{u.kind} of a view" for u in fit.unknowns if any(place.owner == "views" for place in u.places)}
    return sorted(own)


def percent(share: float) -> str:
    """Return a fraction as a percentage of about two digits."""
    size = 100.0 * share
    return f"{size:.2g} %" if size < 99.5 else f"{size:.0f} %" if size < 1e6 else f"{size:.0e} %"

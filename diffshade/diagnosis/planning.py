"""Planning: which photograph to take next, by the errors that a fit would have with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import in_float64
from ..core.fields import check, check_kind
from ..core.progress import showing
from ..core.words import count, did_you_mean, listing
from ..inverse.result import Fit
from ..inverse.statistics.identifiability import some_channels
from ..inverse.statistics.uncertainty import Vector
from ..inverse.unknowns.unknown import Unknown
from ..model.scenes import as_tuple
from .plan_notes import Ranked, plan_notes
from .shot_ranking import add_shot, information, rank_shots, relative_to_values
from .shots import Shot, information_of_shot


@dataclass(frozen=True, eq=False)
class Plan:
    """The errors to expect with each photograph that could be taken; `print` it for the table.

    Every array is NumPy float64.
    """

    shots: tuple[Shot, ...]
    names: tuple[str, ...]
    """The name of each shot: its own, or its index."""
    order: tuple[int, ...]
    """The indices of the shots, best first."""
    unknowns: tuple[Unknown, ...]
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

    def __str__(self) -> str:
        """Return the table of shots, the best first, and the notes below it."""
        quantities = list(dict.fromkeys(u.quantity for u in self.unknowns))
        ranked = self.rank.any()
        head = ["", "shot", *quantities, *(["new"] if ranked else []), "gain"]
        rows = [head, ["", "now", *self.cells(self.now, quantities), *([""] if ranked else []), ""]]
        for place, i in enumerate(self.order):
            new = [f"{self.rank[i]:d}"] if ranked else []
            rows.append(
                [str(place + 1), self.names[i], *self.cells(self.errors[i], quantities), *new, f"{self.gain[i]:.2f}"]
            )
        widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
        lines = [
            "  ".join(
                cell.ljust(w) if k < 2 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
            for row in rows
        ]
        aim = listing(some_channels(self.aim, self.unknowns)) if self.aim.any() else ""
        by = f"the error of {aim}" if aim else "all errors together"
        title = f"plan of {count(len(self.shots), 'photograph')}, ranked by {by}: standard errors with each"
        return "\n".join([title, *(line.rstrip() for line in lines), *(f"- {note}" for note in self.notes)])

    def cells(self, errors: Vector, quantities: Sequence[str]) -> list[str]:
        """Return the largest error of each quantity.

        It is a percentage of the value, or an absolute error for a value without a scale; - marks an unknown that is
        not determined.
        """
        relative = relative_to_values(self.unknowns, self.values, errors, self.scales)
        cells = []
        for quantity in quantities:
            members = [j for j, u in enumerate(self.unknowns) if u.quantity == quantity]
            worst = max(members, key=lambda j: errors[j] if relative[j] == 0 else relative[j])
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
    measured = []
    with (
        showing("plan", show=progress) as report_progress,
        in_float64((fit, shots)) as (own, own_shots),
    ):
        for i, (shot, name) in enumerate(zip(own_shots, names, strict=True)):
            report_progress(name, i / len(shots))
            measured.append(information_of_shot(own, shot, name))
    # An unknown that is not determined is at a bound by chance only.
    evidence = dataclasses.replace(fit.evidence, at_bound=fit.at_bound & fit.evidence.regular)
    after = [add_shot(evidence, of_shot.hessian) for of_shot in measured]
    now = evidence.plain_errors()
    errors = np.array([e.plain_errors() for e in after])
    rank_now, log_now = information(fit, evidence)
    ranks, logs = (np.array(of) for of in zip(*(information(fit, e) for e in after), strict=True))
    rank, gain = ranks - rank_now, logs - log_now
    order = rank_shots(fit, names, aimed, errors, rank, gain)
    clipped = np.array([of_shot.clipped for of_shot in measured])
    notes = plan_notes(Ranked(fit, shots, names, order, aimed, now, errors, rank, clipped))
    return Plan(
        shots, names, order, fit.unknowns, fit.values, fit.scales, now, errors, gain, rank, clipped, aimed, tuple(notes)
    )  # fmt: skip


def find_aim(unknowns: Sequence[Unknown], aim: Sequence[str] | str | None) -> Bool[np.ndarray, " p"]:
    """Return the unknowns that `aim` names; a name is any run of whole segments of a path, with or without channel."""
    found = np.zeros(len(unknowns), bool)
    for name in () if aim is None else as_tuple((aim,) if isinstance(aim, str) else aim):
        if not isinstance(name, str):
            raise TypeError(f"aim must hold names of unknowns; got {name!r}. Give for example 'n_s'.")
        named = np.array([_is_named(name, unknown) for unknown in unknowns])
        if not named.any():
            known = {word for u in unknowns for word in (u.name, u.quantity, u.kind)}
            raise ValueError(f"aim names '{name}', which is not an unknown of this fit. {did_you_mean(name, known)}")
        found |= named
    return found


def _is_named(name: str, unknown: Unknown) -> bool:
    channel = unknown.name[len(unknown.quantity) :]  # .r of k_d.r
    paths = [unknown.name, *(f"{path}{channel}" for path, _ in unknown.places)]
    return any(f".{name}." in f".{path}." for path in paths)


def percent(share: float) -> str:
    """Return a fraction as a percentage of about two digits."""
    size = 100.0 * share
    return f"{size:.2g} %" if size < 99.5 else f"{size:.0f} %" if size < 1e6 else f"{size:.0e} %"

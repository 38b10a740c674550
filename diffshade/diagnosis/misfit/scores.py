"""Scores: which faults of the table the residuals show, each to first order or refitted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ...inverse.unknowns.unknown import coordinate_slopes
from .changes import Case, Move
from .found import Fault, Found
from .linearised import Linearised, linearise
from .score_tests import FALSE_ALARM, Score, ScoreTests

MAX_STEPS = 8  # of a fault's amount
MIN_DECREASE = 1e-3  # relative decrease of the cost below which a refit stops


def scored(at: Linearised, faults: Iterable[Fault], named: Sequence[Found] = ()) -> list[Found]:
    """Return the faults that the residuals show, to first order: significant, and of a plausible size.

    Args:
        at: Where to score them.
        faults: Those to score.
        named: Faults already found; others count with what these cannot explain.
    """
    tests, found = ScoreTests(at.rows, [f.change for f in named]), []
    for fault in faults:
        for case, change in _changes(at, fault):
            score = tests.test(change)
            if score is not None and score.p_value < FALSE_ALARM:
                one = _found(at, fault, case, change, score)
                found += [one] if fault.plausible[0] < one.size < fault.plausible[1] else []
    return found


def refitted(at: Linearised, found: Found) -> Found:
    """Return a fault at its best amount, beyond first order, if it moves numbers of the set-up; else as it is.

    Each step of its amount is followed by a minimisation over the fit's unknowns.
    """
    before, state, key = at.state, at.state, (found.fault.kind, found.which)
    for _ in range(MAX_STEPS):
        case, change = next((case, x) for case, x in _changes(at, found.fault) if case.which == found.which)
        if not isinstance(case.change, Move) or (score := ScoreTests(at.rows).test(change)) is None:
            break
        theta = state.theta.copy()
        theta[at.set_up.inside] -= score.moves
        amounts = {**state.amounts, key: state.amounts.get(key, 0.0) + score.amount}
        then = at.set_up.minimise(case.change.along(theta, score.amount), state.excluded, amounts)
        less = state.share(then)
        if less <= 0.0:
            break
        state = then
        if less < MIN_DECREASE:
            break
        at = linearise(at.set_up, state)
    if state is before:
        return found
    return replace(
        found,
        amount=state.amounts[key],
        share=before.share(state),
        own_share=before.share(state, found.views),
        moves=before.fit.values - state.fit.values,
        after=state,
    )


def _changes(at: Linearised, fault: Fault) -> list[tuple[Case, np.ndarray]]:
    """Return the cases of a fault with the change of each sample by it, where that is linear and finite."""
    if fault.kind not in at.changes:
        cases = [] if fault.cases is None else list(fault.cases(at))
        all_of_it = [c.change.rows @ at.jacobian if isinstance(c.change, Move) else c.change for c in cases]
        changes = [x if fault.at_rims else np.where(at.at_rims, 0.0, x) for x in all_of_it]
        at.changes[fault.kind] = [(c, x) for c, x in zip(cases, changes, strict=True) if np.isfinite(x).all()]
    return at.changes[fault.kind]


def _found(at: Linearised, fault: Fault, case: Case, change: np.ndarray, score: Score) -> Found:
    fit, costs = at.set_up.fit, at.state.costs
    views = tuple(range(len(costs))) if case.views is None else case.views
    moves = np.zeros(len(fit.values))
    moves[at.set_up.inside] = score.moves
    share = score.gain / at.count
    own_share = share * float(costs.sum() / costs[list(views)].sum())
    moves /= coordinate_slopes(fit.values, fit.unknowns)
    return Found(fault, fit, case.which, views, share, own_share, score.amount, moves, change)

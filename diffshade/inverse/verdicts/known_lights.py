"""Known lights: what their stated errors add to the errors of the values, where they are not fitted.

The fit is repeated under lights that are moved by their errors, one way and the opposite way (a parametric bootstrap,
Efron and Tibshirani 1993, section 6.5). The root mean square change holds what a derivative does not: moved highlights
that are fitted as one are wider, whichever way they moved.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...core.progress import ReportProgress
from ...core.thresholds import MOST
from ...core.words import Note, listing
from ...model.scenes import Scene
from ..result import Fit
from ..unknowns.places import Place
from ..unknowns.unknown import free_places, values_at

PAIRS = 16  # of fits, each to lights moved one way and the opposite way


def widen_by_lights(fit: Fit, report_progress: ReportProgress, *, errors: Mapping[Place, float]) -> Fit:
    """Return a fit whose errors are at least those that the errors of its known lights give. In float64."""
    free = free_places(fit.unknowns)
    known = {place: error for place, error in errors.items() if error > 0.0 and place not in free}
    if not known:
        return fit
    draws = _draws(4 * len(fit.scene.lights))
    changes = np.zeros((PAIRS, 2, len(fit.values)))
    for pair in range(PAIRS):
        report_progress("errors of the lights", pair / PAIRS)
        draw = draws[pair].reshape(-1, 4)
        for side, sign in enumerate((1.0, -1.0)):
            under = fit.solved.changed(scene=_moved(fit.scene, known, sign * draw))
            end = under.laid_out().minimise(rtol=1e-8)
            changes[pair, side] = values_at(end.theta, fit.unknowns) - fit.values
    from_lights = np.sqrt(np.mean(changes**2, (0, 1)))
    # the views' own scatter, where the errors are made of it, holds the lights' already
    whole = np.where(fit.determined, np.maximum(fit.errors, np.hypot(fit.plain_errors, from_lights)), fit.errors)
    return dataclasses.replace(fit, errors=whole, notes=(*fit.notes, *_notes(fit, from_lights, changes.mean((0, 1)))))


def _moved(scene: Scene, errors: Mapping[Place, float], draw: Float[np.ndarray, "lights 4"]) -> Scene:
    """Return the scene with its lights moved by their errors times numbers drawn from N(0, 1)."""
    moved = []
    for place, error in errors.items():
        value, (*aside, brighter) = np.asarray(place.value_in(scene, ()), np.float64), draw[place.item or 0]
        if place.field == "intensity":
            moved.append(value * np.exp(error * brighter))
        else:
            far = np.linalg.norm(value) if place.field == "direction" else 1.0  # the error is that of the unit vector
            moved.append(value + far * error * np.array(aside))
    return eqx.tree_at(lambda of: [place.value_in(of, ()) for place in errors], scene, moved)


def _draws(count: int) -> Float[np.ndarray, "pairs count"]:
    """Return numbers like those drawn from N(0, 1), with pairs, or else numbers, that are exactly uncorrelated."""
    u, _, v = np.linalg.svd(np.random.default_rng(0).standard_normal((PAIRS, count)), full_matrices=False)
    return np.sqrt(max(PAIRS, count)) * (u @ v)


def _notes(fit: Fit, from_lights: np.ndarray, shift: np.ndarray) -> list[Note]:
    quantities = [unknown.quantity for unknown in fit.unknowns]

    def named(which: np.ndarray) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for name, here in zip(quantities, which & fit.determined, strict=True) if here))

    large = named(from_lights**2 > MOST * np.maximum(fit.errors, from_lights) ** 2)
    most = f": most of those of {listing(large)}" if large else ""
    found = [Note(f"the errors hold the stated errors of the lights, which are not fitted{most}.", "lights", large)]
    if moved := named(np.abs(shift) > np.maximum(fit.plain_errors, 0.5 * from_lights)):
        text = (
            f"lights that are off by their stated errors change {listing(moved)} to one side, and may have done so "
            "here. Free the lights' directions or positions, which then have these errors as their prior."
        )
        found.append(Note(text, "lights", moved))
    return found

"""Wrong set-ups: which fault of camera, file, highlight, sphere or lights the residuals show, and what it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.words import listing
from ...inverse.result import Fit
from ...inverse.statistics.uncertainty import Vector
from ...inverse.unknowns.unknown import coordinate_slopes, values_at
from ...model.materials import Blinn
from ...model.surfaces import Sphere
from .faults import BLURS, Direction, Linearised, Mask, linearised
from .leftovers import Leftovers, neighbours_of
from .score_tests import Score, ScoreTests

FALSE_ALARM = 1e-4  # of the test of one fault
EXPLAINED = 0.5  # of the structure in the residuals, that a fault explains at least
RIVAL = 0.5  # of the best fault's gain, from which another may be meant as well
BESIDE = 0.25  # of the best fault's gain, that a second one explains at least
FAULTS = 3  # named at most
MOVES, CORRUPTS = 1.0, 2.0  # errors, by which a fault moves a number: to be named, and for the number to be withdrawn
GROSS = 0.2  # of the cost, from which a fault is named whatever it moves to first order
SIMPLER = 0.5  # of what the radius leaves over, which the centre in its place must explain
NEARLY = 0.85  # of the centre's gain, with which the radius is named in its place
CERTAIN = 5.0  # standard deviations of the structure in the residuals, from which a far fault is searched for
DARKEST, STEEPEST, WIDEST = 0.9, 0.7, 4.0  # vignetting, gamma less 1, and a blur in pixels, at most
LOBES = (0.4, 1.7)  # between what the amount of another lobe lies that is one


@dataclass(frozen=True, eq=False)
class WrongSetUp:
    """A fault of the set-up that the residuals show."""

    kind: str
    share: float
    """Which part of the cost it explains."""
    sentence: str
    withdrawn: tuple[str, ...]
    """The names of the numbers that it, or a fault that looks alike, moves by more than two of their errors."""


@dataclass(frozen=True, eq=False)
class _Found:
    direction: Direction
    amount: Vector
    share: float
    moves: Vector
    """Of the values, in their own units."""


def wrong_set_ups(fit: Fit, out: Sequence[Mask | None] | None = None) -> list[WrongSetUp]:
    """Return the faults that the residuals show and that move a number which the fit determines. In float64.

    Each is a score test, so that none needs a fit of its own; only where the residuals are far from noise, and no small
    fault explains them, a sphere's place is searched for. `out`: for each view the pixels that do not count.
    """
    at_end = linearised(fit, out)
    left = neighbours_of(fit, out)
    found, rivals = _greedy(fit, at_end, left)
    rounded = fit.evidence.waves is not None  # which makes neighbours alike
    if left.errors > CERTAIN and not rounded and sum(f.share for f in found) < 0.8 * left.least:
        far = _far(fit, at_end, left)
        if far is not None and far.share > sum(f.share for f in found):
            found, rivals = [far], [f for f in (*found, *rivals) if f.share > RIVAL * far.share]
    elif found and found[0].direction.along:
        again = _searched(fit, at_end, found[0].direction)
        found, rivals = ([again, *found[1:]], [found[0], *rivals]) if again.share > found[0].share else (found, rivals)
    sizes = [np.abs(f.moves) / fit.errors for f in (*found, *rivals)]
    corrupted = fit.determined & (np.max([np.zeros(len(fit.values)), *sizes], 0) > CORRUPTS)
    withdrawn = tuple(name for name, here in zip(fit.names, corrupted, strict=True) if here)
    return [WrongSetUp(f.direction.kind, f.share, _sentence(fit, f), withdrawn) for f in found]


def _greedy(fit: Fit, at_end: Linearised, left: Leftovers) -> tuple[list[_Found], list[_Found]]:
    """Return the faults that explain most, each beside those before it, and the rivals of the first."""
    found: list[_Found] = []
    rivals: list[_Found] = []
    while len(found) < FAULTS:
        tests = ScoreTests(at_end.rows, [f.direction.change for f in found])
        scores = [(d, s) for d in at_end.directions if (s := tests.test(d.change)) is not None]
        seen = [_found(fit, at_end, d, s) for d, s in scores if s.p_value < FALSE_ALARM and plausible(d, s.amount)]
        explained = sum(f.share for f in found)
        least = max(EXPLAINED * (left.least - explained), BESIDE * found[0].share if found else 0.0)
        kinds = {f.direction.kind for f in found}
        usable = [f for f in seen if f.share > least and _matters(fit, f) and f.direction.kind not in kinds]
        if not usable:
            break
        best = max(usable, key=lambda f: f.share)
        if best.direction.kind == "center":  # three amounts, of which one does nearly what the radius does
            simpler = (f for f in usable if f.direction.kind == "radius" and f.share > NEARLY * best.share)
            best = next(simpler, best)
        if not found:
            rivals = [f for f in seen if f is not best and f.share > RIVAL * best.share]
        found.append(best)
    return found, rivals


def _found(fit: Fit, at_end: Linearised, direction: Direction, score: Score) -> _Found:
    moves = np.zeros(len(fit.values))
    moves[at_end.inside] = score.moves
    return _Found(
        direction, score.amount, score.gain / at_end.count, moves / coordinate_slopes(fit.values, fit.unknowns)
    )


def _matters(fit: Fit, found: _Found) -> bool:
    """Whether a fault is gross, or moves a number that is printed."""
    return found.share > GROSS or bool(np.any(fit.determined & (np.abs(found.moves) > MOVES * fit.errors)))


def plausible(direction: Direction, amount: Float[np.ndarray, " k"]) -> bool:
    """Whether an amount is one that a fault can have: an image is darker at its corners, and blurred, not sharpened."""
    one = float(amount[0])
    if direction.kind == "vignetting":
        return 0.0 < one < DARKEST
    if direction.kind == "gamma":
        return abs(one) < STEEPEST
    if direction.kind == "blur":
        return one > 0.0 and _blur(direction, one) < WIDEST
    if direction.kind == "lobe":
        return LOBES[0] < one < LOBES[1]
    return True


def _far(fit: Fit, at_end: Linearised, left: Leftovers) -> _Found | None:
    """Return the sphere's radius or centre that explains the residuals best, searched for beyond first order."""
    best: _Found | None = None
    for direction in at_end.directions:
        if direction.kind not in ("radius", "center"):
            continue
        found = _searched(fit, at_end, direction)
        # the centre has three amounts, so that it must explain clearly more
        least = max(EXPLAINED * left.least, (best.share + SIMPLER * (1.0 - best.share)) if best else 0.0)
        if found.share > least and _matters(fit, found):
            best = found
    return best


def _searched(fit: Fit, at_end: Linearised, direction: Direction) -> _Found:
    """Return a fault of the geometry at its best, beyond first order."""
    end = at_end.samples.search(direction.along)
    moves = fit.values - values_at(end.theta[: len(fit.unknowns)], fit.unknowns)
    return _Found(direction, end.amount, end.share, moves)


def _sentence(fit: Fit, found: _Found) -> str:
    """Say what it is, how much, what it moves, and the remedy."""
    away = np.where(fit.determined, np.abs(found.moves) / fit.errors, 0.0)
    worst = int(np.argmax(away))
    moves = f"This moves {fit.names[worst]} by {away[worst]:.2g} errors."
    what, remedy = _in_words(fit, found.direction, found.amount)
    share = f"{found.share:.0%}" if found.share >= 0.01 else "less than 1%"
    return f"{what}, which explains {share} of the residuals. {moves} {remedy}"


def _in_words(fit: Fit, direction: Direction, amount: Vector) -> tuple[str, str]:
    """Return what a fault is, with its size, and the remedy."""
    one = float(amount[0])
    if direction.kind == "vignetting":
        return (
            f"the images darken towards their corners by about {one:.0%} (vignetting)",
            f"Divide them by 1 - {one:.2g} rho^2, rho the distance from the middle over that of a corner, or take them "
            "with a smaller aperture.",
        )
    if direction.kind == "gamma":
        power = 1.0 + one
        return (
            f"the images look like linear ones raised to the power {power:.4g} (gamma)",
            f"Raise them to the power {1.0 / power:.4g}, or read them with the curve that the camera gave them.",
        )
    if direction.kind == "blur":
        return (
            f"the images are blurred by about {_blur(direction, one):.2g} pixels (standard deviation), or the "
            "highlights have wider edges than the lobe",
            "Focus, or shrink the images, and leave the pixels next to outlines out with View.mask.",
        )
    return _rotation(fit, amount) if direction.kind == "rotation" else _of_object(fit, direction, amount)


def _of_object(fit: Fit, direction: Direction, amount: Vector) -> tuple[str, str]:
    item = fit.scene.objects[direction.which]
    if direction.kind == "lobe":
        own, other = ("Blinn", "Phong") if isinstance(item.material.lobe, Blinn) else ("Phong", "Blinn")
        return (
            f"the highlights have the form of {other}'s lobe rather than {own}'s",
            f"Give Material(lobe=ds.{other}()), or compare both with ds.compare.",
        )
    name = f"objects.{item.name or direction.which}.surface"
    assert isinstance(item.surface, Sphere)
    if direction.kind == "radius":
        now = float(item.surface.radius)
        return (
            f"{name}.radius seems to be about {now + float(amount[0]):.3g} where the scene has {now:.3g}",
            "Measure it again, or free 'surface.radius' and give each View a mask.",
        )
    place = ", ".join(f"{x:.3g}" for x in np.asarray(item.surface.center) + amount)
    away = float(np.linalg.norm(amount))
    return (
        f"{name}.center seems to be about {away:.2g} away from where the scene has it, near ({place})",
        "Measure it again, or free 'surface.center' and give each View a mask.",
    )


def _rotation(fit: Fit, amount: Vector) -> tuple[str, str]:
    size = float(np.linalg.norm(amount))
    axis = ", ".join(f"{x:.2g}" for x in amount / max(size, 1e-300))
    places = [f"'{n}'" for n in ("direction", "position") if any(hasattr(light, n) for light in fit.scene.lights)]
    return (
        f"all lights together are turned by about {size:.2g} degrees about the axis ({axis})",
        f"Check the axes that the lights and the camera are given in, or free {listing(places)}.",
    )


def _blur(direction: Direction, amount: float) -> float:
    """Return the standard deviation of a blur whose amount is so much of one of those tried."""
    return BLURS[direction.which] * float(np.sqrt(amount))

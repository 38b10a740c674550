"""Setup faults: which fault of camera, file, lobe, sphere or lights the residuals show, and what it moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.words import listing
from ...inverse.result import Fit
from ...inverse.statistics.uncertainty import Vector
from ...inverse.unknowns.unknown import coordinate_slopes, values_at
from ...model.lobes import Blinn
from ...model.scenes import Scene
from ...model.surfaces import Sphere
from .faults import BLURS, FACTORS, Direction, Linearised, Mask, linearised, shines
from .residual_correlation import ResidualCorrelation, correlation_of
from .score_tests import Score, ScoreTests

FALSE_ALARM = 1e-4  # significance level of the test of one fault
EXPLAINED = 0.5  # the least that a fault explains of the structure in the residuals
RIVAL = 0.5  # another fault with this fraction of the best fault's gain may be the cause as well
NEXT = 0.25  # the least gain of a second fault, over the best fault's
FAULTS = 3  # reported at most
REPORTED, AFFECTED = 1.0, 2.0  # errors by which a fault moves a value: it is reported; the value is not determined
GROSS = 0.2  # a fault that explains more of the cost is reported whatever it moves to first order
SIMPLER = 0.5  # the least that the centre must explain of what the radius leaves unexplained
NEARLY = 0.85  # a simpler fault with more than this fraction of the best one's gain is preferred
CERTAIN = 5.0  # standard errors of the structure in the residuals: above it a large fault is searched for
DARKEST, STEEPEST, WIDEST = 0.9, 0.7, 4.0  # upper limits of vignetting, |gamma - 1|, and a blur in pixels
LOBES = (0.4, 1.7)  # the range of the amount for another lobe; 1 is exactly that lobe


@dataclass(frozen=True, eq=False)
class SetupFault:
    """A fault of the setup that the residuals show."""

    kind: str
    share: float
    """The fraction of the cost that it explains."""
    sentence: str
    affected: tuple[str, ...]
    """The names of the values that it, or a fault that looks similar, moves by more than two of their errors."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    direction: Direction
    amount: Vector
    share: float
    moves: Vector
    """How far it moves the values, in their own units."""


def setup_faults(fit: Fit, excluded: Sequence[Mask | None] | None = None) -> list[SetupFault]:
    """Return the faults that the residuals show and that move a value which the fit determines. Runs in float64.

    Each is a score test and needs no fit of its own. A sphere's place is searched for beyond first order only if the
    residuals are far from noise and no small fault explains them.

    Args:
        fit: The fit.
        excluded: The pixels of each view that do not count.
    """
    at_end = linearised(fit, excluded)
    structure = correlation_of(fit, excluded)
    found, rivals = _greedy(fit, at_end, structure)
    rounded = fit.evidence.waves is not None  # rounding correlates neighbours
    if structure.errors > CERTAIN and not rounded and sum(f.share for f in found) < 0.8 * structure.least:
        large = _large_fault(fit, at_end, structure)
        if large is not None and large.share > sum(f.share for f in found):
            found, rivals = [large], [f for f in (*found, *rivals) if f.share > RIVAL * large.share]
    elif found and found[0].direction.along:
        again = _searched(fit, at_end, found[0].direction)
        found, rivals = ([again, *found[1:]], [found[0], *rivals]) if again.share > found[0].share else (found, rivals)
    sizes = [np.abs(f.moves) / fit.errors for f in (*found, *rivals)]
    moved = fit.determined & (np.max([np.zeros(len(fit.values)), *sizes], 0) > AFFECTED)
    affected = tuple(name for name, here in zip(fit.names, moved, strict=True) if here)
    return [SetupFault(f.direction.kind, f.share, _sentence(fit, f), affected) for f in found]


def _greedy(fit: Fit, at_end: Linearised, structure: ResidualCorrelation) -> tuple[list[_Candidate], list[_Candidate]]:
    """Return the faults that explain most, each in addition to those before it, and the rivals of the first."""
    found: list[_Candidate] = []
    rivals: list[_Candidate] = []
    while len(found) < FAULTS:
        tests = ScoreTests(at_end.rows, [f.direction.change for f in found])
        scores = [(d, s) for d in at_end.directions if (s := tests.test(d.change)) is not None]
        seen = [_candidate(fit, at_end, d, s) for d, s in scores if s.p_value < FALSE_ALARM and plausible(d, s.amount)]
        explained = sum(f.share for f in found)
        least = max(EXPLAINED * (structure.least - explained), NEXT * found[0].share if found else 0.0)
        kinds = {f.direction.kind for f in found}
        usable = [f for f in seen if f.share > least and _matters(fit, f) and f.direction.kind not in kinds]
        if not usable:
            break
        best = max(usable, key=lambda f: f.share)
        if best.direction.kind == "center":  # one of its three amounts does nearly what the radius does
            simpler = (f for f in usable if f.direction.kind == "radius" and f.share > NEARLY * best.share)
            best = next(simpler, best)
        if best.direction.kind == "highlight":  # of either sign and any width it imitates much: what is simpler is said
            simpler = [f for f in usable if f.direction.kind != "highlight" and f.share > NEARLY * best.share]
            best = max(simpler, key=lambda f: f.share, default=best)
        if not found:
            rivals = [f for f in seen if f is not best and f.share > RIVAL * best.share]
        found.append(best)
    return found, rivals


def _candidate(fit: Fit, at_end: Linearised, direction: Direction, score: Score) -> _Candidate:
    moves = np.zeros(len(fit.values))
    moves[at_end.inside] = score.moves
    return _Candidate(
        direction, score.amount, score.gain / at_end.count, moves / coordinate_slopes(fit.values, fit.unknowns)
    )


def _matters(fit: Fit, found: _Candidate) -> bool:
    """Whether a fault is gross, or moves a determined value."""
    return found.share > GROSS or bool(np.any(fit.determined & (np.abs(found.moves) > REPORTED * fit.errors)))


def plausible(direction: Direction, amount: Float[np.ndarray, " k"]) -> bool:
    """Whether a fault can have this amount: an image is darker at its corners, and blurred, not sharpened."""
    one = float(amount[0])
    if direction.kind == "vignetting":
        return 0.0 < one < DARKEST
    if direction.kind == "gamma":
        return abs(one) < STEEPEST
    if direction.kind == "blur":
        return one > 0.0 and _blur(direction, one) < WIDEST
    if direction.kind == "lobe":
        return LOBES[0] < one < LOBES[1]
    if direction.kind == "highlight":
        return one > 0.0
    return True


def _large_fault(fit: Fit, at_end: Linearised, structure: ResidualCorrelation) -> _Candidate | None:
    """Return the sphere's radius or centre that explains the residuals best, searched for beyond first order."""
    best: _Candidate | None = None
    for direction in at_end.directions:
        if direction.kind not in ("radius", "center"):
            continue
        found = _searched(fit, at_end, direction)
        # The centre has three amounts, so it must explain clearly more.
        least = max(EXPLAINED * structure.least, (best.share + SIMPLER * (1.0 - best.share)) if best else 0.0)
        if found.share > least and _matters(fit, found):
            best = found
    return best


def _searched(fit: Fit, at_end: Linearised, direction: Direction) -> _Candidate:
    """Return a fault of the geometry at its best amount, beyond first order."""
    end = at_end.samples.search(direction.along)
    moves = fit.values - values_at(end.theta[: len(fit.unknowns)], fit.unknowns)
    return _Candidate(direction, end.amount, end.share, moves)


def _sentence(fit: Fit, found: _Candidate) -> str:
    """Return what it is, its size, what it moves, and the remedy."""
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
            f"Divide them by 1 - {one:.2g} rho^2, with rho the distance from the centre over that of a corner, or use "
            "a smaller aperture, or give the views a Sensor() and free 'sensor.vignetting.second'.",
        )
    if direction.kind == "gamma":
        power = 1.0 + one
        return (
            f"the images look like linear ones raised to the power {power:.4g} (gamma)",
            f"Raise them to the power {1.0 / power:.4g}, read them with the camera's own curve, or give the views a "
            "Sensor() and free 'sensor.gamma'.",
        )
    if direction.kind == "blur":
        return (
            f"the images are blurred by about {_blur(direction, one):.2g} pixels (standard deviation), or the "
            "highlights have wider edges than the lobe",
            "Focus, or shrink the images, and exclude the pixels next to outlines with View.mask.",
        )
    if direction.kind == "highlight":
        factor = FACTORS[direction.which]
        kind = "sharper" if factor > 1 else "wider"
        n_s = factor * float(np.mean(next(n for n in _exponents(fit.scene))))
        return (
            f"the highlights have a second, {kind} part, with n_s near {n_s:.2g}",
            f"Give the material highlights=ds.Highlight(k_s=0.1, n_s={n_s:.2g}) and free both.",
        )
    return _rotation(fit, amount) if direction.kind == "rotation" else _of_object(fit, direction, amount)


def _exponents(scene: Scene) -> Iterator[np.ndarray]:
    """Yield n_s of each material that shines."""
    for item in scene.objects:
        if shines(item.material.k_s):
            yield np.asarray(item.material.n_s)


def _of_object(fit: Fit, direction: Direction, amount: Vector) -> tuple[str, str]:
    item = fit.scene.objects[direction.which]
    if direction.kind == "lobe":
        own, other = ("Blinn", "Phong") if isinstance(item.material.lobe, Blinn) else ("Phong", "Blinn")
        return (
            f"the highlights fit {other}'s lobe better than {own}'s",
            f"Give Material(lobe=ds.{other}()), or compare both with ds.compare.",
        )
    name = f"objects.{item.name or direction.which}.surface"
    assert isinstance(item.surface, Sphere)
    if direction.kind == "radius":
        now = float(item.surface.radius)
        return (
            f"{name}.radius seems to be about {now + float(amount[0]):.3g}, but the scene has {now:.3g}",
            "Measure it again, or free 'surface.radius' and give each View a mask.",
        )
    place = ", ".join(f"{x:.3g}" for x in np.asarray(item.surface.center) + amount)
    away = float(np.linalg.norm(amount))
    return (
        f"{name}.center seems to be off by about {away:.2g}, near ({place})",
        "Measure it again, or free 'surface.center' and give each View a mask.",
    )


def _rotation(fit: Fit, amount: Vector) -> tuple[str, str]:
    size = float(np.linalg.norm(amount))
    axis = ", ".join(f"{x:.2g}" for x in amount / max(size, 1e-300))
    places = [f"'{n}'" for n in ("direction", "position") if any(hasattr(light, n) for light in fit.scene.lights)]
    return (
        f"all lights together are turned by about {size:.2g} degrees around the axis ({axis})",
        f"Check the axes of the lights and of the camera, or free {listing(places)}.",
    )


def _blur(direction: Direction, amount: float) -> float:
    """Return the standard deviation of a blur, from its amount relative to a tested one."""
    return BLURS[direction.which] * float(np.sqrt(amount))

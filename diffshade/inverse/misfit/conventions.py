"""Conventions: whether lights seem to be in other axes or in another order than the photographs, or `lit=` left out.

These are common where directions come from another program, and ruin every number. No first-order change of the scene
leads from one convention to another: each is tried by a fit of some pixels. That all lights are on in every photograph,
where each has its own, shows in photographs that differ though nothing else does.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...core.thresholds import CLEARLY, MOST, SLIGHT, SMALL, TINY
from ...core.words import MAX_NAMED, listing
from ...model.scenes import Scene
from ..data.samples import kept
from ..data.view_sets import ViewSet
from ..data.views import colours
from ..pixels.blocks import BLOCK
from ..result import Fit
from ..solving import solve_again
from ..unknowns.places import Place
from ..unknowns.unknown import free_places

MUCH_WORSE = 1.0 / SMALL  # times the median mean square: such views may be swapped
MIN_VIEWS = 4  # with fewer, some axes may be right by chance
HEALED = 0.25  # of the squares that the scene as given leaves, below which a convention is believed

Convention = tuple[str, Scene, ViewSet]  # what it is in words, and the scene and views in it


def other_convention(fit: Fit, squares: Mapping[int, float]) -> str | None:
    """Return a sentence if other axes, or another order of the lights, heal most of a fit's misfit. In float64.

    Axes and orders of all lights are tried where the misfit is gross, and two photographs are swapped where these are
    much worse than the others. Photographs of one camera and several lights are compared with each other.

    Args:
        fit: The fit.
        squares: The mean square of the residuals of each view.
    """
    gross = fit.evidence.spread[1] > SLIGHT * fit.squares
    worst = sorted(squares, key=lambda i: -squares[i])[:MIN_VIEWS]
    if not gross:
        worst = [i for i in worst if squares[i] > MUCH_WORSE * np.median([*squares.values()])]
    if not gross and len(worst) < 2:
        return None
    if gross and (unlike := _unlike(fit)):
        return unlike
    free = {(place.owner, place.field) for place in free_places(fit.unknowns)}
    placed = any(owner == "lights" and name in ("direction", "position") for owner, name in free)
    few = len(fit.views) < MIN_VIEWS
    if placed or (few and not gross):
        return None
    data = fit.solved.problem.data.part(BLOCK)
    given = _cost(fit, fit.scene, data)
    swapped = () if few else _swapped(fit.scene, data, worst)
    conventions = itertools.chain(_conventions(fit.scene, data) if gross else (), swapped)
    tried = [(_cost(fit, scene, of), words) for words, scene, of in conventions]
    (best, words), *others = sorted(tried) or [(np.inf, "")]
    if best > (SLIGHT if few else HEALED) * given or (others and CLEARLY * best > others[0][0]):
        return None
    left = np.sqrt(best / given)
    return f"{words}: they fit with {left:.0%} of the RMSE so. Nothing is determined until it is corrected."


def _unlike(fit: Fit) -> str | None:
    """Return a sentence if photographs under the same lights, but for a factor, differ as much as the fit misses."""
    data, missed = fit.solved.problem.data, fit.evidence.spread[1] / fit.squares
    for group in data.setups:
        if len(group) < 2 or len(data.lit[group[0]]) < 2:
            continue
        views = [data.views[i] for i in group]
        step = 1 + int(np.sqrt(np.prod(views[0].camera.shape) / BLOCK))
        shown = np.array([(np.asarray(colours(view))[::step, ::step] - view.black) / view.exposure for view in views])
        shown = shown[:, np.all([kept(view)[::step, ::step] for view in views], 0)].reshape(len(group), -1)
        mean = shown.mean(0)
        factor = shown @ mean / max(float(mean @ mean), TINY)
        if np.sum((shown - factor[:, None] * mean) ** 2) > MOST * missed * np.sum(shown**2):
            names = listing([f"views[{i}]" for i in group[:MAX_NAMED]])
            more = f" and {len(group) - MAX_NAMED} more" if len(group) > MAX_NAMED else ""
            return (
                f"{names}{more} have one camera and the same {len(data.lit[group[0]])} lights, and show different "
                "pictures: give each View the lights that are on in it, lit=. Nothing is determined until it is "
                "corrected."
            )
    return None


def _cost(fit: Fit, scene: Scene, data: ViewSet) -> float:
    _, end = solve_again(fit.solved.problem, scene, data, fit.solved.theta)
    return float(end.point.total.cost)


def _conventions(scene: Scene, data: ViewSet) -> Iterator[Convention]:
    """Yield the scene with its lights in other axes, and the views under other lights.

    Of one light in 48 axes one may be right by chance; then directions are reversed alone.
    """
    for axes in other_axes() if len({*data.lit}) > 1 else [-np.eye(3)]:
        yield axes_in_words(axes), _turned(scene, axes), data
    one_each = all(len(of) == 1 for of in data.lit) and len({*data.lit}) == len(data.lit)
    for words, order in orders(len(data.lit)) if one_each else ():
        yield words, scene, _lit_by(data, order)


def _swapped(scene: Scene, data: ViewSet, worst: Sequence[int]) -> Iterator[Convention]:
    """Yield the scene and the views with two of the worst views under each other's lights."""
    for i, j in itertools.combinations(sorted(worst), 2):
        order = [*range(len(data.views))]
        order[i], order[j] = j, i
        yield f"views[{i}] and views[{j}] seem to be swapped", scene, _lit_by(data, order)


def _lit_by(data: ViewSet, order: Sequence[int]) -> ViewSet:
    """Return the views, each under the lights of another one."""
    lit = tuple(data.lit[k] for k in order)
    views = tuple(dataclasses.replace(view, lit=of) for view, of in zip(data.views, lit, strict=True))
    return dataclasses.replace(data, views=views, lit=lit)


def _turned(scene: Scene, axes: Float[np.ndarray, "3 3"]) -> Scene:
    """Return the scene with the places of its lights in other axes."""
    places = [Place("lights", i, (name,)) for i, light in enumerate(scene.lights) for name in light.placement]
    moved = [axes @ np.asarray(place.value_in(scene, ()), np.float64) for place in places]
    return eqx.tree_at(lambda of: [place.value_in(of, ()) for place in places], scene, moved)


def axes_in_words(*either: Float[np.ndarray, "3 3"]) -> str:
    """Return the sentence on lights in axes that are swapped or negated; of several, in which is not known."""
    ways = " or ".join(f"with {_moves_in_words(axes)}" for axes in either)
    return f"the lights seem to be described in other axes than the photographs, {ways}"


def _moves_in_words(axes: Float[np.ndarray, "3 3"]) -> str:
    order, names = np.abs(axes).argmax(1), "xyz"
    moved = [names[k] for k in range(3) if order[k] != k]
    negated = [names[k] for k in range(3) if axes[k, order[k]] < 0]
    swapped = f"{listing(moved)} {'swapped' if len(moved) == 2 else 'in the order ' + ''.join(names[k] for k in order)}"
    return " and ".join([*([swapped] if moved else []), *([f"{listing(negated)} negated"] if negated else [])])


def other_axes() -> Iterator[Float[np.ndarray, "3 3"]]:
    """Yield the axes that are swapped or negated."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = np.array(signs)[:, None] * np.eye(3)[list(order)]
            if (axes != np.eye(3)).any():
                yield axes


def orders(n: int) -> Iterator[tuple[str, list[int]]]:
    """Yield the usual wrong orders of n lights, one for each photograph."""
    as_text = sorted(range(n), key=str)
    back = np.argsort(as_text).tolist()
    for words, order in (
        ("the lights seem to be listed in the reverse order of the photographs", [*range(n - 1, -1, -1)]),
        ("the list of lights seems to begin one too early for the photographs", [*range(1, n), 0]),
        ("the list of lights seems to begin one too late for the photographs", [n - 1, *range(n - 1)]),
        ("the photographs seem to be sorted as text (1, 10, 11, 2), and the lights by number", as_text),
        ("the lights seem to be sorted as text (1, 10, 11, 2), and the photographs by number", back),
    ):
        if order != [*range(n)]:
            yield words, order

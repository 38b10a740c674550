"""Start search: a coarse search, over the unknowns in which the image is not linear, for where a fit begins.

Each candidate is judged by its cost at the best linear unknowns (k_a, k_d, k_s), which are solved for within their
bounds, on a few of the pixels. Unknowns of one kind are tried together, one group after another.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.backend import jit_quickly
from ...core.fields import Array
from ...core.progress import ReportProgress
from ...model.flaps import LIMITS
from ...model.scenes import Scene
from ..forward.gram import Point
from ..pixels.blocks import Block
from ..unknowns.light_priors import middle_of
from ..unknowns.places import Place
from ..unknowns.unknown import Unknown, coordinates, free_places
from ..unknowns.visibility import Arrow, places_apart
from .descent import box_step
from .solvers import BoxConstraints, Task, evaluate, linear_step, minimise

BEST = 3  # candidates that are followed
SHORT = 30  # steps, on a part of the pixels
FACTORS = (0.03, 0.1, 0.3, 1.0, 3.0)  # between two coefficients
EDGE = 5.0  # degrees
NEARBY = 0.15  # of a direction or of a distance: half of the first step of a search
APPROACH = 16  # steps,
SHRINK = 0.6  # each of so much of the last one's reach,
STEEP = 0.5  # and of samples that change by less within it, in units of the images' root mean square

Theta = Float[np.ndarray, " p"]
Moves = Callable[[np.ndarray, Scene], np.ndarray]
End = tuple[float, Theta, bool]
"""Where steps ended: the cost, the point, and whether it is the minimum, not where the steps ended before."""


class Group(NamedTuple):
    """Unknowns that are tried together: a position's x, y and z, say."""

    unknown: Unknown
    """The first of them."""
    members: list[int]
    values: Float[np.ndarray, "n m"]
    """The values that are tried, in the solver's coordinates."""

    def at(self, theta: Theta) -> Float[np.ndarray, "n p"]:
        """Return the points to try around theta."""
        points = np.tile(theta, (len(self.values), 1))
        points[:, self.members] = self.values
        return points


def groups_to_try(unknowns: Sequence[Unknown], scene: Scene, arrow: Arrow | None = None) -> list[Group]:
    """Return the unknowns that a search tries, by kind and quantity, and the values that it tries.

    Lights that show apart from each other are left to `light_search`, which tries all of them at once.
    """
    apart = {j for of in places_apart(unknowns, arrow) for j in of}
    members: dict[tuple[str, str], list[int]] = {}
    for j, unknown in enumerate(unknowns):
        if _moves_of(unknown) is not None and j not in apart:
            members.setdefault((unknown.kind, unknown.quantity), []).append(j)
    found = []
    for indices in members.values():
        of = [unknowns[j] for j in indices]
        moves = _moves_of(of[0])
        assert moves is not None
        tried = moves(np.array([unknown.start for unknown in of]), scene)
        found.append(Group(of[0], indices, np.array([coordinates(row, of) for row in tried])))
    return found


def _moves_of(unknown: Unknown) -> Moves | None:
    """Return what makes the values to try of those of the scene; None for an unknown that is not searched for.

    A place that is known to be nearer than the first step of a search is not searched for.
    """
    listed = FACTORS if unknown.parameter.role == "factor" else unknown.parameter.search
    if listed:
        return _listed(*listed)
    is_direction = unknown.parameter.role == "direction"
    is_place = is_direction or unknown.parameter.role == "position"
    if is_place and unknown.prior is not None and unknown.prior[1] < NEARBY * max(abs(unknown.start), 1.0):
        return None
    return _MOVES.get(unknown.kind, _MOVES["direction"] if is_direction else None)


def is_local(unknowns: Sequence[Unknown]) -> bool:
    """Whether the search is for more than a material: around what the scene says of a light's place, say."""
    return any(
        of.parameter.reach or (_moves_of(of) and not of.parameter.search and of.parameter.role != "factor")
        for of in unknowns
    )


def _listed(*values: float, with_own: bool = False) -> Moves:
    """Try the same values whatever the scene's are, or these too."""

    def moves(own: np.ndarray, scene: Scene) -> np.ndarray:
        tried = np.outer(values, np.ones(len(own)))
        return np.concatenate([own[None], tried]) if with_own else tried

    return moves


def _scaled(*factors: float) -> Moves:
    return lambda values, scene: np.outer(factors, values)


def turned(axis: np.ndarray, angles: Sequence[float]) -> np.ndarray:
    """Return directions at these angles (degrees) off an axis, six around it for each."""
    axis = axis / np.linalg.norm(axis)
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    around = np.deg2rad(60.0 * np.arange(6))[:, None]
    ring = np.cos(around) * u + np.sin(around) * np.cross(axis, u)
    tilts = np.deg2rad(np.asarray(angles))[:, None, None]
    return np.concatenate([axis[None], (np.cos(tilts) * axis + np.sin(tilts) * ring).reshape(-1, 3)])


def _size(scene: Scene) -> float:
    """Return about half the width of an object."""
    return float(np.mean([getattr(item.surface, "radius", 1.0) for item in scene.objects]))


def _positions(position: np.ndarray, scene: Scene) -> np.ndarray:
    """Return places around the object, nearer and farther than the scene's."""
    if len(position) != 3:
        return position[None]
    middle = middle_of(scene)
    offset = position - middle
    far = np.linalg.norm(offset)
    if far == 0:  # told to stand in the middle of the object: in front of it, seen along -z, is as good a guess as any
        offset, far = np.array([0.0, 0.0, 1.0]), 3.0 * _size(scene)
    around = turned(offset, (20.0, 40.0, 70.0))
    return np.concatenate([position[None], *(middle + far * factor * around for factor in (0.6, 1.0, 1.6))])


def _centers(center: np.ndarray, scene: Scene) -> np.ndarray:
    steps = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])[:, : len(center)]
    return center + 0.25 * _size(scene) * steps


def _limits(limit: np.ndarray, scene: Scene) -> np.ndarray:
    """Return planes across the object, nearer and farther than the scene's."""
    return limit + _size(scene) * np.array([0.0, -0.25, 0.25, -0.5, 0.5, -0.75, 0.75])[:, None]


_MOVES: dict[str, Moves] = {
    "z_f": _scaled(1.0, 0.5, 0.7, 0.85, 1.15, 1.3),
    "z_b": _scaled(1.0, 0.7, 0.85, 1.15, 1.3, 2.0),
    "radius": _scaled(1.0, 0.85, 1.2),
    "exponent": _listed(0.0, 1.0, 4.0, 16.0, 64.0, with_own=True),
    "cutoff": _listed(10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, with_own=True),
    "direction": lambda values, scene: values[None] if len(values) != 3 else turned(values, (20.0, 45.0, 80.0)),
    "position": _positions,
    "center": _centers,
    **dict.fromkeys(LIMITS, _limits),
}


def best_linear(point: Point, box: BoxConstraints) -> tuple[Array, Array]:
    """Return the point at the best linear unknowns, and the cost there, which is quadratic in them."""
    step = linear_step(point, box)
    return point.theta + step, point.total.cost - point.gain(step)


_best_linear = jit_quickly(best_linear)


def at_best_linear(theta: Theta, task: Task, chunks: Sequence[Block]) -> tuple[Point, float, Theta]:
    """Solve for the linear unknowns at theta; return the pass there, the cost and the unknowns at the minimum.

    A cost that is not finite is infinite.
    """
    point = evaluate(theta, task, chunks)
    found, cost = (point.theta, point.total.cost) if task.model.projects else _best_linear(point, task.box)
    return point, float(cost) if np.isfinite(cost) else np.inf, np.asarray(found)


def steepest(unknowns: Sequence[Unknown]) -> Float[np.ndarray, " p"] | None:
    """Return the slopes above which `RenderedModel` leaves samples out: none as yet, and None where it never will."""
    return np.full(len(unknowns), np.inf) if any(unknown.parameter.reach for unknown in unknowns) else None


def approach(theta: Theta, task: Task, chunks: Sequence[Block], rms: float) -> Theta:
    """Return where Gauss-Newton steps lead that look only at what a step can tell, from coarse to fine.

    Near the rim of a glass ball a pixel runs through all that is behind while eta changes by a thousandth, and in the
    sum of squares a few such pixels hide what all others say. So a sample is left out of a step within whose reach it
    would change by more than `STEEP`, and the reach shrinks. The unknowns that the search has other groups for stay.
    """
    reach = np.array([unknown.parameter.reach for unknown in task.unknowns])
    bends, searched = reach > 0, np.array([_moves_of(unknown) is not None for unknown in task.unknowns])
    for _ in range(APPROACH):
        limit = np.where(bends, STEEP * rms / np.where(bends, reach, 1.0), np.inf)
        model = eqx.tree_at(lambda m: m.steepest, task.model, limit)
        point = evaluate(theta, task.using(model), chunks)
        most = np.where(bends, reach, np.where(searched, 0.0, np.inf))
        theta = np.asarray(_gauss_newton(point, task.box, most))
        reach = reach * SHRINK
    return theta


@jit_quickly
def _gauss_newton(point: Point, box: BoxConstraints, most: Array) -> Array:
    """Return the point after the step to the minimum within the box of the quadratic model, of so much at most."""
    theta, of = point.theta, point.total
    low, high = jnp.maximum(box.lower - theta, -most), jnp.minimum(box.upper - theta, most)
    return theta + box_step(of.hessian, of.gradient, jnp.full_like(low, 1e-9), low, high)


def with_wide_edges(scene: Scene, unknowns: Sequence[Unknown]) -> Scene:
    """Return the scene with soft edges at least `EDGE` wide for spots whose cutoff is unknown and softness known.

    Only pixels within the edge tell where it is: of a narrow one a search would see nothing.
    """
    free = free_places(unknowns)
    for i, light in enumerate(scene.lights):
        cutoff = Place("lights", i, ("cutoff",))
        unseen = cutoff in free and cutoff.beside("softness") not in free
        if unseen and getattr(light, "softness", EDGE) < EDGE:
            scene = eqx.tree_at(lambda s, i=i: s.lights[i].softness, scene, np.asarray(EDGE))
    return scene


def search(task: Task, coarse: Sequence[Block], chunks: Sequence[Block], report_progress: ReportProgress) -> End:
    """Find the best start: candidates are judged on a few pixels, the lowest followed most of the way on a part of all.

    What the scene says of lights and surfaces is always followed too, with the best material for it and with a plain
    one: where several of these are unknown, judging them one after another can lead astray, and so can a highlight that
    vanishes at the best k_s because it is out of place.
    """
    begin = coordinates(np.array([u.start for u in task.unknowns]), task.unknowns)
    groups, local = groups_to_try(task.unknowns, task.scene, task.box.arrow), is_local(task.unknowns)
    # candidates of a model that projects are judged alike whatever the linear unknowns were: no need to know the best
    told = local or not groups or not task.model.projects
    first = at_best_linear(begin, task, coarse)[1:] if told else (np.inf, begin)

    def tried(group: Group, theta: Theta) -> list[tuple[float, Theta]]:
        within = list(np.clip(group.at(theta), task.box.lower, task.box.upper))
        if group.unknown.parameter.reach:
            rms = float(np.sqrt(task.squares / sum(float(np.sum(chunk.observed.weight > 0)) for chunk in chunks)))
            within = [approach(candidate, task, coarse, rms) for candidate in within]
        judged = [at_best_linear(candidate, task, coarse)[1:] for candidate in within]
        return [judged[i] for i in _lowest([cost for cost, _ in judged])]

    def with_role(role: str) -> list[Group]:
        return [group for group in groups if group.unknown.parameter.role == role]

    found: list[tuple[float, Theta]] = [] if groups else [first]
    one_by_one = groups * min(len(groups), 2)  # twice where there are several
    for k, group in enumerate(one_by_one):
        report_progress("searching for a start", 0.5 * k / len(one_by_one))
        found += tried(group, found[0][1] if found else first[1])
        found.sort(key=_cost)
    followed = _distinct(found or [first])[:BEST]
    if local:
        as_told = first
        for group in with_role("exponent"):
            as_told = min([as_told, *tried(group, as_told[1])], key=_cost)
        followed = _distinct([*followed, as_told])
    starts = [(theta, task) for _, theta in followed]
    if local:
        box = eqx.tree_at(lambda box: box.linear, task.box, replace_fn=np.zeros_like)
        starts.append((begin, task.within(box)))  # all move together: k_s is not solved for at once

    ends = []
    for k, start in enumerate(starts):
        report_progress("searching for a start", 0.5 + 0.5 * k / len(starts))
        ends.append(follow(*start, chunks))
    best = min(ends, key=_cost)
    for exchanged in _with_exponents_exchanged(best[1], groups):
        # a highlight that is wide across its direction looks much like one that is wide along it, turned by 90 degrees
        for group in with_role("direction"):
            exchanged = min(tried(group, exchanged), key=_cost, default=(np.inf, exchanged))[1]
        best = min(best, follow(exchanged, task, chunks), key=_cost)
    return best


def follow(theta: Theta, task: Task, chunks: Sequence[Block]) -> End:
    """Return where a few steps from a point end."""
    end = minimise(theta, task, chunks, max_steps=SHORT, rtol=1e-6)
    return float(end.point.total.cost), np.asarray(end.point.theta), not end.message


def _with_exponents_exchanged(theta: Theta, groups: Sequence[Group]) -> list[Theta]:
    """Return the point with each two exponents of one material exchanged, where a direction of it is free as well."""

    def of_material(role: str) -> list[tuple[Any, list[int]]]:
        of_role = [group for group in groups if group.unknown.parameter.role == role and group.unknown.places]
        holders = [group.unknown.places[0] for group in of_role]
        return [((of.owner, of.item, of.part), g.members) for of, g in zip(holders, of_role, strict=True)]

    turned_ones, found = {material for material, _ in of_material("direction")}, []
    for (material, one), (of_other, other) in itertools.combinations(of_material("exponent"), 2):
        if material == of_other and material in turned_ones and len(one) == len(other):
            exchanged = np.array(theta)
            exchanged[one + other] = theta[other + one]
            found.append(exchanged)
    return found


def _cost(of: Sequence[Any]) -> float:
    return of[0]


def _lowest(costs: Sequence[float]) -> list[int]:
    """Return where costs have a local minimum along their list."""
    padded = [np.inf, *costs, np.inf]
    return [i for i, c in enumerate(costs) if c <= padded[i] and c <= padded[i + 2] and np.isfinite(c)]


def _distinct(found: Sequence[tuple[float, Theta]]) -> list[tuple[float, Theta]]:
    """Leave out points that are there already."""
    kept: list[tuple[float, Theta]] = []
    for cost, theta in found:
        if all(np.abs(theta - other).max() > 1e-9 for _, other in kept):
            kept.append((cost, theta))
    return kept

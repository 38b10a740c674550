"""Planning: which photograph to take next, by the errors that a fit would have with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.backend import in_float64
from ..core.fields import Array, Checked, Scalar, as_scalar, check, check_kind, is_concrete, parameter_of, quantities
from ..core.progress import showing
from ..core.words import did_you_mean, listing
from ..inverse.data.samples import Counts, find_samples
from ..inverse.data.views import View, has_mask, is_grey, lights_on
from ..inverse.forward.gram import Gram
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.pixels.blocks import Block, total
from ..inverse.problem import fit_problem
from ..inverse.result import Fit
from ..inverse.statistics.identifiability import VAGUE, VAGUE_LOG, null_directions, relative_errors
from ..inverse.statistics.uncertainty import SINGULAR, Evidence, Matrix, Vector, scaled
from ..inverse.unknowns.names import CHANNELS
from ..inverse.unknowns.slots import put_back
from ..inverse.unknowns.unknown import Unknown, coordinate_slopes, coordinates, logarithms
from ..model.cameras import AbstractCamera
from ..model.gbuffers import GBuffer
from ..model.lights import AbstractLight
from ..model.rendering import render, silhouette
from ..model.scenes import Scene, as_tuple
from ..parallel.threads import on_all_cores

# Where a light is, and whither it shines, is what a shot says; what else is unknown of a lamp goes with it.
PLACED = {"position", "direction", "edge"}  # roles of the numbers that say where a light stands
MUCH = 0.05  # share of a shot's pixels; with more of them clipped, its exposure is too long


class Shot(Checked):
    """A photograph that could be taken, for `plan`.

    `light`: the only light that is on; by default those of the fit's first view. What is unknown of all the fit's lamps
    of its kind together, such as their attenuation, is unknown of it too: it is the same lamp, moved. `camera`: by
    default that of the first view. `exposure`: the factor from radiance to the image, above 0, known. `name`: a word of
    your own for the table.
    """

    light: AbstractLight | None = None
    camera: AbstractCamera | None = None
    exposure: Scalar = eqx.field(converter=as_scalar, default=1.0)
    name: str = eqx.field(static=True, default="")

    def check_together(self) -> None:
        if self.light is not None:
            check_kind("Shot.light", self.light, AbstractLight, "PointLight((0, 0, 3))")
        if self.camera is not None:
            check_kind("Shot.camera", self.camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
        if is_concrete(self.exposure) and not self.exposure > 0:
            raise ValueError(f"Shot.exposure must be above 0; got {self.exposure}. Give 1 if it is not known.")
        if not isinstance(self.name, str):
            raise TypeError(f"Shot.name must be a word; got {self.name!r}. Give for example 'lamp near'.")


@dataclass(frozen=True, eq=False)
class Plan:
    """What each photograph that could be taken would tell; `print` it for the table. Every array is NumPy float64."""

    shots: tuple[Shot, ...]
    names: tuple[str, ...]
    """A name of each shot: its own, or its number."""
    order: tuple[int, ...]
    """The shots, the one to take first."""
    unknowns: tuple[Unknown, ...]
    values: Float[np.ndarray, " p"]
    scales: Float[np.ndarray, " p"]
    """What each number may be small against, as of the fit."""
    now: Float[np.ndarray, " p"]
    """Standard errors of the fit for independent noise; infinite where nothing is determined."""
    errors: Float[np.ndarray, "shots p"]
    """What they are expected to be with each shot added to the views."""
    gain: Float[np.ndarray, " shots"]
    """What each shot adds to log det of the information, in relative units: in all, errors shrink by e^(-gain/2)."""
    rank: Int[np.ndarray, " shots"]
    """How many directions each shot determines that the views do not."""
    clipped: Float[np.ndarray, " shots"]
    """The share of each shot's pixels that the sensor would clip; they do not count."""
    aim: Bool[np.ndarray, " p"]
    """The unknowns by whose errors the shots are ranked; none where it is by all together."""
    notes: tuple[str, ...]

    @property
    def best(self) -> Shot:
        """The shot to take first."""
        return self.shots[self.order[0]]

    def __str__(self) -> str:
        """Return the table of shots, the best first, and below it the notes."""
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
        number = len(self.shots)
        aimed = listing(list(dict.fromkeys(u.quantity for u, a in zip(self.unknowns, self.aim, strict=True) if a)))
        by = f"the error of {aimed}" if aimed else "all errors together"
        title = f"plan of {number} photograph{'' if number == 1 else 's'}, ranked by {by}: standard errors with each"
        return "\n".join([title, *(line.rstrip() for line in lines), *(f"- {note}" for note in self.notes)])

    def cells(self, errors: Vector, quantities: Sequence[str]) -> list[str]:
        """Return the largest error of each quantity: in per cent of the value where it has a size, - where unknown."""
        relative = _shares(self.unknowns, self.values, errors, self.scales)
        cells = []
        for quantity in quantities:
            members = [j for j, u in enumerate(self.unknowns) if u.quantity == quantity]
            worst = max(members, key=lambda j: errors[j] if relative[j] == 0 else relative[j])
            size = _percent(relative[worst]) if relative[worst] > 0 else f"{errors[worst]:.2g}"
            cells.append(size if np.isfinite(errors[worst]) else "-")
        return cells


def plan(
    fit: Fit, shots: Sequence[Shot] | Shot, *, aim: Sequence[str] | str | None = None, progress: bool = False
) -> Plan:
    r"""Rank photographs that could be taken by the errors that the fit would have with each of them.

    $$ Cov = (F + J^T J / \sigma^2)^{-1} $$

    is the covariance to expect, with F the Fisher information of the views and J the Jacobian of the shot at the fitted
    scene (Fedorov 1972; Pukelsheim 1993), for independent noise of the fit's own size; unknowns at a bound stay there.
    Its pixels are those that show an object and that the first view's sensor would not clip. `aim`: names of unknowns,
    as in `fit`; the shots are ranked by their expected relative error (the root mean square of several), without it by
    the gain of log det of the information (D-optimal). Where the views leave something undetermined, what counts first
    is how many directions of it a shot determines. `progress`: show a line on the terminal.

    Raises ValueError, TypeError: one sentence that names the shot or the unknown and the remedy.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    shots = as_tuple(shots)
    if not shots:
        raise ValueError("plan needs at least one shot; got none. Give for example Shot(light=PointLight((0, 0, 3))).")
    for i, shot in enumerate(shots):
        check_kind(f"shots[{i}]", shot, Shot, "Shot(light=PointLight((0, 0, 3)))")
    check(shots)
    aimed = _aimed(fit.unknowns, aim)
    names = tuple(shot.name or f"shots[{i}]" for i, shot in enumerate(shots))
    seen = []
    with (
        showing("plan", show=progress) as report_progress,
        in_float64((fit, shots)) as (own, own_shots),
    ):
        for i, (shot, name) in enumerate(zip(own_shots, names, strict=True)):
            report_progress(name, i / len(shots))
            seen.append(_look(own, shot, name))
    # where nothing is determined, it is by chance that a value stands at a bound
    evidence = dataclasses.replace(fit.evidence, at_bound=fit.at_bound & fit.evidence.determined)
    after = [_with(evidence, H) for H, _ in seen]
    now = evidence.plain_errors()
    errors = np.array([e.plain_errors() for e in after])
    rank_now, log_now = _information(fit, evidence)
    ranks, logs = (np.array(of) for of in zip(*(_information(fit, e) for e in after), strict=True))
    rank, gain = ranks - rank_now, logs - log_now
    order = _order(fit, names, aimed, errors, rank, gain)
    clipped = np.array([share for _, share in seen])
    notes = _notes(fit, shots, names, order, aimed, now, errors, rank, clipped)
    return Plan(
        shots, names, order, fit.unknowns, fit.values, fit.scales, now, errors, gain, rank, clipped, aimed, tuple(notes)
    )  # fmt: skip


def _aimed(unknowns: Sequence[Unknown], aim: Sequence[str] | str | None) -> Bool[np.ndarray, " p"]:
    """Return the unknowns that the names of `aim` mean; a name is any run of segments, with a channel or without."""
    found = np.zeros(len(unknowns), bool)
    for name in () if aim is None else as_tuple((aim,) if isinstance(aim, str) else aim):
        if not isinstance(name, str):
            raise TypeError(f"aim must hold names of unknowns; got {name!r}. Give for example 'n_s'.")
        meant = np.array([_means(name, unknown) for unknown in unknowns])
        if not meant.any():
            known = {word for u in unknowns for word in (u.name, u.quantity, u.kind)}
            raise ValueError(f"aim names '{name}', which is no unknown of this fit. {did_you_mean(name, known)}")
        found |= meant
    return found


def _means(name: str, unknown: Unknown) -> bool:
    letter = unknown.name.rpartition(".")[2]
    channel = f".{letter}" if letter in CHANNELS else ""
    paths = [unknown.name, *(f"{path}{channel}" for path, _ in unknown.places)]
    return any(f".{name}." in f".{path}." for path in paths)


def _look(fit: Fit, shot: Shot, name: str) -> tuple[Matrix, float]:
    """Return the Gram of a shot in the values' own units, and the share of its pixels that would be clipped."""
    scene, lit, unknowns = _lit_by(fit, shot)
    first = fit.views[0]
    camera = first.camera if shot.camera is None else shot.camera
    same = eqx.tree_equal(*(jax.tree.map(np.asarray, c) for c in (camera, first.camera)))
    if any(isinstance(item.surface, GBuffer) for item in scene.objects) and not same:
        raise ValueError(
            f"{name} has a camera of its own, but this scene knows its surface only as the fit's cameras see it, by a "
            "GBuffer. Leave Shot.camera out."
        )
    inside = np.asarray(silhouette(scene.objects, camera))
    if not inside.any():
        raise ValueError(
            f"{name} sees no object: none is before its camera at ({', '.join(f'{x:g}' for x in camera.eye)}). Turn "
            "the camera to one by its target."
        )
    moving = any("surface" in path.split(".") for unknown in unknowns for path, _ in unknown.places)
    try:
        image = float(shot.exposure) * np.asarray(render(scene, camera, lit=lit)) + float(first.black)
        view = View(
            image.mean(-1, keepdims=True) if is_grey(first) else image,
            camera,
            mask=inside if moving else None,
            lit=lit,
            exposure=shot.exposure,
            black=first.black,
            noise=first.noise,
            saturation=find_samples(fit.scene, first, moving=moving and has_mask(first)).level,
            floor=first.floor,
        )
        samples = find_samples(scene, view, moving=moving)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    counts = ~samples.ends().any(-1)
    clipped = 1.0 - float(counts.mean())
    samples = eqx.tree_at(lambda s: s.pixels, samples, samples.pixels[counts])
    if not counts.any():
        return np.zeros((len(unknowns),) * 2), clipped
    number = int(counts.sum())
    problem = fit_problem(
        scene,
        [view],
        unknowns,
        [samples],
        Counts(1, number, number * view.image.shape[2], 0, 0),
        "squares",
        "exclude",
    )
    theta = jnp.asarray(coordinates(fit.values, unknowns))
    summaries = on_all_cores(lambda chunk: _summary(theta, problem.model, chunk), problem.chunks())
    H = np.asarray(_gram(theta, problem.model, total(summaries)).hessian).sum(0)
    slope = coordinate_slopes(fit.values, unknowns)
    # a robust loss gives the samples of a shot the weight that those of the views have on average
    count, _, _, _, weight = fit.evidence.spread
    return H * np.outer(slope, slope) * weight / count, clipped


@jax.jit
def _summary(theta: Array, model: AbstractForwardModel, chunk: Block) -> Any:
    return model.summary(theta, chunk)


@jax.jit
def _gram(theta: Array, model: AbstractForwardModel, summary: Any) -> Gram:
    return model.gram(theta, summary)


def _lit_by(fit: Fit, shot: Shot) -> tuple[Scene, tuple[int, ...] | None, list[Unknown]]:
    """Return the fitted scene with the shot's light, which light is on, and the unknowns with their places in it.

    An unknown of the views alone, such as their exposure, has no place in a shot.
    """
    new: dict[int, list[tuple[str, int]]] = {}
    scene, lit = fit.scene, fit.views[0].lit
    if shot.light is not None:
        number = len(scene.lights)
        light = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), shot.light)
        scene, lit = dataclasses.replace(scene, lights=(*scene.lights, light)), (number,)
        for leaf, holders in _holders(fit, light).items():
            if len(holders) == 1 and None not in holders:
                new.setdefault(holders.pop() or 0, []).append((f"lights.{number}.{leaf[0]}", leaf[1]))
    unknowns = [
        dataclasses.replace(u, places=[*(p for p in u.places if not p[0].startswith("views.")), *new.get(j, [])])
        for j, u in enumerate(fit.unknowns)
    ]
    return put_back(scene, (), unknowns, fit.values)[0], lit, unknowns


def _holders(fit: Fit, light: AbstractLight) -> dict[tuple[str, int], set[int | None]]:
    """Return for each number of a light which unknowns it is in the fit's lights of its kind, None where it is known.

    One unknown for all of them belongs to the lamp; the lights that no view has on say nothing.
    """
    on = {i for view in fit.views for i in lights_on(fit.scene, view)}
    same = [i for i in sorted(on) if type(fit.scene.lights[i]) is type(light)]
    holder = {place: j for j, u in enumerate(fit.unknowns) for place in u.places}
    return {
        (leaf, c): {holder.get((f"lights.{i}.{leaf}", c)) for i in same}
        for leaf, value, spec in quantities(light)
        if parameter_of(spec).role not in PLACED
        for c in range(np.size(value))
    }


def _with(evidence: Evidence, H: Matrix) -> Evidence:
    """Return the evidence with one cluster more, whose gradient is none: it is expected where the fit is."""
    zero, directions = null_directions(evidence.total + H)
    return dataclasses.replace(
        evidence,
        hessian=np.concatenate([evidence.hessian, H[None]]),
        gradient=np.concatenate([evidence.gradient, np.zeros((1, len(H)))]),
        determined=~zero & ~directions.any(0),
    )


def _information(fit: Fit, evidence: Evidence) -> tuple[int, float]:
    """Return the rank of the information about the unknowns inside their bounds, and its log det in relative units.

    Of a singular matrix the log det is that of the largest eigenvalues, as many as the rank: within what is determined.
    """
    inside = ~evidence.at_bound
    H = evidence.total[np.ix_(inside, inside)] / max(evidence.sigma2, 1e-300)
    A, lengths = scaled(H)
    w = np.linalg.eigvalsh(A)
    rank = int(np.sum(w > SINGULAR**2 * w.max(initial=0.0)))
    size = _sizes(fit)[inside]
    if rank == len(w):  # the scaled matrix has the better condition
        return rank, float(np.log(w).sum() + 2.0 * np.log(lengths * size).sum())
    largest = np.linalg.eigvalsh(H * np.outer(size, size))[len(w) - rank :]
    return rank, float(np.log(np.maximum(largest, 1e-300)).sum())


def _order(
    fit: Fit,
    names: Sequence[str],
    aimed: Bool[np.ndarray, " p"],
    errors: Float[np.ndarray, "shots p"],
    rank: Int[np.ndarray, " shots"],
    gain: Float[np.ndarray, " shots"],
) -> tuple[int, ...]:
    """Return the shots from the best on: by rank gained, then by the aim where there is one, else by log det.

    Where the views determine everything no shot gains rank. What differs by a rounding alone is a tie, which the names
    break.
    """

    def key(i: int) -> tuple:
        by = (0.0, -gain[i])
        if aimed.any():
            relative = (errors[i] / _sizes(fit))[aimed]
            known = np.isfinite(relative)
            by = (float(np.sum(~known)), float(np.sqrt(np.sum(relative[known] ** 2))))
        return (-int(rank[i]), by[0], float(f"{by[1]:.9g}"), names[i], i)

    return tuple(sorted(range(len(names)), key=key))


def _notes(
    fit: Fit,
    shots: Sequence[Shot],
    names: Sequence[str],
    order: Sequence[int],
    aimed: Bool[np.ndarray, " p"],
    now: Vector,
    errors: Float[np.ndarray, "shots p"],
    rank: Int[np.ndarray, " shots"],
    clipped: Float[np.ndarray, " shots"],
) -> list[str]:
    """Say what the first choice does, what no shot does, and what was taken for granted."""
    first, unknowns = order[0], fit.unknowns
    notes = []
    if (new := ~np.isfinite(now) & np.isfinite(errors[first])).any():
        notes.append(f"{names[first]} determines {_quantities(unknowns, new)}, which the views do not.")
    known = np.isfinite(now) & np.isfinite(errors[first]) & (now > 0)
    chosen = known & (aimed if aimed.any() else True)
    if chosen.any():
        ratio = float(np.exp(np.mean(np.log(errors[first][chosen] / now[chosen]))))
        what = _quantities(unknowns, chosen) if aimed.any() else "what the views determine"
        notes.append(f"with {names[first]} the errors of {what} are {ratio:.2g} times those of now.")
    never = np.array(~np.isfinite(errors).any(0))
    if never.any():
        fix = "it" if never.sum() == 1 else "one"
        notes.append(
            f"none of these shots determines {_quantities(unknowns, never)} (-). Fix {fix}, or plan with other lights, "
            "distances or cameras."
        )
    elif not np.isfinite(errors).all() or not np.isfinite(now).all():
        notes.append("an unknown that is not determined has - in place of an error.")
    limit = np.where(logarithms(unknowns), VAGUE_LOG, VAGUE)
    lost = (
        ~fit.determined
        & np.isfinite(errors[first])
        & (_shares(unknowns, fit.values, errors[first], fit.scales) > limit)
    )
    if lost.any():
        notes.append(f"with {names[first]} too {_quantities(unknowns, lost)} would be lost in the noise.")
    if rank.any():
        notes.append("new: directions that a shot determines and the views do not; they count first.")
    for i in order:
        if clipped[i] > MUCH:
            notes.append(
                f"{names[i]} would have {clipped[i]:.0%} of its pixels clipped; they do not count. Give it a shorter "
                "exposure."
            )
    own = {
        leaf
        for shot in shots
        if shot.light is not None
        for (leaf, _), holders in _holders(fit, shot.light).items()
        if len(holders) > 1
    }
    own |= {f"{u.kind} of a view" for u in unknowns if any(p.startswith("views.") for p, _ in u.places)}
    if own:
        notes.append(f"taken as known of a shot, though unknown in the views: {listing(sorted(own))}.")
    notes.append("errors are for independent noise of the fit's size; compare them with each other.")
    return notes


def _quantities(unknowns: Sequence[Unknown], which: Bool[np.ndarray, " p"]) -> str:
    return listing(list(dict.fromkeys(u.quantity for u, here in zip(unknowns, which, strict=True) if here)))


def _sizes(fit: Fit) -> Vector:
    """Return what each error is taken relative to: see `relative_errors`; 1 where a value has no size."""
    share = _shares(fit.unknowns, fit.values, np.ones(len(fit.values)), fit.scales)
    return np.where(share > 0, 1.0 / np.where(share > 0, share, 1.0), 1.0)


def _shares(unknowns: Sequence[Unknown], values: Vector, errors: Vector, scales: Vector) -> Vector:
    """Return errors relative to their values; 0 where a value has no size, being 0 or on both sides of it."""
    none = (values == 0) & np.array([np.isfinite(u.lower) for u in unknowns])  # not a vector's component
    return np.where(none, 0.0, relative_errors(unknowns, np.where(none, 1.0, values), errors, scales))


def _percent(share: float) -> str:
    percent = 100.0 * share
    return f"{percent:.2g} %" if percent < 99.5 else f"{percent:.0f} %" if percent < 1e6 else f"{percent:.0e} %"

"""Gauges: changes of several unknowns together that no pixel shows, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ...core.thresholds import NEGLIGIBLE
from ...core.words import MAX_NAMED, Note, listing
from ..unknowns.places import Place
from ..unknowns.unknown import Unknown, free_places

OF_ATTENUATION = ("attenuation", "amplitude")  # roles
SCALED = ("k_a", "k_d", "k_s")

Vector = Float[np.ndarray, " p"]


def sentence(direction: Vector, unknowns: Sequence[Unknown], values: Vector) -> str:
    """Say which unknowns a direction mixes, how they change together, and what to do about it."""
    names = quantities(unknowns, np.flatnonzero(direction))
    cannot, together, more = _gauge(direction, unknowns, values)
    amplitudes = [u.quantity for u in unknowns if u.parameter.role == "amplitude"]
    keys = ("exposure", "intensity", "ambient", "radius", "center")
    kinds = {unknown.quantity: unknown.kind for unknown in unknowns}
    simplest = [n for n in names if n in amplitudes] + [n for key in keys for n in names if kinds[n] == key]
    fix = (simplest or names[-1:])[0]
    if sum(kinds[name] == "intensity" for name in names) > 1:
        more += ", or give intensity_error, the relative error of the intensities as they are stated"
    return f"these views cannot separate {cannot}: {together}. Fix one, for example {fix}{more}."


def set_by_priors(
    directions: Float[np.ndarray, "m p"],
    covariance: Float[np.ndarray, "p p"],
    unknowns: Sequence[Unknown],
    values: Vector,
) -> list[Note]:
    """Return notes on what the priors alone decide, and how well the views know what does not depend on it.

    Args:
        directions: Along which no pixel changes, and which priors hold.
        covariance: Of all unknowns, 0 where one is held.
        unknowns: What was fitted.
        values: Their values.
    """
    notes = []
    for direction in directions:
        cannot, together, _ = _gauge(direction, unknowns, values)
        text = (
            f"without priors the views cannot separate {cannot}: {together}. The priors decide this, and the errors "
            f"contain their width.{_product(direction, covariance, unknowns, values)}"
        )
        notes.append(Note(text, "gauge", tuple(quantities(unknowns, np.flatnonzero(direction)))))
    return list(dict.fromkeys(notes))


def taken_as_exact(unknowns: Sequence[Unknown], lights: int, views: int) -> str:
    """Return a sentence on the lights' intensities if reflections are free and the intensities or exposures are not.

    All intensities times 1.3 and all reflections over 1.3 make the same images, and thin haze, which dims an object and
    adds light to it, those of weaker reflections and a larger k_a. With every intensity free, or every exposure, that
    is a gauge, which the fit names.

    Args:
        unknowns: Of the fit.
        lights: How many lights the scene has.
        views: How many views were fitted.
    """
    free = free_places(unknowns)
    names = [name for name in SCALED if any(place.fields == ("material", name) for place in free)]
    senders = (
        [Place("lights", i, ("intensity",)) for i in range(lights)],
        [Place("views", i, ("exposure",)) for i in range(views)],
    )
    if not names or any(of and free.issuperset(of) for of in senders):
        return ""
    scale, them = ("scales", "it") if len(names) == 1 else ("scale", "them")
    return (
        f"{listing(names)} {scale} inversely with the lights' intensities, which are taken as exact, and thin haze "
        f"would change {them}: no image can check these."
    )


def quantities(unknowns: Sequence[Unknown], which: Int[np.ndarray, " n"]) -> list[str]:
    """Return the names without their channels, each once."""
    return list(dict.fromkeys(unknowns[int(j)].quantity for j in which))


def of_attenuation(names: Sequence[str], unknowns: Sequence[Unknown]) -> list[str]:
    """Return those of the names that are numbers of an attenuation."""
    found = {unknown.quantity for unknown in unknowns if unknown.parameter.role in OF_ATTENUATION}
    return [name for name in names if name in found]


def listed(names: Sequence[str], unknowns: Sequence[Unknown]) -> str:
    """Return names in words, those of many lights or views together: "the intensity of lights 0 to 47"."""
    at = {u.quantity: places.pop() for u in unknowns if len(places := free_places([u])) == 1}
    kinds = {name: (at[name].owner, at[name].fields) for name in names if name in at}
    found: dict[str, None] = {}
    for name in names:
        owner, fields = kinds.get(name, ("", ()))
        of = sorted(at[other].item or 0 for other, kind in kinds.items() if kind == (owner, fields))
        what = ".".join(map(str, fields))
        if owner not in ("lights", "views") or len(of) <= MAX_NAMED:
            found[name] = None
        elif of == [*range(of[0], of[-1] + 1)]:
            found[f"the {what} of {owner} {of[0]} to {of[-1]}"] = None
        else:
            found[f"the {what} of {len(of)} {owner}"] = None
    return listing(list(found))


def _gauge(direction: Vector, unknowns: Sequence[Unknown], values: Vector) -> tuple[str, str, str]:
    """Return what is mixed, how it changes together, and one more remedy; pixels hold reflection light/attenuation."""
    involved = np.flatnonzero(direction)
    names = quantities(unknowns, involved)
    signs = np.array([unknowns[int(j)].parameter.gauge for j in involved])
    attenuation = of_attenuation(names, unknowns)
    lights = [name for name in quantities(unknowns, involved[signs < 0]) if name not in attenuation]
    reflections = [name for name in names if name not in (*lights, *attenuation)]
    if not reflections:
        signs = np.abs(signs)  # light and attenuation grow together
    factors = signs * direction[involved] / np.where(values[involved] == 0, np.inf, values[involved])
    alike = np.all(np.abs(factors - factors[0]) <= NEGLIGIBLE * np.abs(factors[0])) and factors[0] != 0
    if motion := _motion(direction, unknowns, values):
        return listed(names, unknowns), f"{motion} leaves every pixel unchanged", ""
    if not alike or (reflections and lights and attenuation):
        together = "they can be changed together without changing any pixel"
        return listed(names, unknowns), together, ", or add views from other distances or directions"
    if reflections and lights:
        together = "scaling the former up and the latter down by one factor leaves every pixel unchanged"
        return f"{listed(reflections, unknowns)} from {listed(lights, unknowns)}", together, ""
    kinds = [kind for kind in (reflections, lights, attenuation) if kind]
    together = "scaling all of them together leaves every pixel unchanged"
    return " from ".join(listed(kind, unknowns) for kind in kinds), together, ""


def _motion(direction: Vector, unknowns: Sequence[Unknown], values: Vector) -> str:
    """Return how places change together along a direction, as d = s x + t for each of them; "" for other changes."""
    moved = set(quantities(unknowns, np.flatnonzero(direction)))
    rows, changes = [], []
    for unknown, value, change in zip(unknowns, values, direction, strict=True):
        if unknown.parameter.role == "position" and unknown.channel:
            rows.append([value, *np.eye(3)["xyz".index(unknown.channel)]])
            changes.append(change)
        elif unknown.kind == "radius":
            rows.append([value, 0.0, 0.0, 0.0])
            changes.append(change)
        moved -= {unknown.quantity} if unknown.parameter.role == "position" or unknown.kind == "radius" else set()
    sent = {u.quantity for u in unknowns if u.parameter.role == "light"}
    if moved - sent or len(rows) <= 4 or not np.any(changes):
        return ""
    A, d = np.array(rows), np.array(changes)
    (s, *t), *_ = np.linalg.lstsq(A, d, rcond=None)
    if np.linalg.norm(A @ [s, *t] - d) > NEGLIGIBLE * np.linalg.norm(d):
        return ""
    if abs(s) * np.linalg.norm(A[:, 0]) <= NEGLIGIBLE * np.linalg.norm(d):
        return "" if moved else "moving them together by one vector"
    brighter = " and the intensities with the square of that" if moved else ""
    return f"scaling all places and sizes about one point{brighter}"


def _product(
    direction: Vector, covariance: Float[np.ndarray, "p p"], unknowns: Sequence[Unknown], values: Vector
) -> str:
    """Return how well k_d times the mean intensity is known, where a direction scales one against the other."""
    involved = np.flatnonzero(direction).tolist()
    diffuse = next((j for j in involved if unknowns[j].kind == "k_d"), None)
    if diffuse is None:
        return ""
    channel = unknowns[diffuse].channel
    sent = [j for j in involved if unknowns[j].kind == "intensity" and unknowns[j].channel in ("", channel)]
    if len(sent) < 2:
        return ""
    relative = np.zeros(len(values))
    relative[diffuse] = 1.0
    relative[sent] = values[sent] / values[sent].sum()
    relative = np.where(values == 0, 0.0, relative / np.where(values == 0, 1.0, values))
    error = float(np.sqrt(max(relative @ covariance @ relative, 0.0)))
    name = unknowns[diffuse].name
    return f" {name} times the mean intensity does not depend on them, and is known to {100.0 * error:.2g} %."

"""Names: what users type, runs of whole segments of paths, and which places they mean. Nothing else parses a name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ...core.words import did_you_mean
from .places import Place
from .unknown import Named


def segments_of(name: str) -> list[str]:
    """Return the segments of a name: of `material.k_d`, material and k_d."""
    return name.split(".")


def rest_after(name: str, place: Place) -> str | None:
    """Return what follows a name in the path of a place, "" at its end; None where the name is no run of segments."""
    if name == "ambient" != place.path:  # the scene's is named by its whole path; a light's own is lights.0.ambient
        return None
    _, found, rest = f".{place.path}.".partition(f".{name}.")
    return rest.removesuffix(".") if found else None


def means(name: str, place: Place) -> bool:
    """Whether a name means a place."""
    return rest_after(name, place) is not None


def is_named(name: str, number: Named) -> bool:
    """Whether a name means a number: as the factor that it is, or at a place, with its channel after it or without."""
    head, _, last = name.rpartition(".")
    heads = (name, head) if last == number.channel != "" else (name,)
    return name == number.quantity or any(means(of, place) for of in heads for place in number.places)


def names_of(where: str, names: Any, known: Iterable[Place]) -> tuple[str, ...]:
    """Return the names as typed, one or several; refuse those that mean no place, and say which may be meant."""
    names = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, Iterable) else (names,)
    segments = {segment for place in known for segment in place.segments if not segment.isdigit()}
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"{where} must hold names of parameters; got {name!r}. Give for example 'k_d'.")
        if "," in name:
            several = tuple(part.strip() for part in name.split(",") if part.strip())
            raise ValueError(f"{where} has several names in one, '{name}'. Give a tuple of names: {several}.")
        if all(segment.isdigit() for segment in segments_of(name)):
            raise ValueError(
                f"{where} names '{name}', a number alone. Name what it counts, for example 'lights.{name}'."
            )
        if not any(means(name, place) for place in known):
            head, _, last = name.rpartition(".")
            of_a_material = head.endswith("material") and any(means(head, place) for place in known)
            # which a scene has only where they are given
            if last in ("k_t", "eta") and (of_a_material or last not in segments):
                raise ValueError(
                    f"{where} names '{name}', but no such material has one. Give it, for example {last}="
                    f"{'0.5' if last == 'k_t' else '1.5'}."
                )
            short = {".".join(place.segments[1:]) for place in known}  # ball.material.k_d
            options = segments | {place.path for place in known} | {of for of in short if of and not of[0].isdigit()}
            if fuller := [path for path in options if _holds_in_order(name, path)]:
                raise ValueError(f"no parameter is named '{name}'. Did you mean '{min(fuller, key=len)}'?")
            raise ValueError(f"no parameter is named '{name}'. {did_you_mean(name, options)}")
    return names


def _holds_in_order(name: str, path: str) -> bool:
    """Whether a path has all segments of a name in their order: `ball.material.k_d` those of `ball.k_d`."""
    rest = iter(segments_of(path))
    return all(segment in rest for segment in segments_of(name))


def tied_name(names: Sequence[str], place: Place) -> str:
    """Return the name that a place shares with those tied to it, a name of `tied` and what follows it; or its path."""
    for name in names:
        if (rest := rest_after(name, place)) is not None:
            return f"{name}.{rest}" if rest else name
    return place.path


def short_names(quantities: Iterable[tuple[str, Sequence[Place]]], known: Iterable[Place]) -> list[str]:
    """Return for each name its last segments, as few as mean its own places alone among all that are known."""
    every = _lines(known)
    found = []
    for quantity, places in quantities:
        segments, own = segments_of(quantity), _lines(places)
        runs = [".".join(segments[k:]) for k in reversed(range(len(segments))) if not segments[k].isdigit()]
        alone = (run for run in runs if every.count(f".{run}.") == own.count(f".{run}."))
        found.append(next(alone, quantity))
    return found


def _lines(places: Iterable[Place]) -> str:
    return "\n".join({f".{place}." for place in places})

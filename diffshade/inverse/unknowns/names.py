"""Names: dotted paths of a scene's numbers, and which of them a name means."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ...core.fields import Array, parameter_of, quantities
from ...core.words import did_you_mean
from ...model.scenes import Scene
from ..data.views import View
from .unknown import Unknown

OF_RGB = ("red", "blue")  # gains of a sensor, which other bands have none of
PER_VIEW = ("exposure", "black")  # numbers of a view itself that can be free


def everything(scene: Scene, views: Sequence[View]) -> Iterator[tuple[str, Array, dataclasses.Field]]:
    """Yield every number, vector and colour that can be unknown: its dotted path, its value and its field."""
    for path, value, spec in quantities(scene):
        yield path_with_names(path, scene), value, spec
    fields = {spec.name: spec for spec in dataclasses.fields(View)}
    for i, view in enumerate(views):
        for name in PER_VIEW:
            yield f"views.{i}.{name}", getattr(view, name), fields[name]
        if view.sensor is not None:
            whole = quantities(view.sensor, f"views.{i}.sensor")
            yield from (of for of in whole if not scene.bands or of[2].name not in OF_RGB)


def path_name(path: Any, scene: Scene) -> str:
    """Return the dotted path of a leaf, from the key path that JAX gives it."""
    return path_with_names(jax.tree_util.keystr(path, simple=True, separator="."), scene)


def path_with_names(path: str, scene: Scene) -> str:
    """Return a dotted path with an object's own name, where it has one, in place of its number."""
    head, _, rest = path.partition(".")
    number, _, rest = rest.partition(".")
    name = scene.objects[int(number)].name if head == "objects" else ""
    return f"objects.{name}.{rest}" if name else path


def numbers_of(value: Array, spec: dataclasses.Field) -> Float[np.ndarray, " n"]:
    """Return the numbers of a value; of a direction those of the unit vector, the only part that has a meaning."""
    numbers = np.ravel(np.asarray(value, np.float64))
    return numbers / np.linalg.norm(numbers) if parameter_of(spec).role == "direction" else numbers


def check_names(where: str, names: Iterable[str], known: Mapping[str, Any]) -> tuple[str, ...]:
    """Check that each name is a run of segments of some path."""
    names = (names,) if isinstance(names, str) else tuple(names) if isinstance(names, Iterable) else (names,)
    segments = {segment for path in known for segment in path.split(".") if not segment.isdigit()}
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"{where} must hold names of parameters; got {name!r}. Give for example 'k_d'.")
        if all(segment.isdigit() for segment in name.split(".")):
            raise ValueError(
                f"{where} names '{name}', a number alone. Name what it counts, for example 'lights.{name}'."
            )
        if not any(end_of_run(name, path) is not None for path in known):
            head, _, last = name.rpartition(".")
            of_a_material = head.endswith("material") and any(end_of_run(head, path) is not None for path in known)
            # which a scene has only where they are given
            if last in ("k_t", "eta") and (of_a_material or last not in segments):
                raise ValueError(
                    f"{where} names '{name}', but no such material has one. Give it, for example {last}="
                    f"{'0.5' if last == 'k_t' else '1.5'}."
                )
            short = {path.partition(".")[2] for path in known}  # ball.material.k_d
            options = segments | set(known) | {path for path in short if path and not path[0].isdigit()}
            if fuller := [path for path in options if _holds_in_order(name, path)]:
                raise ValueError(f"no parameter is named '{name}'. Did you mean '{min(fuller, key=len)}'?")
            raise ValueError(f"no parameter is named '{name}'. {did_you_mean(name, options)}")
    return names


def _holds_in_order(name: str, path: str) -> bool:
    """Whether a path has all segments of a name in their order: `ball.material.k_d` those of `ball.k_d`."""
    rest = iter(path.split("."))
    return all(segment in rest for segment in name.split("."))


def end_of_run(name: str, path: str) -> int | None:
    """Return where the run of segments `name` ends in a path, or None where it is no part of it."""
    if name == "ambient" != path:  # the scene's is named by its whole path; a light's own is lights.0.ambient
        return None
    run, segments = name.split("."), path.split(".")
    for start in range(len(segments) - len(run) + 1):
        if segments[start : start + len(run)] == run:
            return start + len(run)
    return None


def concerns(name: str, unknown: Unknown, path: str) -> bool:
    """Whether a name means an unknown at a path: a run of the path, with the unknown's channel after it or without."""
    own = unknown.name[len(unknown.quantity) + 1 :]  # r of k_d.r
    of_one = bool(own) and name.endswith(f".{own}") and end_of_run(name[: -len(own) - 1], path) is not None
    return of_one or end_of_run(name, path) is not None


def ratio_name(unknown: Unknown, known: Mapping[str, Any]) -> str:
    """Return the short name of an unknown factor, `k_s/k_d`."""
    return "/".join(short_name(name, list(known)) for name in unknown.quantity.split("/")) if not unknown.places else ""


def tied_name(name: str, path: str) -> str | None:
    """Return the name of what a path is tied to by a name: the name, and what follows its run; None without a run."""
    end = end_of_run(name, path)
    return None if end is None else ".".join([name, *path.split(".")[end:]])


def shorten(unknowns: Sequence[Unknown], paths: Sequence[str]) -> None:
    """Shorten each name to its last segments, as few as still name this quantity alone among the scene's paths."""
    holders = _holders(paths)
    for unknown in unknowns:
        if not unknown.places:
            unknown.name = unknown.quantity = "/".join(short_name(name, paths) for name in unknown.quantity.split("/"))
            continue
        own = {path for path, _ in unknown.places}
        segments = unknown.quantity.split(".")
        for k in range(1, len(segments) + 1):
            run = ".".join(segments[-k:])
            if segments[-k].isdigit():
                continue
            if holders[run] <= own:
                unknown.name = run + unknown.name[len(unknown.quantity) :]
                unknown.quantity = run
                break


def _holders(paths: Sequence[str]) -> Mapping[str, set[str]]:
    """Return for each run of segments the paths that hold it."""
    found: dict[str, set[str]] = {}
    for path in paths:
        segments = path.split(".")
        for start, end in itertools.combinations(range(len(segments) + 1), 2):
            found.setdefault(".".join(segments[start:end]), set()).add(path)
    return found


def short_name(path: str, paths: Sequence[str]) -> str:
    """Return the last segments of a path, as few as still name it alone."""
    segments = path.split(".")
    runs = (".".join(segments[-k:]) for k in range(1, len(segments) + 1) if not segments[-k].isdigit())
    return next((run for run in runs if all(p == path or end_of_run(run, p) is None for p in paths)), path)

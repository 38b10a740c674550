"""Parameters: the unknowns of a fit, found from the names that are free, tied, bounded, constrained and known."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

from ...core.fields import as_exponent, as_vector, check_kind, is_over_pixels, parameter_of
from ...model.flaps import LIMITS
from ...model.fresnel import Dielectric
from ...model.gbuffers import GBuffer
from ...model.patterns import Texture
from ...model.scenes import Scene, bends
from ..data.views import View
from .constraints import COLOURS, Grey, Proportional, colourless, has_factor, make_proportional, proportions_of
from .light_priors import set_direction_priors, set_intensity_priors, stated_errors
from .names import check_names, end_of_run, everything, numbers_of, path_with_names, shorten, tied_name
from .ranges import check_directions, check_names_an_unknown, prior_of, set_range
from .unknown import Unknown
from .visibility import views_that_show


def find_unknowns(
    scene: Scene,
    views: Sequence[View],
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    constraints: Sequence[Grey | Proportional] = (),
    priors: Mapping[str, Sequence[Any]] | None = None,
    light_error: Float[ArrayLike, " lights"] | float | None = None,
    intensity_error: Float[ArrayLike, " lights"] | float | None = None,
    *,
    from_scene: bool = False,
    grey: bool = False,
    with_dark_lights: bool = False,
) -> list[Unknown]:
    """Return the unknowns that `free` names, in the scene's order.

    A name is any run of whole segments of a dotted path (`k_d`, `material.k_d`, `objects.0`, `views.0.exposure`), but
    `ambient` is the scene's alone.

    Args:
        scene: The scene, whose values are known where they are not free.
        views: The photographs.
        free: Names of what is to be fitted. Fields whose `Parameter.by_own_name` is set, such as `constant`, the
            amplitude of an attenuation, are freed only by a name that holds their own.
        tied: Names; free numbers whose paths are equal after the matched run are one unknown, channel by channel.
        bounds: Ranges by name.
        constraints: What else is known.
        priors: Values and standard deviations by name.
        light_error: Standard deviation of the directions of all lights, or of each, degrees.
        intensity_error: Relative standard deviation of the intensities of all lights, or of each.
        from_scene: Whether all start at the scene's values.
        grey: Whether the channels of each colour are one unknown.
        with_dark_lights: Whether unknowns of lights that are on in no view count; else they are left out.

    Raises:
        ValueError: For a name that matches nothing, a contradictory bound, constraint or prior, or a cutoff whose edge
            is hard.
    """
    known = {path: (value, spec) for path, value, spec in everything(scene, views)}
    _check_object_names(scene, known)
    free = tuple(free) if isinstance(free, Iterable) and not isinstance(free, str) else (free,)
    _refuse_arrays(scene, free, known)
    free, tied = check_names("free", free, known), check_names("tied", tied, known)
    bounds, priors = bounds or {}, priors or {}
    check_kind("bounds", bounds, Mapping, "{'k_s': (0, 1)}")
    check_kind("priors", priors, Mapping, "{'n_s': (50, 0.2)}")
    freed = _freed(scene, free, known)
    one_channel = colourless(constraints, freed, known)
    proportions = proportions_of(constraints, freed, known)
    _check_are_free("tied", tied, freed, known)
    _check_are_free("constraints", [c.name for c in constraints if not has_factor(c)], freed, known)
    found: dict[tuple[str, int], Unknown] = {}
    for path in freed:
        if path not in proportions:
            _check_can_be_free(path, known)
            one = grey or path in one_channel
            _add(found, path, known, tied, scene.channels, one_channel=one, from_scene=from_scene)
    if not with_dark_lights:
        _leave_out_dark_lights(found, free, scene, views)
    unknowns = list(found.values())
    for path, (to, factor) in proportions.items():
        unknowns += make_proportional(path, to, factor, unknowns, known, from_scene=from_scene)
    for where, names in (("bounds", bounds), ("priors", priors)):
        for name in names:
            check_names_an_unknown(where, name, unknowns, freed, proportions, known)
    shorten(unknowns, list(known))
    for unknown in unknowns:
        set_range(unknown, bounds, known)
        unknown.prior = prior_of(unknown, priors)
    stated = stated_errors(scene, light_error, intensity_error)
    if stated.direction is not None:
        set_direction_priors(unknowns, scene, stated.direction)
    if stated.intensity is not None:
        set_intensity_priors(unknowns, scene, stated.intensity)
    check_directions(unknowns)
    return unknowns


def _leave_out_dark_lights(
    found: dict[tuple[str, int], Unknown], free: Sequence[str], scene: Scene, views: Sequence[View]
) -> None:
    """Leave out what belongs to lights alone that are on in no view; raise ValueError for a name of nothing else."""
    shows = views_that_show(scene, views, list(found.values()))
    of_lights = [all(path.startswith("lights.") for path, _ in unknown.places) for unknown in found.values()]
    dark = [key for key, shown, here in zip(found, shows, of_lights, strict=True) if here and not shown.any()]
    for name in free:
        named = [key for key, u in found.items() if any(end_of_run(name, path) is not None for path, _ in u.places)]
        if named and set(named) <= set(dark):
            raise ValueError(
                f"{name} cannot be freed: its light is on in no view. Give the views `lit`, or leave it out."
            )
    for key in dark:
        del found[key]


def _refuse_arrays(scene: Scene, free: Iterable[str], known: Mapping[str, Any]) -> None:
    """Refuse names of coefficients that are arrays, where they name nothing else."""
    arrays = [
        f"objects.{item.name or i}.material.{name}"
        for i, item in enumerate(scene.objects)
        for name, of in item.material.coefficients.items()
        if is_over_pixels(of) or isinstance(of, Texture)
    ]
    for name in free:
        if not isinstance(name, str) or any(end_of_run(name, path) is not None for path in known):
            continue
        for path in arrays:
            if end_of_run(name, path) is not None:
                raise ValueError(
                    f"free names '{name}', but {path} is an array, which fit leaves as it is. Use fit_texels for a "
                    "value at every pixel, or minimise an objective of your own."
                )


def _add(
    found: dict[tuple[str, int], Unknown],
    path: str,
    known: Mapping[str, Any],
    tied: Sequence[str],
    of_colours: Sequence[str],
    *,
    one_channel: bool,
    from_scene: bool,
) -> None:
    """Add the unknowns of a path, or its places to those that it is tied to."""
    value, spec = known[path]
    converter = spec.metadata["converter"]
    colour = converter in COLOURS or (converter is as_exponent and np.ndim(value) == 1)
    channels = of_colours if colour else "xyz" if converter is as_vector else ""
    quantity = next((n for name in tied if (n := tied_name(name, path))), path)
    one = not channels or (colour and one_channel)
    for c, number in enumerate(numbers_of(value, spec)):
        unknown = found.setdefault(
            (quantity, 0 if one else c),
            Unknown(
                name=quantity if one else f"{quantity}.{channels[c]}",
                quantity=quantity,
                lower=-np.inf,
                upper=np.inf,
                start=float(number) if from_scene else _start(path, number, known),
                parameter=parameter_of(spec),
            ),
        )
        unknown.places.append((path, c))


def _check_are_free(where: str, names: Sequence[str], freed: Sequence[str], known: Mapping[str, Any]) -> None:
    """Refuse names that match nothing free."""
    for name in check_names(where, names, known):
        if not any(end_of_run(name, path) is not None for path in freed):
            raise ValueError(f"{where} names '{name}', which is not free. Add it to free, or leave it out.")


def _frees(name: str, path: str, spec: dataclasses.Field) -> bool:
    last = path.split(".")[-1]
    return end_of_run(name, path) is not None and (not parameter_of(spec).by_own_name or last in name.split("."))


def _freed(scene: Scene, free: Sequence[str], known: Mapping[str, Any]) -> list[str]:
    """Return the paths that names free; refuse those that cannot be free for what the scene holds."""
    freed = [path for path in known if any(_frees(name, path, known[path][1]) for name in free)]
    gbuffer = any(isinstance(item.surface, GBuffer) for item in scene.objects)
    for i, item in enumerate(scene.objects):
        k_s, eta = (path_with_names(f"objects.{i}.material.{last}", scene) for last in ("k_s", "eta"))
        if isinstance(item.material.fresnel, Dielectric) and k_s in freed:
            if any(_frees(name, k_s, known[k_s][1]) and "k_s" in name.split(".") for name in free):
                raise ValueError(
                    f"{k_s} cannot be freed beside fresnel=Dielectric(), whose W follows from eta. Free eta instead, "
                    "or name the other k_s by their whole paths."
                )
            freed.remove(k_s)
        if gbuffer and bends(item) and eta in freed:
            raise ValueError(
                f"{eta} cannot be freed in a scene with a GBuffer, which glass does not bend. Leave eta out, or fit "
                "without the GBuffer."
            )
    return freed


def _start(path: str, number: float, known: Mapping[str, Any]) -> float:
    of, head = parameter_of(known[path][1]), path.rpartition(".")[0]
    if of.role == "attenuation" and of.start == 0:
        beside = [known[other] for other in known if other.rpartition(".")[0] == head]
        if any(parameter_of(spec).role == "amplitude" and not value > 0 for value, spec in beside):
            return 1.0  # with all numbers of the law at 0 it would divide by 0
    return float(number if of.start is None else of.start)


def _check_object_names(scene: Scene, known: Iterable[str]) -> None:
    """Refuse an object's name that names a parameter."""
    for item in scene.objects:
        if item.name and any(item.name in (p.split(".")[0], *p.split(".")[2:]) for p in known):
            raise ValueError(f"an object is named '{item.name}', which is a parameter's name. Rename it.")


def _check_can_be_free(path: str, known: Mapping[str, Any]) -> None:
    head, _, last = path.rpartition(".")
    softness = known.get(f"{head}.softness")
    unit = "degrees" if last == "cutoff" else "scene units" if last in LIMITS else ""
    if unit and softness is not None and not softness[0] > 0:
        raise ValueError(
            f"{path} cannot be freed while softness is 0: a hard edge has no derivative. Give {head}.softness, in "
            f"{unit}, at least two pixels wide."
        )

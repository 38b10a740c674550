"""Parameters: the unknowns of a fit, found from the names that are free, tied, bounded, constrained and known."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

from ...core.fields import Parameter, as_exponent, as_vector, check_kind, is_over_pixels, parameter_of
from ...core.thresholds import SINGLE
from ...model.flaps import LIMITS
from ...model.fresnel import Dielectric
from ...model.gbuffers import GBuffer
from ...model.patterns import Texture
from ...model.scenes import Scene, bends
from ..data.views import View, lights_on
from .constraints import COLOURS, Grey, Proportional, colourless, products_of, proportions_of
from .light_priors import stated_errors
from .names import means, names_of, segments_of, short_names, tied_name
from .places import Known, Place, everything
from .ranges import check_directions, check_names_an_unknown, prior_of, range_of
from .slots import value_in
from .unknown import Named, Product, Unknown

_LOGGER = logging.getLogger("diffshade")


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
        ValueError: For no name, or one that matches nothing, a contradictory bound, constraint or prior, or a cutoff
            whose edge is hard.
    """
    known: Known = {place: (value, spec) for place, value, spec in everything(scene, views)}
    _check_object_names(scene, known)
    free = tuple(free) if isinstance(free, Iterable) and not isinstance(free, str) else (free,)
    _refuse_arrays(scene, free, known)
    free, tied = names_of("free", free, known), names_of("tied", tied, known)
    bounds, priors = bounds or {}, priors or {}
    check_kind("bounds", bounds, Mapping, "{'k_s': (0, 1)}")
    check_kind("priors", priors, Mapping, "{'n_s': (50, 0.2)}")
    freed = _freed(scene, free, known)
    one_channel = colourless(constraints, freed, known)
    proportions = proportions_of(constraints, freed, known)
    _check_are_free("tied", tied, freed, known)
    _say_what_ties_nothing(tied, freed)
    _check_are_free("constraints", [c.name for c in constraints if getattr(c, "factor", None) is None], freed, known)
    own = [place for place in freed if place not in proportions]
    found = _named(own, set(freed) if grey else one_channel, tied, scene.channels, known)
    if not with_dark_lights:
        found = _without_dark_lights(found, free, scene, views)
    factors = [(place, to) for place, (to, factor) in proportions.items() if factor is None]
    for pair in factors:
        name = "/".join(short_names([(of.path, [of]) for of in pair], known))
        found.append(Named(name, "", (), Parameter("factor", start=1.0)))
    for where, names in (("bounds", bounds), ("priors", priors)):
        for name in names:
            check_names_an_unknown(where, name, found, proportions, known)
    errors = stated_errors(scene, light_error, intensity_error)
    unknowns = []
    for number, products in zip(found, products_of(proportions, found, known), strict=True):
        start = value_in(scene, views, number, products)
        start = start if from_scene and not np.isnan(start) else _start(number, start, known)
        unknowns.append(_unknown(number, products, start, known, bounds, priors, errors))
    if not unknowns:
        raise ValueError(
            "free must name at least one parameter; got none. Give for example free=('k_d', 'k_s', 'n_s')."
        )
    check_directions(unknowns)
    return unknowns


def _named(
    freed: Iterable[Place], grey: Collection[Place], tied: Sequence[str], of_colours: Sequence[str], known: Known
) -> list[Named]:
    """Return the numbers of the places that are free, those that are tied as one, with their short names."""
    found: dict[tuple[str, int], tuple[str, list[Place]]] = {}
    for place in freed:
        _check_can_be_free(place, known)
        value, spec = known[place]
        converter = spec.metadata["converter"]
        colour = converter in COLOURS or (converter is as_exponent and np.ndim(value) == 1)
        channels = of_colours if colour else "xyz" if converter is as_vector else ""
        one = not channels or (colour and place in grey)
        for c in range(np.size(value)):
            of_one = found.setdefault((tied_name(tied, place), 0 if one else c), ("" if one else channels[c], []))
            of_one[1].append(place.at(c))
    short = short_names([(quantity, places) for (quantity, _), (_, places) in found.items()], known)
    return [
        Named(name, channel, tuple(places), parameter_of(known[places[0].whole][1]))
        for name, (channel, places) in zip(short, found.values(), strict=True)
    ]


def _without_dark_lights(
    found: Sequence[Named], free: Sequence[str], scene: Scene, views: Sequence[View]
) -> list[Named]:
    """Leave out what belongs to lights alone that are on in no view; raise ValueError for a name of nothing else."""
    on = {i for view in views for i in lights_on(scene, view)}
    dark = {of for of in found if all(place.owner == "lights" and place.item not in on for place in of.places)}
    for name in free:
        named = {of for of in found if any(means(name, place) for place in of.places)}
        if named and named <= dark:
            raise ValueError(
                f"{name} cannot be freed: its light is on in no view. Give the views `lit`, or leave it out."
            )
    return [of for of in found if of not in dark]


def _start(number: Named, value: float, known: Known) -> float:
    """Return where a number starts that does not start at its value in the scene."""
    of = number.parameter
    if of.role == "attenuation" and of.start == 0:
        beside = [known[other] for other in known if other.holder == number.places[0].holder]
        if any(parameter_of(spec).role == "amplitude" and not value > 0 for value, spec in beside):
            return 1.0  # with all numbers of the law at 0 it would divide by 0
    return value if of.start is None else of.start


def _unknown(
    number: Named,
    products: Sequence[Product],
    start: float,
    known: Known,
    bounds: Mapping[str, Sequence[float | int]],
    priors: Mapping[str, Sequence[Any]],
    errors: Mapping[Place, float],
) -> Unknown:
    """Return a number with all that is known of it beforehand; `errors` are those of the lights."""
    of = number.parameter
    lower, upper = range_of(number, bounds, known)
    prior = prior_of(number, (lower, upper), priors)
    error = errors.get(number.places[0].whole) if number.places else None
    if error == 0.0:
        stated = "intensity_error" if number.kind == "intensity" else "light_error"
        raise ValueError(
            f"{number.name} is free, but {stated} says that it is exact: 0. Give an error above 0, or do not free it."
        )
    if error is not None and number.kind == "intensity":
        if not start > 0.0:
            raise ValueError(
                f"{number.name} is {start:g}, of which no error is relative. Give that light an intensity above 0, or "
                "leave intensity_error out."
            )
        # the mean of intensities with relative errors would pull the scale of all to their low side, that of their
        # logarithms does not
        of, lower = dataclasses.replace(of, logarithmic=True), max(lower, SINGLE * start)  # its logarithm is finite
        prior = (float(np.log(start)), error)
    start = float(np.clip(start, lower, upper))
    if error is not None and prior is None:
        prior = (start, error)
    return Unknown(number.quantity, number.channel, number.places, of, lower, upper, start, tuple(products), prior)


def _refuse_arrays(scene: Scene, free: Iterable[str], known: Known) -> None:
    """Refuse names of coefficients that are arrays, where they name nothing else."""
    arrays = [
        Place("objects", i, ("material", name), name=item.name)
        for i, item in enumerate(scene.objects)
        for name, of in item.material.coefficients.items()
        if is_over_pixels(of) or isinstance(of, Texture)
    ]
    for name in (name for name in free if isinstance(name, str)):
        array = next((place for place in arrays if means(name, place)), None)
        if array is not None and not any(means(name, place) for place in known):
            raise ValueError(
                f"free names '{name}', but {array} is an array, which fit leaves as it is. Use fit_texels for a "
                "value at every pixel, or minimise an objective of your own."
            )


def _check_are_free(where: str, names: Sequence[str], freed: Sequence[Place], known: Known) -> None:
    """Refuse names that match nothing free."""
    for name in names_of(where, names, known):
        if not any(means(name, place) for place in freed):
            raise ValueError(f"{where} names '{name}', which is not free. Add it to free, or leave it out.")


def _say_what_ties_nothing(tied: Sequence[str], freed: Sequence[Place]) -> None:
    """Say which names are of one object alone; of lamps and views a program may have any number."""
    for name in tied:
        owners = [(place.owner, place.item) for place in freed if means(name, place)]
        if len(owners) == 1 and owners[0][0] == "objects":
            _LOGGER.warning(
                "tied names '%s', which one object alone has: nothing is tied. It makes objects alike, not channels.",
                name,
            )


def _frees(name: str, place: Place, known: Known) -> bool:
    return means(name, place) and (not parameter_of(known[place][1]).by_own_name or place.field in segments_of(name))


def _freed(scene: Scene, free: Sequence[str], known: Known) -> list[Place]:
    """Return the places that names free; refuse those that cannot be free for what the scene holds."""
    freed = [place for place in known if any(_frees(name, place, known) for name in free)]
    gbuffer = any(isinstance(item.surface, GBuffer) for item in scene.objects)
    for i, item in enumerate(scene.objects):
        k_s, eta = (Place("objects", i, ("material", of), name=item.name) for of in ("k_s", "eta"))
        if isinstance(item.material.fresnel, Dielectric) and k_s in freed:
            if any(means(name, k_s) and "k_s" in segments_of(name) for name in free):
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


def _check_object_names(scene: Scene, known: Iterable[Place]) -> None:
    """Refuse an object's name that names a parameter."""
    fields = {of for place in known for of in (place.segments[0], *place.fields)}
    for item in scene.objects:
        if item.name in fields:
            raise ValueError(f"an object is named '{item.name}', which is a parameter's name. Rename it.")


def _check_can_be_free(place: Place, known: Known) -> None:
    """Refuse a cutoff, or a flap, whose edge is hard."""
    softness = place.beside("softness")
    unit = "degrees" if place.field == "cutoff" else "scene units" if place.field in LIMITS else ""
    if unit and softness in known and not known[softness][0] > 0:
        raise ValueError(
            f"{place} cannot be freed while softness is 0: a hard edge has no derivative. Give {softness}, in {unit}, "
            "at least two pixels wide."
        )

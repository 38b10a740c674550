"""Fault words: what the sentences of the table of faults say of one that was found."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int

from ...core.thresholds import SLIGHT, SMALL, VAGUE
from ...core.words import MAX_NAMED, listing
from ...model.cameras import camera_axes
from ...model.lobes import Blinn
from ..data.relightable import dome
from ..statistics.identifiability import some_channels
from ..unknowns.unknown import coordinate_slopes
from . import changes, other_scenes
from .found import Found


def of_exposure(f: Found) -> dict[str, Any]:
    """Return what predicts the view otherwise, and its exposure."""
    count = len(f.given.views)
    others = f"views[{1 - f.which}] predicts (or the other view is wrong by the inverse factor)"
    return {
        "others": others if count == 2 else "the other views predict" if count > 2 else "the scene predicts",
        "exposure": f.size * float(f.given.views[f.which].exposure),
    }


def of_light(f: Found) -> dict[str, Any]:
    """Return which part of the light places it, and where that is about."""
    light = (f.given if f.after is None else f.after.fit).scene.lights[f.which]
    return {"place": light.placement[0], "near": _vector(getattr(light, light.placement[0]), ".3g")}


def of_lobe(f: Found) -> dict[str, Any]:
    """Return the material's lobe and the other one."""
    is_blinn = isinstance(f.given.scene.objects[f.which].material.lobe, Blinn)
    return {"own": "Blinn", "other": "Phong"} if is_blinn else {"own": "Phong", "other": "Blinn"}


def of_viewer(f: Found) -> dict[str, Any]:
    """Return whose highlights these are, and what `local_viewer` is of theirs."""
    is_local = f.given.views[0].camera.local_viewer
    far = "who is far away, as for parallel rays and, by default, in OpenGL, not of one at the camera's eye"
    return {"where": far if is_local else "at the camera's eye, not of one who is far away", "local": not is_local}


def of_highlight(f: Found) -> dict[str, Any]:
    """Return whether the second highlight is wider or sharper, its n_s, and what to free before."""
    factor = other_scenes.EXPONENT_FACTORS[f.which]
    n_s = factor * shared_exponent(f)
    known = not any(place.field == "n_s" for unknown in f.given.unknowns for place in unknown.all_places)
    free = "Free 'n_s', which is known in this fit. Or: " if known else ""
    return {"wider": "sharper" if factor > 1 else "wider", "n_s": n_s, "free": free}


def shared_exponent(f: Found) -> float:
    """Return the mean n_s of the first material that shines."""
    shiny = (x.material.n_s for x in f.given.scene.objects if other_scenes.shines(x.material.k_s))
    return float(np.mean(np.asarray(next(shiny))))


def by_colour(f: Found) -> dict[str, Any]:
    """Return n_s of each channel."""
    n_s = f.given.values[f.which] * np.exp(f.amount)
    few = len(n_s) <= MAX_NAMED
    return {"n_s": _vector(n_s, ".3g") if few else f"({n_s[0]:.3g}, ..., {n_s[-1]:.3g})"}


def of_sphere(f: Found) -> dict[str, Any]:
    """Return the sphere's name, its radius as given, and its radius and centre as they seem to be."""
    item = f.given.scene.objects[f.which]
    sphere: Any = item.surface
    return {
        "surface": f"objects.{item.name or f.which}.surface",
        "given": float(sphere.radius),
        "radius": float(sphere.radius) + f.size,
        "center": _vector(np.asarray(sphere.center) + f.amount, ".3g"),
    }


def of_rotation(f: Found) -> dict[str, Any]:
    """Return the axis of the turn, and what of the lights to free."""
    places = [n for n in ("direction", "position") if any(hasattr(light, n) for light in f.given.scene.lights)]
    return {
        "axis": _vector(f.amount / max(f.length, 1e-300), ".2g"),
        "places": listing([f"'{name}'" for name in places]),
    }


def of_black(f: Found) -> dict[str, Any]:
    """Return which pixels are brighter, and what to subtract."""
    if np.ptp(f.amount) <= VAGUE * f.size:
        even = f"{np.mean(f.amount):.2g}"
        return {"pixels": f"all pixels are {even}", "remedy": f"Give View(black={even})"}
    channels = f.given.scene.channels
    levels = np.where(np.abs(f.amount) > SMALL * f.size, f.amount, 0.0)
    if len(levels) > MAX_NAMED:
        return {"pixels": f"the channels are up to {f.size:.2g}", "remedy": "Subtract the level of each channel"}
    said = [f"{colour(name)} is {x:.2g}" for name, x in zip(channels, levels, strict=False) if x > 0.0]
    return {"pixels": listing(said), "remedy": f"Subtract {_vector(levels, '.2g')} from the images"}


def colour(channel: str) -> str:
    """Return a channel's name in words."""
    return {"r": "red", "g": "green", "b": "blue"}.get(channel, channel)


def of_elsewhere(f: Found) -> dict[str, Any]:
    """Return which normal, of those that the camera may see, gets most of the light, and how much more than another."""
    normals = dome(500, 0.0) @ np.stack(camera_axes(f.given.views[0].camera))
    gets = other_scenes.harmonics(normals) @ f.amount
    return {"toward": _vector(normals[np.argmax(gets)], ".2g"), "more": float(np.ptp(gets))}


def of_bound(f: Found) -> dict[str, Any]:
    """Return the values at bounds, and these."""
    which = beyond_bounds(f)
    bounds = [f"{bound:.3g}" for bound in dict.fromkeys(f.given.values[which].tolist())]
    names = some_channels(np.isin(np.arange(len(f.given.values)), which), f.given.unknowns)
    return {"names": listing(names), "bounds": f"the bound{'s' if len(bounds) > 1 else ''} {listing(bounds)}"}


def of_falloff(f: Found) -> dict[str, Any]:
    """Return how the lamps' light falls off."""
    return {"falls": "falls off by the square of the distance" if f.which else "does not fall off"}


def beyond_bounds(f: Found) -> Int[np.ndarray, " beyond"]:
    """Return which values the photographs want beyond their bounds, if a fault is of these: by a percent, or most."""
    if f.fault.kind != "bound":
        return np.zeros(0, int)
    which, fit = changes.bounded(f.given), f.given
    beyond = f.amount / coordinate_slopes(fit.values, fit.unknowns)[which] / np.abs(fit.values[which])
    return which[(beyond > 0.0) & ((beyond > SLIGHT) | (beyond == beyond.max()))]


def _vector(of: Any, form: str) -> str:
    return f"({', '.join(format(x, form) for x in np.asarray(of))})"

"""Metallic-roughness surfaces, of glTF, three.js and PBR keys of MTL: GGX, diffuse reflection and a clear coat.

Under a light of pi I such a surface reflects I (n.l) ((1 - F) base + pi F V D): D and V are GGX and its Smith term with
alpha = roughness^2, F = f0 + (f90 - f0)(1 - v.h)^5 (glTF 2.0, appendix B). The highlight is multiplied by
1 + f0 (1/E - 1) for multiple scattering (Turquin 2019), with E the fraction of the light that GGX reflects. The
appendix leaves this to programs; three.js does it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.thresholds import SINGLE, TINY
from ..model.lobes import Blinn
from ..model.materials import Material
from ..model.microfacets import Microfacets
from .classic_fits import nearest
from .exports import stated
from .lobe_refits import N_S_RANGE, named
from .readings import Reading
from .reference import Cosines, Radiance, Reference, joined, reference

F0 = 0.04  # for the refractive index 1.5 of a dielectric
ROUGHNESSES = 64  # for which multiple scattering is computed, where each point has its own
ROUGHNESS = (0.045, 1.0)  # three.js and Filament raise smaller values to .045, to keep a lamp's highlight visible


Colour3 = Float[np.ndarray, "3"]
Colours = Float[np.ndarray, "*n 3"]


def schlick(cosine: Cosines) -> Cosines:
    """Return (1 - cosine)^5 (Schlick 1994)."""
    return (1.0 - cosine) ** 5


class MetallicRoughness(NamedTuple):
    """Roughness, diffuse colour, the reflectance F at normal incidence and at grazing angles, and a clear coat.

    The first four are one for all points, or one for each.
    """

    roughness: Any
    base: Colours
    head_on: Colours
    edge: Any = 1.0
    coat: float = 0.0
    coat_roughness: float = 0.0
    beneath: Colour3 | None = None
    """The head-on reflectance of the dielectric part, beneath which light is diffused; `head_on` if None."""

    grazing: Callable[[Cosines], Cosines] = schlick
    """How F goes from head-on to grazing angles, by the cosine."""

    def reflected(self, points: Reference) -> Radiance:
        """Return the radiance."""
        grazing = self.grazing(np.clip(points.v_h, 0.0, 1.0))[:, None]
        F = self.head_on + (self.edge - self.head_on) * grazing
        lost = F if self.beneath is None else self.beneath + (self.edge - self.beneath) * grazing
        again = 1.0 + self.head_on * (1.0 / kept(points.n_v, self.roughness**2) - 1.0)[:, None]
        own = points.n_l[:, None] * ((1.0 - lost) * self.base + F * again * ggx(points, self.roughness**2)[:, None])
        if not self.coat:
            return own
        F_coat = F0 + (1.0 - F0) * grazing
        through = 1.0 - self.coat * (F0 + (1.0 - F0) * self.grazing(points.n_v)[:, None])
        shine = ggx(points, max(self.coat_roughness, ROUGHNESS[0]) ** 2)[:, None]
        return own * through + self.coat * points.n_l[:, None] * F_coat * shine


def surface_of(
    colour: Colour3, metallic: float, roughness: float, dielectric: Any = F0, edge: float = 1.0, **more: Any
) -> MetallicRoughness:
    """Return a surface between a dielectric, 0, of this base colour and a metal, 1.

    Args:
        colour: Base colour.
        metallic: 0 to 1.
        roughness: 0 to 1.
        dielectric: The dielectric's reflectance at normal incidence; 0.04 by default.
        edge: The dielectric's reflectance at grazing angles; 1 by default.
        **more: `coat`, `coat_roughness` and `grazing` of the surface.
    """
    beneath = np.minimum(dielectric, 1.0) * np.ones(3)
    head_on = beneath * (1.0 - metallic) + colour * metallic
    edge = edge * (1.0 - metallic) + metallic
    rough = float(np.clip(roughness, *ROUGHNESS))
    return MetallicRoughness(rough, colour * (1.0 - metallic), head_on, edge, beneath=beneath, **more)


def metal_of(surface: MetallicRoughness, colour: Colour3, metallic: float) -> Colour3:
    """Return which share of a surface's highlight is that of its metal, and has the base colour."""
    return np.where(surface.head_on > 0, metallic * colour / np.maximum(surface.head_on, TINY), metallic)


def classic(surface: MetallicRoughness, name: str, what: str, reading: Reading, **more: Any) -> Material:
    """Return the Phong or Blinn material nearest to a surface, and note the remaining error.

    Args:
        surface: The surface.
        name: The material's name.
        what: What it is in its program, for the note.
        reading: The reading that keeps the note.
        **more: Other fields of the material.
    """
    if not (np.any(surface.head_on) or surface.edge or surface.coat):  # matte
        return Material(k_d=surface.base, lobe=Blinn(), **more)
    widths = [surface.roughness] + ([surface.coat_roughness] if surface.coat else [])
    points = joined([reference(min(2.0 / max(width, ROUGHNESS[0]) ** 4, N_S_RANGE[1])) for width in widths])
    target = surface.reflected(points)
    fit = nearest(target, points)
    if fit.largest < SINGLE and not any(np.any(np.asarray(of.k_s) > SINGLE) for of in fit.highlights):
        return Material(k_d=fit.k_d, lobe=Blinn(), **more)
    found = fit.material(**more)
    peak = "" if target.max() <= 1 else f" Its highlight reaches {target.max():.2g}."
    reading.note(name, f"the {what} becomes {named(found)}: {stated(fit.rms, fit.largest)}{peak}")
    return found


def what_of(metallic: float, roughness: float) -> str:
    """Return a surface in words."""
    return f"surface of roughness {roughness:.3g} and metalness {metallic:.3g}"


def ggx(points: Reference, alpha: float | Cosines) -> Cosines:
    """Return pi V D."""
    facets = Microfacets(alpha)
    return facets.distribution(points.n_h) * facets.visibility(points.n_l, points.n_v)


def kept(n_v: Cosines, alpha: float | Cosines) -> Cosines:
    """Return E(n.v), the fraction of the light that GGX with F = 1 reflects.

    Of many alpha, it is that of the nearest of `ROUGHNESSES`.
    """
    if not np.ptp(alpha):
        return _kept(n_v, float(np.ravel(alpha)[0]))
    steps = np.unique(np.rint(alpha * ROUGHNESSES) / ROUGHNESSES).clip(0.5 / ROUGHNESSES)
    E = np.stack([_kept(n_v, a) for a in steps])
    return E[np.abs(alpha - steps[:, None]).argmin(0), np.arange(len(n_v))]


def _kept(n_v: Cosines, alpha: float) -> Cosines:
    """Return E(n.v), the integral of V D (n.l) over all l.

    It is the mean of 4 V (n.l)(v.h)/(n.h) over h distributed as D (n.h), at 32 cosines, interpolated linearly.
    """
    u, turn = (np.arange(48) + 0.5) / 48, 2 * np.pi * (np.arange(48) + 0.5) / 48
    n_h = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))[:, None]
    mu = (np.linspace(0.0, 1.0, 32) ** 2).clip(1e-3)[:, None, None]
    v_h = mu * n_h + np.sqrt(1 - mu**2) * np.sqrt(1 - n_h**2) * np.cos(turn)
    n_l = 2 * v_h * n_h - mu
    some = (n_l > 0) & (v_h > 0)
    weight = np.where(some, 4 * Microfacets(alpha).visibility(np.where(some, n_l, 1.0), mu) * n_l * v_h / n_h, 0.0)
    return np.interp(n_v, mu.ravel(), weight.mean((1, 2)))

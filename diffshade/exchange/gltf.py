"""glTF 2.0, metallic-roughness with KHR_materials_specular: written only, since this library has no GGX lobe.

Under a light of pi I it reflects I (n.l) ((1 - F) base + pi F V D): D and V are GGX and its Smith term with alpha =
roughness^2, F = f0 + (f90 - f0)(1 - v.h)^5, f0 = min(.04 specularColor, 1) specular and f90 = specular (glTF 2.0,
appendix B; KHR_materials_specular). The highlight is multiplied by 1 + f0 (1/E - 1) for multiple scattering (Turquin
2019), with E the fraction of the light that GGX reflects. The appendix leaves this to programs; three.js does it.
"""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ..core.fields import in_short
from ..model.lobes import Phong
from ..model.materials import Material
from .exports import Draft, notes_on_glass, notes_on_lights, opacity, stated
from .lobe_refits import check_plain, named
from .reference import Cosines, Radiance, Reference, differences, radiance, reference_of

F0 = 0.04  # for the refractive index 1.5 that glTF gives a dielectric
ROUGHNESS = (0.045, 1.0)  # three.js and Filament raise smaller values to .045, to keep a lamp's highlight visible


class Surface(NamedTuple):
    """A surface in glTF: roughness, base colour, and the reflectance of each channel at normal incidence."""

    roughness: float
    base: Float[np.ndarray, "3"]
    head_on: Float[np.ndarray, "3"]

    def reflected(self, points: Reference) -> Radiance:
        """Return the radiance."""
        grazing = 1.0 - np.clip(points.v_h, 0.0, 1.0)
        F = self.head_on + (self.head_on.max() - self.head_on) * grazing[:, None] ** 5
        again = 1.0 + self.head_on * (1.0 / kept(points.n_v, self.roughness**2) - 1.0)[:, None]
        return points.n_l[:, None] * ((1.0 - F) * self.base + F * again * ggx(points, self.roughness**2)[:, None])


def ggx(points: Reference, alpha: float | Cosines) -> Cosines:
    """Return pi V D (Walter et al. 2007; Heitz 2014)."""
    D = alpha**2 / (points.n_h**2 * (alpha**2 - 1.0) + 1.0) ** 2
    return D * smith(points.n_l, points.n_v, alpha)


def smith(n_l: Any, n_v: Any, alpha: float | Cosines) -> Any:
    """Return V, the fraction that is neither shadowed nor masked, over 4 (n.l)(n.v) (Heitz 2014)."""
    a2 = alpha * alpha
    return 0.5 / (n_l * np.sqrt(a2 + (1 - a2) * n_v**2) + n_v * np.sqrt(a2 + (1 - a2) * n_l**2))


def kept(n_v: Cosines, alpha: float) -> Cosines:
    """Return E(n.v), the integral of V D (n.l) over all l: the fraction of the light that GGX with F = 1 reflects.

    It is the mean of 4 V (n.l)(v.h)/(n.h) over h distributed as D (n.h), at 32 cosines, interpolated linearly.
    """
    u, turn = (np.arange(48) + 0.5) / 48, 2 * np.pi * (np.arange(48) + 0.5) / 48
    n_h = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))[:, None]
    mu = (np.linspace(0.0, 1.0, 32) ** 2).clip(1e-3)[:, None, None]
    v_h = mu * n_h + np.sqrt(1 - mu**2) * np.sqrt(1 - n_h**2) * np.cos(turn)
    n_l = 2 * v_h * n_h - mu
    some = (n_l > 0) & (v_h > 0)
    weight = np.where(some, 4 * smith(np.where(some, n_l, 1.0), mu, alpha) * n_l * v_h / n_h, 0.0)
    return np.interp(n_v, mu.ravel(), weight.mean((1, 2)))


def fitted(material: Material) -> tuple[Surface, float, float]:
    """Return the surface nearest to a material by least squares, and the error."""
    check_plain(material)
    points = reference_of(material)
    target = radiance(material, points)
    blinn = np.min(material.n_s) * (4.0 if isinstance(material.lobe, Phong) else 1.0)
    alpha = np.sqrt(2.0 / (blinn + 2.0))  # D and Blinn's lobe then have the same curvature at the peak
    head_on = np.clip(4.0 * alpha**2 * np.asarray(material.k_s), 1e-4, 0.9)
    start = [np.log(np.clip(np.sqrt(alpha), 0.05, 0.99)), *np.clip(np.asarray(material.k_d), 1e-3, 0.99), *head_on]

    def surface(x: np.ndarray) -> Surface:
        return Surface(float(np.exp(x[0])), x[1:4], x[4:])

    bounds = ([np.log(ROUGHNESS[0]), *np.zeros(6)], [np.log(ROUGHNESS[1]), *np.ones(6)])
    found = least_squares(lambda x: (surface(x).reflected(points) - target).ravel(), start, bounds=bounds, xtol=1e-12)
    best = surface(found.x)
    return best, *differences(target, best.reflected(points))


def write_gltf(name: str, material: Material, lights: Any) -> Draft:
    """Return a glTF file with the material only."""
    surface, rms, largest = fitted(material)
    notes = [f"the highlight, {named(material)}, is refitted as GGX with roughness {surface.roughness:.3g}:"]
    notes[0] += f" {stated(rms, largest)}"
    if np.any(material.k_a):
        notes.append(f"glTF has no ambient reflection: k_a {in_short(material.k_a)} is not written.")
    if lights:
        notes += notes_on_lights(lights, "glTF")
        notes.append("KHR_lights_punctual, glTF's lights, has only the falloff 1/d^2.")
    notes += notes_on_glass(material, "glTF", colour=False, eta=False)
    notes.append("multiply the intensity of each light by pi: glTF divides the diffuse term by pi.")
    k_e, strength = np.asarray(material.k_e), max(1.0, float(np.max(material.k_e)))
    specular = float(surface.head_on.max())
    alpha = opacity(material)
    extensions: dict[str, Any] = {"KHR_materials_specular": {"specularFactor": specular}}
    if specular > 0:
        extensions["KHR_materials_specular"]["specularColorFactor"] = [
            float(f) / specular / F0 for f in surface.head_on
        ]
    if strength > 1:
        extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    document = {
        "asset": {"version": "2.0", "generator": "diffshade", "extras": {"diffshade": notes}},
        "extensionsUsed": list(extensions),
        "materials": [
            {
                "name": name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*map(float, surface.base), alpha],
                    "metallicFactor": 0.0,
                    "roughnessFactor": surface.roughness,
                },
                "emissiveFactor": [float(k) for k in k_e / strength],
                "alphaMode": "BLEND" if alpha < 1 else "OPAQUE",
                "extensions": extensions,
            }
        ],
    }
    return Draft(json.dumps(document, indent=2) + "\n", rms, largest, tuple(notes))

"""The reference for comparing two materials: points of a surface, one viewer, and lights from several directions.

The viewer is far away along +z, and a light of intensity 1 is far away at 0, 20, 40, 60 and 80 degrees from it. Under
each light there are 256 normals spread evenly over the highlight (around the halfway vector, to where Blinn's highlight
is a thousandth of its peak) and 256 over the hemisphere around it. Normals that the viewer cannot see are excluded. An
error is a difference of radiance at these points: the root mean square over points and channels, and the largest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.backend import in_float64
from ..core.fields import Exponent
from ..core.thresholds import NEGLIGIBLE
from ..inverse.data.relightable import dome
from ..model.lobes import AbstractPowerLobe, AbstractReflectance, Phong
from ..model.materials import Material
from ..model.reflection import reflectance
from ..model.vectors import Vec3

EDGE = NEGLIGIBLE  # the edge of a highlight over its peak; and the least cosine of a point that is no rounding

ANGLES = (0.0, 20.0, 40.0, 60.0, 80.0)  # degrees between the light and the viewer
POINTS = 256

Normals = Float[np.ndarray, "n 3"]
Cosines = Float[np.ndarray, " n"]
Radiance = Float[np.ndarray, "n 3"]


class Reference(NamedTuple):
    """Points of a surface: unit normals and unit directions to the light; the viewer is in direction (0, 0, 1)."""

    n: Normals
    l: Normals

    @property
    def n_l(self) -> Cosines:
        """(n . l)_+"""
        return np.maximum((self.n * self.l).sum(-1), 0.0)

    @property
    def n_v(self) -> Cosines:
        """n . v"""
        return self.n[..., 2]

    @property
    def h(self) -> Normals:
        """Halfway vector."""
        h = self.l + np.array([0.0, 0.0, 1.0])
        return h / np.linalg.norm(h, axis=-1, keepdims=True)

    @property
    def n_h(self) -> Cosines:
        """(n . h)_+"""
        return np.maximum((self.n * self.h).sum(-1), 0.0)

    @property
    def v_h(self) -> Cosines:
        """v . h"""
        return self.h[..., 2]

    def highlights(self, lobe: AbstractPowerLobe) -> Callable[[float], Cosines]:
        """Return the highlights of k_s = 1 as a function of n_s (E5, E6)."""
        with in_float64():
            cosine = np.broadcast_to(np.asarray(lobe.cosine(*self.vectors)), self.n_v.shape)
        shines = (self.n_l > 0) & (cosine > 0)
        return lambda n_s: np.where(shines, np.where(shines, cosine, 1.0) ** n_s, 0.0)

    @property
    def vectors(self) -> tuple[Vec3, Vec3, Vec3]:
        """n, l and v."""
        v = np.broadcast_to([0.0, 0.0, 1.0], self.n.shape)
        return Vec3.of(self.n), Vec3.of(self.l), Vec3.of(v)


def reference(n_s: float) -> Reference:
    """Return the reference points for a highlight as wide as Blinn's with the exponent n_s."""
    normals, lights = [], []
    for angle in np.deg2rad(ANGLES):
        h = np.array([np.sin(angle / 2), 0.0, np.cos(angle / 2)])
        x, y = np.array([h[2], 0.0, -h[0]]), np.array([0.0, 1.0, 0.0])
        for least in (EDGE ** (1.0 / n_s) if n_s > 0 else 0.0, 0.0):
            n = dome(POINTS, least) @ np.stack([x, y, h])
            l = np.broadcast_to([np.sin(angle), 0.0, np.cos(angle)], n.shape)
            seen = (n[:, 2] > EDGE) & (np.abs((n * l).sum(-1)) > EDGE)
            normals.append(n[seen])
            lights.append(l[seen])
    return Reference(np.concatenate(normals), np.concatenate(lights))


def reference_of(material: Material) -> Reference:
    """Return the reference points for a material, those of each of its highlights."""
    return joined([reference(as_blinn(of.n_s, of.lobe)) for of in (material, *material.highlights)])


def joined(parts: Sequence[Reference]) -> Reference:
    """Return the points of several references as those of one."""
    return Reference(*(np.concatenate(of) for of in zip(*parts, strict=True)))


def as_blinn(n_s: Exponent, lobe: AbstractReflectance) -> float:
    """Return the exponent of Blinn's highlight that is about as wide: 4 n_s of Phong's n_s."""
    return float(np.min(n_s)) * (4.0 if isinstance(lobe, Phong) else 1.0)


def radiance(material: Material, points: Reference) -> Radiance:
    """Return the radiance of a material at the points: k_d (n.l)_+ + W (cos)_+^n_s, without ambient light."""
    with in_float64(material) as material:
        return np.asarray(reflectance(material, material.at(None), *points.vectors).stack())


def differences(one: Radiance, other: Radiance) -> tuple[float, float]:
    """Return the root mean square and the largest difference of radiance."""
    difference = np.abs(one - other)
    return float(np.sqrt(np.mean(difference**2))), float(difference.max())

"""Refits: the material of another lobe, or of narrower limits, that looks most like a given one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from ..core.fields import check, check_kind
from ..model.fresnel import NoFresnel
from ..model.materials import AbstractLobe, Material
from .reference import Cosines, Radiance, differences, radiance, reference_of

EXPONENTS = (0.1, 1e5)  # within which a highlight is looked for


@dataclass(frozen=True)
class Refit:
    """A material that looks like another one: `material`, and what is left of the difference."""

    material: Material
    rms: float
    """Root mean square difference of radiance over the reference, under a light of intensity 1."""
    largest: float
    """The largest difference."""
    before: Material

    def __str__(self) -> str:
        if not self.largest:
            return "the highlight is the same."
        return (
            f"the highlight, {named(self.before)}, becomes {named(self.material)}: under a light of intensity 1 the "
            f"radiance differs by {self.rms:.2g} (rms) and {self.largest:.2g} (at most)."
        )


def named(material: Material) -> str:
    """Return a highlight in words."""
    exponents = ", ".join(f"{n:.4g}" for n in np.ravel(material.n_s))
    fresnel = "" if isinstance(material.fresnel, NoFresnel) else f" and {type(material.fresnel).__name__}'s weight"
    return f"{type(material.lobe).__name__} with n_s {exponents}{fresnel}"


def with_lobe(
    material: Material, lobe: AbstractLobe, *, highest_n_s: float | int = EXPONENTS[1], highest_k: float | int = np.inf
) -> Refit:
    r"""Return the material of this lobe, with a constant k_s and one n_s, that looks most like the given one.

    $$ \min \sum (I - I_{given})^2 $$

    over a reference: a viewer and lights of intensity 1 far away, at 0, 20, 40, 60 and 80 degrees from one another;
    under each 256 normals evenly over the highlight, to where it is a thousandth of its peak, and 256 over the half
    sphere about it. A Phong highlight becomes a Blinn one of about 4 n_s, and back. `highest_n_s`, `highest_k`: limits
    of another program on n_s and on each of k_d and k_s. A material that is of this lobe and within the limits is
    returned as it is. Raises ValueError for one whose coefficients are patterns, TypeError for what is no material or
    no lobe.
    """
    check_plain(material)
    check_kind("lobe", lobe, AbstractLobe, "Blinn()")
    n_s = np.unique(np.asarray(material.n_s))
    within = all(np.all(np.asarray(k) <= highest_k) for k in (material.k_d, material.k_s)) and n_s[-1] <= highest_n_s
    alike = type(material.lobe) is type(lobe) and isinstance(material.fresnel, NoFresnel) and len(n_s) == 1
    if within and alike:
        return Refit(dataclasses.replace(material, n_s=float(n_s[0])), 0.0, 0.0, material)
    points = reference_of(material)
    target = radiance(material, points)
    k_d = np.minimum(material.k_d, highest_k)
    shape = Shape(points.highlights(lobe), (EXPONENTS[0], float(highest_n_s)), float(highest_k))
    n, k_s = shape.fit(target - points.n_l[:, None] * np.asarray(material.k_d))
    new = dataclasses.replace(material, k_d=k_d, k_s=k_s, n_s=n, lobe=lobe, fresnel=NoFresnel())
    return Refit(new, *differences(target, radiance(new, points)), material)


@dataclass(frozen=True)
class Shape:
    """A family of highlights, linear in k: base + k basis, for an exponent n."""

    basis: Callable[[float], Cosines]
    exponents: tuple[float, float]
    highest_k: float = np.inf
    base: Callable[[float], Cosines] | None = None

    def fit(self, target: Radiance) -> tuple[float, Float[np.ndarray, "3"]]:
        """Return n, and k of each channel, of the highlight nearest to the target, by squares.

        k is solved for at each n, and of n a whole range is searched before the best place is refined.
        """
        if not np.any(target):
            return float(np.clip(10.0, *self.exponents)), np.zeros(3)

        def cost(log_n: float) -> float:
            n = float(np.exp(log_n))
            return float(np.sum((self.of(n, self.weights(n, target)) - target) ** 2))

        log_n = lowest(cost, *np.log(self.exponents))
        n = float(np.exp(log_n))
        return n, self.weights(n, target)

    def weights(self, n: float, target: Radiance) -> Float[np.ndarray, "3"]:
        """Return the best k, 0 to the highest, at one n."""
        basis, base = self.basis(n), self._base(n)
        size = float(basis @ basis)
        best = basis @ (target - base[:, None]) / (size if size > 0 else 1.0)
        return np.clip(best, 0.0, self.highest_k)

    def of(self, n: float, k: Float[np.ndarray, "3"]) -> Radiance:
        """Return the highlight."""
        return self._base(n)[:, None] + self.basis(n)[:, None] * k

    def _base(self, n: float) -> Cosines:
        return np.zeros_like(self.basis(n)) if self.base is None else self.base(n)


def lowest(cost: Callable[[float], float], lower: float, upper: float) -> float:
    """Return where a function of one number is lowest: the best of 40, refined between its neighbours, or an end."""
    tried = np.linspace(lower, upper, 40)
    best = int(np.argmin([cost(float(x)) for x in tried]))
    low, high = tried[max(best - 1, 0)], tried[min(best + 1, len(tried) - 1)]
    found: Any = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-9})
    return min((float(found.x), float(low), float(high)), key=cost)


def check_plain(material: Material) -> None:
    """Refuse what is no material, and patterns, which no file of a material holds."""
    check_kind("material", material, Material, "Material(k_d=0.7)")
    check(material)
    if material.patterns:
        raise ValueError(
            f"a material's file holds colours; got a {type(material.patterns[0]).__name__}. Give one colour for each "
            "coefficient, or write the scene with write_scene."
        )

"""Lobe refits: the material with another lobe, or within limits, that is nearest to a given one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ..core.fields import check, check_kind
from ..core.words import count, listing
from ..model.bands import check_rgb
from ..model.fresnel import Dielectric, NoFresnel
from ..model.lobes import AbstractLobe, AbstractPowerLobe
from ..model.materials import Material
from .reference import Cosines, Radiance, differences, radiance, reference_of

N_S_RANGE = (0.1, 1e5)  # the range of n_s that is searched


@dataclass(frozen=True)
class Refit:
    """A material refitted to look like another one, and the remaining difference."""

    material: Material
    rms: float
    """Root mean square difference of radiance over the reference, under a light of intensity 1."""
    largest: float
    """The largest difference."""
    before: Material

    def __str__(self) -> str:
        if not self.largest:
            return "the highlight is unchanged."
        return (
            f"the highlight, {named(self.before)}, becomes {named(self.material)}: under a light of intensity 1 the "
            f"radiance differs by {self.rms:.2g} (rms) and {self.largest:.2g} (at most)."
        )


def named(material: Material) -> str:
    """Return a highlight in words."""
    exponents = ", ".join(f"{n:.4g}" for n in np.ravel(material.n_s))
    fresnel = "" if isinstance(material.fresnel, NoFresnel) else f" and {type(material.fresnel).__name__}'s weight"
    more = f" and {count(len(material.highlights), 'further highlight')}" if material.highlights else ""
    return f"{type(material.lobe).__name__} with n_s {exponents}{fresnel}{more}"


def with_lobe(
    material: Material,
    lobe: AbstractPowerLobe,
    *,
    highest_n_s: float | int = N_S_RANGE[1],
    highest_k: float | int = np.inf,
) -> Refit:
    r"""Return the material with this lobe, constant k_s and one n_s that is nearest to a given material.

    $$ \min \sum (I - I_{given})^2 $$

    The sum is over a reference: a viewer far away, and a light of intensity 1 far away at 0, 20, 40, 60 and 80 degrees
    from it. Under each light there are 256 normals spread evenly over the highlight, to where it is a thousandth of its
    peak, and 256 over the hemisphere around it. A Phong highlight becomes a Blinn highlight of about 4 n_s, and back. A
    material that has this lobe and is within the limits is returned unchanged.

    Args:
        material: The given material, without patterns.
        lobe: The lobe to refit with.
        highest_n_s: The largest n_s allowed, as in another program; 100,000 by default.
        highest_k: The largest k_d and k_s allowed; by default without limit.

    Returns:
        The material and the remaining difference.

    Raises:
        ValueError: If a coefficient is a pattern.
        TypeError: If an argument has another type.
    """
    check_plain(material)
    check_rgb("with_lobe's material", material)
    check_kind("lobe", lobe, AbstractPowerLobe, "Blinn()")
    n_s = np.unique(np.asarray(material.n_s))
    within = all(np.all(np.asarray(k) <= highest_k) for k in (material.k_d, material.k_s)) and n_s[-1] <= highest_n_s
    same_lobe = type(material.lobe) is type(lobe) and isinstance(material.fresnel, NoFresnel) and len(n_s) == 1
    if within and same_lobe and not material.highlights:
        return Refit(dataclasses.replace(material, n_s=float(n_s[0])), 0.0, 0.0, material)
    points = reference_of(material)
    target = radiance(material, points)
    k_d = np.minimum(material.k_d, highest_k)
    shape = Shape(points.highlights(lobe), (N_S_RANGE[0], float(highest_n_s)), float(highest_k))
    n, k_s = shape.fit(target - points.n_l[:, None] * np.asarray(material.k_d))
    new = dataclasses.replace(material, k_d=k_d, k_s=k_s, n_s=n, lobe=lobe, fresnel=NoFresnel(), highlights=())
    return Refit(new, *differences(target, radiance(new, points)), material)


@dataclass(frozen=True)
class Shape:
    """A family of highlights, linear in k: base + k basis, for an exponent n."""

    basis: Callable[[float], Cosines]
    exponents: tuple[float, float]
    highest_k: float = np.inf
    base: Callable[[float], Cosines] = lambda n: np.zeros(1)

    def fit(self, target: Radiance) -> tuple[float, Float[np.ndarray, "3"]]:
        """Return n and each channel's k of the highlight nearest to the target by least squares.

        k is solved for at each n. n is searched over its whole range, then refined.
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
        """Return the best k within its limits at one n."""
        basis, base = self.basis(n), self.base(n)
        size = float(basis @ basis)
        best = basis @ (target - base[:, None]) / (size if size > 0 else 1.0)
        return np.clip(best, 0.0, self.highest_k)

    def of(self, n: float, k: Float[np.ndarray, "3"]) -> Radiance:
        """Return the highlight."""
        return self.base(n)[:, None] + self.basis(n)[:, None] * k


def lowest(cost: Callable[[float], float], lower: float, upper: float) -> float:
    """Return the minimiser of a function of one number: the best of 40 points, refined between its neighbours."""
    grid = np.linspace(lower, upper, 40)
    best = int(np.argmin([cost(float(x)) for x in grid]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found: Any = scipy.optimize.minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-9})
    return min((float(found.x), float(low), float(high)), key=cost)


def is_matte(material: Material) -> bool:
    """Return whether a material has no highlight."""
    shines = np.any(material.k_s) or any(np.any(of.k_s) for of in material.highlights)
    return isinstance(material.lobe, AbstractLobe) and not shines and not isinstance(material.fresnel, Dielectric)


def check_plain(material: Material) -> None:
    """Refuse what is not a material, and patterns, which material files cannot hold."""
    check_kind("material", material, Material, "Material(k_d=0.7)")
    check(material)
    if material.patterns:
        raise ValueError(
            f"a material file holds colours; got a {type(material.patterns[0]).__name__}. Give one colour for each "
            "coefficient, or write the scene with write_scene."
        )
    if material.maps:
        raise ValueError(
            f"a material file holds colours; got an array for {listing(list(material.maps))}. Give one "
            "colour for each coefficient."
        )

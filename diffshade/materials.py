"""Materials: how much of each kind of light a surface reflects, and the shape of its highlight."""

from __future__ import annotations

import abc

import equinox as eqx
from jaxtyping import Float

from .fields import Array, Checked, Colour, Exponent, as_colour, as_exponent, check_kind
from .vectors import Vec3, dot, halfway, reflect


class AbstractLobe(eqx.Module):
    """The shape of a highlight: the cosine that is raised to n_s."""

    @abc.abstractmethod
    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return the base of the highlight's power; all vectors are unit and point away from the surface."""


class Phong(AbstractLobe):
    """The highlight's cosine is v . r with the mirror direction r = 2(n.l)n - l (E5; Phong 1975)."""

    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return v . r."""
        return dot(v, reflect(l, n))


class Blinn(AbstractLobe):
    """The highlight's cosine is n . h with the halfway vector h = (l+v)/|l+v| (E6; Blinn 1977)."""

    def cosine(self, n: Vec3, l: Vec3, v: Vec3) -> Float[Array, "..."]:
        """Return n . h."""
        return dot(n, halfway(l, v))


class Material(Checked):
    """The reflection coefficients of a surface (E1, E4-E6); a coefficient that is not given is 0: no such term.

    `k_a`, `k_d`, `k_s`: ambient, diffuse and specular reflection, RGB or one number (grey), at least 0. `n_s`: the
    specular exponent, at least 0 (1 is dull, 200 polished), one for all channels or one a channel. `lobe`: `Phong()` or
    `Blinn()`.
    """

    k_a: Colour = eqx.field(converter=as_colour, default=0.0, metadata={"lower": 0})
    k_d: Colour = eqx.field(converter=as_colour, default=0.0, metadata={"lower": 0})
    k_s: Colour = eqx.field(converter=as_colour, default=0.0, metadata={"lower": 0})
    n_s: Exponent = eqx.field(converter=as_exponent, default=10.0, metadata={"lower": 0})
    lobe: AbstractLobe = eqx.field(default_factory=Phong)

    def check_together(self) -> None:
        check_kind("Material.lobe", self.lobe, AbstractLobe, "Phong()")

"""Materials: how much of each kind of light a surface reflects, by its coefficients and lobes."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..core.fields import (
    Array,
    Checked,
    Coefficient,
    Numbers,
    Scalar,
    as_coefficient,
    as_exponent,
    as_normals,
    as_scalar,
    check_kind,
    checked_colour,
    in_short,
    is_concrete,
    is_over_pixels,
    parameter,
)
from .bands import of_bands
from .fresnel import AbstractFresnel, Dielectric, NoFresnel
from .lobes import EXPONENT, AbstractLobe, AbstractReflectance, Coefficients, Phong
from .patterns import AbstractPattern, Texture, colour_at
from .vectors import Vec3, normalize

REFLECTION = parameter("reflection", lower=0, linear=True, start=0.3, gauge=1)
EMISSION = {**REFLECTION, "parameter": dataclasses.replace(REFLECTION["parameter"], by_own_name=True)}
# reach: slightly more than half the distance between the values of eta that a search tries
INDEX = parameter(
    "index", lower=0.1, upper=10, by_own_name=True, search=tuple(np.linspace(1.0, 2.5, 16).tolist()), reach=0.06
)


def as_highlights(value: Any) -> Any:
    """Make a tuple of one highlight or several; any other value is returned unchanged for the check to refuse."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


class Highlight(Checked):
    r"""A further highlight of a material, beside its own: $W I_l (cosine)_+^{n_s}$ with its own k_s, n_s and lobe.

    Args:
        k_s: Specular reflection, RGB or grey, at least 0; 0 by default.
        n_s: Specular exponent, at least 0, one for all channels or one per channel; 10 by default.
        lobe: `Phong()`, the default, `Blinn()` or `Brushed()`.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range.
        TypeError: A value is of the wrong kind.
    """

    k_s: Coefficient = eqx.field(converter=as_coefficient, default=0.0, metadata=REFLECTION)
    n_s: Coefficient = eqx.field(converter=as_exponent, default=10.0, metadata=EXPONENT)
    lobe: AbstractLobe = eqx.field(default_factory=Phong)

    def check_together(self) -> None:
        check_kind("Highlight.lobe", self.lobe, AbstractLobe, "Phong()")
        if isinstance(self.k_s, Checked):
            check_kind("Highlight.k_s", self.k_s, AbstractPattern, "Chequer(0.1, 0.9)")


class Material(Checked):
    r"""The coefficients of a surface (E1, E4-E7, E9, E12, E13).

    $$ I_{refl} = k_e + k_a I_a + \sum_l f_{rad} f_{ang} I_l (k_d (n \cdot l)_+ + W (v \cdot r)_+^{n_s}) $$
    $$ I = (1 - k_t) I_{refl} + k_t I_{trans}, \qquad \sin\theta_r = (\eta_i / \eta_r) \sin\theta_i $$

    A colour is RGB or one number (grey); an array over the pixels of the one camera that sees the object, (H, W) or
    (H, W, 3); a pattern of the point, for example a `Chequer`; or a `Texture`. All are in the same range, and so are
    the maps of n_s. Where n.l <= 0 there is neither diffuse reflection nor a highlight; nothing is normalised. Sources:
    Phong 1975, Blinn 1977, Foley et al. 1990, 16.1 and 16.5.

    Args:
        k_a: Ambient reflection, at least 0; 0 (no such term) by default.
        k_d: Diffuse reflection, at least 0; 0 by default.
        k_s: Specular reflection, at least 0; 0 by default.
        n_s: Specular exponent, at least 0 (1 is dull, 200 polished), one for all channels or one per channel; 10 by
            default.
        lobe: `Phong()`, the default, `Blinn()`, `Brushed()`, or a reflectance of your own.
        fresnel: How the highlight's weight W depends on the angle: `NoFresnel()`, the default, where W is k_s;
            `Schlick()`; or `Dielectric()`, where W follows from `eta` and k_s must be 0.
        k_e: Emission, at least 0; 0 by default.
        k_t: Transmission, 0 to 1. None, the default, is an opaque surface: nothing is traced behind it.
        eta: Index of refraction, 0.1 to 10; with 1 or None, the default, rays are not bent.
        highlights: Further highlights, which are added to the one of k_s, n_s and lobe; none by default. The weight of
            each depends on the angle as `fresnel` says.
        normal: Normals that shade in place of the surface's own: (H, W, 3), unit vectors in scene coordinates; or a
            `Texture` of $(n + 1) / 2$ with n along u, along v and out of the surface (Blinn 1978). None, the default,
            shades with the surface's own.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range; or, with `Dielectric()`, k_s is
            not 0 or eta is None.
        TypeError: A value is of the wrong kind.
    """

    k_a: Coefficient = eqx.field(converter=as_coefficient, default=0.0, metadata=REFLECTION)
    k_d: Coefficient = eqx.field(converter=as_coefficient, default=0.0, metadata=REFLECTION)
    k_s: Coefficient = eqx.field(converter=as_coefficient, default=0.0, metadata=REFLECTION)
    n_s: Coefficient = eqx.field(converter=as_exponent, default=10.0, metadata=EXPONENT)
    lobe: AbstractReflectance = eqx.field(default_factory=Phong)
    fresnel: AbstractFresnel = eqx.field(default_factory=NoFresnel)
    k_e: Coefficient = eqx.field(converter=as_coefficient, default=0.0, metadata=EMISSION)
    k_t: Coefficient = eqx.field(
        converter=as_coefficient, default=None, metadata=parameter("transmission", lower=0, upper=1, start=0.5)
    )
    eta: Scalar | None = eqx.field(converter=as_scalar, default=None, metadata=INDEX)
    highlights: tuple[Highlight, ...] = eqx.field(converter=as_highlights, default=())
    normal: Float[Array, "h w 3"] | AbstractPattern | None = eqx.field(converter=as_normals, default=None)

    @staticmethod
    def foley(
        *,
        O_d: Numbers,
        O_s: Numbers = 1.0,
        k_a: Numbers = 0.0,
        k_d: Numbers = 0.0,
        k_s: Numbers = 0.0,
        **more: Any,
    ) -> Material:
        """Return the material of Foley's form, $k_a O_d$, $k_d O_d$ and $k_s O_s$ per channel (E10; Foley et al. 1990).

        The channels are red, green and blue, or samples of the wavelength (`Scene.bands`).

        Args:
            O_d: Diffuse colour of the object, RGB, grey or a number for each band, at least 0.
            O_s: Specular colour of the object, RGB, grey or a number for each band, at least 0; 1 by default.
            k_a: Ambient coefficient, at least 0; 0 by default.
            k_d: Diffuse coefficient, at least 0; 0 by default.
            k_s: Specular coefficient, at least 0; 0 by default.
            **more: n_s, lobe and the other fields of `Material`.

        Returns:
            The material.

        Raises:
            ValueError: A value is not a colour or is below 0, or as `Material` raises it.
            TypeError: A value is not numbers, or as `Material` raises it.
        """
        given = {"O_d": O_d, "O_s": O_s, "k_a": k_a, "k_d": k_d, "k_s": k_s}
        colours = {name: checked_colour(f"Material.foley's {name}", value) for name, value in given.items()}
        width = next((bands for of in colours.values() if (bands := np.shape(of)[-1]) != 3), 3)  # 3 may be grey
        if width != 3:
            colours = {name: of_bands(of, width) for name, of in colours.items()}
            for name, of in colours.items():
                if np.shape(of)[-1] != width:
                    raise ValueError(
                        f"Material.foley's {name} has {np.shape(of)[-1]} numbers, beside colours of {width}. Give one, "
                        f"or {width}."
                    )
        scaled = {k: colours[k] * colours["O_s" if k == "k_s" else "O_d"] for k in ("k_a", "k_d", "k_s")}
        return Material(**scaled, **more)

    def check_together(self) -> None:
        check_kind("Material.lobe", self.lobe, AbstractReflectance, "Phong()")
        check_kind("Material.fresnel", self.fresnel, AbstractFresnel, "Schlick()")
        for name in ("k_a", "k_d", "k_s", "k_e", "k_t"):
            if isinstance(colour := getattr(self, name), Checked):
                check_kind(f"Material.{name}", colour, AbstractPattern, "Chequer(0.1, 0.9)")
        for name in ("n_s", "normal"):
            if isinstance(texture := getattr(self, name), Checked):
                check_kind(f"Material.{name}", texture, Texture, "Texture(image)")
        if is_over_pixels(self.normal) and is_concrete(self.normal):
            length2 = np.sum(np.square(np.asarray(self.normal)), -1)
            if not ((np.abs(length2 - 1.0) < 2e-3) | (length2 == 0)).all():
                row, column = np.argwhere((np.abs(length2 - 1.0) >= 2e-3) & (length2 != 0))[0]
                raise ValueError(
                    f"Material.normal must hold unit vectors; at row {row}, column {column} the length is "
                    f"{float(np.sqrt(length2[row, column])):.4g}. Normalise them."
                )
        for i, highlight in enumerate(self.highlights):
            check_kind(f"Material.highlights[{i}]", highlight, Highlight, "Highlight(k_s=0.2, n_s=200)")
        if not isinstance(self.fresnel, Dielectric):
            return
        if self.highlights:
            raise ValueError(
                "Material.highlights must not be given beside fresnel=Dielectric(), whose one W follows from eta; got "
                f"{len(self.highlights)}. Leave them out, or use Schlick()."
            )
        if isinstance(self.k_s, AbstractPattern) or (is_concrete(self.k_s) and np.any(self.k_s)):
            raise ValueError(
                f"Material.k_s must not be given beside fresnel=Dielectric(), whose W follows from eta; got "
                f"{in_short(self.k_s)}. Leave k_s out, or use Schlick()."
            )
        if self.eta is None:
            raise ValueError(
                "Material.eta must be given with fresnel=Dielectric(); got None. Give for example eta=1.5."
            )

    @property
    def coefficients(self) -> dict[str, Any]:
        """All that may be a pattern or an array over the pixels, by name."""
        own = {name: getattr(self, name) for name in ("k_a", "k_d", "k_s", "k_e", "k_t", "n_s", "normal")}
        more = {
            f"highlights.{i}.{name}": getattr(of, name)
            for i, of in enumerate(self.highlights)
            for name in ("k_s", "n_s")
        }
        return {**own, **more}

    @property
    def patterns(self) -> tuple[AbstractPattern, ...]:
        """The patterns among the coefficients."""
        return tuple(of for of in self.coefficients.values() if isinstance(of, AbstractPattern))

    @property
    def maps(self) -> dict[str, Float[Array, "h w ..."]]:
        """The arrays over the pixels among the coefficients, by name."""
        return {name: of for name, of in self.coefficients.items() if is_over_pixels(of)}

    def at(self, p: Vec3 | None, uv: Vec3 | None = None) -> Coefficients:
        """Return the coefficients at a point.

        Args:
            p: The point, scene units; None (position unknown) is enough if no coefficient is a pattern.
            uv: Its texture coordinates (u, v, 0); None is enough if no coefficient is a `Texture`.

        Returns:
            The coefficients, with patterns evaluated to colours.
        """
        k_a, k_d, k_s, k_e = (colour_at(k, p, uv) for k in (self.k_a, self.k_d, self.k_s, self.k_e))
        opaque = Vec3(np.zeros(()), np.zeros(()), np.zeros(()))
        k_t = opaque if self.k_t is None else colour_at(self.k_t, p, uv)
        eta = np.ones(()) if self.eta is None else self.eta
        highlights = tuple((colour_at(more.k_s, p, uv), _exponent(more.n_s, uv)) for more in self.highlights)
        return Coefficients(k_a, k_d, k_s, k_e, k_t, _exponent(self.n_s, uv), eta, highlights)

    def shading_normal(self, n: Vec3, texture: tuple[Vec3, Vec3, Vec3] | None) -> Vec3:
        """Return the normal that shades a point.

        Args:
            n: The surface's own.
            texture: What `AbstractSurface.texture` returns there; None is enough if `normal` is no `Texture`.

        Returns:
            The unit normal.
        """
        if self.normal is None:
            return n
        if isinstance(self.normal, AbstractPattern):
            assert texture is not None
            uv, along_u, along_v = texture
            of = self.normal(uv)
            return normalize(along_u * (2.0 * of.x - 1.0) + along_v * (2.0 * of.y - 1.0) + n * (2.0 * of.z - 1.0))
        return Vec3.of(self.normal)


def _exponent(n_s: Any, uv: Vec3 | None) -> Float[Array, "..."] | Vec3:
    """Return n_s, as a `Vec3` where there is one per channel."""
    if isinstance(n_s, AbstractPattern):
        return colour_at(n_s, None, uv).x
    if not np.ndim(n_s):
        return n_s
    return n_s[..., 0] if np.shape(n_s)[-1] == 1 else Vec3.of(n_s)

r"""Extension: what a lobe, light, law of attenuation, pattern or surface of your own is made of.

A class that derives from one of the bases below works in `render`, `fit` and `examine` as the library's own do. Its
fields, made by `number`, `colour` and `vector`, are checked, freed by name, reported with errors, and written to scene
files. Equations are written component by component: a `Vec3` holds x, y and z apart, each of the shape of the image.

```python
import jax.numpy as jnp
import diffshade as ds
from diffshade.extension import AbstractLobe, Scalar, dot, halfway, number

class Gaussian(AbstractLobe):
    width: Scalar = number(0.2, lower=0.01, start=0.2, search=(0.05, 0.1, 0.2, 0.4), logarithmic=True)

    def highlight(self, n_s, n, l, v):
        cosine = dot(n, halfway(l, v))
        return jnp.exp((cosine * cosine - 1.0) / (self.width * self.width))

material = ds.Material(k_d=0.5, k_s=0.3, lobe=Gaussian(0.1))
```

What the numbers must be: finite everywhere, with finite derivatives, also where a formula has a pole. Put the guard
inside: `jnp.where(x > 0, f(jnp.where(x > 0, x, 1.0)), 0.0)`.

| base | what to write | where it works |
|---|---|---|
| `AbstractPowerLobe` | `cosine`, the base of the power n_s | everywhere; fits are as fast as Phong's |
| `AbstractLobe` | `highlight`, of weight 1 | `render`, `fit`, `examine`, `report`; not `fit_texels` |
| `AbstractReflectance` | `reflected`, the whole of it | as `AbstractLobe` |
| `AbstractEmitter` | `is_local`, `path`, `arriving` | everywhere but files of other programs |
| `AbstractLamp` | `path`, with fields position, intensity, attenuation | as `AbstractEmitter`; fits are faster |
| `AbstractLight` | `is_local`, `emitters`: a light of many emitters | as `AbstractEmitter` |
| `AbstractAttenuation` | `factor`, the fraction at a distance | as the `attenuation` of every lamp; fits are as fast |
| `AbstractPattern` | `__call__`, a colour at a point | as the coefficient it stands for |
| `AbstractSurface`, `AbstractSolid` | `intersect`; of a solid also `leave` and `holds` | as the library's own shapes |
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx

from .core.fields import Numbers, as_colour, as_scalar, as_vector, parameter
from .model.attenuation import AbstractAttenuation, RadialAttenuation
from .model.cameras import Rays
from .model.lights import AbstractEmitter, AbstractLamp, AbstractLight, Path, PointLight, SpotLight
from .model.lobes import AbstractLobe, AbstractPowerLobe, AbstractReflectance, Coefficients
from .model.patterns import AbstractPattern
from .model.surfaces import AbstractSolid, AbstractSurface, Hit
from .model.vectors import Vec3, cross, dot, halfway, length, normalize, positive_power, reflect, safe_sqrt, where

if TYPE_CHECKING:  # what one may give; the field makes an array of it, which a type checker does not see
    Scalar: TypeAlias = Any
    Colour: TypeAlias = Any
    Vector: TypeAlias = Any
else:
    from .core.fields import Colour, Scalar, Vector

__all__ = [
    "AbstractAttenuation",
    "AbstractEmitter",
    "AbstractLamp",
    "AbstractLight",
    "AbstractLobe",
    "AbstractPattern",
    "AbstractPowerLobe",
    "AbstractReflectance",
    "AbstractSolid",
    "AbstractSurface",
    "Coefficients",
    "Colour",
    "Hit",
    "Path",
    "PointLight",
    "RadialAttenuation",
    "Rays",
    "Scalar",
    "SpotLight",
    "Vec3",
    "Vector",
    "colour",
    "cross",
    "dot",
    "halfway",
    "length",
    "normalize",
    "number",
    "positive_power",
    "reflect",
    "safe_sqrt",
    "vector",
    "where",
]


def number(
    default: Numbers | Any = dataclasses.MISSING,
    *,
    lower: float | int | None = None,
    upper: float | int | None = None,
    start: float | None = None,
    search: tuple[float, ...] = (),
    logarithmic: bool = False,
    linear: bool = False,
    role: str = "",
    gauge: int = 0,
) -> Any:
    """Return a field that holds one number.

    Args:
        default: Its value where none is given; without one it must be given.
        lower: The least value allowed; no bound by default.
        upper: The largest value allowed; no bound by default.
        start: Where a fit begins; by default at the scene's value.
        search: Values that a fit tries before it begins; none by default. Give them where the cost has several minima.
        logarithmic: Whether a fit solves for its logarithm; for widths and exponents. Needs `lower` above 0.
        linear: Whether the image is linear in it together with k_a, k_d and k_s. An intensity multiplies them: False.
        role: "attenuation", a number of a law of attenuation, which notes of a fit then name as one; "amplitude", one
            that a light of another intensity stands for, freed by its own name alone; or "", any number, by default.
        gauge: 1 where twice it, with all others of the law of which this is said, halves the light; -1 where it doubles
            the light; 0 for neither, by default.

    Returns:
        The field, to stand behind the annotation `Scalar`.

    Raises:
        ValueError: A number that is solved for as its logarithm may be 0 or less, `lower` is not below `upper`, or
            the role is none of these.
    """
    _check_role(role, ("attenuation", "amplitude", ""))
    if logarithmic and not (lower is not None and lower > 0):
        raise ValueError(f"lower must be above 0 for a logarithmic number; got {lower}. Give the least value.")
    _check_range(lower, upper)
    of_fit = {"start": start, "search": search, "logarithmic": logarithmic, "linear": linear, "gauge": gauge}
    by_own_name = role == "amplitude"
    return _field(as_scalar, default, parameter(role, lower=lower, upper=upper, by_own_name=by_own_name, **of_fit))


def colour(
    default: Numbers | Any = dataclasses.MISSING,
    *,
    lower: float | int | None = 0,
    upper: float | int | None = None,
    start: float | None = None,
    linear: bool = False,
) -> Any:
    """Return a field that holds a colour, RGB or grey.

    Args:
        default: Its value where none is given; without one it must be given.
        lower: The least value allowed; 0 by default.
        upper: The largest value allowed; no bound by default.
        start: Where a fit begins; by default at the scene's value.
        linear: Whether the image is linear in it together with k_a, k_d and k_s. An intensity multiplies them: False.

    Returns:
        The field, to stand behind the annotation `Colour`.

    Raises:
        ValueError: `lower` is not below `upper`.
    """
    _check_range(lower, upper)
    return _field(as_colour, default, parameter(lower=lower, upper=upper, start=start, linear=linear))


def vector(default: Numbers | Any = dataclasses.MISSING, *, role: str = "") -> Any:
    """Return a field that holds a vector.

    Args:
        default: Its value where none is given; without one it must be given.
        role: "position", whose error is judged by the size of the objects; "direction", which is fitted as a unit
            vector; or "", three numbers, by default.

    Returns:
        The field, to stand behind the annotation `Vector`.

    Raises:
        ValueError: The role is none of these.
    """
    _check_role(role, ("position", "direction", ""))
    return _field(as_vector, default, parameter(role))


def _check_role(role: str, roles: tuple[str, ...]) -> None:
    if role not in roles:
        raise ValueError(f"role must be {' or '.join(map(repr, roles))}; got {role!r}. Give one of them.")


def _check_range(lower: float | int | None, upper: float | int | None) -> None:
    if lower is not None and upper is not None and not lower < upper:
        raise ValueError(f"lower must be below upper; got {lower:g} and {upper:g}. Exchange them, or give one alone.")


def _field(converter: Any, default: Any, metadata: dict[str, Any]) -> Any:
    given = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(converter=converter, metadata=metadata, **given)

"""Other scenes: what a fault changes in the pictures, drawn anew with another material, lamp or shape."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ...core.fields import Array
from ...core.thresholds import FAR_MORE, MOST, SINGLE, SLIGHT, SMALL
from ...model.attenuation import AbstractAttenuation, RadialAttenuation
from ...model.bands import widened
from ...model.diffuse_laws import DiffuseLaw, under_coat
from ...model.fresnel import NoFresnel
from ...model.gbuffers import GBuffer
from ...model.lights import AbstractLamp, DirectionalLight, PointLight
from ...model.lobes import EXPONENTS, AbstractPowerLobe, Blinn, Phong
from ...model.materials import Highlight, Material
from ...model.microfacets import Microfacets
from ...model.patterns import AbstractPattern
from ...model.scenes import Scene
from ...model.surfaces import Sphere
from ...model.vectors import Vec3
from ..data.recording import photograph
from ..data.views import View, lights_on
from ..result import Fit
from .changes import Case
from .linearised import Linearised
from .regions import center_of, seen_points

EXPONENT_FACTORS = (1 / 16, 1 / 4, 4.0, 16.0)  # tested n_s of a second highlight, over the first's
USUAL_TRANSLUCENCY = 0.2  # w by which the fault is drawn: an amount is a multiple of that change
OF_ONE_PLACE = (AbstractLamp, DirectionalLight)  # lights without extent
STEP = SLIGHT  # relative, of lamps' distances and a sphere's axes: small beside their curvature, large beside rounding


def of_lobe(at: Linearised) -> Iterator[Case]:
    """Yield the other lobe, of which n_s is another number."""
    renamed = np.zeros(len(at.fit.values))
    for j, unknown in enumerate(at.fit.unknowns):
        for place in unknown.all_places:
            if place.field == "n_s":
                blinn = isinstance(at.fit.scene.objects[place.item or 0].material.lobe, Blinn)
                renamed[j] = at.fit.values[j] * (1.0 - (0.25 if blinn else 4.0))
    for case in _of_material(at, 0, with_other_lobe):
        yield replace(case, renamed=renamed)


def of_viewer(at: Linearised) -> Iterator[Case]:
    """Yield highlights as the other viewer sees them: far away, or at the eye of the camera."""
    if _is_placed(at.fit.scene) and len({view.camera.local_viewer for view in at.fit.views}) == 1:
        yield Case(0, (at.drawn(_by_other_viewer) - at.predicted)[None])


def _is_placed(scene: Scene) -> bool:
    """Whether the positions of all surfaces are known."""
    return not any(isinstance(x.surface, GBuffer) and x.surface.position is None for x in scene.objects)


def _by_other_viewer(scene: Scene, view: View) -> Float[np.ndarray, "h w c"]:
    camera = replace(view.camera, local_viewer=not view.camera.local_viewer)
    return photograph(scene, replace(view, camera=camera))


def of_roughness(at: Linearised) -> Iterator[Case]:
    """Yield surfaces that reflect more towards the light, as clay and plaster do; an amount is r of their law."""
    yield from _of_law(at, DiffuseLaw(1.0, 0.0).at, 1.0)


def of_translucency(at: Linearised) -> Iterator[Case]:
    """Yield surfaces that light enters, as wax, marble and skin; an amount is about w of their law."""
    if not at.fit.scene.shadows:  # with shadows, the side that turns away from the light is drawn black
        yield from _of_law(at, DiffuseLaw(0.0, USUAL_TRANSLUCENCY).at, USUAL_TRANSLUCENCY)


def of_coat(at: Linearised) -> Iterator[Case]:
    """Yield colours under a clear coat, as of plastic, glaze and varnish."""
    yield from _of_law(at, under_coat, 1.0)


def of_microfacets(at: Linearised) -> Iterator[Case]:
    """Yield highlights of microfacets, as wide at half their height, and the colour below them, as under a coat.

    One material shines, by a power of one cosine.
    """
    shiny = [item.material for item in at.fit.scene.objects if shines(item.material.k_s)]
    plain = len(shiny) == 1 and isinstance(shiny[0].fresnel, NoFresnel) and not shiny[0].highlights
    if not plain or not isinstance(shiny[0].lobe, Phong | Blinn) or isinstance(shiny[0].n_s, AbstractPattern):
        return
    n_s, blinn = float(np.mean(np.asarray(shiny[0].n_s))), isinstance(shiny[0].lobe, Blinn)
    if n_s < EXPONENTS[0]:  # too wide for a highlight
        return
    half = 0.25 ** (1.0 / n_s) if blinn else 0.5 + 0.5 * 0.5 ** (1.0 / n_s)  # (n.h)^2 at half the height
    facets = Microfacets(np.sqrt((1.0 - half) / (np.sqrt(2.0) - half)))

    def beyond(n_l: np.ndarray, n_v: np.ndarray, l_v: np.ndarray) -> np.ndarray:
        n_l, n_v = np.clip(n_l, 0.0, 1.0), np.clip(n_v, SMALL, 1.0)
        n_h = (n_l + n_v) / np.sqrt(np.maximum(2.0 + 2.0 * l_v, SINGLE))
        cosine = n_h if blinn else 2.0 * n_l * n_v - l_v
        shone = facets.distribution(np.minimum(n_h, 1.0)) * facets.visibility(n_l, n_v)
        shone *= 4.0 * facets.alpha**2 * n_l  # 1 where l and v are n
        return np.where(n_l > 0.0, shone - np.maximum(cosine, 0.0) ** n_s, 0.0)

    both = [_reflected(at, beyond, "k_s"), _reflected(at, _beyond_lambert(under_coat), "k_d")]
    if all(change is not None for change in both):
        yield Case(0, np.array(both))


def _of_law(at: Linearised, law: Callable[..., Array], amount: float) -> Iterator[Case]:
    """Yield the change by k_d that reflects by another law, by an amount."""
    if (change := _reflected(at, _beyond_lambert(law), "k_d")) is not None:
        yield Case(0, change[None] / amount)


def _beyond_lambert(law: Callable[..., Array]) -> Callable[..., np.ndarray]:
    return lambda n_l, n_v, l_v: np.maximum(np.asarray(law(n_l, n_v, l_v)), 0.0) - np.maximum(n_l, 0.0)


def _reflected(at: Linearised, beyond: Callable[..., np.ndarray], of: str) -> Float[np.ndarray, " n"] | None:
    """Return what surfaces show by more of one coefficient, from the cosines between normal, light and viewer.

    None if a view has other than one light without extent, or a sensor, or something is transparent.
    """
    single = all(len(lit) == 1 and isinstance(at.fit.scene.lights[lit[0]], OF_ONE_PLACE) for lit in at.set_up.lit)
    plain = all(view.sensor is None for view in at.fit.views)
    if single and plain and not any(item.material.k_t is not None for item in at.fit.scene.objects):
        return at.drawn(partial(_beyond, beyond, of))
    return None


def _beyond(beyond: Callable[..., np.ndarray], of: str, scene: Scene, view: View) -> Float[np.ndarray, "h w c"]:
    """Return what the surfaces of a scene show a view by so much more of a coefficient."""
    n, p, inside, n_v, ray = seen_points(scene.objects, view.camera)
    k = lights_on(scene, view)[0]
    light: Any = scene.lights[k]
    l = np.asarray(light.path(None if p is None else Vec3.of(p)).l.stack())
    more = beyond(np.sum(n * l, -1), n_v, -np.sum(l * ray, -1))
    flat = _flat(scene, of)  # given as ambient light too, what arrives is reflected whichever way a surface faces
    whole = eqx.tree_at(lambda s: s.lights[k].ambient, flat, light.intensity, is_leaf=lambda leaf: leaf is None)
    shown = photograph(replace(whole, ambient=0.0), view) - float(view.black)
    return np.where(inside, more, 0.0)[..., None] * shown


def _flat(scene: Scene, of: str) -> Scene:
    """Return a scene whose materials reflect ambient light alone, by one of their coefficients."""
    none, materials = np.zeros(len(scene.channels)), [item.material for item in scene.objects]
    flat = [replace(m, k_a=getattr(m, of), k_d=none, k_s=none, k_e=none, highlights=()) for m in materials]
    return eqx.tree_at(lambda s: [item.material for item in s.objects], scene, flat)


def of_elsewhere(at: Linearised) -> Iterator[Case]:
    """Yield light from other directions, as k_d reflects it: the nine harmonics up to the second order hold nearly all.

    Ramamoorthi and Hanrahan 2001, "An Efficient Representation for Irradiance Environment Maps". In one photograph nine
    amounts imitate most other faults.
    """
    if len(at.fit.views) > 1 and all(view.sensor is None for view in at.fit.views):
        yield Case(0, at.drawn(_by_harmonics).T)


def _by_harmonics(scene: Scene, view: View) -> Float[np.ndarray, "h w c 9"]:
    seen = harmonics(seen_points(scene.objects, view.camera).normal)
    even = photograph(
        replace(_flat(scene, "k_d"), lights=(), ambient=1.0, background=0.0), replace(view, lit=None, black=0.0)
    )
    return even[..., None] * seen[..., None, :]


def harmonics(n: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 9"]:
    """Return what a surface that faces n gets of each harmonic."""
    x, y, z = np.moveaxis(n, -1, 0)
    second = [x * y, y * z, x * z, 0.5 * (x**2 - y**2), 0.25 * (3.0 * z**2 - 1.0)]
    return np.stack([np.full(x.shape, 0.25), 0.5 * x, 0.5 * y, 0.5 * z, *second], -1)


def of_second_highlight(at: Linearised) -> Iterator[Case]:
    """Yield second highlights, sharper and wider."""
    for k, factor in enumerate(EXPONENT_FACTORS):
        yield from _of_material(at, k, partial(_with_second_highlight, factor, len(at.fit.scene.channels)))


def of_missing_highlight(at: Linearised) -> Iterator[Case]:
    """Yield highlights on objects that are matte, as the scene says and no free number changes."""
    matte = not any(shines(item.material.k_s) for item in at.fit.scene.objects)
    if matte and not any(place.field == "k_s" for u in at.fit.unknowns for place in u.all_places):
        for k, n_s in enumerate(EXPONENTS[1:]):
            shiny = [replace(item.material, k_s=MOST, n_s=n_s) for item in at.fit.scene.objects]
            scene = eqx.tree_at(lambda s: [item.material for item in s.objects], at.fit.scene, shiny)
            yield Case(k, (at.drawn(scene=scene) - at.predicted)[None] / MOST)


def of_attenuation(at: Linearised) -> Iterator[Case]:
    """Yield lamps whose light does not fall off, and lamps whose light falls off by the square of the distance."""
    for power in (0, 2):
        yield from _of_lamps(at, power, with_lamps(at.fit, partial(falling, power)), 1.0)


def of_distance(at: Linearised) -> Iterator[Case]:
    """Yield lamps that are all farther by the same factor, and as strong where the object is."""
    yield from _of_lamps(at, 0, with_lamps(at.fit, partial(farther, 1.0 + STEP)), STEP)


def of_near(at: Linearised) -> Iterator[Case]:
    """Yield lights at infinity that are lamps, whose light does not fall off, or does; an amount is over the distance.

    It is drawn where they are twice as far as the camera. Directions that are free have no place in a scene of lamps.
    """
    turning = any(place.field == "direction" for unknown in at.fit.unknowns for place in unknown.all_places)
    if not turning and _is_placed(at.fit.scene):
        for power in (0, 2):
            yield from _of_lamps(at, power, with_near_lamps(at.fit, power, FAR_MORE), 1.0 / FAR_MORE)


def with_near_lamps(fit: Fit, power: int, factor: float) -> Scene:
    """Return a fit's scene with lamps for lights at infinity, farther than the camera by a factor; see `falling`."""

    def near(light: Any, center: np.ndarray) -> Any:
        d = factor * np.linalg.norm(np.asarray(fit.views[0].camera.eye) - center)
        place = center - d * np.asarray(light.direction) / np.linalg.norm(light.direction)
        lamp = PointLight(place, light.intensity, ambient=light.ambient, specular=light.specular)
        return falling(power, lamp, center)

    return with_lamps(fit, near, (DirectionalLight,))


def of_size(at: Linearised) -> Iterator[Case]:
    """Yield square lights, as wide as they are far.

    To the first order in the square of its width such light is the mean of that of the light moved to four sides, so
    far that where its light ends on the object is drawn as gradual as that of a usual lamp is.
    """
    movable = any(isinstance(light, OF_ONE_PLACE) for light in at.fit.scene.lights)
    if movable and at.light.any():
        sides = (partial(aside, side) for side in ((0, 1), (0, -1), (1, 1), (1, -1)))
        moved = (at.drawn(scene=with_lamps(at.fit, to_side, OF_ONE_PLACE)) for to_side in sides)
        yield Case(0, (sum(moved) / 4.0 - at.predicted)[None] / (6.0 * SMALL**2))  # whose variance is a twelfth


def aside(side: tuple[int, int], light: Any, center: np.ndarray) -> Any:
    """Return a light moved across the way of its light, by `SMALL` of its distance: along an axis, forth or back."""
    axis, sign = side
    place = light.placement[0]
    there = np.asarray(getattr(light, place))
    arm = there - center if place == "position" else there
    across = np.linalg.svd(arm[None])[2][1 + axis]
    return eqx.tree_at(lambda of: getattr(of, place), light, there + sign * SMALL * np.linalg.norm(arm) * across)


def _of_lamps(at: Linearised, which: int, scene: Scene, amount: float) -> Iterator[Case]:
    """Yield the change by other lamps, by an amount, but for that of their strength, which the reflections imitate."""
    same = all(light is before for light, before in zip(scene.lights, at.fit.scene.lights, strict=True))
    if same or not at.light.any():
        return
    changed = at.drawn(scene=scene) - at.predicted
    weighted = at.weight * at.light
    changed = changed - at.light * (weighted @ changed / (weighted @ at.light))
    if np.abs(changed).max() > SINGLE * np.abs(at.light).max():
        yield Case(which, changed[None] / amount)


def with_lamps(fit: Fit, change: Callable[[Any, np.ndarray], Any], kinds: tuple[type, ...] = (AbstractLamp,)) -> Scene:
    """Return a fit's scene with all its lights of some kinds changed, given the middle of its objects."""
    center = center_of(fit.scene.objects, fit.views[0].camera)
    lights = [change(light, center) if isinstance(light, kinds) else light for light in fit.scene.lights]
    return replace(fit.scene, lights=lights)


def falling(power: int, lamp: Any, center: np.ndarray) -> Any:
    """Return a lamp whose light falls off by a power of the distance, and is what it was at the centre."""
    d = float(np.linalg.norm(np.asarray(lamp.position) - center))
    there = float(_factor(lamp.attenuation, d))
    if not d > 0.0 or not there > 0.0:
        return lamp
    law = RadialAttenuation(*((np.arange(3) == power) / (there * d**power)))
    return eqx.tree_at(lambda of: of.attenuation, lamp, law)


@jax.jit
def _factor(law: AbstractAttenuation, d: float) -> Array:
    """Return how much of the light is left at a distance, by one program for each law."""
    return law(d)


def farther(factor: float, lamp: Any, center: np.ndarray) -> Any:
    """Return a lamp that is farther from the centre by a factor, and as strong there."""
    arm = np.asarray(lamp.position) - center
    d = float(np.linalg.norm(arm))
    there, then = float(_factor(lamp.attenuation, d)), float(_factor(lamp.attenuation, factor * d))
    if not then > 0.0:
        return lamp
    moved = center + factor * arm, there / then * np.asarray(lamp.intensity)
    return eqx.tree_at(lambda of: (of.position, of.intensity), lamp, moved)


def of_ellipsoid(at: Linearised) -> Iterator[Case]:
    """Yield a sphere, the scene's only object, that is longer along some directions: five amounts of equal volume.

    It is drawn as a G-buffer, which glass, shadows and patterns on the sphere do not allow.
    """
    (item, *others), scene = at.fit.scene.objects, at.fit.scene
    patterned = any(isinstance(getattr(item.material, of.name), AbstractPattern) for of in fields(item.material))
    if others or not isinstance(item.surface, Sphere) or patterned or item.material.k_t is not None or scene.shadows:
        return
    yield Case(0, at.drawn(_by_stretch).T / STEP)


def stretch(amount: Float[np.ndarray, "5"]) -> Float[np.ndarray, "3 3"]:
    """Return the relative change of lengths along each direction, symmetric and of no volume, by five amounts."""
    e = np.eye(3)
    pairs = [np.outer(e[i], e[j]) + np.outer(e[j], e[i]) for i, j in ((0, 1), (0, 2), (1, 2))]
    along = [np.diag(e[0] - e[1]), np.diag(2.0 * e[2] - e[0] - e[1]) / np.sqrt(3.0)]
    return np.tensordot(amount, [*pairs, *along], 1)


def _by_stretch(scene: Scene, view: View) -> Float[np.ndarray, "h w c 5"]:
    """Return the change of a photograph by `STEP` of each amount."""
    before, *after = (photograph(of, view) for of in _stretched(scene, view))
    return np.stack([of - before for of in after], -1)


def _stretched(scene: Scene, view: View) -> Iterator[Scene]:
    """Yield a scene of one sphere as a view sees it, and then with its axes changed by `STEP`, in five ways.

    A stretch I + S turns the normal n at p, seen from e, to (I - S) n of the point of the sphere that is now seen at
    the same pixel: p - S (p - c), and along the ray from e until it is on the sphere again.
    """
    sphere: Any = scene.objects[0].surface
    n, p, mask, _, ray = seen_points(scene.objects, view.camera)
    arm = p - np.asarray(sphere.center)
    facing = np.where(np.abs(across := np.sum(n * ray, -1)) > STEP, across, -1.0)
    for S in (np.zeros((3, 3)), *(STEP * stretch(amount) for amount in np.eye(5))):
        along = np.sum(n * (arm @ S), -1) / facing
        turned = n + (along[..., None] * ray - arm @ S) / float(sphere.radius) - n @ S
        turned = turned / np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), SINGLE)
        surface = GBuffer(np.where(mask[..., None], turned, 0.0), p, mask)
        yield eqx.tree_at(lambda s: s.objects[0].surface, scene, surface)


def _of_material(at: Linearised, which: int, change: Callable[[Material], Material | None]) -> Iterator[Case]:
    """Yield the change of the pictures by a change of each material that shines."""
    scene = with_materials(at.fit.scene, change)
    if scene is not None:
        yield Case(which, (at.drawn(scene=scene) - at.predicted)[None])


def with_materials(scene: Scene, change: Callable[[Material], Material | None]) -> Scene | None:
    """Return a scene with all materials that shine changed; None if there are none, or one cannot be changed."""
    shiny = [i for i, item in enumerate(scene.objects) if shines(item.material.k_s)]
    changed = [change(scene.objects[i].material) for i in shiny]
    if not shiny or any(material is None for material in changed):
        return None
    return eqx.tree_at(lambda s: [s.objects[i].material for i in shiny], scene, changed)


def _with_second_highlight(factor: float, bands: int, m: Material) -> Material | None:
    """Return a material with a second highlight as strong as the first, of n_s by a factor."""
    if m.highlights or not isinstance(m.lobe, AbstractPowerLobe) or not isinstance(m.fresnel, NoFresnel):
        return None
    second = Highlight(m.k_s, np.maximum(factor * np.asarray(m.n_s, np.float64), 1.0), m.lobe)
    return replace(m, highlights=(widened(second, bands),))  # of one band its colour was made RGB


def with_other_lobe(m: Material) -> Material | None:
    """Return a material with Blinn's highlight of four times n_s for Phong's, or the other way round."""
    if not isinstance(m.lobe, Phong | Blinn):
        return None
    lobe, factor = (Phong(), 0.25) if isinstance(m.lobe, Blinn) else (Blinn(), 4.0)
    return replace(m, lobe=lobe, n_s=factor * np.asarray(m.n_s, np.float64))


def shines(k_s: Any) -> bool:
    """Whether a surface with this k_s has a highlight."""
    return isinstance(k_s, AbstractPattern) or bool(np.any(np.asarray(k_s) > 0))

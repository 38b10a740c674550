"""The largest error of every equation E1-E14 against all that it is compared with: `python tests/support/equations.py`.

Pictures are those of the oracle's scenes and of the references by other programs; a picture counts for every equation
that it needs. Numbers that can be worked out by hand are the closed forms. Pictures are rendered operation by
operation, which takes a quarter of the time of compiling them all, or with `--compiled` as users render them.
"""

import argparse
import functools
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import oracle
from oracle_scenes import LONG_TO_COMPILE, SCENES, equations, library_camera, library_scene, needed
from reference_files import FOLDER, PROGRAMS, Refraction, Shading, read_reference
from rich.console import Console
from rich.table import Table

import diffshade as ds
from diffshade.model.rendering import pixel_rays
from diffshade.model.transmission import bend
from diffshade.model.vectors import Vec3, refract

TERMS = {
    "E1": "ambient",
    "E2": "radial attenuation",
    "E3": "angular attenuation",
    "E4": "diffuse",
    "E5": "specular, Phong",
    "E6": "specular, Blinn",
    "E7": "Fresnel",
    "E8": "viewer",
    "E9": "many lights, emission",
    "E10": "Foley's colours",
    "E11": "area light",
    "E12": "refraction",
    "E13": "transparency",
    "E14": "atmosphere",
}
FILES = sorted(FOLDER.glob("*.npz"))
WITNESSES = ("oracle", "closed form", *dict.fromkeys(PROGRAMS.values()))


@dataclass(frozen=True)
class Comparison:
    """One picture or table of numbers: how far it is from what a witness says, and how far it may be."""

    equation: str
    witness: str
    numbers: int
    error: float
    tolerance: float
    name: str = ""


@functools.cache
def picture(name: str, *, compiled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return what the library and what the oracle renders of one of the oracle's scenes."""
    scene, camera = SCENES[name]
    with jax.disable_jit(not compiled):
        found = np.asarray(ds.render(library_scene(scene), library_camera(camera)))
    return found, oracle.render(scene, camera)


@functools.cache
def reference(path: Path, *, compiled: bool) -> tuple[Shading | Refraction, np.ndarray]:
    """Return what another program renders and what the library does."""
    of_program = read_reference(path)
    with jax.disable_jit(not compiled):
        return of_program, of_program.found()


# Closed forms: what is found, what is right, and how far apart they may be.
ClosedForm = tuple[np.ndarray, np.ndarray, float]
FLAT = ds.OrthographicCamera((0, 0, 4), shape=(1, 1))
UP = ds.GBuffer(np.array([[(0.0, 0, 1)]]), np.zeros((1, 1, 3)))


def seen(material: ds.Material, *lights, **more) -> np.ndarray:
    """Return the colour of a point at the origin that faces the viewer, who is 4 away."""
    return np.asarray(ds.shade(ds.Scene(ds.Object(ds.Sphere(), material), lights, **more), UP, FLAT))[0, 0]


def ambient() -> ClosedForm:
    """k_a I_a"""
    return seen(ds.Material(k_a=(0.2, 0.3, 0.4)), ambient=(0.5, 1, 2)), np.array([0.1, 0.3, 0.8]), 1e-15


def radial_attenuation() -> ClosedForm:
    """1/(1 + 2 + 4/8) at a distance of 2."""
    light = ds.PointLight((0, 0, 2), attenuation=ds.RadialAttenuation(1.0, 1.0, 0.125))
    return seen(ds.Material(k_d=1), light), np.full(3, 1 / 3.5), 1e-15


def angular_attenuation() -> ClosedForm:
    """cos^3 of 60 degrees, on a point that the light falls straight on."""
    light = ds.SpotLight((0, 0, 2), (np.sqrt(3), 0, -1), cutoff=70, exponent=3)
    return seen(ds.Material(k_d=1), light), np.full(3, 0.125), 1e-14


def diffuse() -> ClosedForm:
    """cos 60 degrees."""
    return seen(ds.Material(k_d=1), ds.DirectionalLight((np.sqrt(3), 0, -1))), np.full(3, 0.5), 1e-15


def phong() -> ClosedForm:
    """cos^5 of 60 degrees."""
    return seen(ds.Material(k_s=1, n_s=5), ds.DirectionalLight((np.sqrt(3), 0, -1))), np.full(3, 2**-5), 1e-14


def blinn() -> ClosedForm:
    """cos^4 of half of 60 degrees."""
    material = ds.Material(k_s=1, n_s=4, lobe=ds.Blinn())
    return seen(material, ds.DirectionalLight((np.sqrt(3), 0, -1))), np.full(3, 0.75**2), 1e-14


def fresnel() -> ClosedForm:
    """((eta - 1)/(eta + 1))^2 head on; at Brewster's angle, tan i = eta, r_p = 0 and r_s = (1 - eta^2)/(1 + eta^2)."""
    eta = 1.5
    material = ds.Material(n_s=0, fresnel=ds.Dielectric(), eta=eta)
    found = [seen(material, ds.DirectionalLight(d)) for d in ((0, 0, -1), (eta, 0, -1))]
    right = [((eta - 1) / (eta + 1)) ** 2, 0.5 * ((eta**2 - 1) / (eta**2 + 1)) ** 2]
    return np.array(found), np.repeat(right, 3).reshape(2, 3), 1e-14


def emission_and_two_lights() -> ClosedForm:
    """Three numbers that are added."""
    material = ds.Material(k_e=(0.1, 0, 0), k_d=1)
    lights = ds.DirectionalLight((0, 0, -1), (0, 0.2, 0)), ds.PointLight((0, 0, 2), (0, 0, 0.3))
    return seen(material, *lights), np.array([0.1, 0.2, 0.3]), 1e-15


def foley() -> ClosedForm:
    """(k_a I_a + k_d) O_d + k_s O_s under a light straight above."""
    material = ds.Material.foley(O_d=(0.2, 0.4, 0.8), O_s=(1, 0.5, 0), k_a=0.5, k_d=0.25, k_s=0.5)
    return seen(material, ds.DirectionalLight((0, 0, -1))), np.array([0.65, 0.55, 0.6]), 1e-14


def rectangle() -> ClosedForm:
    """The unit square parallel to the surface, one corner 1 above the point: pi times its form factor.

    (Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-3.) A light of 48 x 48 samples is 1e-5 off.
    """
    one_over_d2 = ds.RadialAttenuation(0, 0, 1)
    light = ds.AreaLight((0, 0, 1), (0, 1, 0), (1, 0, 0), samples=(48, 48), attenuation=one_over_d2)
    right = np.sqrt(0.5) * np.arctan(np.sqrt(0.5))
    return seen(ds.Material(k_d=1), light), np.full(3, right), 2e-5


def snell() -> ClosedForm:
    """30 degrees into an index of 1.61 give 18.09; behind a slab a ray is t sin(i - r)/cos r beside where it was."""
    i = np.deg2rad(30)
    r = np.arcsin(0.5 / 1.61)
    v = np.array([np.sin(i), 0, np.cos(i)])
    camera = ds.OrthographicCamera(tuple(8 * v), shape=(1, 1))
    slab = ds.Box((0, 0, -0.35), (50, 50, 0.7))
    T, p, d = (np.asarray(a) for a in _through(slab, np.array(1.61), v, camera))
    shift = np.linalg.norm(np.cross(p, d))  # of the line that comes out, from the one through the origin
    right = [np.rad2deg(r), 0.7 * np.sin(i - r) / np.cos(r)]
    return np.array([np.rad2deg(np.arctan2(-T[0], -T[2])), shift]), np.array(right), 1e-13


@jax.jit
def _through(slab, eta, v, camera):
    rays = pixel_rays(camera.projection(), camera.shape)
    way, _ = bend(slab, rays, slab.intersect(rays), eta)
    n = Vec3(*(jax.numpy.array(x) for x in (0.0, 0.0, 1.0)))
    T, _ = refract(Vec3.of(v), n, 1 / eta)
    return T.stack(), way.outer.origin.stack()[0, 0], way.outer.direction.stack()[0, 0]


def layers() -> ClosedForm:
    """Three panes before a background: k_e (1 - k_t) of each, times the k_t of those before it."""
    k_t, k_e = np.array([0.5, 0.2, 0.7]), np.array([0.3, 0.9, 0.4])
    panes = [
        ds.Object(ds.Plane((0, 0, -z), (0, 0, 1)), ds.Material(k_e=e, k_t=t))
        for z, (t, e) in enumerate(zip(k_t, k_e, strict=True))
    ]
    image = ds.render(ds.Scene(panes, background=(1, 2, 3)), FLAT)
    before = np.array([1, 0.5, 0.1])
    return np.asarray(image)[0, 0], (before * (1 - k_t) * k_e).sum() + 0.07 * np.array([1, 2, 3]), 1e-14


def air() -> ClosedForm:
    """Of white at a distance of 4: black depth cueing from 2 to 6, and black fog of two kinds."""
    airs = ds.DepthCueing(2, 6, s_f=0.9, s_b=0.1), ds.Fog(0.25), ds.Fog(0.5, squared=True)
    found = [seen(ds.Material(k_e=1), atmosphere=a) for a in airs]
    return np.array(found), np.repeat([0.5, np.exp(-1), np.exp(-4)], 3).reshape(3, 3), 1e-14


CLOSED_FORMS: dict[str, Callable[[], ClosedForm]] = {
    "E1": ambient,
    "E2": radial_attenuation,
    "E3": angular_attenuation,
    "E4": diffuse,
    "E5": phong,
    "E6": blinn,
    "E7": fresnel,
    "E9": emission_and_two_lights,
    "E10": foley,
    "E11": rectangle,
    "E12": snell,
    "E13": layers,
    "E14": air,
}


def comparisons(
    *, compiled: bool = False, leave_out: Collection[str] = (), files: Collection[Path] = FILES
) -> Iterator[Comparison]:
    """Compare with the oracle, but for some of its scenes, the closed forms and the other programs."""
    for name, (scene, _) in SCENES.items():
        if name not in leave_out:
            found, expected = picture(name, compiled=compiled)
            error = (np.abs(found - expected) / (np.abs(expected) + 0.01)).max()
            yield from (Comparison(e, "oracle", found.size, error, 1e-12, name) for e in needed(scene))
    for equation, closed_form in CLOSED_FORMS.items():
        with jax.disable_jit(not compiled and equation != "E11"):  # whose light has 2,304 emitters
            found, right, tolerance = closed_form()
        yield Comparison(equation, "closed form", found.size, np.abs(found - right).max(), tolerance)
    for path in files:
        of_program, found = reference(path, compiled=compiled)
        names = {"E12"} if isinstance(of_program, Refraction) else equations(of_program.scene)
        errors = np.abs(found - of_program.expected)[of_program.mask]
        more = errors.size, errors.max(), of_program.tolerance, path.stem
        yield from (Comparison(e, of_program.program, *more) for e in names)


def table(found: list[Comparison]) -> Table:
    """One row an equation: the largest error against each witness, in how many pictures, of how many numbers in all."""
    title = "Largest error of each equation (in how many pictures or tables)"
    caption = "oracle: relative, |a - b|/(|b| + 0.01), at most 1e-12; the others: absolute"
    rows = Table(title=title, caption=caption)
    rows.add_column("")
    rows.add_column("equation", no_wrap=True)
    for witness in WITNESSES:
        rows.add_column(witness, justify="right", no_wrap=True)
    rows.add_column("numbers", justify="right")
    rows.add_column("right")
    for equation, term in TERMS.items():
        here = [c for c in found if c.equation == equation]
        cells = []
        for witness in WITNESSES:
            by = [c.error for c in here if c.witness == witness]
            cells.append(f"{max(by):.1e} ({len(by)})" if by else "")
        within = "yes" if all(c.error <= c.tolerance for c in here) else "[bold red]NO"
        rows.add_row(equation, term, *cells, f"{sum(c.numbers for c in here):,}", within)
    return rows


def main() -> None:
    """Print the table; exit with 1 where an error is above its tolerance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compiled", action="store_true", help="compile the pictures, but for those that take minutes")
    options = parser.parse_args()
    with jax.enable_x64(True):
        found = list(comparisons(compiled=options.compiled, leave_out=LONG_TO_COMPILE if options.compiled else ()))
    Console(width=132).print(table(found))
    raise SystemExit(any(not c.error <= c.tolerance for c in found))


if __name__ == "__main__":
    main()

"""What is differentiable, and where it is not smooth: the checks of tests/model/test_gradients_of_the_whole_model.py.

`python tests/support/derivatives.py` runs them and writes tests/support/DERIVATIVES.md.
"""

import argparse
import dataclasses
import inspect
import math
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from test_gradients import ATTENUATION, DARK, DOWN, QUICK, SOFT, UP, ZERO, colour, corner, path_of, unit

import diffshade as ds
from diffshade.fields import _KINDS, Checked

TABLE = Path(__file__).with_name("DERIVATIVES.md")
MARGIN = 0.05
STEP = 3e-5
SMALL = 1e-3  # a derivative below it is not told from the rounding of the differences

# Derivatives where the image is smooth ------------------------------------------------------------------------------


def smooth_pixels(image, flat):
    """The pixels at which every comparison that the program makes is decided by more than the margin.

    Each kink and jump of the model is a comparison: n.l > 0, a hit in front of another, one side of a box's edge, the
    critical angle, z <= z_f. So the program is run operation by operation and the smallest |a - b| noted.
    """
    with jax.disable_jit():
        closed = jax.make_jaxpr(image)(flat)
    shape = closed.out_avals[0].shape[:2]
    margin = np.full(shape, np.inf)

    def note(gap):
        if gap.shape == shape:
            # 0, to the tolerance of a ray on a surface, is no chance but two ways to one number: a ray that has left a
            # solid is on it; were it chance, the difference below would show it
            np.minimum(margin, np.where((np.abs(gap) < 2e-4) | np.isnan(gap), np.inf, np.abs(gap)), out=margin)

    def run(jaxpr, constants, arguments):
        known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))

        def value(atom):
            return atom.val if isinstance(atom, jax.extend.core.Literal) else known[atom]

        for equation in jaxpr.eqns:
            name, inputs = equation.primitive.name, [value(atom) for atom in equation.invars]
            inner = next((equation.params[key] for key in ("jaxpr", "call_jaxpr") if key in equation.params), None)
            if inner is None:
                outputs = equation.primitive.bind(*inputs, **equation.params)
                outputs = outputs if equation.primitive.multiple_results else [outputs]
            else:
                assert name != "scan"  # which disable_jit unrolls
                outputs = run(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), inputs)
            if name in ("gt", "lt", "ge", "le", "max", "min") and np.asarray(inputs[0]).dtype.kind == "f":
                note(np.subtract(*np.broadcast_arrays(*inputs)))
            elif name in ("abs", "sign"):
                note(np.asarray(inputs[0]))
            known.update(zip(equation.outvars, outputs, strict=True))
        return [value(atom) for atom in jaxpr.outvars]

    with np.errstate(invalid="ignore"):
        run(closed.jaxpr, closed.consts, [flat])
    return margin > MARGIN


def errors_of(render, tree):
    """Map the path of each leaf to the largest error of its derivative, or None where that is 0 everywhere.

    Of the forward and the reverse mode against central differences (of fourth order), element by element, in units of
    the largest element of the leaf's derivative, or of SMALL.
    """
    flat, unravel = ravel_pytree(tree)

    def image(flat):
        return render(unravel(flat))

    smooth = smooth_pixels(image, flat)
    assert smooth.sum() >= 40, smooth.sum()
    weight = np.random.default_rng(3).normal(size=(*smooth.shape, 3)) * smooth[..., None]

    @partial(jax.jit, compiler_options=QUICK)
    def at(flat, tangent):
        def total(flat):
            return (weight * image(flat)).sum()

        return *jax.jvp(total, (flat,), (tangent,)), jax.grad(total)(flat)

    basis = np.eye(flat.size)
    forward = np.array([at(flat, row)[1] for row in basis])
    reverse = np.asarray(at(flat, basis[0])[2])
    near, far = (
        np.array([at(flat + h * e, e)[0] - at(flat - h * e, e)[0] for e in basis]) / (2 * h) for h in (STEP, 2 * STEP)
    )
    differences = (4 * near - far) / 3
    errors, first = {}, 0
    for path, leaf in jax.tree.leaves_with_path(tree):
        of = slice(first, first := first + np.size(leaf))
        largest = np.abs(differences[of]).max()
        if largest == 0 and not forward[of].any() and not reverse[of].any():
            errors[path_of(path)] = None
        else:
            gap = np.abs([forward[of] - differences[of], reverse[of] - differences[of]]).max()
            errors[path_of(path)] = float(gap / max(largest, SMALL))
    return errors


FLOOR = ds.Plane((0.1, -1.1, 0.2), (0.1, 2.0, 0.15))
WALL = ds.Plane((0.2, 0.1, -2.5), (0.1, 0.15, 2.0))
ON_THE_FLOOR = ds.Chequer((0.9, 0.7, 0.5), (0.1, 0.3, 0.2), 3.1, True, (1, 0.1, 0.2), (-0.2, 0.1, 1))
ON_THE_WALL = ds.Chequer((0.9, 0.7, 0.5), (0.1, 0.3, 0.2), 2.7, True, (1, 0.1, 0.2), (-0.1, 1, 0.3))
BALL = ds.Sphere((-0.7, -0.1, 0.3), 0.8)
BLOCK = ds.Box((0.9, -0.2, 0.1), (1.1, 1.3, 0.9), (20, 35, 10))
POINT = ds.PointLight((1.5, 2, 2.5), (5, 4, 3), ATTENUATION)
DIRECTIONAL = ds.DirectionalLight((-1, -0.8, -2), (0.6, 0.5, 0.4))
AREA = ds.AreaLight(
    (-1.2, 2.3, 1), (1, 0.1, 0.3), (0.2, -0.3, 1.1), (5, 6, 7), exponent=1.5, attenuation=ATTENUATION, samples=(2, 1)
)
MEASURED = ds.MeasuredLight(
    (-1, 1.7, 2.2),
    (0.4, -0.9, -1.3),
    ds.Profile((0, 25, 60, 110, 180), (0, 100, 220, 360), [[3, 2.5, 1, 0.4, 0], [3, 2, 1.5, 0.2, 0]] * 2),
    (2, 3, 4),
    ATTENUATION,
    side=(1, 0.3, 0.1),
)
COLOURS: dict[str, Any] = {"k_a": (0.1, 0.2, 0.15), "k_d": (0.7, 0.25, 0.2), "k_e": (0.05, 0.02, 0.1)}
SHINY: dict[str, Any] = {**COLOURS, "k_s": (0.4, 0.3, 0.5)}
EYE = {"eye": (0.5, 0.8, 5), "target": (0.1, 0.1, -0.1), "up": (0.2, 1, 0.1), "shape": (24, 32)}
RANDOM = np.random.default_rng(5)
RELIEF = ds.GBuffer(
    unit(RANDOM.normal((0, 0, 1.5), size=(6, 12, 3))),
    0.5 * RANDOM.normal(size=(6, 12, 3)),
    RANDOM.random((6, 12)) < 0.9,
)

# name: scene and camera; together they hold every numeric field of the model
SCENES = {
    "a floor, a turned box and a ball": (
        ds.Scene(
            [
                ds.Object(FLOOR, ds.Material(0.1, ON_THE_FLOOR, 0.2, 3.5)),
                ds.Object(BLOCK, ds.Material(**SHINY, n_s=(3, 4.5, 6), fresnel=ds.Schlick())),
                ds.Object(BALL, ds.Material(**COLOURS, n_s=7.5, lobe=ds.Blinn(), fresnel=ds.Dielectric(), eta=1.6)),
            ],
            [AREA, DIRECTIONAL, MEASURED],
            (0.9, 0.8, 0.7),
            (0.1, 0.2, 0.3),
            ds.DepthCueing(2.5, 9, s_f=0.9, s_b=0.2, I_dc=(0.5, 0.6, 0.7)),
        ),
        ds.Camera(**{**EYE, "eye": (0.5, 2.5, 4.5)}, fov=40),  # from where no horizon is seen
    ),
    "a glass ball before a wall": (
        ds.Scene(
            [
                ds.Object(BALL, ds.Material(**SHINY, n_s=6, k_t=(0.5, 0.6, 0.7), eta=1.4, lobe=ds.Blinn())),
                ds.Object(WALL, ds.Material(0.1, ON_THE_WALL)),
            ],
            [POINT],
            atmosphere=ds.Fog(0.1, I_dc=(0.5, 0.6, 0.7), radial=True),
        ),
        ds.Camera(**EYE, fov=40, principal_point=(15.3, 12.4), aspect=1.05),
    ),
    "a turned glass box before a wall": (
        ds.Scene(
            [
                ds.Object(WALL, ds.Material(0.1, ON_THE_WALL)),
                ds.Object(
                    BLOCK,
                    ds.Material(**COLOURS, n_s=(3, 4.5, 6), fresnel=ds.Dielectric(), k_t=(0.5, 0.6, 0.7), eta=1.3),
                ),
            ],
            [DIRECTIONAL],
            atmosphere=ds.Fog(0.1, I_dc=(0.5, 0.6, 0.7), squared=True),
        ),
        ds.OrthographicCamera(**EYE, height=3.2),
    ),
    "unbent through two balls and past a wall": (
        ds.Scene(
            [
                ds.Object(BALL, ds.Material(**COLOURS, k_t=ON_THE_WALL, eta=1)),
                ds.Object(ds.Sphere((-0.2, 0.3, -1), 1), ds.Material(**SHINY, n_s=4, fresnel=ds.Schlick(), k_t=0.6)),
                ds.Object(WALL, ds.Material(0.1, ON_THE_WALL)),
            ],
            [POINT],
            (0.9, 0.8, 0.7),
            (0.1, 0.2, 0.3),
            ds.DepthCueing(2.5, 9, s_f=0.9, s_b=0.2, I_dc=(0.5, 0.6, 0.7), radial=True),
        ),
        ds.Camera(**EYE, fov=40, local_viewer=False),
    ),
    "a relief in fog": (
        ds.Scene(
            [ds.Object(RELIEF, ds.Material(**SHINY, n_s=5, lobe=ds.Blinn()))],
            [POINT, SOFT],
            atmosphere=ds.Fog(0.2, I_dc=(0.5, 0.6, 0.7), squared=True, radial=True),
        ),
        ds.Camera(**{**EYE, "shape": (6, 12)}, fov=40),
    ),
}


def errors_in(name):
    """Map the path of each leaf of a scene and its camera to the error of its derivatives (see errors_of)."""
    free = jax.tree.map(
        lambda leaf: not isinstance(leaf, ds.Profile) and leaf.dtype != bool,  # a lamp's table is measured, not fitted
        SCENES[name],
        is_leaf=lambda node: isinstance(node, ds.Profile),
    )
    numbers, rest = eqx.partition(SCENES[name], free)
    return errors_of(lambda numbers: ds.render(*eqx.combine(numbers, rest)), numbers)


# Derivatives at the kinks -------------------------------------------------------------------------------------------


@partial(jax.jit, compiler_options=QUICK, static_argnums=0)
def forward(function, tree, tangent):
    return jax.jvp(function, (tree,), (tangent,))[1]


@partial(jax.jit, compiler_options=QUICK, static_argnums=0)
def reverse(function, tree, cotangent):
    return jax.vjp(function, tree)[1](cotangent)[0]


def seen(tree):
    """The colour of the only pixel of a scene and its camera."""
    return ds.render(*tree)[0, 0]


def derivatives_at(function, tree):
    """Map each leaf's path to its derivative, channels first; both modes must agree and be finite."""
    flat, unravel = ravel_pytree(tree)
    by_row = np.stack([ravel_pytree(reverse(function, tree, channel))[0] for channel in np.eye(3)])
    by_column = np.stack([forward(function, tree, unravel(jnp.asarray(column))) for column in np.eye(flat.size)], -1)
    paths = [path_of(path) for path, leaf in jax.tree.leaves_with_path(tree) for _ in range(np.size(leaf))]
    for i, path in enumerate(paths):
        assert np.isfinite(by_column[:, i]).all(), f"the forward derivative with respect to {path}: {by_column[:, i]}"
        assert np.isfinite(by_row[:, i]).all(), f"the reverse derivative with respect to {path}: {by_row[:, i]}"
    np.testing.assert_allclose(by_column, by_row, rtol=1e-9, atol=1e-9 * max(1, np.abs(by_row).max()))
    return {path: by_row[:, np.equal(paths, path)] for path in dict.fromkeys(paths)}


def at_the_origin(fresnel, l=(1, 0, 2), *, eta=1.5, area=None, cutoff=90, exponent=1):
    """A plane seen from straight above, at the origin, under a point light and an area light of one emitter."""
    k_s = 0 if isinstance(fresnel, ds.Dielectric) else (0.4, 0.3, 0.5)
    k_d = ds.Chequer(0.7, 0.2, 2.0, isinstance(fresnel, ds.Dielectric))
    middle, u, v = area or ((0, 0, 2), (1, 0, 0), (0, -1, 0))
    corner = np.subtract(middle, 0.5 * np.add(u, v))
    lights = [
        ds.PointLight(l, (3, 4, 5), ATTENUATION),
        ds.AreaLight(corner, u, v, (3, 4, 5), cutoff, exponent, ATTENUATION, samples=(1, 1)),
    ]
    surface = ds.Plane((0, 0, 0), (0, 0, 1))
    scene = ds.Scene(ds.Object(surface, ds.Material(0.1, k_d, k_s, 4, ds.Phong(), fresnel, eta=eta)), lights)
    return scene, ds.OrthographicCamera((0, 0, 4), shape=(1, 1))


def through(surface, *, eye=(0.3, 0.2, 4), wall=((0, 0, -3), (0, 0, 1)), k_t=0.6, eta=1.4, **atmosphere):
    """A ball or box of glass before a wall, on one ray along -z."""
    glass = ds.Material(0.1, 0.5, 0.4, 4, k_e=0.1, k_t=k_t, eta=eta)
    objects = [ds.Object(surface, glass), ds.Object(ds.Plane(*wall), ds.Material(0.1, ON_THE_WALL))]
    if isinstance(surface, ds.Sphere):
        air = ds.DepthCueing(**{"z_f": 1, "z_b": 20, "s_f": 0.9, "s_b": 0.2, "I_dc": 0.5, **atmosphere})
        camera = ds.OrthographicCamera
    else:
        air = ds.Fog(**{"density": 0.1, "I_dc": 0.5, "radial": True, **atmosphere})
        camera = ds.Camera
    scene = ds.Scene(objects, ds.PointLight((2, 3, 4), (3, 4, 5), ATTENUATION), 1.0, 0.2, air)
    return scene, camera(eye, target=np.add(eye, DOWN), shape=(1, 1))


def in_fog(density=0.3, **place):
    """The corner of test_gradients.py, in radial fog."""
    scene, *rest = corner("phong", **place)
    return dataclasses.replace(scene, atmosphere=ds.Fog(density, I_dc=0.5, radial=True)), *rest


DIELECTRIC, SCHLICK, SPHERE, BOX = ds.Dielectric(), ds.Schlick(), ds.Sphere(), ds.Box()
TURNED = ds.Box(rotation=(0, 45, 0))
EMITTER = "0.lights.1"
LIGHT_0 = ["0.lights.0"]
GLASS, WALL_BEHIND = "0.objects.0", "0.objects.1"
REFLECTED = [f"{GLASS}.material.{name}" for name in ("k_a", "k_d", "k_s", "n_s", "k_e")]
EDGES = [f"{EMITTER}.{name}" for name in ("corner", "edge_u", "edge_v")]
ETA = [f"{GLASS}.material.eta"]
CHEQUER = [f"{GLASS}.material.k_d.{name}" for name in ("a", "period", "u", "v")]
AIR = [f"0.atmosphere.{name}" for name in ("z_f", "z_b")]
JUST_ABOVE, JUST_BELOW = 1 + 1e-14, 1 - 1e-14

# place: equations, function, tree, and the leaves (or all that is below a path) whose derivative is 0 there
PLACES = {
    "light along the surface, exact dielectric": ("E7", seen, at_the_origin(DIELECTRIC, (1, 0, 0)), [*LIGHT_0]),
    "light along the surface, Schlick": ("E7", seen, at_the_origin(SCHLICK, (1, 0, 0)), LIGHT_0),
    "exact dielectric of eta = 1: W = 0": ("E7", seen, at_the_origin(DIELECTRIC, eta=1), ETA),
    "eta = 1, light along the surface: cos = g = 0": (
        "E7",
        seen,
        at_the_origin(DIELECTRIC, (1, 0, 0), eta=1, area=((0, 0, -2), (1, 0, 0), (0, -1, 0))),
        [*ETA, *LIGHT_0, EMITTER],
    ),
    "eta < 1, total reflection of the light: W = 1": (
        "E7",
        seen,
        at_the_origin(DIELECTRIC, (2, 0, 1), eta=0.5, area=((4, 0, 1), (0, 0, 1), (0, 1, 0))),
        ETA,
    ),
    "the light at the critical angle, reflected totally": (
        "E7",
        seen,
        at_the_origin(DIELECTRIC, (3, 0, 4), eta=0.6 * JUST_BELOW, area=((0, 0, -2), (1, 0, 0), (0, -1, 0))),
        ETA,
    ),
    "the light at the critical angle, not reflected totally": (
        "E7",
        seen,
        at_the_origin(DIELECTRIC, (3, 0, 4), eta=0.6 * JUST_ABOVE),
        [],
    ),
    "an edge of a hard chequer": ("", seen, at_the_origin(SCHLICK), CHEQUER),
    "an area light's emitter on the surface: d = 0": (
        "E2, E11",
        seen,
        at_the_origin(SCHLICK, area=((0, 0, 0), (1, 0, 0), (0, -1, 0))),
        [EMITTER],
    ),
    "an area light seen edge-on": (
        "E11",
        seen,
        at_the_origin(SCHLICK, area=((2, 0, 2), (1, 0, 1), (0, 1, 0))),
        [EMITTER],
    ),
    "an area light seen edge-on, exponent 0": (
        "E11",
        seen,
        at_the_origin(SCHLICK, area=((2, 0, 2), (1, 0, 1), (0, 1, 0)), exponent=0),
        [f"{EMITTER}.exponent", f"{EMITTER}.cutoff"],
    ),
    "behind an area light": ("E11", seen, at_the_origin(SCHLICK, area=((0, 0, 2), (1, 0, 0), (0, 1, 0))), [EMITTER]),
    "an area light of cutoff 0, off its axis": (
        "E11",
        seen,
        at_the_origin(SCHLICK, area=((1, 0, 2), (1, 0, 0), (0, -1, 0)), cutoff=0),
        [EMITTER],
    ),
    "k_t = 0": ("E13", seen, through(SPHERE, k_t=0), [WALL_BEHIND, *ETA, "0.background"]),
    "k_t = 1": ("E13", seen, through(SPHERE, k_t=1), REFLECTED),
    "eta = 1": ("E12", seen, through(SPHERE, eta=1), []),
    "eta = 1 and k_t = 1, through the middle": (
        "E12",
        seen,
        through(SPHERE, eye=(0, 0, 4), k_t=1, eta=1),
        [*REFLECTED, *ETA],
    ),
    "the ray along the normal": ("E12", seen, through(SPHERE, eye=(0, 0, 4)), ETA),
    "the silhouette of a ball: the ray touches it": ("", seen, through(SPHERE, eye=(0, 1, 4)), [GLASS]),
    "next to the silhouette, inside": ("", seen, through(SPHERE, eye=(0, JUST_BELOW, 4)), []),
    "the ray at the critical angle, reflected totally": (
        "E12",
        seen,
        through(SPHERE, eye=(0, 0.6 * JUST_ABOVE, 4), eta=0.6),
        [WALL_BEHIND, *ETA, f"{GLASS}.material.k_t", "0.background"],
    ),
    "the ray at the critical angle, not reflected totally": (
        "E12",
        seen,
        through(SPHERE, eye=(0, 0.6 * (1 - 1e-9), 4), eta=0.6),
        [],
    ),
    "total reflection of the ray": (
        "E12",
        seen,
        through(SPHERE, eye=(0, 0.8, 4), eta=0.6),
        [WALL_BEHIND, *ETA, f"{GLASS}.material.k_t", "0.background"],
    ),
    "the eye in the middle of a ball": ("E12", seen, through(SPHERE, eye=(0, 0, 0)), ETA),
    "the eye within a ball": ("E12", seen, through(SPHERE, eye=(0.3, 0.2, 0.1)), []),
    "the eye on a ball": ("E12", seen, through(SPHERE, eye=(0, 0, 1)), ETA),
    "z = z_f": (
        "E14",
        seen,
        through(SPHERE, eye=(0, 0, 4), k_t=0, z_f=3, z_b=5),
        [*AIR, "0.atmosphere.s_b"],
    ),
    "z = z_b": ("E14", seen, through(SPHERE, eye=(0, 0, 4), k_t=0, z_f=1, z_b=3), [*AIR, "0.atmosphere.s_f"]),
    "z = 0 in radial fog": (
        "E14",
        colour,
        in_fog(l=(1, 0, 2), v=(0, 0, 0)),
        ["0.atmosphere.density", "0.atmosphere.I_dc"],
    ),
    "fog of density 0": ("E14", colour, in_fog(0, l=(1, 0, 2)), ["0.atmosphere.I_dc"]),
    "a light on the surface, in fog: d = 0": ("E2, E14", colour, in_fog(d=0), ["0.lights.0", "0.lights.2"]),
    "the ray in the plane of a box's face": ("", seen, through(BOX, eye=(0.5, 0.2, 4)), [GLASS]),
    "the edge of a box": ("E12", seen, through(TURNED, eye=(0, 0.2, 4)), []),
    "the silhouette of a box at a corner": ("", seen, through(BOX, eye=(0.5, 0.5, 4)), [GLASS]),
    "through a slab along its normal": ("E12", seen, through(BOX), ETA),
    "through a box, k_t = 0": ("E13", seen, through(BOX, k_t=0), [WALL_BEHIND, *ETA, "0.background"]),
    "through a box, k_t = 1": ("E13", seen, through(BOX, k_t=1), REFLECTED),
    "total reflection within a box": (
        "E12",
        seen,
        through(TURNED, eye=(0.6, 0.2, 4), eta=1.6),
        [],
    ),
    "the eye within a box": ("E12", seen, through(BOX, eye=(0.1, 0.2, 0.3)), ETA),
    "the eye on a box": ("E12", seen, through(BOX, eye=(0.1, 0.2, 0.5)), ETA),
    "a plane seen edge-on": ("", seen, through(BOX, wall=((0, 0.2, 0), (0, 1, 0)), density=0.2), [WALL_BEHIND]),
}


def below(path, roots):
    """Whether a path is one of the roots or leads on from one."""
    return any(path == root or path.startswith(f"{root}.") for root in roots)


def check_place(name):
    """The derivatives at a kink: finite, 0 where PLACES says so, and not 0 everywhere."""
    _, function, tree, zero = PLACES[name]
    found = derivatives_at(function, tree)
    paths = [path for path in found if below(path, zero)]
    assert len(paths) >= len(zero)
    assert not [path for path in paths if found[path].any()]
    assert any(derivative.any() for derivative in found.values())


# The table ----------------------------------------------------------------------------------------------------------

EQUATIONS = {
    "Scene": {"ambient": "E1", "background": "E13"},
    "Material": {
        "k_a": "E1",
        "k_d": "E4",
        "k_s": "E5, E6, E7",
        "n_s": "E5, E6",
        "k_e": "E9",
        "k_t": "E13",
        "eta": "E7, E12",
    },
    "Chequer": dict.fromkeys(("a", "b", "period", "u", "v"), "smooth"),
    "Sphere": dict.fromkeys(("center", "radius"), ""),
    "Plane": dict.fromkeys(("point", "normal"), ""),
    "Box": dict.fromkeys(("center", "size", "rotation"), ""),
    "GBuffer": dict.fromkeys(("normal", "position"), ""),
    "PointLight": {"position": "E2-E6", "intensity": "E9"},
    "DirectionalLight": {"direction": "E4-E6", "intensity": "E9"},
    "SpotLight": {
        "position": "E2-E6",
        "direction": "E3",
        "intensity": "E9",
        **dict.fromkeys(("cutoff", "exponent", "softness"), "E3"),
    },
    "AreaLight": dict.fromkeys(("corner", "edge_u", "edge_v", "intensity", "cutoff", "exponent"), "E11"),
    "MeasuredLight": {"position": "E2-E6", "direction": "E3", "intensity": "E9", "side": "E3"},
    "RadialAttenuation": dict.fromkeys(("constant", "linear", "quadratic"), "E2"),
    "DepthCueing": dict.fromkeys(("z_f", "z_b", "s_f", "s_b", "I_dc"), "E14"),
    "Fog": dict.fromkeys(("density", "I_dc"), "E14"),
    "Camera": {
        **dict.fromkeys(("eye", "target"), "E8"),
        **dict.fromkeys(("up", "fov", "principal_point", "aspect"), ""),
    },
    "OrthographicCamera": {**dict.fromkeys(("eye", "target"), "E8"), "up": "", "height": ""},
}
# The image is a step function of these, whose derivative is 0.
JUMPS = {"AreaLight.cutoff"}
# What no comparison says.
REMARKS = {
    "Material.n_s": "0 < n_s < 1: as v.r or n.h -> 0 the true derivative with respect to directions is infinite",
    "Material.eta": "at the critical angle the true derivative is infinite on the side that is not totally reflected",
    "Chequer.period": "with `smooth=False` the derivative is 0: a jump",
    "Chequer.u": "with `smooth=False` the derivative is 0: a jump",
    "Chequer.v": "with `smooth=False` the derivative is 0: a jump",
    "Sphere.center": "grows without bound towards the silhouette, which itself is a jump that no derivative sees",
    "Sphere.radius": "grows without bound towards the silhouette, which itself is a jump that no derivative sees",
    "Box.rotation": "at an edge that of one of its faces; the silhouette is a jump that no derivative sees",
    "Box.center": "at an edge that of one of its faces; the silhouette is a jump that no derivative sees",
    "Box.size": "at an edge that of one of its faces; the silhouette is a jump that no derivative sees",
    "SpotLight.cutoff": "0 with softness 0: the edge is a jump that no derivative sees",
    "AreaLight.cutoff": "0 everywhere: the edge of an emitter's cone is a jump that no derivative sees",
    "MeasuredLight.direction": "at an angle of the table that of the side of the larger angle; 0 at the poles",
    "DepthCueing.z_f": "at z_f and z_b that of the constant side",
    "DepthCueing.z_b": "at z_f and z_b that of the constant side",
}
HEADING = """# What is differentiable

Written by `python tests/support/derivatives.py` from the checks of `tests/model/test_gradients_of_the_whole_model.py` and
`tests/model/test_gradients.py`; float64.

`error`: the largest difference of the forward and the reverse derivative from central finite differences, of any
element in any of {scenes} scenes, relative to the largest element of the derivative (or to {small}), rounded up to a
power of ten and at least 1e-09; at pixels where each comparison that the program makes is decided by more than
{margin}. `finite at` and `0 at`: the kinks of the second table, of the fields that its pixel has.
"""


def numeric_fields():
    """Every numeric field of the model's public classes, `Class.field`. `View`, `Noise`, `Shot` belong to fits."""
    found = []
    for name, kind in ((name, getattr(ds, name)) for name in dir(ds)):
        if inspect.isclass(kind) and issubclass(kind, Checked) and kind not in (ds.View, ds.Noise, ds.Shot):
            for field in dataclasses.fields(kind):
                if field.metadata.get("converter") in _KINDS or (kind is ds.GBuffer and field.name != "mask"):
                    found.append(f"{name}.{field.name}")
    return found


def field_of(tree, path):
    """The class and field, `Material.k_d`, that a path of a tree's leaf ends in."""
    parent = tree
    for key in path[:-1]:
        parent = getattr(parent, key.name) if hasattr(key, "name") else parent[key.idx]
    if isinstance(parent, tuple):  # scene, camera, normal and position, as corner makes them
        return ("GBuffer.normal", "GBuffer.position")[path[-1].idx - 2]
    return f"{type(parent).__name__}.{path[-1].name}"


def by_field(tree, values):
    """Map each field to the values of its leaves, of a map from the leaves' paths."""
    found = {}
    for path, _ in jax.tree.leaves_with_path(tree):
        if path_of(path) in values:
            found.setdefault(field_of(tree, path), []).append(values[path_of(path)])
    return found


def worst_errors(errors):
    """Map each field to its largest error in all scenes, given errors_in(name) of each; None where it is always 0."""
    found = {}
    for name, values in errors.items():
        for field, of in by_field(SCENES[name], values).items():
            found.setdefault(field, []).extend(value for value in of if value is not None)
    return {field: max(of, default=None) for field, of in found.items()}


def kinks():
    """Every kink that is checked: its name, its equations, a tree, and the paths claimed to be 0."""
    for name, (lobe, place) in DARK.items():
        tree = corner(lobe, **place)
        kept = {"0.objects.0.material.k_a", "0.ambient"}
        kept |= {"0.objects.0.material.k_d"} if place.get("l", UP)[2] > 0 else set()
        paths = [path_of(path) for path, _ in jax.tree.leaves_with_path(tree)]
        yield name, "E4-E6", tree, [path for path in paths if path not in kept]
    for name, (place, zero) in ZERO.items():
        yield name, "E2-E6", corner("phong", **place), zero
    for name, (equations, _, tree, zero) in PLACES.items():
        yield name, equations, tree, zero


def table(orders):
    """The text of the table, given the power of ten of each field's error, or None where the derivative is 0."""
    finite, zero, places = {}, {}, []
    for number, (name, equations, tree, paths) in enumerate(kinks(), 1):
        claims = {path_of(path): below(path_of(path), paths) for path, _ in jax.tree.leaves_with_path(tree)}
        fields = by_field(tree, claims)
        for field, of in fields.items():
            finite.setdefault(field, []).append(number)
            if all(of):
                zero.setdefault(field, []).append(number)
        some = [f"{field}{'' if all(of) else ' (of one)'}" for field, of in fields.items() if any(of)]
        kept = [field for field, of in fields.items() if not all(of)]
        what = f"all but {', '.join(kept)}" if len(kept) < 5 else ", ".join(some) or "-"
        places.append(f"| {number} | {name} | {equations or '-'} | {what} |")
    rows = []
    for field in numeric_fields():
        kind, name = field.split(".")
        order = orders[field]
        error = "0 and 0" if order is None else f"1e{order:+03d}"
        cells = [field, EQUATIONS[kind][name] or "-", error, runs(finite.get(field)), runs(zero.get(field))]
        rows.append(f"| {' | '.join(cells)} | {REMARKS.get(field, '')} |")
    lines = [
        HEADING.format(scenes=len(SCENES), margin=MARGIN, small=SMALL),
        "| field | equation | error | finite at | 0 at | where it is not smooth |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        "## Kinks",
        "",
        "One pixel exactly there. Every derivative is finite, and forward and reverse mode agree.",
        "",
        "| | place | equation | the derivative with respect to these is 0, the documented one-sided limit |",
        "|---|---|---|---|",
        *places,
    ]
    return "\n".join(lines) + "\n"


def runs(numbers):
    """1-3, 5 for 1, 2, 3, 5."""
    parts = []
    for n in numbers or ():
        if parts and parts[-1][1] == n - 1:
            parts[-1][1] = n
        else:
            parts.append([n, n])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts) or "-"


def order_of(error):
    return None if error is None else max(-9, math.ceil(math.log10(max(error, 1e-30))))


def committed_orders():
    """The errors that the committed table claims."""
    rows = [line.split(" | ") for line in TABLE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    claimed = {row[0].removeprefix("| "): row[2] for row in rows if "." in row[0]}
    return {field: None if error == "0 and 0" else int(error.removeprefix("1e")) for field, error in claimed.items()}


def main():
    """Run every check of the places and scenes here and write the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for name in PLACES:
        check_place(name)
    errors = worst_errors({name: errors_in(name) for name in SCENES})
    TABLE.write_text(table({field: order_of(error) for field, error in errors.items()}), encoding="utf-8")
    print(f"wrote {TABLE}")


if __name__ == "__main__":
    import conftest

    assert conftest
    main()

"""What is differentiable, and where it is not smooth: the checks of tests/model/test_derivatives.py.

All of it runs operation by operation: to compile the forward and the reverse mode of so many scenes takes many times as
long. What no comparison here says: with 0 < n_s < 1 the true derivative by directions is infinite as v.r or n.h -> 0;
that by eta at the critical angle, on the side that is not totally reflected; that by a sphere grows without bound
towards its silhouette. A silhouette, the edge of a hard chequer, and that of a spot or a flap without softness are
jumps that no derivative sees. At an edge of a box it is that of one of its faces, at an angle of a lamp's table that of
the side of the larger angle, and at z_f and z_b that of the constant side.
"""

import dataclasses
import functools
import inspect
from typing import Any

import equinox as eqx
import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
from directions import unit
from jax.flatten_util import ravel_pytree
from public_names import PUBLIC

import diffshade as ds
from diffshade.core.fields import _KINDS, Checked

MARGIN = 0.05
STEP = 3e-5
DIRECTIONS = 96  # at once, whatever the scene: of each shape, every operation is compiled
SMALL = 1e-3  # a derivative below it is not told from the rounding of the differences
UP, DOWN, RIGHT = (0, 0, 1), (0, 0, -1), (1, 0, 0)


def path_of(path):
    return jax.tree_util.keystr(path, simple=True, separator=".")


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


def brightness(name):
    """The numbers of a scene and its camera, flat and as a tree, and of the former a sum over the smooth pixels."""
    free = jax.tree.map(
        # a lamp's table is measured, not fitted
        lambda leaf: not isinstance(leaf, ds.lamps.Profile) and leaf.dtype != bool,
        SCENES[name],
        is_leaf=lambda node: isinstance(node, ds.lamps.Profile),
    )
    numbers, rest = eqx.partition(SCENES[name], free)
    flat, unravel = ravel_pytree(numbers)

    def image(flat):
        return ds.render(*eqx.combine(unravel(flat), rest))

    smooth = smooth_pixels(image, flat)
    assert smooth.sum() >= 20, smooth.sum()
    weight = np.random.default_rng(3).normal(size=(*smooth.shape, 3)) * smooth[..., None]
    return flat, numbers, lambda flat: (weight * image(flat)).sum()


def central(ahead, back, far_ahead, far_back):
    """The derivative by differences of fourth order."""
    return (8 * (ahead - back) - (far_ahead - far_back)) / (12 * STEP)


def slopes(name):
    """The derivatives along one direction of all numbers of a scene: differences, forward, and reverse by number."""
    flat, _, total = brightness(name)
    along = np.random.default_rng(2).normal(size=flat.shape) / 3

    def at(step):  # traced, so that a number may be beyond what it may be
        value, slope = jax.jvp(total, (flat + step * along,), (jnp.asarray(along),))
        return float(value), float(slope)

    with jax.disable_jit():
        differences = central(*(at(h * STEP)[0] for h in (1, -1, 2, -2)))
        return differences, at(0.0)[1], np.asarray(jax.grad(total)(flat)) * along


def errors_in(name):
    """Map the path of each leaf of a scene and its camera to the largest error of its derivative; None if 0 everywhere.

    Of the forward and the reverse mode against central differences, element by element, in units of the largest element
    of the leaf's derivative, or of SMALL.
    """
    flat, tree, total = brightness(name)
    steps, points = np.eye(flat.size), STEP * np.array([1, -1, 2, -2])[:, None, None]
    forward, values = [], []
    with jax.disable_jit():
        reverse = np.asarray(jax.grad(total)(flat))
        for i in range(0, flat.size, DIRECTIONS):
            some = np.zeros((DIRECTIONS, flat.size))
            some[: flat.size - i] = steps[i : i + DIRECTIONS]
            forward.append(jax.vmap(lambda e: jax.jvp(total, (flat,), (e,))[1])(jnp.asarray(some)))
            values.append(
                jax.vmap(total)(jnp.asarray(np.asarray(flat) + points * some).reshape(-1, flat.size)).reshape(4, -1)
            )
    forward = np.concatenate(forward)[: flat.size]
    differences = central(*np.concatenate(values, 1)[:, : flat.size])
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


ATTENUATION = ds.RadialAttenuation(0.4, 0.2, 0.1)
CLAMPED = ds.RadialAttenuation(0.2, 0.35, 0.3, clamp=True)  # 1 at d = 1.15; the lit points are .8 to 1.6 away
FLOOR = ds.Plane((0.1, -1.1, 0.2), (0.1, 2.0, 0.15))
WALL = ds.Plane((0.2, 0.1, -2.5), (0.1, 0.15, 2.0))
ON_THE_FLOOR = ds.Chequer((0.9, 0.7, 0.5), (0.1, 0.3, 0.2), 3.1, True, (1, 0.1, 0.2), (-0.2, 0.1, 1))
ON_THE_WALL = ds.Chequer((0.9, 0.7, 0.5), (0.1, 0.3, 0.2), 2.7, True, (1, 0.1, 0.2), (-0.1, 1, 0.3))
BALL = ds.Sphere((-0.7, -0.1, 0.3), 0.8)
BLOCK = ds.Box((0.9, -0.2, 0.1), (1.1, 1.3, 0.9), (20, 35, 10))
POINT = ds.PointLight((1.5, 2, 2.5), (5, 4, 3), ATTENUATION)
DIRECTIONAL = ds.DirectionalLight((-1, -0.8, -2), (0.6, 0.5, 0.4))
SOFT = ds.SpotLight((0.8, 1, 1.5), (-1, -1, -1), (5, 4, 3), 60, 3.5, ATTENUATION, softness=55)
AREA = ds.AreaLight(
    (-1.2, 2.3, 1), (1, 0.1, 0.3), (0.2, -0.3, 1.1), (5, 6, 7), exponent=1.5, attenuation=ATTENUATION, samples=(2, 1)
)
FLAPS = ds.Flaps(-0.7, 0.9, -0.9, 0.7, 0.1, 1.4, softness=0.9)
MEASURED = ds.lamps.MeasuredLight(
    (-1, 1.7, 2.2),
    (0.4, -0.9, -1.3),
    ds.lamps.Profile((0, 25, 60, 110, 180), (0, 100, 220, 360), [[3, 2.5, 1, 0.4, 0], [3, 2, 1.5, 0.2, 0]] * 2),
    (2, 3, 4),
    ATTENUATION,
    side=(1, 0.3, 0.1),
)
APART: dict[str, Any] = {"ambient": (0.3, 0.2, 0.1), "specular": (0.4, 0.6, 0.5)}  # of a light
COLOURS: dict[str, Any] = {"k_a": (0.1, 0.2, 0.15), "k_d": (0.7, 0.25, 0.2), "k_e": (0.05, 0.02, 0.1)}
SHINY: dict[str, Any] = {**COLOURS, "k_s": (0.4, 0.3, 0.5)}
EYE = {"eye": (0.5, 0.8, 5), "target": (0.1, 0.1, -0.1), "up": (0.2, 1, 0.1), "shape": (12, 16)}
RANDOM = np.random.default_rng(5)
BUMPS = np.random.default_rng(2).normal((0, 0, 1.5), 0.3, (*EYE["shape"], 3))
BUMPS /= np.linalg.norm(BUMPS, axis=-1, keepdims=True)
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
        ds.Camera(**EYE, fov=40, principal_point=(7.7, 6.2), aspect=1.05),
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
    "a ball under lights that are clamped and cut off": (
        ds.Scene(
            ds.Object(
                ds.Sphere((0.1, -0.2, 0.15), 1.1),
                ds.Material(
                    **{**SHINY, "k_d": ds.Texture(np.random.default_rng(3).uniform(0.2, 0.8, (3, 4, 3)))},
                    n_s=9.5,
                    lobe=ds.Blinn(),
                    highlights=[
                        ds.Highlight((0.3, 0.2, 0.1), 4.0, ds.Brushed((1, 0.3, 0.2), 7.0)),
                        ds.Highlight(0.2, (3, 5, 8)),
                    ],
                ),
            ),
            [
                ds.PointLight((0.8, 0.7, 1.7), (0.5, 0.4, 0.3), CLAMPED),
                ds.SpotLight((0.8, 1, 1.5), (-1, -1.2, -1.4), (5, 4, 3), 25, 3.5, ATTENUATION),
                ds.DirectionalLight((1, 0.3, -2), (0.2, 0.5, 0.4)),
            ],
        ),
        ds.OrthographicCamera(**EYE, height=3, local_viewer=False),
    ),
    "a ball under two lights of each kind": (
        ds.Scene(
            ds.Object(ds.Sphere((0.1, -0.2, 0.15), 1.1), ds.Material(**SHINY, n_s=4.5, normal=BUMPS)),
            [
                POINT,
                ds.PointLight((-1.5, 2, 2.5), (2, 4, 3), ATTENUATION),
                DIRECTIONAL,
                ds.DirectionalLight((1, 0.3, -2), (0.2, 0.5, 0.4)),
                SOFT,
                ds.SpotLight((-0.8, 1, 1.5), (1, -1, -1), (5, 4, 3), 65, 2, ATTENUATION, softness=60),
            ],
        ),
        ds.Camera(**EYE, fov=40),
    ),
    "a ball under lights whose colours are apart": (
        ds.Scene(
            ds.Object(
                ds.Sphere((0.1, -0.2, 0.15), 1.1), ds.Material(**SHINY, n_s=4.5, highlights=[ds.Highlight(0.2, 7)])
            ),
            [dataclasses.replace(light, **APART) for light in (POINT, DIRECTIONAL, SOFT, AREA, MEASURED)],
        ),
        ds.Camera(**EYE, fov=40),
    ),
    "a ball under lamps with flaps": (
        ds.Scene(
            ds.Object(ds.Sphere((0.1, -0.2, 0.15), 1.1), ds.Material(**SHINY, n_s=4.5)),
            [dataclasses.replace(light, flaps=FLAPS) for light in (POINT, SOFT, AREA)],
        ),
        ds.Camera(**EYE, fov=40),
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


# Derivatives at the kinks -------------------------------------------------------------------------------------------


def seen(tree):
    """The colour of the only pixel of a scene and its camera."""
    return ds.render(*tree)[0, 0]


def colour(tree):
    """The colour of a point that is given, as corner makes it."""
    scene, camera, n, p = tree
    return ds.shade(scene, ds.GBuffer(n, p, np.ones((1, 1))), camera)[0, 0]


BATCH = 24  # one shape for all, so that few operations are compiled
CHANNELS = (0.7, 1.1, -0.6)  # so weighted, the channels are one number whose derivative is 0 where that of each is


def derivatives_at(function, trees):
    """For each of several trees of one structure, map each leaf's path to its derivative, of CHANNELS in one.

    They must be finite, and those of the forward mode along a random direction what the reverse mode says.
    """
    count = len(trees)
    assert count <= BATCH
    trees = jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees, *[trees[-1]] * (BATCH - count))
    random = np.random.default_rng(7)
    along = jax.tree.map(lambda leaf: jnp.asarray(random.normal(size=leaf.shape), leaf.dtype), trees)

    def both(tree, tangent):
        colour, forward = jax.jvp(function, (tree,), (tangent,))
        return forward, jax.vjp(function, tree)[1](jnp.asarray(CHANNELS, colour.dtype))[0]

    with jax.disable_jit():
        forward, reverse = jax.vmap(both)(trees, along)
    assert np.isfinite(forward).all(), forward
    found, expected, terms = [{} for _ in range(count)], 0, 1
    for (path, leaf), tangent in zip(jax.tree.leaves_with_path(reverse), jax.tree.leaves(along), strict=True):
        rows, steps = (np.asarray(a).reshape(BATCH, -1) for a in (leaf, tangent))
        assert np.isfinite(rows).all(), f"the reverse derivative with respect to {path_of(path)} is {rows}"
        for of_place, row in zip(found, rows[:count], strict=True):
            of_place[path_of(path)] = row
        expected, terms = expected + (rows * steps).sum(-1), terms + np.abs(rows * steps).sum(-1)
    tolerance = max(1e-8, 1e4 * np.finfo(forward.dtype).eps)
    assert (np.abs(forward @ np.asarray(CHANNELS, forward.dtype) - expected) <= tolerance * terms).all()
    return found


def structure_of(tree):
    return jax.tree.structure(tree), tuple(np.shape(leaf) for leaf in jax.tree.leaves(tree))


def corner(lobe, l=UP, d=2.0, v=UP, axis=None, *, attenuation=(0.5, 0.2, 0.1), spot=(60, 2, 30), **material):
    """One point, one light of each kind at the same place, and one viewer, exactly at a kink; n is UP.

    Scene, camera, normal and position; `l` and `v` of any length, `spot` its cutoff, exponent and softness.
    """
    l, eye, n = np.array(l, float), 4 * np.array(v, float), np.zeros((1, 1, 3)) + UP
    position, direction = l * d, -l if axis is None else np.array(axis, float)
    radial = ds.RadialAttenuation(*attenuation, clamp=True)
    cutoff, exponent, softness = spot
    lights = [
        ds.PointLight(position, (3, 4, 5), radial),
        ds.DirectionalLight(-l, (0.3, 0.4, 0.5)),
        ds.SpotLight(position, direction, (3, 4, 5), cutoff, exponent, radial, softness),
    ]
    kind = ds.Phong() if lobe == "phong" else ds.Blinn()
    material = ds.Material(**{"k_a": 0.1, "k_d": 0.5, "k_s": 0.4, "n_s": 4, "lobe": kind, **material})
    camera = ds.OrthographicCamera(eye, target=eye + DOWN, shape=(1, 1))
    return ds.Scene(ds.Object(ds.Sphere(), material), lights), camera, n, 0 * n


HIGHLIGHT_ONLY = {"k_d": 0}
# Where the light gives nothing on either side, or the derivative is that of the side where it gives nothing.
DARK = {
    "n.l = 0": ("phong", {"l": RIGHT}),
    "n.l = 0, n_s = 0": ("phong", {"l": RIGHT, "v": RIGHT, "n_s": 0}),
    "n.l = 0, Blinn": ("blinn", {"l": RIGHT}),
    "n.l < 0, and v = r": ("phong", {"l": DOWN, "v": DOWN}),
    "v.r = 0, n_s = 1": ("phong", {"v": RIGHT, "n_s": 1, **HIGHLIGHT_ONLY}),
    "v.r = 0, n_s = .5": ("phong", {"v": RIGHT, "n_s": 0.5, **HIGHLIGHT_ONLY}),
    "v.r = 0, n_s = 0": ("phong", {"v": RIGHT, "n_s": 0, **HIGHLIGHT_ONLY}),
    "v.r < 0, n_s = 0": ("phong", {"l": (1, 0, 1), "v": (2, 0, 1), "n_s": 0, **HIGHLIGHT_ONLY}),
    "n.h = 0, n_s = 1": ("blinn", {"l": (1, 0, 1), "d": 4, "v": (1, 0, -1), "n_s": 1, **HIGHLIGHT_ONLY}),
    "n.h = 0, n_s = 0": ("blinn", {"l": (1, 0, 1), "d": 4, "v": (1, 0, -1), "n_s": 0, **HIGHLIGHT_ONLY}),
    "l = -v": ("blinn", {"v": DOWN, "n_s": 1, **HIGHLIGHT_ONLY}),
    "l = -v, n_s = 0": ("blinn", {"v": DOWN, "n_s": 0, **HIGHLIGHT_ONLY}),
}

RADIAL = [f"0.lights.{i}.attenuation.{name}" for i in (0, 2) for name in ("constant", "linear", "quadratic")]
NEAR_LIGHTS = [*RADIAL, *(f"0.lights.{i}.{name}" for i in (0, 2) for name in ("position", "intensity"))]
SPOT = [f"0.lights.2.{name}" for name in ("direction", "intensity", "cutoff", "exponent", "softness")]
# Places, and some of the numbers whose derivative is 0 there: those of the clamped or missing term.
ZERO = {
    "d = 0": ({"d": 0}, NEAR_LIGHTS),
    "d = 0, 1/d^2": ({"d": 0, "attenuation": (0, 0, 1)}, NEAR_LIGHTS),
    "d below 1e-6, clamped": ({"d": 1e-7, "l": (1, 0, 2)}, RADIAL),
    "f_rad = 1 exactly": ({"attenuation": (0, 0, 0.25)}, RADIAL),
    "k_s = 0": ({"k_s": 0, "l": (1, 0, 2)}, ["0.objects.0.material.n_s"]),
    "n_s = 0": ({"n_s": 0, "k_d": 0, "l": (1, 0, 2)}, ["1.eye", "1.target", "0.lights.1.direction"]),
    "v = r": ({}, ["0.objects.0.material.n_s"]),
    "v = r, n_s = 10000": ({"n_s": 1e4}, ["0.objects.0.material.n_s"]),
    "on the spot's axis": ({}, ["0.lights.2.cutoff", "0.lights.2.exponent", "0.lights.2.softness"]),
    "cutoff 90, at 90 degrees": ({"axis": RIGHT, "spot": (90, 2, 0)}, SPOT),
    "cutoff 90, soft, at 90 degrees": ({"axis": RIGHT, "spot": (90, 0, 45)}, SPOT),
    "cutoff 0, off the axis": ({"axis": (0.1, 0, -1), "spot": (0, 2, 0)}, SPOT),
    "cutoff 0, on the axis": ({"spot": (0, 2, 0)}, ["0.lights.2.cutoff", "0.lights.2.softness"]),
    "cutoff and softness too small to tell": ({"spot": (1e-9, 2, 1e-9)}, ["0.lights.2.exponent"]),
    "softness lost in rounding": ({"axis": (1, 0, -2), "spot": (40, 2, 1e-15)}, ["0.lights.2.softness"]),
    "the eye on the point": ({"v": (0, 0, 0), "l": (1, 0, 2)}, ["1.eye", "1.target"]),
}


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
    """The corner, in radial fog."""
    scene, *rest = corner("phong", **place)
    return dataclasses.replace(scene, atmosphere=ds.Fog(density, I_dc=0.5, radial=True)), *rest


DIELECTRIC, SCHLICK, SPHERE, BOX = ds.Dielectric(), ds.Schlick(), ds.Sphere(), ds.Box()
TURNED = ds.Box(rotation=(0, 45, 0))
EMITTER = "0.lights.1"
LIGHT_0 = ["0.lights.0"]
GLASS, WALL_BEHIND = "0.objects.0", "0.objects.1"
REFLECTED = [f"{GLASS}.material.{name}" for name in ("k_a", "k_d", "k_s", "n_s", "k_e")]
ETA = [f"{GLASS}.material.eta"]
CHEQUER = [f"{GLASS}.material.k_d.{name}" for name in ("a", "period", "u", "v")]
AIR = [f"0.atmosphere.{name}" for name in ("z_f", "z_b")]
JUST_ABOVE, JUST_BELOW = 1 + 1e-14, 1 - 1e-14

# place: function, tree, and the leaves (or all that is below a path) whose derivative is 0 there
PLACES = {
    "light along the surface, exact dielectric": (seen, at_the_origin(DIELECTRIC, (1, 0, 0)), [*LIGHT_0]),
    "light along the surface, Schlick": (seen, at_the_origin(SCHLICK, (1, 0, 0)), LIGHT_0),
    "exact dielectric of eta = 1: W = 0": (seen, at_the_origin(DIELECTRIC, eta=1), ETA),
    "eta = 1, light along the surface: cos = g = 0": (
        seen,
        at_the_origin(DIELECTRIC, (1, 0, 0), eta=1, area=((0, 0, -2), (1, 0, 0), (0, -1, 0))),
        [*ETA, *LIGHT_0, EMITTER],
    ),
    "eta < 1, total reflection of the light: W = 1": (
        seen,
        at_the_origin(DIELECTRIC, (2, 0, 1), eta=0.5, area=((4, 0, 1), (0, 0, 1), (0, 1, 0))),
        ETA,
    ),
    "the light at the critical angle, reflected totally": (
        seen,
        at_the_origin(DIELECTRIC, (3, 0, 4), eta=0.6 * JUST_BELOW, area=((0, 0, -2), (1, 0, 0), (0, -1, 0))),
        ETA,
    ),
    "the light at the critical angle, not reflected totally": (
        seen,
        at_the_origin(DIELECTRIC, (3, 0, 4), eta=0.6 * JUST_ABOVE),
        [],
    ),
    "an edge of a hard chequer": (seen, at_the_origin(SCHLICK), CHEQUER),
    "an area light's emitter on the surface: d = 0": (
        seen,
        at_the_origin(SCHLICK, area=((0, 0, 0), (1, 0, 0), (0, -1, 0))),
        [EMITTER],
    ),
    "an area light seen edge-on": (
        seen,
        at_the_origin(SCHLICK, area=((2, 0, 2), (1, 0, 1), (0, 1, 0))),
        [EMITTER],
    ),
    "an area light seen edge-on, exponent 0": (
        seen,
        at_the_origin(SCHLICK, area=((2, 0, 2), (1, 0, 1), (0, 1, 0)), exponent=0),
        [f"{EMITTER}.exponent", f"{EMITTER}.cutoff"],
    ),
    "behind an area light": (seen, at_the_origin(SCHLICK, area=((0, 0, 2), (1, 0, 0), (0, 1, 0))), [EMITTER]),
    "an area light of cutoff 0, off its axis": (
        seen,
        at_the_origin(SCHLICK, area=((1, 0, 2), (1, 0, 0), (0, -1, 0)), cutoff=0),
        [EMITTER],
    ),
    "k_t = 0": (seen, through(SPHERE, k_t=0), [WALL_BEHIND, *ETA, "0.background"]),
    "k_t = 1": (seen, through(SPHERE, k_t=1), REFLECTED),
    "eta = 1": (seen, through(SPHERE, eta=1), []),
    "eta = 1 and k_t = 1, through the middle": (
        seen,
        through(SPHERE, eye=(0, 0, 4), k_t=1, eta=1),
        [*REFLECTED, *ETA],
    ),
    "the ray along the normal": (seen, through(SPHERE, eye=(0, 0, 4)), ETA),
    "the silhouette of a ball: the ray touches it": (seen, through(SPHERE, eye=(0, 1, 4)), [GLASS]),
    "next to the silhouette, inside": (seen, through(SPHERE, eye=(0, JUST_BELOW, 4)), []),
    "the ray at the critical angle, reflected totally": (
        seen,
        through(SPHERE, eye=(0, 0.6 * JUST_ABOVE, 4), eta=0.6),
        [WALL_BEHIND, *ETA, f"{GLASS}.material.k_t", "0.background"],
    ),
    "the ray at the critical angle, not reflected totally": (
        seen,
        through(SPHERE, eye=(0, 0.6 * (1 - 1e-9), 4), eta=0.6),
        [],
    ),
    "total reflection of the ray": (
        seen,
        through(SPHERE, eye=(0, 0.8, 4), eta=0.6),
        [WALL_BEHIND, *ETA, f"{GLASS}.material.k_t", "0.background"],
    ),
    "the eye in the middle of a ball": (seen, through(SPHERE, eye=(0, 0, 0)), ETA),
    "the eye within a ball": (seen, through(SPHERE, eye=(0.3, 0.2, 0.1)), []),
    "the eye on a ball": (seen, through(SPHERE, eye=(0, 0, 1)), ETA),
    "z = z_f": (
        seen,
        through(SPHERE, eye=(0, 0, 4), k_t=0, z_f=3, z_b=5),
        [*AIR, "0.atmosphere.s_b"],
    ),
    "z = z_b": (seen, through(SPHERE, eye=(0, 0, 4), k_t=0, z_f=1, z_b=3), [*AIR, "0.atmosphere.s_f"]),
    "z = 0 in radial fog": (
        colour,
        in_fog(l=(1, 0, 2), v=(0, 0, 0)),
        ["0.atmosphere.density", "0.atmosphere.I_dc"],
    ),
    "fog of density 0": (colour, in_fog(0, l=(1, 0, 2)), ["0.atmosphere.I_dc"]),
    "a light on the surface, in fog: d = 0": (colour, in_fog(d=0), ["0.lights.0", "0.lights.2"]),
    "the ray in the plane of a box's face": (seen, through(BOX, eye=(0.5, 0.2, 4)), [GLASS]),
    "the edge of a box": (seen, through(TURNED, eye=(0, 0.2, 4)), []),
    "the silhouette of a box at a corner": (seen, through(BOX, eye=(0.5, 0.5, 4)), [GLASS]),
    "through a slab along its normal": (seen, through(BOX), ETA),
    "through a box, k_t = 0": (seen, through(BOX, k_t=0), [WALL_BEHIND, *ETA, "0.background"]),
    "through a box, k_t = 1": (seen, through(BOX, k_t=1), REFLECTED),
    "total reflection within a box": (
        seen,
        through(TURNED, eye=(0.6, 0.2, 4), eta=1.6),
        [],
    ),
    "the eye within a box": (seen, through(BOX, eye=(0.1, 0.2, 0.3)), ETA),
    "the eye on a box": (seen, through(BOX, eye=(0.1, 0.2, 0.5)), ETA),
    "a plane seen edge-on": (seen, through(BOX, wall=((0, 0.2, 0), (0, 1, 0)), density=0.2), [WALL_BEHIND]),
}


def below(path, roots):
    """Whether a path is one of the roots or leads on from one."""
    return any(path == root or path.startswith(f"{root}.") for root in roots)


def at_corners(lobe):
    """Map the name of each corner, dark or with a 0, to its derivatives."""
    places = {name: place for name, (of, place) in DARK.items() if of == lobe}
    places |= {name: place for name, (place, _) in ZERO.items()}
    return dict(zip(places, derivatives_at(colour, [corner(lobe, **place) for place in places.values()]), strict=True))


@functools.cache
def at_places_like(function, structure):
    """Map the name of each of the PLACES of one structure to its derivatives."""
    trees = {name: tree for name, (f, tree, _) in PLACES.items() if (f, structure_of(tree)) == (function, structure)}
    return dict(zip(trees, derivatives_at(function, list(trees.values())), strict=True))


def check_place(name):
    """The derivatives at a kink: 0 where PLACES says so, and not 0 everywhere."""
    function, tree, zero = PLACES[name]
    found = at_places_like(function, structure_of(tree))[name]
    paths = [path for path in found if below(path, zero)]
    assert len(paths) >= len(zero)
    assert not [path for path in paths if found[path].any()]
    assert any(derivative.any() for derivative in found.values())


# Every number ---------------------------------------------------------------------------------------------------------

# The power of ten within which the derivatives by a field are those of finite differences, of any element in any scene;
# of the others it is -9. None: the image is a step function of the field, whose derivative is 0.
ORDERS = {
    **dict.fromkeys(("Box.rotation", "Camera.fov", "Chequer.period", "Chequer.v", "Plane.point"), -8),
    **dict.fromkeys(("DepthCueing.z_f", "DepthCueing.s_f"), -8),
    **dict.fromkeys(("RadialAttenuation.constant", "RadialAttenuation.linear"), -8),
    **dict.fromkeys(("Highlight.n_s", "Material.n_s"), -7),
    **dict.fromkeys(("SpotLight.cutoff", "SpotLight.exponent", "SpotLight.softness"), -7),
    "AreaLight.cutoff": None,
}


def numeric_fields():
    """Every numeric field of the model's public classes, `Class.field`; some classes belong to fits."""
    found, of_fits = [], (ds.View, ds.Noise, ds.Sensor, ds.Vignetting, ds.Shot)
    for name, kind in sorted(PUBLIC.items()):
        if inspect.isclass(kind) and issubclass(kind, Checked) and kind not in of_fits:
            for field in dataclasses.fields(kind):
                if field.metadata.get("converter") in _KINDS or (kind is ds.GBuffer and field.name != "mask"):
                    found.append(f"{name}.{field.name}")
    return found


def field_of(tree, path):
    """The class and field, `Material.k_d`, that a path of a tree's leaf ends in."""
    parent = tree
    for key in path[:-1]:
        parent = getattr(parent, key.name) if hasattr(key, "name") else parent[key.idx]
    return f"{type(parent).__name__}.{path[-1].name}"

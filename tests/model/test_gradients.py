"""Derivatives: equal to finite differences away from the kinks, finite and on the documented side at them.

Finite differences are compared at the pixels where |n.l|, |v.r| (or |n.h|), n.v and the distances to a spot's edges and
to the clamp of the attenuation all exceed .05.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from jax.test_util import check_jvp, check_vjp

import diffshade as ds
from diffshade.attenuation import angular_attenuation
from diffshade.rendering import pixel_rays

MARGIN = 0.05
# the time goes into compiling, not into running
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}
LOBES = {"phong": ds.Phong(), "blinn": ds.Blinn()}
MATERIALS = {
    "phong": ds.Material((0.1, 0.2, 0.15), (0.7, 0.25, 0.2), (0.4, 0.3, 0.5), 4.5, ds.Phong()),
    "blinn": ds.Material((0.1, 0.2, 0.15), (0.7, 0.25, 0.2), (0.4, 0.3, 0.5), 9.5, ds.Blinn()),
}
SPHERE = ds.Sphere((0.1, -0.2, 0.15), 1.1)
ATTENUATION = ds.RadialAttenuation(0.4, 0.2, 0.1)
CLAMPED = ds.RadialAttenuation(0.2, 0.35, 0.3, clamp=True)  # 1 at d = 1.15; the lit points are .8 to 1.6 away
POINT = ds.PointLight((1.5, 2, 2.5), (5, 4, 3), ATTENUATION)
DIRECTIONAL = ds.DirectionalLight((-1, -0.8, -2), (0.6, 0.5, 0.4))
SOFT = ds.SpotLight((0.8, 1, 1.5), (-1, -1, -1), (5, 4, 3), 60, 3.5, ATTENUATION, softness=55)
LIGHTS = {
    "hard": [
        ds.PointLight((0.8, 0.7, 1.7), (0.5, 0.4, 0.3), CLAMPED),
        ds.SpotLight((0.8, 1, 1.5), (-1, -1.2, -1.4), (5, 4, 3), 25, 3.5, ATTENUATION),
    ],
    "soft": [POINT, SOFT],
    "directional": [DIRECTIONAL],
    "two of each": [
        POINT,
        ds.PointLight((-1.5, 2, 2.5), (2, 4, 3), ATTENUATION),
        DIRECTIONAL,
        ds.DirectionalLight((1, 0.3, -2), (0.2, 0.5, 0.4)),
        SOFT,
        ds.SpotLight((-0.8, 1, 1.5), (1, -1, -1), (5, 4, 3), 65, 2, ATTENUATION, softness=60),
    ],
}
EYE = {"eye": (0.5, 0.8, 4), "target": (0.1, 0, -0.1), "up": (0.2, 1, 0.1), "shape": (16, 20)}
CAMERAS = {
    "perspective": ds.Camera(**EYE, fov=40),
    "orthographic": ds.OrthographicCamera(**EYE, height=3),
    "perspective, viewer at infinity": ds.Camera(**EYE, fov=40, local_viewer=False),
    "orthographic, viewer at infinity": ds.OrthographicCamera(**EYE, height=3, local_viewer=False),
}
CASES = [
    ("hard", "phong", "perspective"),
    ("hard", "blinn", "orthographic"),
    ("soft", "blinn", "perspective, viewer at infinity"),
    ("directional", "blinn", "orthographic, viewer at infinity"),
    ("two of each", "phong", "orthographic"),
]


def unit(a):
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def dot(a, b):
    return np.sum(np.broadcast_to(a, np.broadcast_shapes(a.shape, b.shape)) * b, axis=-1)


def is_smooth(light, lobe, p, n, v):
    """Whether the light's contribution to a point is away from every kink by the margin."""
    if isinstance(light, ds.DirectionalLight):
        l = np.broadcast_to(unit(-np.asarray(light.direction)), p.shape)
    else:
        l = unit(light.position - p)
    n_l = dot(n, l)
    base = dot(v, 2 * n_l[..., None] * n - l) if isinstance(lobe, ds.Phong) else dot(n, unit(l + v))
    smooth = (np.abs(n_l) > MARGIN) & (np.abs(base) > MARGIN)
    if not isinstance(light, ds.DirectionalLight) and light.attenuation.clamp:
        a, d = light.attenuation, np.linalg.norm(light.position - p, axis=-1)
        smooth &= np.abs(1 / (a.constant + a.linear * d + a.quadratic * d**2) - 1) > MARGIN
    if isinstance(light, ds.SpotLight):
        cos_phi = dot(-l, unit(np.asarray(light.direction)))
        smooth &= np.abs(cos_phi - np.cos(np.deg2rad(light.cutoff))) > MARGIN
    return smooth


def smooth_pixels(scene, camera, gbuffer):
    """The pixels at which the image is differentiable, background included: no pixel lies on the silhouette."""
    p, n, inside = (np.asarray(a) for a in (gbuffer.position, gbuffer.normal, gbuffer.mask))
    backward = unit(np.asarray(camera.eye) - np.asarray(camera.target))
    v = unit(camera.eye - p) if camera.local_viewer else np.broadcast_to(backward, p.shape)
    lobe = scene.objects[0].material.lobe
    smooth = dot(n, v) > MARGIN
    for light in scene.lights:
        smooth &= is_smooth(light, lobe, p, n, v)
    return smooth | ~inside


def path_of(path):
    return jax.tree_util.keystr(path, simple=True, separator=".")


def check_leaves(function, tree, *, zero=()):
    """What jax.test_util.check_grads does, forward and reverse, for one leaf after the other by the same two programs.

    `zero` are the leaves of which nothing depends; that of all others something does is checked too.
    """
    flat, unravel = ravel_pytree(tree)

    def along(step, which):
        return function(unravel(flat + which * step))

    reverse = jax.jit(jax.value_and_grad(along), compiler_options=QUICK)

    def jvp_along(step, tangent, which):
        return jax.jvp(lambda step: along(step, which), (step,), (tangent,))

    forward = jax.jit(jvp_along, compiler_options=QUICK)
    at = np.zeros_like(flat)
    for i, (path, _) in enumerate(jax.tree.leaves_with_path(tree)):
        which, _ = ravel_pytree([np.full_like(leaf, j == i) for j, leaf in enumerate(jax.tree.leaves(tree))])

        def value(step, which=which):
            return reverse(step, which)[0]

        def jvp(primals, tangents, which=which):
            return forward(*primals, *tangents, which)

        def vjp(step, which=which):
            out, gradient = reverse(step, which)
            return out, lambda cotangent: (cotangent * gradient,)

        try:
            check_jvp(value, jvp, (at,), eps=1e-5)
            check_vjp(value, vjp, (at,), eps=1e-5)
        except AssertionError as error:
            raise AssertionError(f"the derivative with respect to {path_of(path)}: {error}") from None
        is_zero = not np.any(reverse(at, which)[1])
        assert is_zero == (path_of(path) in zero), f"the derivative with respect to {path_of(path)} is 0: {is_zero}"


@pytest.mark.parametrize(("lights", "lobe", "camera"), CASES)
def test_every_number_of_a_scene_and_its_camera(lights, lobe, camera):
    camera = CAMERAS[camera]
    scene = ds.Scene(ds.Object(SPHERE, MATERIALS[lobe]), LIGHTS[lights], (0.9, 0.8, 0.7), (0.1, 0.2, 0.3))
    gbuffer = ds.intersect(scene, camera)
    smooth = smooth_pixels(scene, camera, gbuffer)
    assert (smooth & np.asarray(gbuffer.mask)).sum() >= 25
    weight = np.random.default_rng(3).normal(size=(*smooth.shape, 3)) * smooth[..., None]
    # a hard edge is a jump, which no derivative sees, and has no width
    zero = {"0.lights.1.cutoff", "0.lights.1.softness"} if lights == "hard" else set()
    check_leaves(lambda both: jnp.sum(weight * ds.render(*both)), (scene, camera), zero=zero)


@pytest.mark.parametrize("lobe", MATERIALS)
def test_every_number_of_a_gbuffer(lobe):
    camera = dataclasses.replace(CAMERAS["perspective"], shape=(6, 8))
    random = np.random.default_rng(5)
    mask = random.random((6, 8)) < 0.8
    points = {"normal": unit(random.normal(size=(6, 8, 3))), "position": 0.5 * random.normal(size=(6, 8, 3))}
    scene = ds.Scene(ds.Object(SPHERE, MATERIALS[lobe]), [POINT, DIRECTIONAL, SOFT])
    smooth = smooth_pixels(scene, camera, ds.GBuffer(**points, mask=mask))
    assert (smooth & mask).sum() > 5
    weight = random.normal(size=(6, 8, 3)) * smooth[..., None]
    check_leaves(lambda p: jnp.sum(weight * ds.shade(scene, ds.GBuffer(**p, mask=mask), camera)), points)


# One point, one light of each kind at the same place, and one viewer, exactly at a kink. n is always (0, 0, 1).
UP, DOWN, RIGHT = (0, 0, 1), (0, 0, -1), (1, 0, 0)


def corner(lobe, l=UP, d=2.0, v=UP, axis=None, *, attenuation=(0.5, 0.2, 0.1), spot=(60, 2, 30), **material):
    """Scene, camera, normal and position; `l` and `v` of any length, `spot` its cutoff, exponent and softness."""
    l, eye, n = np.array(l, float), 4 * np.array(v, float), np.zeros((1, 1, 3)) + UP
    position, direction = l * d, -l if axis is None else np.array(axis, float)
    radial = ds.RadialAttenuation(*attenuation, clamp=True)
    cutoff, exponent, softness = spot
    lights = [
        ds.PointLight(position, (3, 4, 5), radial),
        ds.DirectionalLight(-l, (0.3, 0.4, 0.5)),
        ds.SpotLight(position, direction, (3, 4, 5), cutoff, exponent, radial, softness),
    ]
    material = ds.Material(**{"k_a": 0.1, "k_d": 0.5, "k_s": 0.4, "n_s": 4, "lobe": LOBES[lobe], **material})
    camera = ds.OrthographicCamera(eye, target=eye + DOWN, shape=(1, 1))
    return ds.Scene(ds.Object(ds.Sphere(), material), lights), camera, n, 0 * n


def colour(tree):
    scene, camera, n, p = tree
    return ds.shade(scene, ds.GBuffer(n, p, np.ones((1, 1))), camera)[0, 0]


@partial(jax.jit, compiler_options=QUICK)
def forward(tree, tangent):
    return jax.jvp(colour, (tree,), (tangent,))[1]


@partial(jax.jit, compiler_options=QUICK)
def reverse(tree, cotangent):
    return jax.vjp(colour, tree)[1](cotangent)[0]


def derivatives(tree):
    """Map each leaf's path to its derivative, channels first, after a look at whether both modes agree and are finite.

    One column a program run: to compile the whole Jacobian takes four times as long.
    """
    leaves, structure = jax.tree.flatten(tree)
    nothing = [np.zeros_like(leaf) for leaf in leaves]
    rows = [jax.tree.leaves(reverse(tree, channel)) for channel in np.eye(3)]
    found = {}
    for i, (path, leaf) in enumerate(jax.tree.leaves_with_path(tree)):
        name, by_row = path_of(path), np.stack([np.ravel(row[i]) for row in rows])
        columns = np.eye(leaf.size).reshape(leaf.size, *leaf.shape)
        tangents = [structure.unflatten([*nothing[:i], column, *nothing[i + 1 :]]) for column in columns]
        by_column = np.stack([forward(tree, tangent) for tangent in tangents], axis=-1)
        assert np.isfinite(by_column).all(), f"the forward derivative with respect to {name} is {by_column}"
        assert np.isfinite(by_row).all(), f"the reverse derivative with respect to {name} is {by_row}"
        tolerance = 1e4 * np.finfo(by_row.dtype).eps
        atol = tolerance * max(1, np.abs(by_row).max())
        np.testing.assert_allclose(by_column, by_row, rtol=tolerance, atol=atol, err_msg=name)
        found[name] = by_row
    return found


def names_of_nonzero(found):
    return {path for path, derivative in found.items() if derivative.any()}


AMBIENT = {"0.objects.0.material.k_a", "0.objects.0.material.k_e", "0.ambient"}
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


@pytest.mark.parametrize(("lobe", "place"), DARK.values(), ids=DARK)
def test_zero_where_it_is_dark(lobe, place):
    n_l = place.get("l", UP)[2]
    diffuse = {"0.objects.0.material.k_d"} if n_l > 0 else set()
    assert names_of_nonzero(derivatives(corner(lobe, **place))) == AMBIENT | diffuse


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


@pytest.mark.parametrize("lobe", MATERIALS)
@pytest.mark.parametrize(("place", "zero"), ZERO.values(), ids=ZERO)
def test_zero_on_the_documented_side(lobe, place, zero):
    found = derivatives(corner(lobe, **place))
    assert not names_of_nonzero(found) & set(zero)
    assert names_of_nonzero(found) >= AMBIENT


@pytest.mark.parametrize("lobe", MATERIALS)
def test_finite_in_float32(lobe):
    places = [place for of, place in DARK.values() if of == lobe] + [place for place, _ in ZERO.values()]
    with jax.enable_x64(False):
        for place in places:
            derivatives(corner(lobe, **place))


def finite_derivatives(function, tree):
    """One derivative along a random direction, forward, and the gradient of a random sum, reverse; both finite."""
    random = np.random.default_rng(11)
    direction = jax.tree.map(lambda leaf: random.normal(size=leaf.shape), tree)
    value, slope = jax.jit(lambda t, d: jax.jvp(function, (t,), (d,)), compiler_options=QUICK)(tree, direction)
    weights = jax.tree.map(lambda leaf: random.normal(size=leaf.shape), value)
    gradient = jax.jit(lambda t, w: jax.vjp(function, t)[1](w)[0], compiler_options=QUICK)(tree, weights)
    for path, derivative in jax.tree.leaves_with_path((slope, gradient)):
        assert np.isfinite(derivative).all(), path_of(path)
    return value, slope, gradient


def test_nothing_comes_from_outside_the_mask():
    points = {"normal": np.zeros((1, 2, 3)) + UP, "position": np.zeros((1, 2, 3))}
    for array in points.values():
        array[0, 1] = np.nan
    scene, camera, _, _ = corner("phong", (1, 0, 2))
    camera = dataclasses.replace(camera, shape=(1, 2))
    mask = np.array([[True, False]])
    _, slope, gradient = finite_derivatives(lambda p: ds.shade(scene, ds.GBuffer(**p, mask=mask), camera), points)
    assert slope[0, 0].all()
    assert not slope[0, 1].any()
    for derivative in gradient.values():
        assert derivative[0, 0].any()
        assert not derivative[0, 1].any()


def test_finite_at_the_silhouette():
    # pixel centres at -2, -1, 0, 1, 2: four rays touch the unit sphere, exactly
    camera = ds.OrthographicCamera((0, 0, 4), height=5, shape=(5, 5))
    scene = ds.Scene(ds.Object(ds.Sphere(), MATERIALS["phong"]), [POINT])

    def seen(both):
        scene, camera = both
        hit = scene.objects[0].surface.intersect(pixel_rays(camera.projection(), camera.shape))
        return ds.render(scene, camera), hit.p.stack(), hit.n.stack()

    (image, p, n), _, _ = finite_derivatives(seen, (scene, camera))
    np.testing.assert_array_equal(p[2, 3], RIGHT)
    np.testing.assert_array_equal(n[2, 3], RIGHT)
    assert not image[2, 3].any()


@pytest.mark.parametrize("exponent", [0, 1, 3.5])
@pytest.mark.parametrize("edge", ["outer", "inner"])
def test_the_edge_of_a_spot_is_smooth_where_softness_makes_it_so(exponent, edge):
    cutoff, exponent, softness = jnp.array(40.0), jnp.array(float(exponent)), jnp.array(15.0)
    cos_phi = jnp.cos(jnp.deg2rad(cutoff if edge == "outer" else cutoff - softness))
    slope = jax.grad(lambda x: angular_attenuation(x, cutoff, exponent, softness))(cos_phi)
    expected = 0.0 if edge == "outer" else exponent * cos_phi ** (exponent - 1)
    np.testing.assert_allclose(slope, expected, rtol=1e-12)
    by_edge = jax.grad(lambda c, s: angular_attenuation(cos_phi, c, exponent, s), (0, 1))(cutoff, softness)
    np.testing.assert_allclose(by_edge, 0, atol=1e-15)


def test_the_edge_of_a_hard_spot_is_a_jump_that_no_derivative_sees():
    cutoff, softness = jnp.array(40.0), jnp.array(0.0)
    cos_phi = jnp.cos(jnp.deg2rad(cutoff))
    found = jax.grad(angular_attenuation, (0, 1, 2, 3))(cos_phi, cutoff, jnp.array(2.0), softness)
    x = float(cos_phi)
    np.testing.assert_allclose(np.array(found), (2 * x, 0, x**2 * np.log(x), 0), rtol=1e-12)

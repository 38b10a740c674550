"""Coefficients over the pixels and textures: rendered, differentiated, known in a fit, and refused with a sentence."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera(eye=(0.3, 0.5, 4), fov=32, shape=(20, 24))
RANDOM = np.random.default_rng(0)
MAPS: dict[str, Any] = {
    "k_a": RANDOM.uniform(0, 0.2, (20, 24)),
    "k_d": RANDOM.uniform(0.2, 0.8, (20, 24, 3)),
    "k_s": RANDOM.uniform(0.1, 0.5, (20, 24, 1)),
    "n_s": RANDOM.uniform(5, 50, (20, 24)),
}
LIGHTS = (ds.PointLight((2, 2, 3)), ds.DirectionalLight((1, -1, -2), 0.5))


def scene(surface=None, lights=LIGHTS, **material) -> ds.Scene:
    return ds.Scene(ds.Object(surface or ds.Sphere(), ds.Material(**material)), lights)


def test_each_pixel_has_its_own_material():
    mapped = np.asarray(ds.render(scene(**MAPS), CAMERA))
    for row, column in ((5, 12), (10, 6), (14, 15), (0, 0)):
        own = {name: value[row, column] for name, value in MAPS.items()}
        own["n_s"] = float(own["n_s"])
        expected = np.asarray(ds.render(scene(**own), CAMERA))[row, column]
        np.testing.assert_allclose(mapped[row, column], expected, rtol=1e-13)


@pytest.mark.thorough
@pytest.mark.parametrize("lobe", [ds.Phong(), ds.Brushed()])
def test_a_map_of_one_value_is_that_value(lobe):
    plain: dict[str, Any] = {"k_a": 0.1, "k_d": (0.5, 0.4, 0.3), "k_s": 0.3, "n_s": (10, 20, 30)}
    maps: dict[str, Any] = {name: np.broadcast_to(value, (20, 24, 3)) for name, value in plain.items()}
    for surface in (ds.Sphere(), ds.intersect(scene(), CAMERA)):
        expected = ds.render(scene(surface, lobe=lobe, **plain), CAMERA)
        np.testing.assert_allclose(ds.render(scene(surface, lobe=lobe, **maps), CAMERA), expected, rtol=1e-13)
    two = ds.Scene([ds.Object(ds.Sphere(), ds.Material(**maps)), ds.Object(ds.Plane((0, -1, 0)), ds.Material(k_d=0.4))])
    same = eqx.tree_at(lambda s: s.objects[0].material, two, ds.Material(**plain))
    np.testing.assert_allclose(ds.render(two, CAMERA), ds.render(same, CAMERA), rtol=1e-13)


def test_the_gradient_by_maps_is_that_of_finite_differences():
    """As where a network's output is k_d."""

    @jax.jit
    def cost(maps):
        return jnp.sum((ds.render(scene(**maps), CAMERA) - 0.3) ** 2)

    maps = {name: jnp.asarray(value) for name, value in MAPS.items()}
    slopes = jax.grad(cost)(maps)
    for name, slope in slopes.items():
        assert slope.shape == MAPS[name].shape
        direction = RANDOM.normal(size=slope.shape)
        ends = [cost({**maps, name: maps[name] + sign * 1e-5 * direction}) for sign in (1, -1)]
        np.testing.assert_allclose(np.sum(slope * direction), (ends[0] - ends[1]) / 2e-5, rtol=1e-6)
        assert slope[0, 0].tolist() in (0, [0], [0, 0, 0])  # the background


@pytest.mark.thorough
def test_a_fit_beside_a_known_map_finds_the_light():
    truth = scene(lights=(ds.PointLight((2, 2, 3), (0.9, 0.8, 0.7)),), **MAPS)
    views = [ds.View(ds.render(truth, CAMERA), CAMERA)]
    told = eqx.tree_at(lambda s: s.lights[0].intensity, truth, np.ones(3))
    fit = ds.fit(told, views, free=("intensity",))
    np.testing.assert_allclose(fit.values, (0.9, 0.8, 0.7), rtol=1e-9)
    assert fit.scene.objects[0].material.k_d.shape == (20, 24, 3)
    buffer = ds.intersect(truth, CAMERA)
    again = ds.fit(eqx.tree_at(lambda s: s.objects[0].surface, told, buffer), views, free=("intensity",))
    np.testing.assert_allclose(again.values, fit.values, rtol=1e-5)
    with pytest.raises(ValueError, match=r"'k_d'"):
        ds.fit(told, views, free=("k_d",))


IMAGE = RANDOM.uniform(0, 1, (4, 8, 3))


@pytest.mark.parametrize(
    ("surface", "eye", "up", "row", "column"),
    [
        (ds.Sphere(), (0, 0, 4), (0, 1, 0), (1.5, 3.5), None),  # u, v = 1/2: between the middle pixels
        (ds.Sphere((1, 2, 3), 2), (9, 2, 3), (0, 1, 0), 1.5, 5.5),  # +x is u = 3/4
        (ds.Box(size=(2, 2, 2)), (0, 0, 6), (0, 1, 0), 1.5, 3.5),
        (ds.Plane((0, 0, 0), (0, 0, 1)), (0, 0, 4), (0, 1, 0), 1.5, 3.5),
    ],
)
def test_a_texture_is_where_its_coordinates_say(surface, eye, up, row, column):
    center = np.asarray(getattr(surface, "center", (0, 0, 0)))
    camera = ds.Camera(eye=eye, target=center, up=up, fov=1e-3, shape=(1, 1))
    found = np.asarray(ds.render(scene(surface, lights=(), k_a=ds.Texture(IMAGE)), camera))[0, 0]
    between = IMAGE[1:3, 3:5] if column in (None, 3.5) else IMAGE[1:3, 5:7]
    np.testing.assert_allclose(found, between.mean((0, 1)), rtol=1e-4)


def test_a_texture_runs_to_the_right_and_up_and_is_repeated():
    ramp = ds.Texture(np.stack([*np.meshgrid(np.arange(8) / 8, np.arange(8)[::-1] / 8), np.zeros((8, 8))], -1))
    camera = ds.OrthographicCamera((0, 0, 4), height=0.6, shape=(6, 6))
    seen = np.asarray(ds.render(scene(ds.Plane((0, 0, 0), (0, 0, 1)), lights=(), k_a=ramp), camera))
    assert (np.diff(seen[..., 0], axis=1) > 0).all()  # u to the right
    assert (np.diff(seen[..., 1], axis=0) < 0).all()  # v up
    moved = scene(ds.Plane((2, 3, 0), (0, 0, 1)), lights=(), k_a=ramp)
    np.testing.assert_allclose(ds.render(moved, camera), seen, atol=1e-12)
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=ramp))
    right = ds.render(ds.Scene(ball), ds.Camera((4, 0, 0), fov=1e-3, shape=(1, 1)))[0, 0, 0]
    left = ds.render(ds.Scene(ball), ds.Camera((-4, 0, 0), fov=1e-3, shape=(1, 1)))[0, 0, 0]
    assert right > left  # around the y axis, from -z by -x, +z, +x


@pytest.mark.thorough
def test_normals_over_the_pixels_and_by_a_texture():
    flat = ds.Texture(np.full((2, 2, 3), (0.5, 0.5, 1.0)))
    plain = ds.render(scene(k_d=0.5, k_s=0.3), CAMERA)
    for surface in (ds.Sphere(), ds.Box(rotation=(20, 30, 0))):
        expected = ds.render(scene(surface, k_d=0.5, k_s=0.3), CAMERA)
        np.testing.assert_allclose(
            ds.render(scene(surface, k_d=0.5, k_s=0.3, normal=flat), CAMERA), expected, rtol=1e-9
        )
    own = ds.intersect(scene(), CAMERA).normal
    np.testing.assert_allclose(ds.render(scene(k_d=0.5, k_s=0.3, normal=own), CAMERA), plain, rtol=1e-12)
    up = ds.Texture(np.full((2, 2, 3), (0.5, 0.5 + 0.5 * np.sin(0.4), 0.5 + 0.5 * np.cos(0.4))))
    lamp = (ds.DirectionalLight((0, -1, -1e-9)),)  # from above: a normal tilted up at the middle sees more of it
    camera = ds.Camera((0, 0, 4), fov=1e-3, shape=(1, 1))
    seen = ds.render(scene(lights=lamp, k_d=1.0, normal=up), camera)
    np.testing.assert_allclose(seen[0, 0], np.sin(0.4), rtol=1e-4)


@pytest.mark.thorough
def test_derivatives_at_the_poles_of_a_sphere_are_finite():
    camera = ds.Camera(eye=(0, 4, 0), target=(0, 0, 0), up=(0, 0, 1), fov=1e-3, shape=(1, 1))

    def seen(center):
        item = ds.Object(ds.Sphere(center), ds.Material(k_a=ds.Texture(IMAGE), k_d=0.3, normal=ds.Texture(IMAGE)))
        return jnp.sum(ds.render(ds.Scene(item, LIGHTS), camera))

    for derivative in (jax.grad(seen), jax.jacfwd(seen)):
        assert np.isfinite(derivative(jnp.zeros(3))).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ds.render(scene(k_d=np.ones((4, 5))), CAMERA), (r"objects\[0\]", "(4, 5)", "(20, 24)")),
        (lambda: scene(k_d=np.ones((4, 5)), k_s=np.ones((5, 4))), ("(4, 5)", "(5, 4)", "Resize")),
        (
            lambda: scene(ds.intersect(scene(), CAMERA), k_d=ds.Texture(IMAGE)),
            ("GBuffer", "texture coordinates", "over the pixels"),
        ),
        (
            lambda: ds.Scene(
                [ds.Object(ds.Sphere(), ds.Material(k_t=0.5, eta=1.5)), ds.Object(ds.Plane(), ds.Material(**MAPS))]
            ),
            ("glass", "eta 1.5", "Texture"),
        ),
        (lambda: ds.exchange.with_lobe(ds.Material(**MAPS), ds.Blinn()), ("an array for k_a", "one colour")),
        (
            lambda: ds.fit_texels(scene(**MAPS), [ds.View(np.ones((20, 24, 3)), CAMERA, lit=0)] * 2),
            ("coefficients over the pixels", "plain colours"),
        ),
    ],
)
def test_what_cannot_take_them_says_so(make, words):
    with pytest.raises(ValueError, match="(?s)" + ".*".join(w.replace("(", r"\(").replace(")", r"\)") for w in words)):
        make()

"""Rendering: what is compiled when, what a hundred lights cost, and what does not fit together."""

import contextlib
import dataclasses

import equinox as eqx
import jax
import jax.monitoring
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.core.fields import Vector
from diffshade.model import rendering
from diffshade.model.cameras import AbstractCamera, SomePixels
from diffshade.model.rendering import _render, render_once
from diffshade.model.scenes import stack_scene, with_pixels

BALL = ds.Object(ds.Sphere(), ds.Material(k_a=0.1, k_d=(0.7, 0.25, 0.2), k_s=0.4, n_s=40))
CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(8, 10))


def lights(count: int, seed: int = 0) -> list[ds.PointLight]:
    random = np.random.default_rng(seed)
    return [ds.PointLight(p, i) for p, i in zip(3 * random.normal(size=(count, 3)), random.random(count), strict=True)]


@contextlib.contextmanager
def counting_traces():
    """Count what JAX traces inside the block."""
    traced = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == "/jax/core/compile/jaxpr_trace_duration":
            traced.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield traced
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_an_image_is_linear_radiance_and_row_0_is_on_top():
    """A bright lamp above the ball: unclamped values, in the upper half of the picture."""
    image = np.asarray(ds.render(ds.Scene(BALL, ds.PointLight((0, 3, 1), 50)), CAMERA))
    assert image.shape == (8, 10, 3)
    assert image.dtype == np.float64
    assert image.max() > 10
    assert image[:4].sum() > 3 * image[4:].sum()


def test_a_picture_that_is_rendered_once_is_the_same():
    scene = ds.Scene(BALL, lights(2))
    np.testing.assert_allclose(render_once(scene, CAMERA, 1, 2), ds.render(scene, CAMERA, lit=1, samples=2), rtol=1e-5)


@pytest.mark.thorough
def test_only_a_new_shape_is_traced():
    scene = ds.Scene(BALL, [*lights(2), ds.DirectionalLight((1, -1, -1))])
    with counting_traces() as traced:
        ds.render(scene, CAMERA)
    assert traced  # the count counts
    values = jax.tree.map(lambda leaf: np.asarray(leaf * 1.25), scene)
    with counting_traces() as traced:
        ds.render(values, dataclasses.replace(CAMERA, eye=(1, 2, 3), fov=50))
        ds.render(ds.Scene(BALL, [*lights(2, 1), ds.DirectionalLight((0, -1, 0), 2)]), CAMERA)
        ds.render(scene, CAMERA, lit=(1, 2, 0))
    assert not traced
    with counting_traces() as traced:
        ds.render(scene, dataclasses.replace(CAMERA, shape=(8, 11)))
    assert traced
    with counting_traces() as traced:
        ds.render(ds.Scene(BALL, [*lights(3), ds.DirectionalLight((1, -1, -1))]), CAMERA)
    assert traced


def test_only_a_new_shape_of_gbuffer_is_traced():
    normal = np.full((8, 10, 3), (0.0, 0, 1))
    scene = ds.Scene(BALL, lights(1))
    ds.shade(scene, ds.GBuffer(normal, normal), CAMERA)
    with counting_traces() as traced:
        ds.shade(scene, ds.GBuffer(-normal, 2 * normal, normal[..., 0] > 2), CAMERA)
    assert not traced


def test_what_is_compiled_does_not_grow_with_the_number_of_lights():
    def loss(scene, camera):
        return jnp.sum(_render(scene, camera))

    def size(count):
        return len(jax.jit(jax.grad(loss)).lower(stack_scene(ds.Scene(BALL, lights(count))), CAMERA).as_text())

    assert size(100) == pytest.approx(size(10), rel=0.01)  # "10x3" is written "100x3"


@pytest.mark.thorough
def test_many_lights_and_their_gradient():
    """The light of an image is linear in the intensities, so that they times the gradient give it back (Euler)."""
    lamps = lights(20)

    def total(lamps):
        return jnp.sum(ds.render(ds.Scene(BALL, lamps), CAMERA))

    value, slope = jax.value_and_grad(total)(lamps)
    given = [np.sum(light.intensity * by.intensity) for light, by in zip(lamps, slope, strict=True)]
    assert np.count_nonzero(given) > 5  # the others stand behind the ball or in it
    np.testing.assert_allclose(sum(given), value - dark(ds.Scene(BALL, lamps)).sum(), rtol=1e-12)


def dark(scene):
    return ds.render(scene, CAMERA, lit=())


def test_intersect():
    scene = ds.Scene([BALL, ds.Object(ds.Sphere((0, 0, -2), 3))])
    gbuffer = ds.intersect(scene, dataclasses.replace(CAMERA, shape=(9, 9)))
    assert gbuffer.position is not None
    np.testing.assert_allclose(gbuffer.position[4, 4], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(gbuffer.normal[4, 4], [0, 0, 1], atol=1e-15)
    behind = gbuffer.position[0, 0] - np.array([0, 0, -2])
    np.testing.assert_allclose(np.linalg.norm(behind), 3, rtol=1e-14)
    assert np.asarray(gbuffer.mask).all()
    alone = ds.intersect(ds.Scene(BALL), CAMERA)
    outside = ~np.asarray(alone.mask)
    assert outside.any()
    assert not np.asarray(alone.normal)[outside].any()
    assert not np.asarray(alone.position)[outside].any()


def test_intersect_works_in_a_callers_jit_and_grad():
    """The position nearest to the camera is z = radius."""

    def nearest(radius):
        scene = ds.Scene(ds.Object(ds.Sphere(radius=radius)))
        gbuffer = ds.intersect(scene, ds.Camera((0, 0, 4), shape=(3, 3)))
        assert gbuffer.position is not None
        return gbuffer.position[1, 1, 2]

    np.testing.assert_allclose(jax.jit(nearest)(1.5), 1.5, rtol=1e-14)
    np.testing.assert_allclose(jax.jit(jax.grad(nearest))(1.5), 1, rtol=1e-14)


def test_render_works_in_a_callers_jit_and_vmap():
    def image(k_d):
        scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=k_d)), ds.PointLight((1, 2, 3)))
        return ds.render(scene, CAMERA)

    one = image(0.5)
    np.testing.assert_allclose(jax.jit(image)(0.5), one, rtol=1e-14)
    np.testing.assert_allclose(jax.vmap(image)(jnp.array([0.5, 1])), [one, 2 * one], rtol=1e-14)


def test_arithmetic_on_a_scene_gives_a_scene():
    scene = ds.Scene(BALL, lights(1), ambient=0.5)
    twice = jax.tree.map(lambda leaf: 2 * leaf, scene.lights)
    brighter = eqx.tree_at(lambda s: s.lights[0].attenuation, scene, twice[0].attenuation)
    half = ds.render(brighter, CAMERA) - dark(scene)
    np.testing.assert_allclose(2 * half, ds.render(scene, CAMERA) - dark(scene), rtol=1e-12, atol=1e-15)


def test_float32_unless_told_otherwise():
    with jax.enable_x64(False):
        image = ds.render(ds.Scene(BALL, lights(1)), CAMERA)
        assert image.dtype == np.float32
        gbuffer = ds.intersect(ds.Scene(BALL), CAMERA)
        again = ds.shade(ds.Scene(BALL, lights(1)), gbuffer, CAMERA)
        np.testing.assert_allclose(again, image, rtol=1e-4, atol=1e-6)


NORMAL = np.full((4, 5, 3), (0, 0, 1))


HERE = ("surface", "one normal a pixel", "(4, 5)", "(8, 10)")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ds.render(ds.Scene(ds.Object(ds.GBuffer(NORMAL, NORMAL))), CAMERA), ("objects[0]", *HERE)),
        (lambda: ds.render(ds.Scene([BALL, ds.Object(ds.GBuffer(NORMAL, NORMAL))]), CAMERA), ("objects[1]", *HERE)),
        (lambda: ds.shade(ds.Scene(BALL), ds.GBuffer(NORMAL, NORMAL), CAMERA), ("objects[0]", *HERE)),
        (lambda: ds.intersect(ds.Scene(ds.Object(ds.GBuffer(NORMAL, NORMAL))), CAMERA), ("objects[0]", *HERE)),
        (lambda: ds.shade(ds.Scene([BALL] * 2), ds.GBuffer(NORMAL, NORMAL), CAMERA), ("one object", "got 2", "render")),
        (lambda: ds.render(ds.Scene(BALL, lights(2)), CAMERA, lit=(0, 2)), ("lit", "2 lights, from 0", "got 2")),
        (lambda: ds.render(ds.Scene(BALL, lights(2)), CAMERA, lit=(-1,)), ("lit", "2 lights, from 0", "got -1")),
        (
            lambda: ds.render(ds.Scene(BALL, lights(2)), CAMERA, samples=0),
            ("samples", "whole number", "got 0", "4 x 4"),
        ),
    ],
)
def test_what_does_not_fit_together(make, words):
    refuses(make, *words)


# --- several samples a pixel


EDGED = ds.Scene([BALL, ds.Object(ds.Plane((0, 0, -1), (0, 0, 1)), ds.Material(0.0, 0.5))], lights(2), background=0.2)


@pytest.mark.parametrize("bands", [0, pytest.param(5, marks=pytest.mark.thorough)])
def test_samples_are_the_mean_of_a_finer_picture(bands):
    scene = EDGED if not bands else ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5)), lights(2), bands=bands)
    for camera in (CAMERA, ds.OrthographicCamera((0, 0, 4), height=2.5, shape=CAMERA.shape)):
        fine = np.asarray(ds.render(scene, dataclasses.replace(camera, shape=(24, 30))))
        found = np.asarray(ds.render(scene, camera, samples=3))
        np.testing.assert_allclose(found, fine.reshape(8, 3, 10, 3, -1).mean((1, 3)), rtol=1e-12)
        if bands:
            break


@pytest.mark.parametrize("kind", ["maps", "bodies"])
@pytest.mark.parametrize("samples", [1, 2])
def test_some_pixels_show_what_they_show_in_the_whole_picture(samples, kind):
    pixels = np.array([31, 32, 38, 41, 50, 0])
    if kind == "maps":
        camera = ds.OrthographicCamera((0, 0, 4), height=2.2, shape=(8, 10))
        relief = ds.height_map(0.1 * np.random.default_rng(0).random((8, 10)), camera)
        item = ds.Object(relief, ds.Material(k_d=np.random.default_rng(1).random((8, 10, 3))))
    else:
        camera, item = CAMERA, BALL
    scene = ds.Scene([item, ds.Object(ds.Plane((0, -0.4, 0), (0, 1, 0)))], lights(2))
    whole = np.asarray(ds.render(scene, camera, samples=samples)).reshape(-1, 3)
    some = ds.render(with_pixels(scene, pixels), SomePixels.of(camera, pixels), samples=samples)
    np.testing.assert_allclose(some[0], whole[pixels], rtol=1e-5, atol=1e-6)


class OwnCamera(AbstractCamera):
    """A camera that is not made of its fields."""

    eye: Vector
    target: Vector
    up: Vector
    shape: tuple[int, int] = eqx.field(static=True)
    local_viewer: bool = eqx.field(static=True)

    def __init__(self):
        self.eye, self.target, self.up = CAMERA.eye, CAMERA.target, CAMERA.up
        self.shape, self.local_viewer = CAMERA.shape, True

    def projection(self):
        return CAMERA.projection()


@pytest.mark.parametrize("local", [True, False])
def test_some_pixels_of_a_camera_of_ones_own(local):
    pixels, scene = np.array([31, 32, 41]), ds.Scene(BALL, lights(2))
    some = dataclasses.replace(SomePixels.of(OwnCamera(), pixels), local_viewer=local)
    whole = np.asarray(ds.render(scene, dataclasses.replace(CAMERA, local_viewer=local))).reshape(-1, 3)
    np.testing.assert_allclose(ds.render(scene, some)[0], whole[pixels], rtol=1e-5, atol=1e-6)


@pytest.mark.thorough
def test_a_key_moves_samples_within_their_squares():
    one, same, other = (np.asarray(ds.render(EDGED, CAMERA, samples=3, key=jax.random.key(k))) for k in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    regular, fine = (np.asarray(ds.render(EDGED, CAMERA, samples=n)) for n in (3, 24))
    assert np.abs(one - other).max() > 1e-4
    rms = [np.sqrt(np.mean((of - fine) ** 2)) for of in (one, regular, np.asarray(ds.render(EDGED, CAMERA)))]
    assert max(rms[:2]) < 0.5 * rms[2]
    moved = np.asarray(ds.render(EDGED, CAMERA, key=jax.random.key(1)))
    assert np.abs(moved - ds.render(EDGED, CAMERA)).max() > 0.01


@pytest.mark.thorough
def test_samples_have_the_mean_of_their_derivatives():
    def total(k_d, samples, shape, key=None):
        scene = eqx.tree_at(lambda s: s.objects[0].material.k_d, EDGED, k_d)
        image = ds.render(scene, dataclasses.replace(CAMERA, shape=shape), samples=samples, key=key)
        return jnp.mean(image**1)

    k_d = jnp.array([0.7, 0.25, 0.2])
    found, fine = jax.grad(total)(k_d, 2, (8, 10)), jax.grad(total)(k_d, 1, (16, 20))
    np.testing.assert_allclose(found, fine, rtol=1e-10)
    moved = jax.jit(jax.grad(lambda k_d, key: total(k_d, 2, (8, 10), key)))(k_d, jax.random.key(0))
    np.testing.assert_allclose(moved, fine, rtol=0.05)


# --- many transparent objects, which are compiled without fusion


@pytest.fixture
def clear():
    balls = [ds.Object(ds.Sphere((0.2 * i, 0, -i)), ds.Material(0.1, 0.5, 0.3, k_t=0.5)) for i in range(2)]
    return ds.Scene(balls, ds.PointLight((2, 3, 4)), background=0.3)


def pictured(shape):
    """A G-buffer with coefficients over its pixels."""
    seen = ds.intersect(ds.Scene(BALL), ds.Camera((0, 0, 4), shape=shape))
    shade = np.random.default_rng(0).uniform(0.1, 0.9, (*shape, 3))
    return ds.Scene(ds.Object(seen, ds.Material(0.1, shade, 0.3, n_s=9.0)), lights(2))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "kind",
    ["pictured", "bands", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("ball", "brief", "glass"))],
)
def test_an_image_by_rows_is_the_same_to_the_bit(clear, monkeypatch, kind):
    camera = ds.Camera((0, 0, 4), shape=(9, 11))
    bands = ds.Material(0.1, np.linspace(0.1, 0.9, 5), 0.3, n_s=9.0)
    scene = {
        "ball": ds.Scene(BALL, lights(2)),
        "glass": clear,
        "pictured": pictured(camera.shape),
        "brief": eqx.tree_at(lambda s: s.lights, pictured(camera.shape), tuple(lights(1))),
        "bands": ds.Scene(ds.Object(ds.Sphere(), bands), ds.PointLight((2, 3, 4)), bands=5),
    }[kind]
    several = {"samples": 2, "key": jax.random.key(3)}
    expected, smooth = ds.render(scene, camera), ds.render(scene, camera, **several)
    for size in ("BLOCK", "FEW", "GIVEN"):
        monkeypatch.setattr(rendering, size, 40)
    np.testing.assert_array_equal(ds.render(scene, camera), expected)
    np.testing.assert_array_equal(ds.render(scene, camera, **several), smooth)
    assert np.ptp(expected) > 0.1
    assert (kind in ("pictured", "brief")) == bool((smooth == expected).all())


def test_only_one_opaque_g_buffer_under_one_light_is_shaded_at_once(monkeypatch):
    camera, lamp = ds.Camera((0, 0, 4), shape=(9, 11)), ds.PointLight((2, 3, 4))
    seen = ds.intersect(ds.Scene(BALL), camera)
    asked = []
    monkeypatch.setattr(rendering, "FEW", 40)
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")  # elsewhere no picture is drawn by rows
    monkeypatch.setattr(rendering, "_render", lambda *_, by_rows, **__: asked.append(by_rows))
    item, clear = ds.Object(seen, ds.Material(k_d=0.5)), ds.Object(seen, ds.Material(k_d=0.5, k_t=0.5))
    for objects, lamps in (
        ([item], [lamp]),
        ([clear], [lamp]),
        ([item, item], [lamp]),
        ([BALL], [lamp]),
        ([item], [lamp, lamp]),
        ([item], []),
    ):
        ds.render(ds.Scene(objects, lamps), camera)
    assert asked == [False, True, True, True, True, True]


@pytest.mark.thorough
def test_without_fusion_the_image_is_the_same(clear, monkeypatch):
    camera = ds.Camera((0, 0, 4), shape=(9, 11))
    expected = ds.render(clear, camera)
    with monkeypatch.context() as patch:
        patch.setattr(rendering, "MANY", 2)
        patch.setattr(rendering, "_render", None)  # so that the other program is seen to be used
        np.testing.assert_allclose(ds.render(clear, camera), expected, rtol=1e-12)


@pytest.mark.thorough
def test_within_a_program_of_the_callers_own_it_is_left_to_him(clear, monkeypatch):
    """Compiler options can be given to the outermost program alone."""
    camera = ds.Camera((0, 0, 4), shape=(9, 11))
    expected = ds.render(clear, camera)
    monkeypatch.setattr(rendering, "MANY", 2)

    def image(k_t=None):
        scene = clear if k_t is None else eqx.tree_at(lambda s: s.objects[0].material.k_t, clear, k_t)
        return ds.render(scene, camera)

    half = jnp.full(3, 0.5)
    np.testing.assert_allclose(jax.jit(image)(), expected, rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(image)(half[None])[0], expected, rtol=1e-12)
    np.testing.assert_allclose(jax.grad(lambda x: x * image().sum())(1.0), expected.sum(), rtol=1e-12)


def test_a_picture_of_more_pixels_than_can_be_counted_is_refused():
    camera = dataclasses.replace(CAMERA, shape=(1 << 16, 1 << 16))
    with pytest.raises(ValueError, match="65536 x 65536 has 4,294,967,296 pixels"):
        ds.render(ds.Scene(BALL, lights(1)), camera)

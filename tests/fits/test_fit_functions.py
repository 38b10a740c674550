"""Fit functions: many small fits at once, and derivatives through a fit."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.inverse.fit_functions import FitFunction

LAMPS = (ds.PointLight((2, 3, 4), 20, ds.RadialAttenuation(1, 0.1, 0.5)), ds.DirectionalLight((1, -1, -1), 0.3))
FREE = ("k_a", "k_d", "k_s", "n_s")
TOLD = ds.Scene(ds.Object(ds.Sphere(), ds.Material()), LAMPS)


def camera(side):
    return ds.Camera(eye=(0, 0, 4), fov=35, shape=(side, side))


def drawn(count, side):
    """Return grey photographs of balls with noise, and the cost of the truth."""
    random = np.random.default_rng(0)
    materials = np.exp(random.uniform(np.log((0.02, 0.2, 0.1, 3)), np.log((0.2, 0.8, 0.6, 200)), (count, 4)))
    scenes = [ds.Scene(ds.Object(ds.Sphere(), ds.Material(*of)), LAMPS) for of in materials]
    clean = np.stack([np.asarray(ds.render(scene, camera(side))).mean(-1) for scene in scenes])
    noise = random.normal(0, 0.01, clean.shape)
    inside = np.asarray(ds.intersect(TOLD, camera(side)).mask)
    return clean + noise, 0.5 * (noise[:, inside] ** 2).sum(-1)


@pytest.fixture(scope="module")
def few():
    images, cost = drawn(6, 16)
    function = ds.fit_function(TOLD, ds.View(images[0], camera(16)), free=FREE)
    return function, images, jax.jit(jax.vmap(function))(images), cost


@pytest.mark.thorough
def test_it_is_compiled_once_for_a_caller_who_compiles_nothing():
    (image, other), _ = drawn(2, 12)
    function = ds.fit_function(TOLD, ds.View(image, camera(12)), free=("k_a", "k_d"))
    function(image)
    fitted: Any = FitFunction._fitted
    before = fitted._cache_size()
    function(other)
    assert fitted._cache_size() == before > 0


@pytest.mark.thorough
def test_a_batch_ends_where_fit_does(few):
    function, images, found, cost = few
    assert function.names == FREE
    assert found.converged.all()
    assert (found.cost <= cost).all()
    alone = ds.fit(TOLD, ds.View(images[2], camera(16)), free=FREE).scene.objects[0].material
    expected = [alone.k_a[0], alone.k_d[0], alone.k_s[0], alone.n_s]
    np.testing.assert_allclose([found.values[name][2] for name in FREE], expected, rtol=1e-5)


@pytest.mark.thorough
def test_residuals_are_zero_where_the_image_is_predicted(few):
    function, images, found, _ = few
    theta = jnp.array([*(found.values[name][0] for name in FREE[:3]), jnp.log(found.values["n_s"][0])])
    r = function.residuals(theta, images[0])
    np.testing.assert_allclose(0.5 * r @ r, found.cost[0], rtol=1e-9)
    np.testing.assert_allclose(
        jax.grad(lambda t: 0.5 * (function.residuals(t, images[0]) ** 2).sum())(theta), 0, atol=1e-6
    )


@pytest.mark.thorough
def test_the_gradient_through_a_fit_is_that_of_finite_differences(few):
    function, images, _, _ = few
    along = np.random.default_rng(1).normal(size=images[0].shape)

    @jax.jit
    def end(step):
        found = function(images[1] + step * along)
        return jnp.stack([*found.values.values(), found.cost])

    slope = np.asarray(jax.jit(jax.jacfwd(end))(0.0))
    h = 1e-5
    differences = (8 * (end(h) - end(-h)) - (end(2 * h) - end(-2 * h))) / (12 * h)
    np.testing.assert_allclose(slope, differences, rtol=1e-5)
    reverse = jax.jit(jax.grad(lambda image: function(image).values["n_s"]))(images[1])
    np.testing.assert_allclose(np.sum(reverse * along), slope[3], rtol=1e-8)


MATTE = ds.Material(0.1, 0.5, 0.0, 20)
SURFACES = {"glossy": ds.Material(0.1, 0.5, 0.3, 20), "matte": MATTE, "black": ds.Material(0, 0), "flat": MATTE}


def of_surfaces(side):
    """Return a grey photograph of each surface, the last one all of one value, and the fit of one of them."""
    scenes = [ds.Scene(ds.Object(ds.Sphere(), material), LAMPS) for material in SURFACES.values()]
    images = np.stack([np.asarray(ds.render(scene, camera(side)), np.float64).mean(-1) for scene in scenes])
    images[-1] = 0.5
    return images, ds.fit_function(TOLD, ds.View(images[0], camera(side), mask=images[0] > 0), free=FREE)


def check_surfaces(tolerance):
    """Where k_s is 0 no n_s is determined, and no derivative is by it; the glossy one is as it is alone."""
    images, function = of_surfaces(12)

    def total(images):
        found = jax.vmap(function)(images)
        return sum(value.sum() for value in found.values.values()), found

    (_, found), slopes = jax.jit(jax.value_and_grad(total, has_aux=True))(images)
    assert found.converged.all()
    assert (found.cost >= 0).all()
    expected = [(0.1, 0.5, 0.3), (0.1, 0.5, 0), (0, 0, 0), (0.5, 0, 0)]
    np.testing.assert_allclose(np.stack([found.values[k] for k in FREE[:3]], -1), expected, atol=tolerance)
    assert np.isfinite(found.values["n_s"]).all()
    np.testing.assert_array_equal(found.determined["n_s"], [True, False, False, False])
    assert all(found.determined[name].all() for name in FREE[:3])
    assert np.isfinite(slopes).all()
    np.testing.assert_array_equal(slopes[2], 0)  # all at their bounds
    assert np.abs(slopes[1]).max() < 10
    alone = jax.jit(jax.grad(lambda image: sum(function(image).values.values())))(images[0])
    np.testing.assert_allclose(slopes[0], alone, atol=tolerance * np.abs(alone).max())


@pytest.mark.thorough
@pytest.mark.parametrize(("x64", "tolerance"), [(True, 1e-9), pytest.param(False, 1e-4, marks=pytest.mark.slow)])
def test_an_image_that_does_not_determine_n_s_has_a_derivative_and_spoils_no_other(x64, tolerance):
    with jax.enable_x64(x64):
        check_surfaces(tolerance)


@pytest.mark.thorough
def test_what_cannot_be_told_apart_is_not_determined_and_moves_together():
    """k_d, k_s and the lights' intensities share a scale; the derivative of what they make is that of the image."""
    images, _ = of_surfaces(12)
    free = (*FREE, "lights.0.intensity", "lights.1.intensity")
    function = ds.fit_function(TOLD, ds.View(images[0], camera(12), mask=images[0] > 0), free=free)
    found = jax.jit(function)(images[0])
    assert [name for name in function.names if found.determined[name]] == ["k_a", "n_s"]

    def brightness(scale):
        values = function(scale * images[0]).values
        return values["k_d"] * values["lights.0.intensity"]

    np.testing.assert_allclose(jax.jit(jax.grad(brightness))(1.0), 0.5 * 20, rtol=1e-6)


def test_what_it_does_not_know_is_refused():
    images = np.linspace(0.1, 0.9, 6 * 16 * 16).reshape(6, 16, 16)
    view = ds.View(images[0], camera(16))
    function = ds.fit_function(TOLD, view, free=FREE)
    refuses(lambda: function(images), "(16, 16)", "(6, 16, 16)", "jax.vmap")
    growing = ds.View(images[0], camera(16), noise=ds.Noise(0.01, shot=0.01))
    refuses(lambda: ds.fit_function(TOLD, growing, free=FREE), "views[0]", "grows with the signal")
    refuses(lambda: ds.fit_function(TOLD, view, free=FREE, priors={"k_a": (0.1, 0.01)}), "priors", "View.noise")
    refuses(lambda: ds.fit_function(TOLD, ds.View(images[0], camera(16), saturation=0.15), free=FREE), "clipped")
    refuses(lambda: ds.fit_function(TOLD, view, free="kd"), "'kd'", "k_d")
    refuses(lambda: function(images[0], scene=ds.Scene(TOLD.objects, LAMPS[:1])), "scene", "Make another fit function")
    refuses(lambda: function(images[0], cameras=camera(15)), "cameras", "Make another fit function")


@pytest.mark.thorough
def test_a_grey_image_may_have_its_channel():
    (image,), _ = drawn(1, 8)
    for given in (image, image[..., None]):
        function = ds.fit_function(TOLD, ds.View(given, camera(8)), free="k_d")
        found = [function(of).values["k_d"] for of in (image, image[..., None])]
        assert found[0] == found[1]


@pytest.mark.thorough
def test_it_takes_what_fit_takes():
    """Colours in the order of the channels, ties, constraints, priors and noise: the values are those of `fit`."""
    material = ds.Material(0.05, (0.6, 0.45, 0.3), 0.2, 20)
    photographs = [
        np.asarray(ds.render(ds.Scene(ds.Object(ds.Sphere(), material), LAMPS), camera(16), lit=i)) for i in (0, 1)
    ]
    photographs = [of + np.random.default_rng(3).normal(0, 0.01, of.shape) for of in photographs]
    views = [ds.View(of, camera(16), lit=i, noise=0.01 * (1 + i)) for i, of in enumerate(photographs)]
    options = {
        "free": ("k_a", "k_d", "k_s", "n_s", "lights.0.attenuation.quadratic"),
        "constraints": (ds.Grey("k_s"), ds.Proportional("k_a", "k_d")),
        "priors": {"n_s": (18.0, 0.05), "lights.0.attenuation.quadratic": (0.45, 0.02)},
    }
    function = ds.fit_function(TOLD, views, **options)
    found, fit = jax.jit(function)(*photographs), ds.fit(TOLD, views, **options)
    assert found.values["k_d"].shape == (3,)
    assert function.names == fit.names == ("k_d.r", "k_d.g", "k_d.b", "k_s", "n_s", "quadratic", "k_a/k_d")
    values = np.concatenate([np.ravel(found.values[name]) for name, _ in function.quantities])
    np.testing.assert_allclose(values, fit.values, rtol=1e-5)
    tied = ds.fit_function(TOLD, views, free=("k_d", "intensity"), tied=("intensity",))
    assert [name for name, _ in tied.quantities] == ["k_d", "intensity"]


# By what is known: setups of numbers x, each with the values that are fitted and with x itself


def lit_from(x):
    """A lamp's position and intensity, a direction, and a camera's eye and angle."""
    lamps = ds.PointLight(x[:3], x[3], LAMPS[0].attenuation), ds.DirectionalLight(x[4:7], 0.3)
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.05, 0.5, 0.3, 20)), lamps), ds.Camera(
        eye=x[7:10], fov=x[10], shape=(16, 16)
    )


def lit_by_lamps_that_are_sought(x):
    material = ds.Material(0.05, 0.5, 0.3, 20)
    lamps = ds.PointLight(LAMPS[0].position, x[0], LAMPS[0].attenuation), ds.DirectionalLight((1, -1, -1), x[1])
    return ds.Scene(ds.Object(ds.Sphere(), material), lamps), ds.Camera(eye=(0, 0, 4), fov=x[2], shape=(16, 16))


def of_a_known_colour(x):
    """A highlight of the surface's own colour, of which the brightness is known."""
    k_d = x[0] * np.array((0.6, 0.45, 0.3))
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.05, k_d, 0.5 * k_d, 20)), LAMPS), ds.Camera(
        eye=(0, 0, 4), fov=x[1], shape=(16, 16)
    )


def in_fog(x):
    """Rendered: a floor, and a pattern over the pixels."""
    pattern = x[2] * np.linspace(0.3, 0.6, 768).reshape(16, 16, 3)
    objects = (
        ds.Object(ds.Plane((0, -1, 0)), ds.Material(0.1, 0.4)),
        ds.Object(ds.Sphere(), ds.Material(0.1, pattern, 0.2, 20, ds.Blinn()), name="ball"),
    )
    scene = ds.Scene(objects, LAMPS, atmosphere=ds.Fog(x[0], I_dc=(0.3, 0.4, 0.5)))
    return scene, ds.Camera(eye=(0, 0, 4), fov=x[1], shape=(16, 16))


SETUPS = {
    "lights and camera": (lit_from, (2, 3, 4, 20, 1, -1, -1, 0, 0, 4, 35), {"free": FREE}),
    "moving lights": (
        lit_by_lamps_that_are_sought,
        (20, 0.3, 35),
        {"free": ("k_d", "k_s", "n_s", "lights.0.position", "lights.1.direction")},
    ),
    "a known colour": (
        of_a_known_colour,
        (1, 35),
        {"free": ("k_a", "k_s", "n_s"), "constraints": ds.Proportional("k_s", "k_d")},
    ),
    "fog": (in_fog, (0.1, 35, 1), {"free": ("ball.material.k_a", "ball.material.k_s", "ball.material.n_s")}),
}


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", [pytest.param(of, marks=[pytest.mark.slow] * (of != "lights and camera")) for of in SETUPS]
)
def test_a_fit_moves_with_what_is_known_as_whole_fits_do(name):
    """Forward and reverse, against differences of fits; the outermost pixels, where rays graze, are left out."""
    setup, x, options = SETUPS[name]
    scene, seen = setup(np.array(x, float))
    image = np.asarray(ds.render(scene, seen), float)
    image = image + np.random.default_rng(1).normal(0, 0.01, image.shape)
    mask = np.asarray(ds.intersect(TOLD, ds.Camera(eye=(0, 0, 4), fov=39, shape=(16, 16))).mask)
    function = ds.fit_function(scene, ds.View(image, seen, mask=mask), **options)

    def end(x):
        scene, seen = setup(x)
        found = function(image, scene=scene, cameras=seen)
        return jnp.concatenate([*map(jnp.ravel, found.values.values()), found.cost[None]])

    x, h, whole = jnp.array(x, float), 1e-4, jax.jit(end)
    forward, reverse = jax.jit(jax.jacfwd(end))(x), jax.jit(jax.jacrev(end))(x)
    steps = h * jnp.eye(len(x))
    differences = np.stack(
        [(8 * (whole(x + d) - whole(x - d)) - (whole(x + 2 * d) - whole(x - 2 * d))) / (12 * h) for d in steps], 1
    )
    scale = np.abs(differences).max(1, keepdims=True)
    assert (np.abs(differences).max(0) > 0).all()  # each number shows
    np.testing.assert_allclose(forward / scale, differences / scale, atol=1e-4)
    np.testing.assert_allclose(reverse / scale, forward / scale, atol=1e-9)


@pytest.mark.slow
def test_scenes_at_once_are_fitted_as_each_alone():
    """Twice the light is half the material, and the derivative by the whole scene says so."""
    scene: Any
    scene, seen = lit_from(np.array(SETUPS["lights and camera"][1], float))
    image = np.asarray(ds.render(scene, seen), float).mean(-1)
    function = ds.fit_function(scene, ds.View(image, seen), free=FREE)

    def k_d(brightness):
        lamps = [dataclasses.replace(lamp, intensity=lamp.intensity * brightness) for lamp in scene.lights]
        return function(image, scene=dataclasses.replace(scene, lights=lamps)).values["k_d"]

    np.testing.assert_allclose(jax.jit(jax.vmap(k_d))(jnp.array([0.5, 1.0, 2.0])), [1.0, 0.5, 0.25], rtol=1e-6)
    slopes = jax.jit(jax.grad(lambda scene: function(image, scene=scene).values["k_d"]))(function.scene)
    total = sum(np.sum(slopes.lights[i].intensity * scene.lights[i].intensity) for i in (0, 1))
    np.testing.assert_allclose(total, -0.5, rtol=1e-6)
    theta = jnp.array([0.05, 0.5, 0.3, jnp.log(20.0)])
    assert jnp.abs(function.residuals(theta, image, scene=scene, cameras=[seen])).max() < 1e-6
    assert jnp.abs(function.residuals(theta, image, cameras=ds.Camera((0, 0, 3), shape=(16, 16)))).max() > 0.01


@pytest.mark.slow
def test_a_thousand_fits_end_at_or_below_the_cost_of_the_truth():
    images, cost = drawn(1000, 32)
    function = ds.fit_function(TOLD, ds.View(images[0], camera(32)), free=FREE)
    found = jax.jit(jax.vmap(function))(images)
    assert (found.cost > cost).sum() <= 2
    assert found.converged.all()


@pytest.mark.slow
def test_any_scene_views_in_colour_and_unknowns_at_a_bound():
    """Fog, two objects, two views of one light each; a k_s of 0, which no derivative moves."""
    fog = ds.Fog(0.1, I_dc=(0.3, 0.4, 0.5))
    floor = ds.Object(ds.Plane((0, -1, 0)), ds.Material(0.1, 0.4))
    ball = ds.Object(ds.Sphere(), ds.Material(0.1, (0.6, 0.5, 0.3), 0.0, 20, ds.Blinn()), name="ball")
    scene = ds.Scene((floor, ball), LAMPS, atmosphere=fog)
    pictures = [np.asarray(ds.render(scene, camera(20), lit=i)) for i in range(2)]
    views = [ds.View(picture, camera(20), lit=i) for i, picture in enumerate(pictures)]
    function = ds.fit_function(scene, views, free=("ball.material.k_d", "ball.material.k_s"))
    brighter = [np.stack([picture, 1.1 * picture]) for picture in pictures]
    found = jax.jit(jax.vmap(function))(*brighter)
    assert list(found.values) == ["ball.material.k_d", "ball.material.k_s"]
    np.testing.assert_allclose(found.values["ball.material.k_d"][0], (0.6, 0.5, 0.3), atol=1e-7)
    np.testing.assert_allclose(found.values["ball.material.k_s"][0], 0, atol=1e-7)

    def red(scale):
        return function(pictures[0] * scale, pictures[1]).values["ball.material.k_d"][0]

    slope, h = jax.jacfwd(red)(1.01), 1e-5
    np.testing.assert_allclose(slope, (red(1.01 + h) - red(1.01 - h)) / (2 * h), rtol=1e-5)

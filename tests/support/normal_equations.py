"""The normal equations of a fit: as it adds them up, and by whole images, without blocks, padding or stacked views."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from grams import whole
from synthetic import TIED, light_positions, seen_by, standard_scene

import diffshade as ds
from diffshade.inverse.data.samples import find_samples
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.data.views import is_grey
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.forward.gram import Gram
from diffshade.inverse.pixels.blocks import total
from diffshade.inverse.problem import FitProblem, fit_problem
from diffshade.inverse.unknowns.unknown import Unknown
from diffshade.parallel.threads import on_all_cores

# the time goes into compiling, not into running
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}
SMALL = ds.Camera(eye=(0, 0, 4), fov=32, shape=(10, 12))


def problem_of(scene: ds.Scene, views: Sequence[ds.View], unknowns: list[Unknown]) -> FitProblem:
    data = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge").data
    return fit_problem(scene, data, unknowns, "squares", rendered=True)


@jax.jit
def summary(theta, form, chunk):
    return form.summary(theta, chunk)


def gram(scene: ds.Scene, views: Sequence[ds.View], unknowns: list[Unknown], theta: np.ndarray) -> Gram:
    """Return the Gram of each view as a fit adds it up."""
    work = problem_of(scene, views, unknowns)
    found = total(on_all_cores(lambda chunk: summary(jnp.asarray(theta), work.model, chunk), work.chunks()))
    return whole(work.model.gram(jnp.asarray(theta), found), len(theta))


def dense_gram(
    scene: ds.Scene, views: Sequence[ds.View], unknowns: list[Unknown], theta: np.ndarray, *, moving=False
) -> Gram:
    """The same by `ds.render` and `jax.jacfwd`, view by view: no blocks, no padding, no stacks of views.

    What is not lit is dark here, not left out, so that one program serves all views.
    """

    def put(q):
        changed = scene, tuple(views)
        for j, u in enumerate(unknowns):
            value = jnp.exp(q[j]) if u.logarithmic else q[j]
            for place in u.places:
                leaf = place.value_in(*changed)
                new = value if leaf.ndim == 0 else jnp.asarray(leaf).at[place.channel].set(value)
                changed = eqx.tree_at(lambda both, place=place: place.value_in(*both), changed, new)
        return changed

    def image(q, camera, on, i):
        changed, seen = put(q)
        lights: Any = changed.lights
        dimmed = [light.intensity * switch for light, switch in zip(lights, on, strict=True)]
        switched = eqx.tree_at(lambda s: [light.intensity for light in s.lights], changed, dimmed)
        exposure, black = (jnp.stack([jnp.asarray(getattr(view, n)) for view in seen]) for n in ("exposure", "black"))
        picture = exposure[i] * ds.render(switched, camera) + black[i]
        return picture, picture

    both = jax.jit(jax.jacfwd(image, has_aux=True), compiler_options=QUICK)
    grams = []
    for i, view in enumerate(views):
        samples = find_samples(scene, view, moving=moving)
        on = [1.0 * (view.lit is None or i in view.lit) for i in range(len(scene.lights))]
        J, predicted = (np.asarray(array) for array in both(jnp.asarray(theta), view.camera, on, jnp.asarray(i)))
        target = np.where(samples.inside[..., None], samples.photograph, 0.0)
        if is_grey(view):
            J, predicted = J.mean(2, keepdims=True), predicted.mean(2, keepdims=True)
        floor, level = samples.sensor_range
        measured = (target > floor) & (target < level)
        short = (target >= level) & (predicted < target)
        over = (target <= floor) & (predicted > target)
        counts = samples.inside[..., None] & (measured | short | over)
        J, r = J[counts], (predicted - target)[counts]
        grams.append(Gram(np.asarray(0.5 * r @ r), J.T @ r, J.T @ J))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *grams)


def assert_equal(a: Gram, b: Gram) -> None:
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-10, atol=1e-10 * np.abs(y).max())


def random_views(scene: ds.Scene, cameras: Sequence, **options) -> list[ds.View]:
    """Photographs of noise, so that residuals are large and of both signs."""
    random = np.random.default_rng(0)
    return [ds.View(random.uniform(0.0, 1.0, (*camera.shape, 3)), camera, **options) for camera in cameras]


def lights_of_several_kinds_and_views_of_every_sort():
    """Each view has other lights on (all, one, none, two), another kind of image, another exposure."""
    position = light_positions(3)
    attenuation = ds.RadialAttenuation(1.0, 0.1, 0.05)
    scene = standard_scene(
        lights=[
            ds.PointLight(position[0], (1.0, 0.8, 0.6), attenuation),
            ds.SpotLight(position[2], -position[2], 2.0, 35.0, 2.0, attenuation, softness=10.0),
            ds.PointLight(position[1], 1.5, attenuation),
        ]
    )
    random = np.random.default_rng(0)
    noise = lambda *channels: random.uniform(0.0, 1.0, (*SMALL.shape, *channels))  # noqa: E731
    views = [
        ds.View(noise(3), SMALL, floor=0.2),
        ds.View(noise(), SMALL, lit=1, exposure=0.4, black=0.1),
        ds.View(noise(4), SMALL, lit=(), saturation=0.7),
        ds.View(noise(2), SMALL, mask=noise() > 0.3, lit=(2, 0), saturation=0.8),
    ]
    free = ("material", "lights.1", "intensity", "attenuation", "cutoff", "lights.2.position")
    return scene, views, (*free, "views.3.exposure", "black"), TIED


def several_objects_and_cameras():
    """A G-buffer and a sphere, tied in one colour, under two kinds of camera."""
    scene = ds.Scene(
        [
            ds.Object(seen_by(SMALL), ds.Material(0.1, (0.6, 0.4, 0.2), 0.3, 20)),
            ds.Object(ds.Sphere((0.5, 0.3, 0.8), 0.4), ds.Material(0.2, 0.5, 0.4, 60, lobe=ds.Blinn())),
        ],
        [ds.PointLight((2, 3, 4))],
    )
    far = ds.OrthographicCamera(eye=(0, 0.5, 5), height=2.5, shape=SMALL.shape, local_viewer=False)
    return scene, random_views(scene, [SMALL, far]), ("k_d", "n_s", "k_s"), ("k_d",)


def grey_views_of_normals_without_positions():
    flat = ds.OrthographicCamera((0, 0, 4), shape=SMALL.shape, local_viewer=False)
    surface = ds.GBuffer(seen_by(flat).normal)
    scene = ds.Scene(ds.Object(surface, ds.Material(0.1, 0.6, 0.3, 20)), [ds.DirectionalLight((1, -1, -1))])
    return (
        scene,
        [ds.View(np.random.default_rng(0).uniform(0.0, 1.0, SMALL.shape), flat)],
        ("material", "lights"),
        (),
    )

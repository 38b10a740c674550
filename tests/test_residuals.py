"""Views become residuals: which samples count, and that blocks, padding and stacking change nothing about them."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from synthetic import (
    TIED,
    light_positions,
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.inverse import residuals
from diffshade.inverse.parameters import Unknown, find_unknowns, slots_of
from diffshade.inverse.residuals import Problem, prepare
from diffshade.inverse.solvers import Gram, gram_by_view
from diffshade.inverse.views import find_samples, is_grey

SMALL = ds.Camera(eye=(0, 0, 4), fov=32, shape=(10, 12))
BALL = ds.Scene(ds.Object(ds.Sphere()), [ds.PointLight((2, 3, 4))])
SILHOUETTE = (6, 5)  # a pixel on the ball in SMALL
DARK = np.full((10, 12, 3), 0.5)


def changed(image: np.ndarray, *, at: tuple, value: float) -> np.ndarray:
    image = image.copy()
    image[at] = value
    return image


# --- what a view is


def test_a_grey_image_may_lack_its_channel_axis():
    assert ds.View(np.zeros((10, 12)), SMALL).image.shape == (10, 12, 1)
    assert is_grey(ds.View(np.zeros((10, 12)), SMALL))
    assert is_grey(ds.View(np.zeros((10, 12, 2)), SMALL))  # grey and alpha
    assert not is_grey(ds.View(np.zeros((10, 12, 3)), SMALL))
    assert not is_grey(ds.View(np.zeros((10, 12, 4)), SMALL))


@pytest.mark.parametrize("lit", [2, (2,), [2]])
def test_one_light_may_be_given_as_a_number(lit):
    assert ds.View(DARK, SMALL, lit=lit).lit == (2,)


def test_switches_are_no_indices():
    """(True, False) would silently mean lights 1 and 0."""
    with pytest.raises((TypeError, ValueError), match=r"lit"):
        ds.View(DARK, SMALL, lit=(True, False))


def test_all_lights_are_on_by_default_and_none_with_an_empty_lit():
    assert ds.View(DARK, SMALL).lit is None
    assert ds.View(DARK, SMALL, lit=()).lit == ()


@pytest.mark.parametrize(
    ("image", "options", "sentence"),
    [
        (DARK[..., None], {}, r"^View\.image must have shape .*; got \(10, 12, 3, 1\)\. Give"),
        (np.zeros((10, 12, 5)), {}, r"^View\.image must have shape .*; got \(10, 12, 5\)\. Give"),
        (np.zeros((10, 12, 3), np.uint8), {}, r"^View\.image must be .* floats; got uint8\. .* ds\.read_image\.$"),
        (np.zeros((10, 12, 3), bool), {}, r"^View\.image must be .* floats; got bool\."),
        (np.zeros((12, 10, 3)), {}, r"^View\.image must have the camera's shape \(10, 12\); got \(12, 10\)\. Give"),
        (DARK, {"mask": np.ones((12, 10), bool)}, r"^View\.mask must have the image's shape .*; got \(12, 10\)\."),
        (DARK, {"exposure": 0.0}, r"^View\.exposure must be above 0; got 0\.0\. Give 1 if it is not known\.$"),
        (DARK, {"exposure": -1.0}, r"^View\.exposure must be above 0; got -1\.0\."),
        (DARK, {"exposure": np.inf}, r"^View\.exposure must be finite; got inf\."),
        (DARK, {"exposure": (1.0, 2.0)}, r"^View\.exposure must be a number; got shape \(2,\)\. Give one number\.$"),
    ],
)
def test_what_is_no_view_is_refused_in_a_sentence(image, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        ds.View(image, ds.Camera((0, 0, 4), fov=32, shape=SMALL.shape), **options)


# --- which samples count


def test_without_a_mask_the_silhouette_counts():
    samples = find_samples(BALL, ds.View(DARK, SMALL))
    np.testing.assert_array_equal(samples.inside, ds.intersect(BALL, SMALL).mask)
    assert 0 < samples.inside.sum() < samples.inside.size
    assert samples.counts.sum() == 3 * samples.inside.sum()
    assert samples.saturated == 0


@pytest.mark.parametrize("kind", [bool, float])
def test_a_mask_takes_away_from_the_silhouette_and_adds_nothing(kind):
    left = np.broadcast_to(np.arange(12) < 6, (10, 12))
    samples = find_samples(BALL, ds.View(DARK, SMALL, mask=left.astype(kind)))
    np.testing.assert_array_equal(samples.inside, left & ds.intersect(BALL, SMALL).mask)


def test_a_mask_of_floats_is_inside_from_one_half():
    mask = changed(np.full((10, 12), 0.499), at=SILHOUETTE, value=0.5)
    assert np.argwhere(find_samples(BALL, ds.View(DARK, SMALL, mask=mask)).inside).tolist() == [list(SILHOUETTE)]


@pytest.mark.parametrize("channels", [1, 3])
def test_a_further_channel_is_alpha_and_takes_away_too(channels):
    alpha = changed(np.full((10, 12, 1), 0.499), at=SILHOUETTE, value=0.5)
    view = ds.View(np.concatenate([DARK[..., :channels], alpha], -1), SMALL)
    samples = find_samples(BALL, view)
    assert np.argwhere(samples.inside).tolist() == [list(SILHOUETTE)]
    assert samples.values.shape == (10, 12, channels)
    none = ds.View(view.image, SMALL, mask=changed(np.ones((10, 12), bool), at=SILHOUETTE, value=False))
    with pytest.raises(ValueError, match="no pixel is left to fit"):
        find_samples(BALL, none)


def test_a_sample_at_exactly_one_is_clipped_where_nothing_is_above():
    """The top of an integer file's range. The pixel's other channels still count."""
    samples = find_samples(BALL, ds.View(changed(DARK, at=(*SILHOUETTE, 1), value=1.0), SMALL))
    assert samples.saturated == 1
    assert samples.counts[SILHOUETTE].tolist() == [True, False, True]


@pytest.mark.parametrize("top", [1.0 - 1e-9, 1.0 + 1e-9, 3.0])
def test_another_largest_value_is_not_clipped(top):
    image = changed(changed(DARK, at=(*SILHOUETTE, 1), value=1.0), at=(*SILHOUETTE, 0), value=top)
    image[SILHOUETTE][1] = min(top, 1.0)
    assert find_samples(BALL, ds.View(image, SMALL)).saturated == 0


def test_saturation_names_the_level():
    image = changed(DARK, at=SILHOUETTE, value=0.9)
    assert find_samples(BALL, ds.View(image, SMALL, saturation=0.8)).saturated == 3
    assert find_samples(BALL, ds.View(image, SMALL, saturation=0.9)).saturated == 3
    assert find_samples(BALL, ds.View(image, SMALL, saturation=0.91)).saturated == 0
    ones = changed(DARK, at=SILHOUETTE, value=1.0)
    assert find_samples(BALL, ds.View(ones, SMALL, saturation=float("inf"))).saturated == 0


def test_a_number_that_is_not_finite_is_named_by_row_and_column_unless_it_is_masked():
    row, column = SILHOUETTE
    for bad in (np.nan, np.inf):
        image = changed(DARK, at=(*SILHOUETTE, 2), value=bad)
        with pytest.raises(ValueError, match=rf"finite inside the mask; got .* at row {row}, column {column} \(1 such"):
            find_samples(BALL, ds.View(image, SMALL))
        mask = changed(np.ones((10, 12), bool), at=SILHOUETTE, value=False)
        assert np.isfinite(find_samples(BALL, ds.View(image, SMALL, mask=mask)).values[mask]).all()


def test_a_corner_outside_the_silhouette_may_hold_anything():
    samples = find_samples(BALL, ds.View(changed(DARK, at=(0, 0), value=np.nan), SMALL))
    assert not samples.inside[0, 0]


@pytest.mark.parametrize(
    ("view", "sentence"),
    [
        (ds.View(DARK, SMALL, mask=np.zeros((10, 12), bool)), "no pixel is left to fit: .* Check that the mask"),
        (ds.View(DARK, SMALL, lit=1), r"lit must hold indices of the scene's 1 lights, from 0; got 1\."),
        (ds.View(DARK, SMALL, lit=-1), r"lit must hold indices of the scene's 1 lights, from 0; got -1\."),
        (ds.View(DARK, SMALL, saturation=0.5), r"every pixel is saturated: all are at least 0\.5\. Give a shorter"),
        (ds.View(np.ones_like(DARK), SMALL), r"every pixel is saturated: all are at least 1\."),
    ],
)
def test_a_view_that_leaves_nothing_to_fit_is_named_by_its_number(view, sentence):
    unknowns = find_unknowns(BALL, ("k_d",))
    with pytest.raises(ValueError, match=rf"^views\[1\]: {sentence}"):
        prepare(BALL, [ds.View(DARK, SMALL), view], slots_of(BALL, unknowns), moving=False)


def test_a_moving_surface_needs_a_mask_and_loses_one_pixel_of_its_edge():
    with pytest.raises(
        ValueError, match=r"^a fit of a surface needs a mask of what shows it; got none\. Give View\.mask"
    ):
        find_samples(BALL, ds.View(DARK, SMALL), moving=True)
    mask = np.zeros((10, 12), bool)
    mask[2:7, 3:8] = True
    mask[0, :] = True  # at the picture's own edge, and one pixel thin
    core = np.zeros((10, 12), bool)
    core[3:6, 4:7] = True
    np.testing.assert_array_equal(find_samples(BALL, ds.View(DARK, SMALL, mask=mask), moving=True).inside, core)
    rgba = np.concatenate([DARK, mask[..., None]], -1)
    np.testing.assert_array_equal(find_samples(BALL, ds.View(rgba, SMALL), moving=True).inside, core)


def test_a_mask_of_a_moving_surface_does_not_depend_on_where_the_surface_starts():
    everywhere = np.ones((10, 12), bool)
    assert find_samples(BALL, ds.View(DARK, SMALL, mask=everywhere), moving=True).inside.sum() == 8 * 10


def test_counts_add_up_over_views_of_all_kinds():
    silhouette = int(np.asarray(ds.intersect(BALL, SMALL).mask).sum())
    views = [
        ds.View(DARK, SMALL),
        ds.View(DARK[..., 0], SMALL),
        ds.View(changed(DARK, at=SILHOUETTE, value=1.0), SMALL),
        ds.View(DARK, SMALL, mask=changed(np.zeros((10, 12), bool), at=SILHOUETTE, value=True)),
    ]
    _, counts = prepare(BALL, views, slots_of(BALL, find_unknowns(BALL, ("k_d",))), moving=False)
    assert (counts.views, counts.pixels, counts.saturated) == (4, 3 * silhouette + 1, 3)
    assert counts.samples == (3 + 1 + 3) * silhouette - 3 + 3


# --- blocks, padding and stacking change nothing


compiled_gram = eqx.filter_jit(gram_by_view)


def gram(
    scene: ds.Scene, views: Sequence[ds.View], unknowns: list[Unknown], theta: np.ndarray, *, moving=False
) -> Gram:
    problem, _ = prepare(scene, views, slots_of(scene, unknowns), moving=moving)
    return compiled_gram(jnp.asarray(theta), problem)


def dense_gram(
    scene: ds.Scene, views: Sequence[ds.View], unknowns: list[Unknown], theta: np.ndarray, *, moving=False
) -> Gram:
    """The same by `ds.render` and `jax.jacfwd`, view by view: no blocks, no padding, no stacks of views.

    What is not lit is dark here, not left out, so that one program serves all views.
    """

    def put(q):
        changed = scene
        for j, u in enumerate(unknowns):
            value = jnp.exp(q[j]) if u.logarithmic else q[j]
            for path, c in u.places:

                def where(s, path=path):
                    for segment in path.split("."):
                        s = s[int(segment)] if segment.isdigit() else getattr(s, segment)
                    return s

                new = lambda leaf, c=c, value=value: value if leaf.ndim == 0 else jnp.asarray(leaf).at[c].set(value)  # noqa: E731
                changed = eqx.tree_at(where, changed, replace_fn=new)
        return changed

    def image(q, camera, on):
        lights: Any = put(q).lights
        dimmed = [light.intensity * switch for light, switch in zip(lights, on, strict=True)]
        switched = eqx.tree_at(lambda s: [light.intensity for light in s.lights], put(q), dimmed)
        picture = ds.render(switched, camera)
        return picture, picture

    both = jax.jit(jax.jacfwd(image, has_aux=True))
    grams = []
    for view in views:
        samples = find_samples(scene, view, moving=moving)
        on = [1.0 * (view.lit is None or i in view.lit) for i in range(len(scene.lights))]
        J, predicted = (float(view.exposure) * array for array in both(jnp.asarray(theta), view.camera, on))
        if samples.values.shape[-1] == 1:
            J, predicted = J.mean(2, keepdims=True), predicted.mean(2, keepdims=True)
        J, r = J[samples.counts], (predicted - samples.values)[samples.counts]
        grams.append(Gram(0.5 * r @ r, J.T @ r, J.T @ J))
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *grams)


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
        ds.View(noise(3), SMALL),
        ds.View(noise(), SMALL, lit=1, exposure=0.4),
        ds.View(noise(4), SMALL, lit=(), saturation=0.7),
        ds.View(noise(2), SMALL, mask=noise() > 0.3, lit=(2, 0)),
    ]
    return scene, views, ("material", "lights.1", "intensity", "attenuation", "cutoff", "lights.2.position"), TIED


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


PROBLEMS = [
    lights_of_several_kinds_and_views_of_every_sort,
    several_objects_and_cameras,
    grey_views_of_normals_without_positions,
]


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_gram_of_the_blocks_is_that_of_a_dense_jacobian(problem, monkeypatch):
    monkeypatch.setattr(residuals, "BLOCK", 37)  # several blocks a view, the last one padded
    with jax.enable_x64(True):
        scene, views, free, tied = problem()
        unknowns = find_unknowns(scene, free, tied, grey=all(is_grey(view) for view in views))
        theta = np.random.default_rng(1).uniform(0.2, 0.9, len(unknowns))
        theta[[u.name == "cutoff" for u in unknowns]] = 33.0
        assert_equal(gram(scene, views, unknowns, theta), dense_gram(scene, views, unknowns, theta))


def test_a_moving_sphere_is_compared_inside_its_fixed_mask():
    """A ray that misses takes the sphere's nearest point, so that one that starts too small has a slope too."""
    with jax.enable_x64(True):
        views = random_views(BALL, [SMALL], mask=seen_by(SMALL).mask)
        unknowns = find_unknowns(BALL, ("center", "radius", "k_d"))
        large, small = (np.array([0.02, -0.01, 0.03, radius, 0.5, 0.4, 0.3]) for radius in (1.05, 0.5))
        fills_the_mask = gram(BALL, views, unknowns, large, moving=True)
        assert_equal(fills_the_mask, dense_gram(BALL, views, unknowns, large, moving=True))
        shrunk = gram(BALL, views, unknowns, small, moving=True)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(shrunk))
        assert np.all(np.diagonal(shrunk.hessian[0]) > 0)


def test_padding_and_clipped_samples_have_no_residual():
    with jax.enable_x64(True):
        view = ds.View(changed(DARK, at=(*SILHOUETTE, 1), value=1.0), SMALL)
        unknowns = find_unknowns(BALL, ("k_d",))
        problem, counts = prepare(BALL, [view], slots_of(BALL, unknowns), moving=False)
        block = jax.tree.map(lambda leaf: leaf[0], problem.blocks)
        r = np.stack(eqx.filter_jit(Problem.residuals)(problem, jnp.full(3, 0.1), block))
        assert (r != 0).sum() == counts.samples == 3 * counts.pixels - 1

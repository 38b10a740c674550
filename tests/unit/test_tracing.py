"""What is seen through what (E13), where no oracle is needed to say it."""

import dataclasses

import jax
import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera((0.3, 0.2, 4), fov=40, shape=(12, 16))
LIGHT = ds.PointLight((2, 3, 4), 5)
SOLID = ds.Material(0.1, (0.7, 0.25, 0.2), 0.4, 12)
CLEAR = dataclasses.replace(SOLID, k_t=np.array([0.3, 0.6, 0.9]))
WALL = ds.Object(ds.Plane((0, 0, -2), (0.1, 0, 1)), ds.Material(k_a=ds.Chequer(0.1, (0.9, 0.8, 0.3))))


@pytest.fixture(autouse=True)
def _operation_by_operation():
    """The structures are many."""
    with jax.disable_jit():
        yield


def render(*objects, camera=CAMERA, **options):
    return np.asarray(ds.render(ds.Scene(objects, LIGHT, background=(0.1, 0.2, 0.3), **options), camera))


def ball(material, **options):
    return ds.Object(ds.Sphere(**options), material)


def with_k_t(k_t, **more):
    return dataclasses.replace(SOLID, k_t=np.broadcast_to(k_t, 3) * 1.0, **more)


@pytest.mark.thorough
def test_k_t_of_0_is_opaque_and_k_t_of_1_is_not_there():
    opaque, nothing = render(ball(SOLID), WALL), render(WALL)
    np.testing.assert_allclose(render(ball(with_k_t(0)), WALL), opaque, rtol=1e-14)
    np.testing.assert_allclose(render(ball(with_k_t(1)), WALL), nothing, rtol=1e-14)
    assert (np.abs(opaque - nothing) > 0.01).any(-1).sum() > 40


def test_what_shows_is_a_mixture_of_what_is_there_and_what_is_behind():
    opaque, nothing, k_t = render(ball(SOLID), WALL), render(WALL), np.array(CLEAR.k_t)
    np.testing.assert_allclose(render(ball(CLEAR), WALL), (1 - k_t) * opaque + k_t * nothing, rtol=1e-13)


def test_emission_and_highlight_are_covered_too():
    """(1 - k_t) multiplies all of what a surface sends."""
    bright = {"k_e": np.array([1.0, 2.0, 3.0]), "k_s": np.ones(3)}
    opaque = render(ball(dataclasses.replace(SOLID, **bright)), WALL)
    clear = render(ball(dataclasses.replace(CLEAR, **bright)), WALL)
    k_t = np.array(CLEAR.k_t)
    np.testing.assert_allclose(clear, (1 - k_t) * opaque + k_t * render(WALL), rtol=1e-13)


def test_a_gbuffer_lets_light_through_unbent():
    """Whatever its eta: it has no other side at which a ray could leave it."""
    seen = ds.intersect(ds.Scene(ds.Object(ds.Sphere())), CAMERA)
    buffer = ds.GBuffer(*map(np.asarray, (seen.normal, seen.position, seen.mask)))
    expected = render(ball(CLEAR), WALL)
    for eta in (1.0, 1.5):
        material = dataclasses.replace(CLEAR, eta=np.array(eta))
        np.testing.assert_allclose(render(ds.Object(buffer, material), WALL), expected, rtol=1e-12)


def test_a_plane_lets_light_through_unbent():
    panes = [ds.Object(ds.Plane((0, 0, 1), (0.2, 0.3, 1)), with_k_t(0.5, eta=np.array(eta))) for eta in (1.0, 1.7)]
    np.testing.assert_array_equal(render(panes[0], WALL), render(panes[1], WALL))


@pytest.mark.thorough
@pytest.mark.parametrize("eta", [0.5, 1.5])
def test_glass_that_bends_shows_something_else(eta):
    straight, bent = (render(ball(with_k_t(0.9, eta=np.array(e))), WALL) for e in (1.0, eta))
    assert (np.abs(straight - bent) > 0.01).any(-1).sum() > 20


def test_glass_behind_an_opaque_object_changes_nothing():
    behind = ball(with_k_t(0.9, eta=np.array(1.5)), center=(0, 0, -2), radius=0.3)
    before = ds.Object(ds.Plane((0, 0, 1), (0, 0, 1)), SOLID)
    np.testing.assert_allclose(render(before, behind), render(before), rtol=1e-14)


def test_what_lies_behind_the_camera_is_not_seen_through_glass():
    glass = ball(with_k_t(0.9, eta=np.array(1.5)))
    np.testing.assert_allclose(
        render(glass, ball(SOLID, center=(0, 0, 7))), render(glass, ball(SOLID, center=(0, 0, 99))), rtol=1e-14
    )


def test_the_nearest_of_several_surfaces_is_met_in_any_order():
    objects = [ball(SOLID, center=(-0.3, 0, 0)), ds.Object(ds.Box((0.4, 0.1, 0.2), (1, 1, 1), (10, 20, 30))), WALL]
    found = [ds.intersect(ds.Scene(some), CAMERA) for some in (objects, objects[::-1])]
    for name in ("normal", "position", "mask"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))
    alone = [ds.intersect(ds.Scene(item), CAMERA) for item in objects]
    eye = np.array([0.3, 0.2, 4])
    distance = [np.where(a.mask, np.linalg.norm(np.asarray(a.position) - eye, axis=-1), np.inf) for a in alone]
    position = np.asarray(found[0].position)
    np.testing.assert_allclose(np.linalg.norm(position - eye, axis=-1), np.min(distance, 0), rtol=1e-14)
    assert set(np.argmin(distance, 0).ravel()) == {0, 1, 2}


def test_air_before_glass_is_mixed_in_before_what_is_behind():
    """Black glass with k_t = 1/2 at depth 4, in fog, before a background that no fog reaches."""
    pane = ds.Object(ds.Plane((0, 0, 0), (0, 0, 1)), ds.Material(k_t=0.5))
    s = np.exp(-0.4)
    expected = 0.5 * (1 - s) * np.array([1.0, 0.5, 0]) + 0.5 * np.array([0.1, 0.2, 0.3])
    image = render(pane, atmosphere=ds.Fog(0.1, I_dc=(1, 0.5, 0)), camera=ds.Camera((0, 0, 4), shape=(12, 16)))
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=1e-13)

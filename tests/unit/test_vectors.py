"""The few operations of the model, and the derivative each gives where its formula has none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshade.model.vectors import (
    Vec3,
    cross,
    dot,
    halfway,
    length,
    normalize,
    positive_power,
    reflect,
    safe_sqrt,
    where,
)

RANDOM = np.random.default_rng(1)
A, B, C = (jnp.asarray(RANDOM.normal(size=(4, 5, 3))) for _ in range(3))
UNIT = A / np.linalg.norm(A, axis=-1, keepdims=True)
L = B / np.linalg.norm(B, axis=-1, keepdims=True)


def same(vector, array):
    np.testing.assert_allclose(vector.stack(), array, rtol=1e-13, atol=1e-14)


def test_taken_apart_and_put_together():
    np.testing.assert_array_equal(Vec3.of(A).stack(), A)
    np.testing.assert_array_equal(Vec3.of(A).y, A[..., 1])
    np.testing.assert_array_equal(Vec3.of(A[0, 0]).stack(), A[0, 0])
    mixed = Vec3(jnp.ones((4, 5)), jnp.array(2.0), jnp.array(3.0)).stack()
    np.testing.assert_array_equal(mixed, np.broadcast_to([1.0, 2, 3], (4, 5, 3)))


def test_arithmetic():
    a, b, s = Vec3.of(A), Vec3.of(B), A[..., 0]
    same(a + b, A + B)
    same(a - b, A - B)
    same(-a, -A)
    same(a * b, A * B)
    same(a * s, A * s[..., None])
    same(s * a, A * s[..., None])
    same(2.0 * a, 2 * A)
    same(where(s > 0, a, b), np.where(s[..., None] > 0, A, B))


def test_products():
    a, b = Vec3.of(A), Vec3.of(B)
    np.testing.assert_allclose(dot(a, b), np.sum(A * B, -1), rtol=1e-13, atol=1e-14)
    same(cross(a, b), np.cross(A, B))
    np.testing.assert_allclose(length(a), np.linalg.norm(A, axis=-1), rtol=1e-14)
    same(normalize(a), UNIT)


def test_the_mirror_direction():
    """l + r = 2(n.l)n, r is as long as l and on the other side of n."""
    n, l = Vec3.of(UNIT), Vec3.of(L)
    r = reflect(l, n)
    same(l + r, 2 * np.sum(UNIT * L, -1, keepdims=True) * UNIT)
    np.testing.assert_allclose(length(r), 1, rtol=1e-14)
    np.testing.assert_allclose(dot(r, n), dot(l, n), rtol=1e-12)
    same(reflect(r, n), L)


def test_the_halfway_vector():
    """It halves the angle between l and v; where n is h, v is the mirror direction of l."""
    l, v = Vec3.of(L), Vec3.of(UNIT)
    h = halfway(l, v)
    np.testing.assert_allclose(length(h), 1, rtol=1e-14)
    np.testing.assert_allclose(dot(h, l), dot(h, v), rtol=1e-12)
    np.testing.assert_allclose(2 * dot(h, l) ** 2 - 1, dot(l, v), atol=1e-12)  # cos 2a = 2 cos^2 a - 1
    same(reflect(l, h), UNIT)


def test_in_one_plane_blinns_angle_is_half_of_phongs():
    """angle(n, h) = angle(v, r)/2 where l, n and v lie in one plane."""
    random = np.random.default_rng(0)
    x, y = np.linalg.qr(random.normal(size=(3, 2)))[0].T  # the plane
    of_l, of_v = np.deg2rad(random.uniform(-89, 89, (2, 200)))[:, :, None]
    n = Vec3.of(np.broadcast_to(y, (200, 3)))
    l, v = (Vec3.of(np.sin(angle) * x + np.cos(angle) * y) for angle in (of_l, of_v))

    def between(a, b):  # well-conditioned at small angles, where arccos is not
        return np.arctan2(length(cross(a, b)), dot(a, b))

    r = reflect(l, n)
    np.testing.assert_allclose(between(n, halfway(l, v)), between(v, r) / 2, atol=1e-14)
    same(l + r, 2 * np.cos(of_l) * np.asarray(n.stack()))
    off = Vec3.of(jnp.asarray(np.roll(np.asarray(v.stack()), 1, axis=-1)))  # and not where v lies outside it
    assert (np.abs(between(n, halfway(l, off)) - between(off, r) / 2) > 0.01).mean() > 0.5


def test_zero_vectors_and_their_derivatives():
    zero = jnp.zeros(3)
    for function in (
        lambda a: length(Vec3.of(a)),
        lambda a: normalize(Vec3.of(a)).stack(),
        lambda a: halfway(Vec3.of(a + 1.0), -Vec3.of(jnp.ones(3))).stack(),
    ):
        np.testing.assert_array_equal(function(zero), 0)
        np.testing.assert_array_equal(jax.jvp(function, (zero,), (jnp.array([1.0, -2.0, 3.0]),))[1], 0)
        out, back = jax.vjp(function, zero)
        np.testing.assert_array_equal(back(jnp.ones_like(out)), 0)


@pytest.mark.parametrize(("x", "value", "slope"), [(4.0, 2.0, 0.25), (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)])
def test_safe_sqrt(x, value, slope):
    np.testing.assert_array_equal(jax.value_and_grad(safe_sqrt)(x), (value, slope))


@pytest.mark.parametrize(
    ("x", "n", "value", "by_x", "by_n"),
    [
        (0.5, 3.0, 0.125, 0.75, 0.125 * np.log(0.5)),
        (0.5, 0.0, 1.0, 0.0, np.log(0.5)),
        (1.0, 1e4, 1.0, 1e4, 0.0),
        (0.0, 3.0, 0.0, 0.0, 0.0),
        (0.0, 1.0, 0.0, 0.0, 0.0),
        (0.0, 0.5, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (-0.5, 0.0, 0.0, 0.0, 0.0),
        (-0.5, 2.0, 0.0, 0.0, 0.0),
        (-0.5, 1e4, 0.0, 0.0, 0.0),
    ],
)
def test_the_power_of_what_is_positive(x, n, value, by_x, by_n):
    x, n = jnp.array(x), jnp.array(n)
    np.testing.assert_allclose(positive_power(x, n), value, rtol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(positive_power, (0, 1))(x, n), (by_x, by_n), rtol=1e-13)
    np.testing.assert_allclose(jax.jacrev(positive_power, (0, 1))(x, n), (by_x, by_n), rtol=1e-13)

"""What derivatives compute once: the same values, and programs that do not grow with what their results share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.core import barriers
from diffshade.core.backend import QUICKLY, _known
from diffshade.core.barriers import computed_once, stored

X = jnp.linspace(0.1, 0.9, 12).reshape(3, 4)


def chained(a, *, once, steps=3):
    """A sum over pixels of a long chain, whose steps have numbers of their own: a tree with masks and fixed numbers."""
    x, mask = X, X > 0.5
    for i in range(steps):
        x = jnp.where(mask, x * a[i] + x * x, jnp.sin(x) * a[i])
        tree = {"x": x, "mask": x > 0.4, "fixed": X, "none": None}
        tree = computed_once(tree) if once else tree
        x, mask = tree["x"] * tree["fixed"], tree["mask"]
    return jnp.sum(x * x)


def instructions(text):
    return sum(" = " in line for line in text.splitlines())


def growth(f, *arguments):
    """How many times as many instructions a compiled program has as it is written."""
    lowered = jax.jit(f).lower(*arguments)
    compiled = lowered.compile(_known(tuple(QUICKLY.items())))
    return instructions(compiled.as_text()) / instructions(lowered.as_text("hlo"))


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd, lambda f: jax.jacfwd(jax.grad(f))])
def test_derivatives_are_the_same(derivative):
    a = jnp.array([0.3, 1.2, 0.7])
    found, expected = (jax.jit(derivative(lambda a, once=once: chained(a, once=once)))(a) for once in (True, False))
    np.testing.assert_allclose(found, expected, rtol=1e3 * np.finfo(found.dtype).eps)


@pytest.mark.thorough
def test_they_are_the_same_in_a_batch_and_a_scan():
    a = jnp.array([[0.3, 1.2, 0.7], [0.2, 0.1, 1.7]])

    def scanned(a, once):
        return jax.lax.scan(lambda total, a: (total + chained(a, once=once), None), 0.0, a)[0]

    for f in (jax.vmap(jax.grad(lambda a, once: chained(a, once=once)), (0, None)), jax.grad(scanned)):
        f = jax.jit(f, static_argnums=1)
        np.testing.assert_allclose(f(a, True), f(a, False), rtol=1e3 * np.finfo(a.dtype).eps)


def test_what_is_not_differentiated_has_no_barrier():
    a = jnp.array([0.3, 1.2, 0.7])
    plain, once = (jax.jit(lambda a, once=once: chained(a, once=once)) for once in (False, True))
    assert plain(a) == once(a)
    assert "inlineable" not in once.lower(a).as_text()
    assert "inlineable" in jax.jit(jax.grad(once)).lower(a).as_text()


def test_other_backends_have_no_barrier(monkeypatch):
    monkeypatch.setattr(barriers.jax, "default_backend", lambda: "tpu")
    assert "inlineable" not in jax.jit(jax.grad(lambda a: chained(a, once=True))).lower(X[0]).as_text()


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the CPU's compiler")
def test_a_derivative_does_not_repeat_what_its_results_share():
    a = jnp.linspace(0.1, 1.0, 16)
    with_barriers, without = (
        growth(jax.grad(lambda a, once=once: chained(a, once=once, steps=16)), a) for once in (True, False)
    )
    assert with_barriers < 0.5 * without


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the CPU's compiler")
def test_what_is_stored_is_not_repeated_in_what_shares_it():
    def shared(x, keep):
        for _ in range(8):
            x = jnp.sin(x) * x + jnp.cos(x)
        x = stored(x) if keep else x
        return [x * k + jnp.roll(x, k) for k in range(1, 9)]

    kept, fused = (growth(lambda x, keep=keep: shared(x, keep), X) for keep in (True, False))
    assert kept < 0.5 * fused
    for one, other in zip(*(jax.jit(lambda x, keep=keep: shared(x, keep))(X) for keep in (True, False)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


@pytest.mark.thorough
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the CPU's compiler")
@pytest.mark.parametrize("wall", [False, True])
def test_the_gradient_through_glass_grows_little_where_it_is_compiled(wall):
    """Without barriers by 4.1 and 18, and takes a minute."""
    camera, lamp = ds.Camera((0.3, 0.5, 5), shape=(4, 4)), ds.PointLight((2, 3, 4))
    behind = [ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), ds.Material(k_a=0.1, k_d=0.6))] * wall

    def loss(x):
        glass = ds.Object(ds.Sphere(x[:3], x[3]), ds.Material(k_a=0.1, k_t=0.8, eta=x[4]))
        return jnp.sum(jnp.square(ds.render(ds.Scene([glass, *behind], lamp, background=0.3), camera)))

    assert growth(jax.grad(loss), jnp.array([0.05, -0.1, 0.02, 1.0, 1.5])) < 3.5

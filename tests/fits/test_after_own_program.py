"""A fit after a user's own program that holds the same camera and scene, as most users have JAX: in float32.

All functions, and grad and vmap too: tests/studies/test_own_programs.py.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic

import diffshade as ds

SHAPE = (24, 23)  # silhouette and rays are compiled here: what is compiled already does not meet JAX's memory


def made() -> tuple[ds.Scene, list[ds.View]]:
    scene = synthetic.standard_scene(lights=synthetic.point_lights()[:3])
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=SHAPE)
    return scene, synthetic.one_light_each(synthetic.noisy(synthetic.photographs(scene, camera), 0.002, 0), camera)


@pytest.mark.thorough
def test_a_fit_gives_the_same_after_a_users_own_program():
    scene, views = made()
    known = [scene, views[0].camera]
    with jax.enable_x64(False):
        program = jax.jit(lambda x: x * sum(jnp.sum(leaf) for leaf in jax.tree.leaves(known)))
        jax.value_and_grad(program)(jnp.float32(1.5))
        image = ds.render(scene, views[0].camera)
        fit = ds.fit(scene, views, free=("k_d", "n_s"))
    again = ds.fit(*made(), free=("k_d", "n_s"))
    assert image.dtype == np.float32
    np.testing.assert_allclose(fit.values, again.values, rtol=1e-10)
    np.testing.assert_allclose(fit.plain_errors, again.plain_errors, rtol=1e-8)
